//! Every WESL module composed as the kernels use it and validated, and what it shares with Rust compared: needs no GPU.

use std::collections::{BTreeMap, BTreeSet};
use std::mem::offset_of;
use std::sync::OnceLock;

use nearfield::application::{PathParameters, PathState, SceneLayout};
use nearfield::curve::{Domain, MAX_LEVEL};
use nearfield::geometry::distance::{LENGTH_SLACK, PERIOD_SLACK, RADIUS_SLACK, WRAP_SLACK};
use nearfield::geometry::{PreparedTriangle, RaySpace};
use nearfield::gpu::SOFTWARE_LOOP_ROUNDS;
use nearfield::gpu::shader::{Fill, MODULES, compose};
use nearfield::gpu::wgpu::naga;
use nearfield::query::{Asked, Batch, HitN, KnnBatch, KnnRun, RayBatch, SearchN, SortBatch, Sweep};
use nearfield::structure::Scalar;
use nearfield::structure::aabb_tree::{AabbNode, TreeLayout, any_dimension};
use nearfield::structure::brute_force::{BruteForceLayout, TriangleList};
use nearfield::structure::kd_tree::{KdLeaf, KdNode, KdRoot};
use nearfield::structure::linear_octree::{OctreeLayout, OctreeNode, OctreeSummary};
use nearfield::structure::triangle_bvh::CompressedNode;
use nearfield::structure::uniform_grid::GridLayout;
use nearfield::{HitRecord, Ray, RayWork, Vec3};

/// Module paths that kernels fill: with a structure's traversal, and with a visitor.
const TRAVERSAL: &str = "package::structure::selected";
const VISITOR: &str = "package::structure::visitor";

/// The same for rays: a structure's walk, and what is done with the hits.
const TRACE: &str = "package::structure::ray_selected";
const HIT_VISITOR: &str = "package::structure::hit_visitor";

/// Condition of traversals that holds for visitors of masks, and only for them.
const MASKS: &str = "masks";

/// Conditions of a module of which exactly one holds.
const EXACTLY_ONE: &[(&str, &[&str])] = &[
    ("package::parallel::reduce", &["sum", "smallest", "largest"]),
    ("package::query::knn_boxes", &["few", "some", "many", "most"]),
];

/// A caller's visitor with a binding of its own.
const CALLERS_VISITOR: &str = "
import package::structure::question::{Query, Neighbor};

@group(1) @binding(0) var<storage, read_write> sums: array<f32>;

struct State { sum: f32 }

fn begin(query: Query) -> State { return State(0.0); }

fn visit(state: ptr<function, State>, query: Query, neighbor: Neighbor) -> bool {
    (*state).sum += sqrt(neighbor.dist2);
    return true;
}

fn finish(state: ptr<function, State>, query: Query) { sums[query.slot] = (*state).sum; }
";

type Modules = [(&'static str, &'static str)];

/// A module as it is composed somewhere, parsed and validated.
struct Variant {
    name: String,
    module: naga::Module,
}

// ---- what the sources say ----

fn without_comments(source: &str) -> String {
    source.lines().map(|line| line.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n")
}

/// Modules that a source imports.
fn imports(source: &str) -> BTreeSet<String> {
    let source = without_comments(source);
    let statements = source.split("import ").skip(1).filter_map(|rest| rest.split(';').next());
    let module = |statement: &str| {
        let path = statement.split("::{").next().unwrap_or_default();
        let path = if statement.contains("::{") { path } else { path.rsplit_once("::").map_or(path, |(m, _)| m) };
        path.trim().to_owned()
    };
    statements.map(module).collect()
}

/// Conditions that a source asks for.
fn conditions(source: &str) -> BTreeSet<String> {
    let source = without_comments(source);
    let inside = source.split("@if(").skip(1).filter_map(|rest| rest.split(')').next());
    let words = inside.flat_map(|text| text.split(|c: char| !c.is_alphanumeric() && c != '_'));
    words.filter(|word| !word.is_empty()).map(str::to_owned).collect()
}

fn is_root(source: &str) -> bool {
    without_comments(source).contains("@compute")
}

fn with_function<'a>(modules: &'a Modules, name: &str) -> impl Iterator<Item = &'static str> + use<'a> {
    let declaration = format!("fn {name}(");
    modules.iter().filter(move |(_, source)| source.contains(&declaration)).map(|(path, _)| *path)
}

