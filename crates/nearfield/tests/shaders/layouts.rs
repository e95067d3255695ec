//! Structs and bindings of the kernels against their twins in Rust.

use std::collections::{BTreeMap, BTreeSet};

use nearfield::gpu::wgpu::naga;

use crate::twins::{Layout, is_four_words, stored_twins, twins};
use crate::variants::{Variant, parse, variants};

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
