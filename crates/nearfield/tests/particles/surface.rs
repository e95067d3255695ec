//! Surfaces of fluids: closed, and where the outer particles end.

use libtest_mimic::Trial;
use nearfield::application::particles::{Dimensions, ParticleSurface, fill_ball, fill_box};
use nearfield::application::{ContourSettings, Watch, contour};
use nearfield::geometry::mesh_topology::MeshTopology;
use nearfield::{DVec3, Error, TriMesh, Vec3};

use crate::support::trial;

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("a_ball_of_particles_has_the_surface_of_a_ball", ball),
        trial("a_block_of_particles_ends_with_its_cells", block),
        trial("two_drops_have_two_surfaces_and_one_particle_has_one", drops),
        trial("surfaces_refuse_what_they_cannot_have", wrong_settings),
    ]
}

fn surface(settings: &ParticleSurface, centers: &[DVec3]) -> TriMesh {
    let points: Vec<Vec3> = centers.iter().map(|center| center.as_vec3()).collect();
    let field = settings.field(DVec3::ZERO, &points, &mut Watch::none()).expect("a field");
    contour(&(&field).into(), &ContourSettings::default(), &mut Watch::none()).expect("a surface").mesh()
}

fn ball() {
    let (radius, spacing) = (1.0, 0.1);
    let centers = fill_ball(DVec3::ZERO, radius, spacing, Dimensions::Three);
    let mesh = surface(&ParticleSurface::of_spacing(spacing), &centers);
    let topology = MeshTopology::of(&mesh);
    assert!(topology.is_closed() && topology.is_manifold() && topology.is_oriented());
    assert_eq!((topology.euler_number(), topology.components), (2, 1));
    for vertex in &mesh.vertices {
        let distance = (mesh.origin + vertex.as_dvec3()).length();
        assert!((distance - radius).abs() < spacing, "a vertex {distance} from the middle");
    }
}

fn block() {
    let spacing = 0.1;
    let centers = fill_box(DVec3::ZERO, DVec3::ONE, spacing, Dimensions::Three);
    let mesh = surface(&ParticleSurface::of_spacing(spacing), &centers);
    assert_eq!(MeshTopology::of(&mesh).euler_number(), 2);
    // In the middle of a face the lattice is that of a plane: the surface lies where the cells end, but for the discrete sum in place
    // of the integral.
    let middle = |v: &&DVec3| (v.x - 0.5).abs() < 0.2 && (v.y - 0.5).abs() < 0.2 && v.z > 0.5;
    let vertices: Vec<DVec3> = mesh.vertices.iter().map(|v| mesh.origin + v.as_dvec3()).collect();
    let heights: Vec<f64> = vertices.iter().filter(middle).map(|v| v.z).collect();
    assert!(heights.len() > 20);
    assert!(heights.iter().all(|height| (height - 1.0).abs() < 0.1 * spacing), "{heights:?}");
}

fn drops() {
    let settings = ParticleSurface::of_spacing(0.1);
    let mut centers = fill_ball(DVec3::ZERO, 0.5, 0.1, Dimensions::Three);
    centers.extend(fill_ball(DVec3::new(2.0, 0.0, 0.0), 0.5, 0.1, Dimensions::Three));
    let topology = MeshTopology::of(&surface(&settings, &centers));
    assert!(topology.is_closed());
    assert_eq!((topology.components, topology.euler_number()), (2, 4));
    // Around one particle, a ball of the settings' radius.
    let settings = ParticleSurface { cell: 0.01, ..settings };
    let mesh = surface(&settings, &[DVec3::ONE]);
    assert_eq!(MeshTopology::of(&mesh).euler_number(), 2);
    for vertex in &mesh.vertices {
        let distance = (mesh.origin + vertex.as_dvec3()).distance(DVec3::ONE);
        // Vertices stand where tangent planes meet that touch the ball at most a diagonal of a cell, √3 cells, from there.
        let bound = 1.5 * settings.cell * settings.cell / settings.radius;
        assert!((distance - settings.radius).abs() < bound, "{distance}");
    }
}

fn wrong_settings() {
    let usual = ParticleSurface::of_spacing(0.1);
    let field = |settings: ParticleSurface, points: &[Vec3]| settings.field(DVec3::ZERO, points, &mut Watch::none());
    for wrong in [
        ParticleSurface { radius: 0.0, ..usual },
        ParticleSurface { support: f64::NAN, ..usual },
        ParticleSurface { cell: -1.0, ..usual },
        ParticleSurface { support: usual.radius, ..usual },
    ] {
        assert!(matches!(field(wrong, &[Vec3::ZERO]), Err(Error::InvalidSetting { .. })), "{wrong:?}");
    }
    assert!(matches!(field(usual, &[]), Err(Error::InvalidSetting { .. })));
    assert!(matches!(field(usual, &[Vec3::NAN]), Err(Error::NonFinite { .. })));
}