fn source_of(modules: &Modules, path: &str) -> &'static str {
    modules.iter().find(|(p, _)| *p == path).map_or("", |(_, source)| source)
}

/// The module itself and all that it imports, with open paths as filled.
fn closure(modules: &Modules, root: &str, fills: &[(&str, &str)]) -> BTreeSet<String> {
    let mut reached = BTreeSet::new();
    let mut open = vec![root.to_owned()];
    while let Some(path) = open.pop() {
        let path = fills.iter().find(|(p, _)| *p == path).map_or(path, |(_, module)| (*module).to_owned());
        if reached.insert(path.clone()) {
            open.extend(imports(source_of(modules, &path)));
        }
    }
    reached
}

/// Every way to fill the open paths that a module needs. Visitors of masks go with traversals that give masks.
fn fillings(modules: &Modules, root: &str) -> Vec<Vec<(&'static str, &'static str)>> {
    let own = closure(modules, root, &[]);
    let hit_visitors: Vec<_> = with_function(modules, "finish_ray").collect();
    if own.contains(TRACE) {
        let traces = with_function(modules, "trace");
        let pairs = traces.flat_map(|t| hit_visitors.iter().map(move |&v| (t, v)));
        return pairs.map(|(t, v)| vec![(TRACE, t), (HIT_VISITOR, v)]).collect();
    }
    if own.contains(HIT_VISITOR) {
        return hit_visitors.iter().map(|&v| vec![(HIT_VISITOR, v)]).collect();
    }
    let visitors: Vec<_> = with_function(modules, "finish").collect();
    let takes_masks = |visitor: &str| source_of(modules, visitor).contains("fn visit_mask(");
    if own.contains(TRAVERSAL) {
        let traversals = with_function(modules, "traverse");
        let pairs = traversals.flat_map(|t| visitors.iter().map(move |&v| (t, v)));
        let fits = |t: &str, v: &str| !takes_masks(v) || conditions(source_of(modules, t)).contains(MASKS);
        return pairs.filter(|(t, v)| fits(t, v)).map(|(t, v)| vec![(TRAVERSAL, t), (VISITOR, v)]).collect();
    }
    if own.contains(VISITOR) {
        let fits = |v: &&str| !takes_masks(v) || own.iter().any(|m| conditions(source_of(modules, m)).contains(MASKS));
        return visitors.iter().copied().filter(fits).map(|v| vec![(VISITOR, v)]).collect();
    }
    vec![vec![]]
}

/// Every combination of the conditions that the modules ask for.
fn combinations(modules: &Modules, closure: &BTreeSet<String>) -> Vec<Vec<(String, bool)>> {
    let names: BTreeSet<String> = closure.iter().flat_map(|path| conditions(source_of(modules, path))).collect();
    let names: Vec<String> = names.into_iter().collect();
    let all = (0..1u32 << names.len())
        .map(|bits| names.iter().enumerate().map(|(i, name)| (name.clone(), bits >> i & 1 == 1)).collect::<Vec<_>>());
    let takes_masks = closure.iter().any(|path| source_of(modules, path).contains("fn visit_mask("));
    let allowed = |combination: &Vec<(String, bool)>| {
        let one_of_each = EXACTLY_ONE.iter().filter(|(path, _)| closure.contains(*path)).all(|(_, group)| {
            combination.iter().filter(|(name, on)| *on && group.contains(&name.as_str())).count() == 1
        });
        one_of_each && combination.iter().all(|(name, on)| name != MASKS || *on == takes_masks)
    };
    all.filter(allowed).collect()
}

