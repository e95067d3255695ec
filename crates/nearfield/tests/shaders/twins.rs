//! The layouts in Rust of the structs that kernels read and write.

use std::collections::BTreeMap;
use std::mem::offset_of;

use nearfield::application::mls::{ConcludeParameters, FitParameters, FitState, IterationSums, PointPlace};
use nearfield::application::particles::{
    DemCollide, DemIntegrate, DfsphFluid, DfsphProgress, ParticleBlock, ParticleClock, ParticleDrift,
    ParticleInspection, ParticlePart, ParticleRecord, PbfFluid, WcsphFluid, WcsphLimits,
};
use nearfield::application::wlop::{AdvanceParameters, DensityParameters, PairParameters, Pull, Record, RecordPart};
use nearfield::application::{
    ContourCell, ContourParameters, FieldParameters, PathParameters, PathState, SceneLayout, WindingLayout,
};
use nearfield::curve::{Domain, MAX_LEVEL};
use nearfield::geometry::{PreparedTriangle, RaySpace};
use nearfield::query::{
    Asked, Batch, CellsRun, HitN, KnnBatch, KnnRun, PairSearch, RayBatch, SearchN, SmallList, SortBatch, Sweep,
};
use nearfield::structure::aabb_tree::{AabbNode, TreeLayout};
use nearfield::structure::brute_force::{BruteForceLayout, TriangleList};
use nearfield::structure::cell_sort::CellSort;
use nearfield::structure::kd_tree::{KdLeaf, KdNode, KdRoot};
use nearfield::structure::linear_octree::{OctreeLayout, OctreeNode, OctreeSummary};
use nearfield::structure::multi_level_grid::MultiLevelLayout;
use nearfield::structure::triangle_bvh::CompressedNode;
use nearfield::structure::uniform_grid::GridLayout;
use nearfield::{HitRecord, Ray, RayWork, Vec3};

/// Name, offset and size of the fields of a struct, and its size.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Layout {
    pub(crate) fields: Vec<(String, usize, usize)>,
    pub(crate) size: usize,
}

pub(crate) fn size_of_field<S, F>(_: fn(&S) -> &F) -> usize {
    size_of::<F>()
}

macro_rules! layout_of {
    ($type:ty { $($field:ident),* }) => {
        Layout {
            fields: vec![$((
                stringify!($field).to_owned(),
                offset_of!($type, $field),
                size_of_field(|value: &$type| &value.$field),
            )),*],
            size: size_of::<$type>(),
        }
    };
}

/// Four words, as kernels of the array primitives take them: [u32; 4] in Rust.
pub(crate) fn is_four_words(layout: &Layout) -> bool {
    let words = layout.fields.iter().map(|(_, offset, size)| (*offset, *size));
    layout.size == 16 && words.eq([(0, 4), (4, 4), (8, 4), (12, 4)])
}

