//! Every module in every combination, composed and validated.

use std::sync::OnceLock;

use nearfield::gpu::shader::{Fill, MODULES, compose};
use nearfield::gpu::wgpu::naga;
use rayon::prelude::*;

use crate::sources::*;

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

/// A module as it is composed somewhere, parsed and validated.
pub(crate) struct Variant {
    pub(crate) name: String,
    pub(crate) module: naga::Module,
}

pub(crate) fn parse(wgsl: &str) -> Result<naga::Module, String> {
    let module = naga::front::wgsl::parse_str(wgsl).map_err(|e| e.emit_to_string(wgsl))?;
    let mut validator =
        naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::SUBGROUP);
    validator.validate(&module).map_err(|e| e.emit_to_string(wgsl))?;
    Ok(module)
}

pub(crate) fn variant(
    path: &str,
    fills: &[(&str, Fill<'_>)],
    combination: &[(String, bool)],
    keep_all: bool,
) -> Variant {
    let features: Vec<(&str, bool)> = combination.iter().map(|(name, on)| (name.as_str(), *on)).collect();
    let name = format!("{path} with {fills:?} and {features:?}");
    let composed = compose(path, fills, &features, keep_all).unwrap_or_else(|error| panic!("{name}: {error}"));
    let module = parse(&composed).unwrap_or_else(|error| panic!("{name}: {error}"));
    Variant { name, module }
}

/// Every kernel in every variant, and every other module by itself with all its declarations.
pub(crate) fn variants() -> &'static [Variant] {
    static ALL: OnceLock<Vec<Variant>> = OnceLock::new();
    ALL.get_or_init(|| {
        let mut asked = Vec::new();
        for (path, source) in MODULES {
            for filling in fillings(MODULES, path) {
                for combination in combinations(MODULES, &closure(MODULES, path, &filling)) {
                    asked.push((path, filling.clone(), combination, !is_root(source)));
                }
            }
        }
        let made = |(path, filling, combination, keep_all): &(&&str, Vec<(&str, &'static str)>, Vec<_>, bool)| {
            let fills: Vec<_> = filling.iter().map(|&(at, module)| (at, Fill::Module(module))).collect();
            variant(path, &fills, combination, *keep_all)
        };
        asked.par_iter().map(made).collect()
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