/// Modules that no kernel uses.
fn unreached(modules: &Modules) -> Vec<&'static str> {
    let mut reached = BTreeSet::new();
    for (root, _) in modules.iter().filter(|(_, source)| is_root(source)) {
        for fill in fillings(modules, root) {
            reached.extend(closure(modules, root, &fill));
        }
    }
    modules.iter().map(|(path, _)| *path).filter(|path| !reached.contains(*path)).collect()
}

// ---- composing and validating ----

fn parse(wgsl: &str) -> Result<naga::Module, String> {
    let module = naga::front::wgsl::parse_str(wgsl).map_err(|e| e.emit_to_string(wgsl))?;
    let mut validator =
        naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::SUBGROUP);
    validator.validate(&module).map_err(|e| e.emit_to_string(wgsl))?;
    Ok(module)
}

fn variant(path: &str, fills: &[(&str, Fill<'_>)], combination: &[(String, bool)], keep_all: bool) -> Variant {
    let features: Vec<(&str, bool)> = combination.iter().map(|(name, on)| (name.as_str(), *on)).collect();
    let name = format!("{path} with {fills:?} and {features:?}");
    let composed = compose(path, fills, &features, keep_all).unwrap_or_else(|error| panic!("{name}: {error}"));
    let module = parse(&composed).unwrap_or_else(|error| panic!("{name}: {error}"));
    Variant { name, module }
}

/// Every kernel in every variant, and every other module by itself with all its declarations.
fn variants() -> &'static [Variant] {
    static ALL: OnceLock<Vec<Variant>> = OnceLock::new();
    ALL.get_or_init(|| {
        let mut all = Vec::new();
        for (path, source) in MODULES {
            for filling in fillings(MODULES, path) {
                let fills: Vec<_> = filling.iter().map(|&(at, module)| (at, Fill::Module(module))).collect();
                for combination in combinations(MODULES, &closure(MODULES, path, &filling)) {
                    all.push(variant(path, &fills, &combination, !is_root(source)));
                }
            }
        }
        all
    })
}

#[test]
fn every_module_composes_and_validates_in_every_variant() {
    let kernels = variants().iter().filter(|v| !v.module.entry_points.is_empty()).count();
    assert!(kernels >= MODULES.iter().filter(|(_, source)| is_root(source)).count());
    // Two traversals × (count, nearest, fill twice, nearest-k twice) × their own conditions.
    let queries = variants().iter().filter(|v| v.name.starts_with("package::query::fixed_radius ")).count();
    assert!(queries >= (2 + 4) * 6, "{queries} variants of the query kernel");
}

#[test]
fn a_callers_visitor_composes_with_every_traversal() {
    for traversal in with_function(MODULES, "traverse") {
        let fills = [(TRAVERSAL, Fill::Module(traversal)), (VISITOR, Fill::Caller(CALLERS_VISITOR))];
        let modules = closure(MODULES, "package::query::fixed_radius", &[(TRAVERSAL, traversal)]);
        for combination in combinations(MODULES, &modules) {
            let made = variant("package::query::fixed_radius", &fills, &combination, false);
            let named = |global: &naga::GlobalVariable| global.name.as_deref().is_some_and(|n| n.ends_with("sums"));
            assert!(made.module.global_variables.iter().any(|(_, global)| named(global)), "{}", made.name);
        }
    }
}

#[test]
fn what_does_not_validate_is_found() {
    assert!(parse("fn f() -> u32 { return 1.0f; }").is_err_and(|message| message.contains("wgsl:1")));
    assert!(parse("@group(0) @binding(0) var<storage, read> a: array<u32>; fn f() { a[0] = 1u; }").is_err());
}

#[test]
fn every_module_is_reached_from_a_kernel() {
    assert_eq!(unreached(MODULES), Vec::<&str>::new());
    let orphan = ("package::gpu::orphan", "fn unused() {}");
    assert_eq!(unreached(&[MODULES, &[orphan]].concat()), ["package::gpu::orphan"]);
}

/// Names of imported overrides are mangled, so that constants given to the pipeline would miss them.
#[test]
fn overrides_stand_in_kernels_only() {
    for (path, source) in MODULES {
        let has_override = without_comments(source).contains("override ");
        assert!(is_root(source) || !has_override, "{path} has an override but no entry point");
    }
    for Variant { name, module } in variants() {
        for (_, value) in module.overrides.iter() {
            assert!(
                matches!(value.name.as_deref(), Some("WORKGROUP" | "DIMENSION")),
                "{name}: override {:?}",
                value.name
            );
        }
    }
}

// ---- layouts ----

/// Name, offset and size of the fields of a struct, and its size.
#[derive(Debug, Clone, PartialEq)]
struct Layout {
    fields: Vec<(String, usize, usize)>,
    size: usize,
}

fn size_of_field<S, F>(_: fn(&S) -> &F) -> usize {
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
fn is_four_words(layout: &Layout) -> bool {
    let words = layout.fields.iter().map(|(_, offset, size)| (*offset, *size));
    layout.size == 16 && words.eq([(0, 4), (4, 4), (8, 4), (12, 4)])
}

/// The layouts in Rust by the struct's name in WESL.
fn twins() -> BTreeMap<&'static str, Layout> {
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
    BTreeMap::from([
        ("SceneLayout", scene),
        ("PathParameters", paths),
        ("SearchN", search),
        ("OctreeLayout", octree),
        ("TreeLayout", layout_of!(TreeLayout { period, n_points, inverse_period, depth })),
        ("GridLayout", grid),
        ("Layout", brute_force),
        ("Batch", batch),
        ("KnnRun", with_single_words(run)),
        ("KnnBatch", with_single_words(knn)),
        ("RayBatch", with_single_words(layout_of!(RayBatch { count, padding }))),
        ("SortBatch", with_single_words(layout_of!(SortBatch { count, padding }))),
        ("RaySpace", layout_of!(RaySpace { min, reach, max, margin })),
        ("KdRoot", layout_of!(KdRoot { low, padding_0, high, padding_1 })),
        ("TriangleList", layout_of!(TriangleList { low, n_triangles, high, only_within_box })),
        ("Sweep", sweep),
        ("Domain", domain()),
    ])
}

/// The layout with the array of words at its end as single words: arrays in uniforms have a stride of 16 bytes.
fn with_single_words(mut layout: Layout) -> Layout {
    let (name, offset, size) = layout.fields.pop().unwrap();
    layout.fields.extend((0..size / 4).map(|i| (format!("{name}_{i}"), offset + 4 * i, 4)));
    layout
}

/// Structs that stand in storage buffers.
fn stored_twins() -> BTreeMap<&'static str, Layout> {
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
        ("RayWork", layout_of!(RayWork { triangle_tests, node_visits, leaf_visits, rope_steps })),
    ];
    let compressed =
        layout_of!(CompressedNode { origin, steps, first_node, first_triangle, slots, low_xy, low_z_high_x, high_yz });
    let nodes = [("OctreeNode", node), ("Summary", summary), ("AabbNode", aabb_node), ("CompressedNode", compressed)];
    BTreeMap::from_iter(nodes.into_iter().chain(rays).chain([("Asked", asked), ("HitN", hit)]))
}