/// The layouts in Rust by the struct's name in WESL.
pub(crate) fn twins() -> BTreeMap<&'static str, Layout> {
    let grid = layout_of!(GridLayout {
        origin,
        n_points,
        inverse_cell,
        table_size,
        cells,
        hashed,
        period,
        periodic,
        inverse_period,
        farthest
    });
    let brute_force = layout_of!(BruteForceLayout { period, n_points, inverse_period, padding });
    let batch = with_single_words(layout_of!(Batch {
        count,
        first_id,
        exclude_self,
        own_radius,
        radius,
        in_parts,
        level,
        first,
        end,
        sharers,
        padding
    }));
    let run = layout_of!(KnnRun {
        count,
        first_id,
        exclude_self,
        own_radius,
        radius,
        k,
        first,
        in_parts,
        level,
        are_points,
        padding
    });
    let cells = layout_of!(CellsRun {
        count,
        first_id,
        exclude_self,
        own_radius,
        radius,
        k,
        reach,
        balls,
        scans,
        first,
        capacity,
        smallest
    });
    let knn = layout_of!(KnnBatch { count, first_id, exclude_self, own_radius, radius, k, padding });
    let sweep = layout_of!(Sweep { n_queries, first_id, flags, radius, n_packs, first_pack, end_pack, n_candidates });
    let octree = layout_of!(OctreeLayout { domain, period, n_points, inverse_period, n_nodes, extent, padding });
    let search = layout_of!(SearchN { n_points, depth, count, first, exclude_self, own_points, padding_0, padding_1 });
    let scene = layout_of!(SceneLayout {
        margin,
        emitter_share,
        environment_share,
        columns,
        rows,
        n_emitters,
        n_points,
        n_texels,
        emitter_sums,
        point_sums,
        texel_sums,
        row_cosines,
        materials,
        points,
        texels,
        padding
    });
    let paths = with_single_words(layout_of!(PathParameters {
        camera,
        width,
        height,
        first_pixel,
        n_paths,
        sample,
        seed,
        depth,
        most_depth,
        roulette_depth,
        next_event,
        padding
    }));
    let fit = layout_of!(FitParameters {
        weight_kind,
        weight_a,
        weight_b,
        least,
        has_normals,
        own_radii,
        degree,
        stage,
        from_origin,
        value,
        falloff,
        padding
    });
    let density =
        layout_of!(DensityParameters { inverse_radius2, falloff, skip2, own, result, padding_0, padding_1, padding_2 });
    let pairs = layout_of!(PairParameters {
        inverse_radius2,
        least_y,
        falloff,
        skip2,
        least_weight,
        twice_power,
        weighted,
        least_samples,
        mu,
        least_pull,
        drifts,
        padding
    });
    let conclude = layout_of!(ConcludeParameters {
        center,
        n_points,
        domain,
        accuracy,
        projects,
        is_last,
        oriented,
        n_sums,
        padding_0,
        padding_1
    });
    let inspection = layout_of!(ParticleInspection {
        n_particles,
        n_parts,
        rest_density,
        max_speed2,
        factor,
        length,
        sound_speed,
        least_step,
        most_step,
        padding_0,
        padding_1,
        padding_2
    });
    let collide = layout_of!(DemCollide {
        collider,
        radii,
        spring,
        damping,
        shear,
        attraction,
        pair_rule,
        one_class,
        quantum,
        inverse_quantum
    });
    let dfsph = layout_of!(DfsphFluid {
        gravity,
        n_particles,
        support,
        inverse_support,
        volume_factor,
        relaxation,
        rest_density,
        viscosity,
        xsph,
        fewest_neighbors,
        divergence_tolerance,
        density_tolerance,
        most_iterations,
        n_parts
    });
    let wcsph = layout_of!(WcsphFluid {
        gravity,
        n_particles,
        deepening,
        exponent,
        support,
        inverse_support,
        volume_factor,
        rest_density,
        sound_speed,
        inverse_sound_speed,
        artificial_viscosity,
        viscosity,
        density_diffusion,
        signal_speed,
        viscous_step,
        step_factor,
        least_step,
        n_parts,
        padding_0,
        padding_1
    });
    let contour =
        layout_of!(ContourParameters { corner, spacing, nodes, n_nodes, level, two_sided, threshold, n_cells });
    BTreeMap::from([
        (
            "FieldParameters",
            layout_of!(FieldParameters {
                grid_nodes,
                n_bricks,
                bricks,
                mode,
                radius,
                radius2,
                brick_radius,
                spacing,
                sigma,
                undefined,
                zero,
                padding
            }),
        ),
        ("WindingLayout", layout_of!(WindingLayout { center, scale, n_elements, depth, triangles, padding })),
        ("MlsFitParameters", fit),
        ("WlopDensityParameters", density),
        ("WlopParameters", pairs),
        ("WlopAdvanceParameters", layout_of!(AdvanceParameters { n_samples, n_parts, iteration, least_move })),
        ("MlsConcludeParameters", conclude),
        ("SceneLayout", scene),
        ("PathParameters", paths),
        ("SearchN", search),
        ("OctreeLayout", octree),
        ("TreeLayout", layout_of!(TreeLayout { period, n_points, inverse_period, depth })),
        ("GridLayout", grid),
        ("MultiLevelLayout", layout_of!(MultiLevelLayout { n_points, n_levels, rule, padding, levels })),
        ("Layout", brute_force),
        ("Batch", batch),
        (
            "SmallList",
            layout_of!(SmallList {
                n_points,
                window_words,
                capacity,
                exclude_self,
                radius2,
                padding_0,
                padding_1,
                padding_2
            }),
        ),
        ("PairSearch", layout_of!(PairSearch { capacity, n_pairs, radius, padding })),
        ("KnnRun", with_single_words(run)),
        ("CellsRun", cells),
        ("KnnBatch", with_single_words(knn)),
        ("RayBatch", with_single_words(layout_of!(RayBatch { count, padding }))),
        ("SortBatch", with_single_words(layout_of!(SortBatch { count, padding }))),
        ("RaySpace", layout_of!(RaySpace { min, reach, max, margin })),
        ("KdRoot", layout_of!(KdRoot { low, padding_0, high, padding_1 })),
        ("TriangleList", layout_of!(TriangleList { low, n_triangles, high, only_within_box })),
        ("Sweep", sweep),
        ("Domain", domain()),
        ("ContourParameters", contour),
        ("CellSort", layout_of!(CellSort { n_points, padding_0, padding_1, padding_2 })),
        ("ParticleBlock", layout_of!(ParticleBlock { first, count, padding_0, padding_1 })),
        ("ParticleDrift", layout_of!(ParticleDrift { n_points, limit2, padding_0, padding_1 })),
        ("ParticleInspection", inspection),
        (
            "DemIntegrate",
            layout_of!(DemIntegrate { gravity, n_particles, low, global_damping, high, wall_damping, radii }),
        ),
        ("DemCollide", collide),
        ("DfsphFluid", dfsph),
        ("WcsphFluid", wcsph),
        (
            "PbfFluid",
            layout_of!(PbfFluid {
                low,
                n_particles,
                high,
                support,
                gravity,
                inverse_support,
                value_factor,
                gradient_factor,
                relaxation,
                tensile,
                rest_density,
                xsph,
                vorticity,
                n_parts
            }),
        ),
    ])
}

