//! Winding numbers of the device against those of the CPU, and both against the sum over all elements.

use libtest_mimic::Trial;
use nearfield::application::{GpuWindingNumber, WindingNumber};
use nearfield::geometry::generate::{self, MeshKind};
use nearfield::gpu::Gpu;
use nearfield::{Error, Vec3};

use crate::support::{Random, gpu_trial};

fn places(n: usize) -> Vec<Vec3> {
    let mut random = Random(7);
    (0..n).map(|_| Vec3::from_array(std::array::from_fn(|_| 4.0 * random.unit() - 2.0))).collect()
}

/// Rounding of some hundred terms, each below 1; farther apart is only what one of them opens and the other does not.
fn compare(gpu: &Gpu, winding: &WindingNumber<f32>) {
    let places = places(3000);
    let numbers = GpuWindingNumber::upload(gpu, winding).unwrap().at_each(&places).unwrap();
    let mut far = 0;
    for (place, number) in places.iter().zip(numbers) {
        let expected = winding.at(place.to_array());
        let exact = winding.at_by_brute_force(place.to_array());
        far += usize::from((number - expected).abs() > 1e-4);
        assert!((number - exact).abs() < 2e-2, "{number} at {place}, the sum is {exact}");
    }
    assert!(far <= 3, "{far} differ from the CPU");
}

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("winding_numbers_of_samples_are_those_of_the_cpu", |gpu| {
            let mut random = Random(3);
            let mut normal = || Vec3::from_array(std::array::from_fn(|_| random.unit() - 0.5)).normalize();
            let normals: Vec<[f32; 3]> = (0..6000).map(|_| normal().to_array()).collect();
            let points: Vec<[f32; 3]> = normals.iter().map(|n| n.map(|x| 1.5 * x)).collect();
            let areas = vec![4.0 * std::f32::consts::PI * 2.25 / 6000.0; 6000];
            compare(gpu, &WindingNumber::of_points(&points, &normals, &areas).unwrap());
        }),
        gpu_trial("winding_numbers_of_meshes_are_those_of_the_cpu", |gpu| {
            let mesh = generate::mesh(MeshKind::Torus, 3000, 1);
            let vertices: Vec<[f32; 3]> = mesh.vertices.iter().map(|v| v.to_array()).collect();
            let winding = WindingNumber::of_triangles(&vertices, &mesh.triangles).unwrap();
            compare(gpu, &winding);
        }),
        gpu_trial("edges_of_winding_numbers_on_the_device", |gpu| {
            let nothing = WindingNumber::<f32>::of_points(&[], &[], &[]).unwrap();
            let on_device = GpuWindingNumber::upload(gpu, &nothing).unwrap();
            assert!(on_device.is_empty());
            assert_eq!(on_device.at_each(&[Vec3::ONE]).unwrap(), [0.0]);
            assert!(on_device.at_each(&[]).unwrap().is_empty());
            assert!(matches!(on_device.at_each(&[Vec3::NAN]), Err(Error::NonFinite { .. })));
            let one = WindingNumber::of_points(&[[0.0f32; 3]], &[[0.0, 0.0, 1.0]], &[1.0]).unwrap();
            let number = GpuWindingNumber::upload(gpu, &one).unwrap().at_each(&[Vec3::NEG_Z, Vec3::ZERO]).unwrap();
            let expected = 0.25 / std::f32::consts::PI;
            assert!((number[0] - expected).abs() < 1e-6 && number[1] == 0.0, "{number:?}");
        }),
    ]
}