/// The layout of a domain, whose fields are private: from where its values stand.
fn domain() -> Layout {
    let made = Domain::new(Vec3::new(1.0, 2.0, 3.0), 4.0).unwrap();
    let scale = (1u32 << MAX_LEVEL) as f32 / 4.0;
    assert_eq!(bytemuck::cast::<_, [f32; 8]>(made), [1.0, 2.0, 3.0, 4.0, scale, 0.0, 0.0, 0.0]);
    let field = |name: &str, offset, size| (name.to_owned(), offset, size);
    let mut fields = vec![field("origin", 0, 12), field("edge", 12, 4), field("scale", 16, 4)];
    fields.extend((0..3).map(|i| (format!("padding_{i}"), 20 + 4 * i, 4)));
    Layout { fields, size: 32 }
}

/// The struct's own name, without the path that composition puts in front.
fn own_name(name: &str) -> &str {
    name.rsplit('_').next().unwrap_or(name)
}

fn reflected(module: &naga::Module, ty: naga::Handle<naga::Type>) -> Option<Layout> {
    let naga::TypeInner::Struct { members, span } = &module.types[ty].inner else { return None };
    let mut layouter = naga::proc::Layouter::default();
    layouter.update(module.to_ctx()).unwrap();
    let field =
        |m: &naga::StructMember| (m.name.clone().unwrap_or_default(), m.offset as usize, layouter[m.ty].size as usize);
    Some(Layout { fields: members.iter().map(field).collect(), size: *span as usize })
}

