//! What the sources say: imports, conditions, and every way to fill the paths that are open.

use std::collections::BTreeSet;

/// Module paths that kernels fill: with a structure's traversal, and with a visitor.
pub(crate) const TRAVERSAL: &str = "package::structure::selected";
pub(crate) const VISITOR: &str = "package::structure::visitor";

/// The same for rays: a structure's walk, and what is done with the hits.
pub(crate) const TRACE: &str = "package::structure::ray_selected";
pub(crate) const HIT_VISITOR: &str = "package::structure::hit_visitor";

/// What distance fields are from: samples or triangles.
pub(crate) const SURFACE: &str = "package::application::distance_field::surface";

/// Condition of traversals that holds for visitors of masks, and only for them.
pub(crate) const MASKS: &str = "masks";

/// The kernel that runs visitors, and the condition under which invocations share its queries.
const QUERY_KERNEL: &str = "package::query::fixed_radius";
const SHARED: &str = "shared_queries";

/// Conditions of a module of which exactly one holds.
pub(crate) const EXACTLY_ONE: &[(&str, &[&str])] = &[
    ("package::parallel::reduce", &["sum", "smallest", "largest"]),
    ("package::query::knn_run", &["few", "some", "many", "most"]),
    ("package::structure::uniform_grid::find_pairs", &["counts", "keeps_masks", "marks", "fills"]),
];

pub(crate) type Modules = [(&'static str, &'static str)];

pub(crate) fn without_comments(source: &str) -> String {
    source.lines().map(|line| line.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n")
}

/// Modules that a source imports.
pub(crate) fn imports(source: &str) -> BTreeSet<String> {
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
pub(crate) fn conditions(source: &str) -> BTreeSet<String> {
    let source = without_comments(source);
    let inside = source.split("@if(").skip(1).filter_map(|rest| rest.split(')').next());
    let words = inside.flat_map(|text| text.split(|c: char| !c.is_alphanumeric() && c != '_'));
    words.filter(|word| !word.is_empty()).map(str::to_owned).collect()
}

pub(crate) fn is_root(source: &str) -> bool {
    without_comments(source).contains("@compute")
}

pub(crate) fn with_function<'a>(modules: &'a Modules, name: &str) -> impl Iterator<Item = &'static str> + use<'a> {
    let declaration = format!("fn {name}(");
    modules.iter().filter(move |(_, source)| source.contains(&declaration)).map(|(path, _)| *path)
}

pub(crate) fn source_of(modules: &Modules, path: &str) -> &'static str {
    modules.iter().find(|(p, _)| *p == path).map_or("", |(_, source)| source)
}

/// The module itself and all that it imports, with open paths as filled.
pub(crate) fn closure(modules: &Modules, root: &str, fills: &[(&str, &str)]) -> BTreeSet<String> {
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

/// Ways to fill the open paths that a module needs, each module among them. Visitors of masks go with traversals that give masks.
pub(crate) fn fillings(modules: &Modules, root: &str) -> Vec<Vec<(&'static str, &'static str)>> {
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
    if own.contains(SURFACE) {
        return with_function(modules, "nearest_to").map(|surface| vec![(SURFACE, surface)]).collect();
    }
    // Balls widen around queries for visitors of their own.
    if own.contains(VISITOR) && source_of(modules, root).contains("finish_row(") {
        return with_function(modules, "finish_row").map(|visitor| vec![(VISITOR, visitor)]).collect();
    }
    let visitors: Vec<_> = with_function(modules, "finish").collect();
    let takes_masks = |visitor: &str| source_of(modules, visitor).contains("fn visit_mask(");
    if own.contains(TRAVERSAL) {
        let traversals = with_function(modules, "traverse");
        let pairs = traversals.flat_map(|t| visitors.iter().map(move |&v| (t, v)));
        let fits = |t: &str, v: &str| !takes_masks(v) || conditions(source_of(modules, t)).contains(MASKS);
        let fitting: Vec<_> = pairs.filter(|(t, v)| fits(t, v)).collect();
        // Visitors of applications see the same from every traversal: one is enough. Those of queries go with all.
        let is_first =
            |t: &str, v: &str| fitting.iter().find(|(_, other)| *other == v).is_some_and(|(first, _)| *first == t);
        let is_kept = |t: &str, v: &str| v.starts_with("package::query::") || is_first(t, v);
        let kept = fitting.iter().filter(|(t, v)| is_kept(t, v));
        return kept.map(|&(t, v)| vec![(TRAVERSAL, t), (VISITOR, v)]).collect();
    }
    if own.contains(VISITOR) {
        let fits = |v: &&str| !takes_masks(v) || own.iter().any(|m| conditions(source_of(modules, m)).contains(MASKS));
        return visitors.iter().copied().filter(fits).map(|v| vec![(VISITOR, v)]).collect();
    }
    vec![vec![]]
}

/// Every combination of the conditions that the modules ask for.
pub(crate) fn combinations(modules: &Modules, closure: &BTreeSet<String>) -> Vec<Vec<(String, bool)>> {
    let names: BTreeSet<String> = closure.iter().flat_map(|path| conditions(source_of(modules, path))).collect();
    let names: Vec<String> = names.into_iter().collect();
    let all = (0..1u32 << names.len())
        .map(|bits| names.iter().enumerate().map(|(i, name)| (name.clone(), bits >> i & 1 == 1)).collect::<Vec<_>>());
    let takes_masks = closure.iter().any(|path| source_of(modules, path).contains("fn visit_mask("));
    // Invocations share queries where states can be combined, and only in the query kernel.
    let combines = closure.iter().any(|path| source_of(modules, path).contains("fn combine("));
    let allowed = |combination: &Vec<(String, bool)>| {
        let one_of_each = EXACTLY_ONE.iter().filter(|(path, _)| closure.contains(*path)).all(|(_, group)| {
            combination.iter().filter(|(name, on)| *on && group.contains(&name.as_str())).count() == 1
        });
        let is_on = |wanted: &str| combination.iter().any(|(name, on)| name == wanted && *on);
        let can_share = closure.contains(QUERY_KERNEL) && combines && !is_on(MASKS);
        one_of_each
            && combination.iter().all(|(name, on)| name != MASKS || *on == takes_masks)
            && (can_share || !is_on(SHARED))
    };
    all.filter(allowed).collect()
}

/// Modules that no kernel uses.
pub(crate) fn unreached(modules: &Modules) -> Vec<&'static str> {
    let mut reached = BTreeSet::new();
    for (root, _) in modules.iter().filter(|(_, source)| is_root(source)) {
        for fill in fillings(modules, root) {
            reached.extend(closure(modules, root, &fill));
        }
    }
    modules.iter().map(|(path, _)| *path).filter(|path| !reached.contains(*path)).collect()
}