/// The layout with the array of words at its end as single words: arrays in uniforms have a stride of 16 bytes.
pub(crate) fn with_single_words(mut layout: Layout) -> Layout {
    let (name, offset, size) = layout.fields.pop().unwrap();
    layout.fields.extend((0..size / 4).map(|i| (format!("{name}_{i}"), offset + 4 * i, 4)));
    layout
}

/// Structs that stand in storage buffers.
pub(crate) fn stored_twins() -> BTreeMap<&'static str, Layout> {
    let node =
        layout_of!(OctreeNode { low, level, first_point, end_point, first_child, rope, octant, parent, child_mask });
    let summary = layout_of!(OctreeSummary { n_nodes, n_outside, first_outside, is_overfull });
    let aabb_node = layout_of!(AabbNode { low, first_point, high, end_point });
    let (asked, hit) = (layout_of!(Asked { id, radius }), layout_of!(HitN { index, dist2 }));
    let rays = [
        ("Ray", layout_of!(Ray { origin, t_min, direction, t_max })),
        ("PreparedTriangle", layout_of!(PreparedTriangle { low, index, middle, corners, high, padding })),
        ("KdNode", layout_of!(KdNode { split, link })),
        ("KdLeaf", layout_of!(KdLeaf { min, first, max, count, ropes, padding_0, padding_1 })),
        ("HitRecord", layout_of!(HitRecord { triangle, t, weights })),
        ("PathState", layout_of!(PathState { origin, slot, direction, density, throughput, eta_scale })),
        ("ContourCell", layout_of!(ContourCell { number, inside_cut, emitted_heads, padding })),
        ("RayWork", layout_of!(RayWork { triangle_tests, node_visits, leaf_visits, rope_steps })),
    ];
    let fits = [
        ("MlsFit", layout_of!(FitState { goal, said, normal, curvature, mean_distance, reach, t, state })),
        ("MlsPlace", layout_of!(PointPlace { origin, done, at, flags, normal, curvature })),
        ("WlopPull", layout_of!(Pull { offset, weight, crowd, inputs, padding_0, padding_1 })),
        ("WlopPart", layout_of!(RecordPart { moves, largest, inputs, samples, unattracted, lost, first_lost })),
        ("WlopRecord", layout_of!(Record { moves, largest, inputs, samples, unattracted, is_made, lost, first_lost })),
        (
            "MlsSums",
            layout_of!(IterationSums {
                fitted,
                moving,
                neighbors,
                moves,
                largest,
                along,
                outwards,
                distances,
                flagged,
                padding
            }),
        ),
    ];
    let particles = [
        ("DfsphProgress", layout_of!(DfsphProgress { iterations, is_done, mean, largest })),
        ("WcsphLimits", layout_of!(WcsphLimits { acceleration2, speed2, excess })),
        ("ParticleClock", layout_of!(ParticleClock { time_step, time, made, padding })),
        ("ParticlePart", layout_of!(ParticlePart { neighbors, max_speed2, compression, max_compression, first_bad })),
        (
            "ParticleRecord",
            layout_of!(ParticleRecord {
                neighbors,
                max_speed2,
                compression,
                max_compression,
                first_bad,
                time_step,
                time,
                padding,
                position,
                velocity
            }),
        ),
    ];
    let compressed =
        layout_of!(CompressedNode { origin, steps, first_node, first_triangle, slots, low_xy, low_z_high_x, high_yz });
    let nodes = [("OctreeNode", node), ("Summary", summary), ("AabbNode", aabb_node), ("CompressedNode", compressed)];
    BTreeMap::from_iter(
        nodes.into_iter().chain(rays).chain(fits).chain(particles).chain([("Asked", asked), ("HitN", hit)]),
    )
}

/// The layout of a domain, whose fields are private: from where its values stand.
pub(crate) fn domain() -> Layout {
    let made = Domain::new(Vec3::new(1.0, 2.0, 3.0), 4.0).unwrap();
    let scale = (1u32 << MAX_LEVEL) as f32 / 4.0;
    assert_eq!(bytemuck::cast::<_, [f32; 8]>(made), [1.0, 2.0, 3.0, 4.0, scale, 0.0, 0.0, 0.0]);
    let field = |name: &str, offset, size| (name.to_owned(), offset, size);
    let mut fields = vec![field("origin", 0, 12), field("edge", 12, 4), field("scale", 16, 4)];
    fields.extend((0..3).map(|i| (format!("padding_{i}"), 20 + 4 * i, 4)));
    Layout { fields, size: 32 }
}