/// Why the uniform of this type is not what Rust writes there.
fn uniform_difference(module: &naga::Module, ty: naga::Handle<naga::Type>) -> Option<String> {
    let Some(found) = reflected(module, ty) else {
        let size = module.types[ty].inner.size(module.to_ctx());
        return (size != 16).then(|| format!("a uniform of {size} bytes that is no struct"));
    };
    let name = module.types[ty].name.clone().unwrap_or_default();
    match twins().get(own_name(&name)) {
        Some(twin) => (found != *twin).then(|| format!("{name} is {found:?}, in Rust {twin:?}")),
        None => (!is_four_words(&found)).then(|| format!("{name} has no twin in Rust: {found:?}")),
    }
}

#[test]
fn uniforms_have_the_bytes_of_their_twins() {
    let mut compared = BTreeSet::new();
    for Variant { name, module } in variants() {
        for (_, global) in module.global_variables.iter().filter(|(_, g)| g.space == naga::AddressSpace::Uniform) {
            if let Some(difference) = uniform_difference(module, global.ty) {
                panic!("{name}: {difference}");
            }
            compared.insert(own_name(module.types[global.ty].name.as_deref().unwrap_or_default()).to_owned());
        }
    }
    for twin in twins().keys() {
        assert!(compared.contains(*twin), "{twin} was not compared: {compared:?}");
    }
}

#[test]
fn stored_structs_have_the_bytes_of_their_twins() {
    let twins = stored_twins();
    let mut compared = BTreeSet::new();
    for Variant { name, module } in variants() {
        for (ty, definition) in module.types.iter() {
            let own = own_name(definition.name.as_deref().unwrap_or_default()).to_owned();
            if let (Some(twin), Some(found)) = (twins.get(own.as_str()), reflected(module, ty)) {
                assert_eq!(found, *twin, "{name}: {own}");
                compared.insert(own);
            }
        }
    }
    assert!(compared.iter().eq(twins.keys()), "{compared:?}");
}

#[test]
fn planted_bad_layouts_are_found() {
    let uniform = |fields: &str| {
        let module = parse(&format!("struct Layout {{ {fields} }} @group(0) @binding(3) var<uniform> domain: Layout;"));
        let module = module.unwrap();
        let ty = module.global_variables.iter().next().unwrap().1.ty;
        uniform_difference(&module, ty)
    };
    let vec3s = "period: vec3<f32>, n_points: u32, inverse_period: vec3<f32>";
    assert_eq!(uniform(&format!("{vec3s}, padding: u32")), None);
    assert!(uniform(&format!("{vec3s}, padding: u32, more: u32")).is_some(), "a longer struct");
    assert!(uniform("n_points: u32, period: vec3<f32>, inverse_period: vec3<f32>, padding: u32").is_some(), "moved");
    assert!(uniform("period: vec4<f32>, inverse_period: vec3<f32>, padding: u32").is_some(), "another size");
    assert!(uniform(&format!("{vec3s}, filling: u32")).is_some(), "another name");
}

#[test]
fn parts_of_bounds_are_eight_words() {
    let bounds: Vec<_> =
        variants().iter().filter(|v| v.name.starts_with("package::parallel::reduce::bounds ")).collect();
    assert!(!bounds.is_empty());
    for Variant { name, module } in bounds {
        let parts =
            module.global_variables.iter().filter(|(_, g)| g.name.as_deref().is_some_and(|n| n.contains("parts")));
        let strides: Vec<u32> = parts
            .filter_map(|(_, g)| match module.types[g.ty].inner {
                naga::TypeInner::Array { stride, .. } => Some(stride),
                _ => None,
            })
            .collect();
        assert!(strides.len() >= 2 && strides.iter().all(|&s| s == 32), "{name}: {strides:?}");
    }
}

