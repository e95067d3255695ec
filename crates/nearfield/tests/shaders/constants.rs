//! Numbers that stand on both sides.

use nearfield::HitRecord;
use nearfield::application::PointFlags;
use nearfield::geometry::Scalar;
use nearfield::geometry::distance::{LENGTH_SLACK, PERIOD_SLACK, RADIUS_SLACK, WRAP_SLACK};
use nearfield::gpu::SOFTWARE_LOOP_ROUNDS;
use nearfield::gpu::shader::{MODULES, compose};
use nearfield::gpu::wgpu::naga;
use nearfield::query::KNN_SPAN_POINTS;
use nearfield::structure::aabb_tree::any_dimension;

use crate::variants::parse;

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
    let fit = parse(&compose("package::structure::triangle_bvh::fit", &[], &[], true).unwrap()).unwrap();
    let slack = nearfield::structure::triangle_bvh::SLACK as f32;
    assert_eq!(constant(&fit, "SLACK").map(f32::to_bits), Some(slack.to_bits()), "SLACK");
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

#[test]
fn spans_of_packs_are_the_same_on_both_sides() {
    let source = MODULES.iter().find(|(module, _)| *module == "package::query::knn_words").unwrap().1;
    let line = format!("const SPAN_POINTS = {KNN_SPAN_POINTS}u;");
    assert!(source.contains(&line), "{line}");
}

#[test]
fn flags_of_points_are_the_same_on_both_sides() {
    let source = MODULES.iter().find(|(module, _)| *module == "package::application::point_flags").unwrap().1;
    for (bit, name) in PointFlags::NAMES.iter().enumerate() {
        let constant = format!("const {} = {}u;", name.replace('-', "_").to_uppercase(), 1 << bit);
        assert!(source.contains(&constant), "{constant}");
    }
}