/// Bindings of each group are numbered without gaps over all variants of a module, as `Access` lists number them.
#[test]
fn bindings_are_numbered_without_gaps() {
    let mut numbers: BTreeMap<(String, u32), BTreeSet<u32>> = BTreeMap::new();
    for Variant { name, module } in variants().iter().filter(|v| !v.module.entry_points.is_empty()) {
        let path = name.split(' ').next().unwrap_or_default();
        for (_, global) in module.global_variables.iter() {
            if let Some(binding) = &global.binding {
                numbers.entry((path.to_owned(), binding.group)).or_default().insert(binding.binding);
            }
        }
    }
    for ((path, group), found) in &numbers {
        assert!(found.iter().copied().eq(0..found.len() as u32), "{path}, group {group}: {found:?}");
    }
    assert_eq!(numbers[&("package::query::fixed_radius".to_owned(), 0)].len(), 6);
}

// ---- constants ----

fn constant(module: &naga::Module, name: &str) -> Option<f32> {
    let (_, constant) = module.constants.iter().find(|(_, c)| c.name.as_deref() == Some(name))?;
    match module.global_expressions[constant.init] {
        naga::Expression::Literal(naga::Literal::F32(value)) => Some(value),
        _ => None,
    }
}

#[test]
fn numbers_of_rays_are_the_same_on_both_sides() {
    let text = |path: &str, line: &str| {
        let source = MODULES.iter().find(|(module, _)| *module == path).unwrap().1;
        assert!(source.contains(line), "{path} should say {line:?}");
    };
    let (record, ray) = ("package::query::ray_cast::record", "package::geometry::prepared_ray");
    text("package::gpu::dispatch", &format!("const MOST_LOOP_ROUNDS = {SOFTWARE_LOOP_ROUNDS}u;"));
    text(record, &format!("const MISS = {:#x}u;", HitRecord::MISS));
    text(record, &format!("const INVALID = {:#x}u;", HitRecord::INVALID));
    text(record, &format!("const ABANDONED = {:#x}u;", HitRecord::ABANDONED));
    let module = parse(&compose(ray, &[], &[], true).unwrap()).unwrap();
    let lateral = 1.0 / (1u32 << 19) as f32;
    let slope = 1.0 / (1u64 << 60) as f32;
    for (name, value) in
        [("LATERAL", lateral), ("SMALLEST_SLOPE", slope), ("LARGEST", f32::MAX), ("MAX_COORDINATE", 1e18)]
    {
        assert_eq!(constant(&module, name).map(f32::to_bits), Some(value.to_bits()), "{name}");
    }
}

#[test]
fn slacks_are_the_same_on_both_sides() {
    let composed = compose("package::geometry::distance", &[], &[], true).unwrap();
    let module = parse(&composed).unwrap();
    let slacks = [
        ("RADIUS_SLACK", RADIUS_SLACK),
        ("LENGTH_SLACK", LENGTH_SLACK),
        ("PERIOD_SLACK", PERIOD_SLACK),
        ("WRAP_SLACK", WRAP_SLACK),
    ];
    for (name, value) in slacks {
        assert_eq!(constant(&module, name).map(f32::to_bits), Some(value.to_bits()), "{name}");
    }
    let composed = compose("package::structure::aabb_tree::any_dimension::rows", &[], &[], true).unwrap();
    let module = parse(&composed).unwrap();
    let length = 1.0 / <f32 as Scalar>::MAX_COORDINATE;
    for (name, value) in [("RADIUS_SLACK_N", any_dimension::RADIUS_SLACK as f32), ("LENGTH_SLACK_N", length)] {
        assert_eq!(constant(&module, name).map(f32::to_bits), Some(value.to_bits()), "{name}");
    }
}
