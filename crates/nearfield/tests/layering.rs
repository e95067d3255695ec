//! Reads every import of the library's `.rs` and `.wesl` files and fails on one that points against the flow.
//!
//! Tests inside `src` are exempt (`#[cfg(test)]` items, the files of `#[cfg(test)] mod name;`, `tests.rs`), and so is
//! `lib.rs`, which names everything.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// The flow io → geometry → curve → structure → query → application, with the services gpu and parallel: a module, and
/// what it may use. A module only uses what stands above it in this table.
const MAY_USE: &[(&str, &[&str])] = &[
    ("error", &[]),
    ("host_memory", &["error"]),
    ("geometry", &["error"]),
    // Files become values of geometry; only an application, at the end of the flow, writes files itself.
    ("io", &["error", "geometry"]),
    ("gpu", &["error", "host_memory"]),
    // A reduction gives a bounding box: parallel knows the values of geometry, nothing above them.
    ("parallel", &["error", "host_memory", "geometry", "gpu"]),
    ("curve", &["error", "geometry", "gpu", "parallel"]),
    ("structure", &["error", "host_memory", "geometry", "gpu", "parallel", "curve"]),
    ("query", &["error", "host_memory", "geometry", "gpu", "parallel", "curve", "structure"]),
    ("application", &["error", "host_memory", "geometry", "io", "gpu", "parallel", "curve", "structure", "query"]),
];

/// What the root of the crate re-exports from outside: no module of ours.
const FOREIGN: &str = "";

#[test]
fn the_table_itself_points_one_way() {
    for (place, (module, used)) in MAY_USE.iter().enumerate() {
        for name in *used {
            assert!(
                MAY_USE[..place].iter().any(|(above, _)| above == name),
                "{module} uses {name}, which is not above it"
            );
        }
    }
}

#[test]
fn every_import_follows_the_flow() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let read = |path: &Path| fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let root_names = root_names(&read(&root.join("lib.rs")));
    let mut files = vec![];
    collect(&root, &mut files);
    let sources: Vec<(PathBuf, String)> = files
        .into_iter()
        .map(|path| (path.strip_prefix(&root).expect("a file should lie under its root").to_path_buf(), read(&path)))
        .collect();
    assert!(sources.len() > 10, "only {} files were found", sources.len());
    let mut arrows = vec![];
    let exempt = test_files(&sources);
    for (path, text) in sources.iter().filter(|(path, _)| path != Path::new("lib.rs") && !exempt.contains(path)) {
        arrows.extend(wrong_arrows(path, text, &root_names));
    }
    assert!(arrows.is_empty(), "imports against the flow:\n{}", arrows.join("\n"));
}

#[test]
fn planted_wrong_arrows_are_found() {
    let names = root_names(
        "pub use error::{Error, Result};\npub use geometry::{Aabb};\npub use query::Neighbors;\npub use glam::Vec3;",
    );
    let wrong = |path: &str, text: &str| wrong_arrows(Path::new(path), text, &names);

    for (path, text, to) in [
        ("geometry/aabb.rs", "use crate::structure::UniformGrid;", "structure"),
        ("geometry/aabb.rs", "use crate::{Error, geometry::{Ray, ray::X}, query::{neighbors::Row}};", "query"),
        ("geometry/mod.rs", "use super::io;", "io"),
        ("geometry/generate/mod.rs", "use super::super::gpu::Gpu;", "gpu"),
        ("structure/grid/cpu.rs", "fn f() -> crate::Neighbors { todo() }", "query"),
        ("parallel/scan.rs", "mod inner { use super::super::super::curve::morton; }", "curve"),
        ("gpu/mod.rs", "#[cfg(test)] mod tests { use crate::query::X; }\nfn f() { crate::geometry::f(); }", "geometry"),
        ("gpu/mod.rs", "#[cfg(not(test))]\nuse crate::parallel::scan;", "parallel"),
        ("query/knn.rs", "use crate::r#application::x;", "application"),
        ("newcomer/x.rs", "use crate::error::Error;", "newcomer"),
        ("geometry/ray.rs", "use crate::newcomer::X;", "newcomer"),
        ("geometry/aabb.wesl", "import package::query::walk::{step};", "query"),
        ("parallel/scan.wesl", "import super::super::structure::grid;", "structure"),
        ("gpu/dispatch.wesl", "fn f() -> u32 { return package::parallel::tile::SIZE; }", "parallel"),
    ] {
        let found = wrong(path, text);
        assert_eq!(found.len(), 1, "{path}: {text}: {found:?}");
        assert!(found[0].contains(path) && found[0].contains(to), "{}", found[0]);
    }

    for (path, text) in [
        ("query/knn.rs", "use crate::{structure::Grid, geometry::distance, Error, Vec3, Aabb}; use super::Neighbors;"),
        (
            "geometry/aabb.rs",
            "// use crate::query::X;\n/* crate::io /* crate::gpu */ */ const S: &str = \"crate::io::x\";",
        ),
        (
            "geometry/aabb.rs",
            "const R: &str = r#\"crate::io \" crate::gpu\"#; const C: char = '\"'; fn f<'a>(_: &'a str) {}",
        ),
        ("geometry/aabb.rs", "#[cfg(test)]\n#[allow(dead_code)]\nmod tests { mod deep { use crate::query::X; } }"),
        ("geometry/aabb.rs", "#[cfg(all(test, feature = \"gpu\"))]\nuse crate::gpu::Gpu;\nuse crate::error::Error;"),
        ("geometry/generate/mod.rs", "use super::Aabb; mod inner { use super::super::Ray; } pub(crate) fn f() {}"),
        ("structure/grid/query.wesl", "import package::geometry::distance::dist2;\nimport super::cells;"),
    ] {
        assert_eq!(wrong(path, text), Vec::<String>::new(), "{path}: {text}");
    }
}

#[test]
fn files_of_test_modules_are_exempt() {
    let source = |path: &str, text: &str| (PathBuf::from(path), text.to_owned());
    let sources = [
        source("io/mod.rs", "#[cfg(test)]\nmod test_data;\nmod ply;"),
        source("io/ply.rs", "#[cfg(test)] mod cases;"),
        source("io/ply/cases.rs", ""),
        source("io/test_data.rs", ""),
        source("geometry/generate/tests.rs", ""),
    ];
    let exempt = test_files(&sources);
    assert!(exempt.contains(Path::new("io/test_data.rs")) && exempt.contains(Path::new("io/ply/cases.rs")));
    assert!(exempt.contains(Path::new("geometry/generate/tests.rs")));
    assert!(!exempt.contains(Path::new("io/ply.rs")) && !exempt.contains(Path::new("io/mod.rs")));
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    let entries = fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    for entry in entries {
        let path = entry.expect("a folder's entry should be readable").path();
        if path.is_dir() {
            collect(&path, files);
        } else if path.extension().is_some_and(|extension| extension == "rs" || extension == "wesl") {
            files.push(path);
        }
    }
}

/// Names that `lib.rs` re-exports at the crate's root, and the module each comes from.
fn root_names(lib: &str) -> BTreeMap<String, String> {
    let tokens = tokens(lib);
    let mut names = BTreeMap::new();
    for at in (0..tokens.len()).filter(|&at| tokens[at] == "use") {
        for path in path_tree(&tokens, at + 1) {
            let module = if known(&path[0]) { path[0].clone() } else { FOREIGN.to_owned() };
            names.insert(path[path.len() - 1].clone(), module);
        }
    }
    names
}

fn known(module: &str) -> bool {
    MAY_USE.iter().any(|(name, _)| *name == module)
}

/// Files that hold only tests.
fn test_files(sources: &[(PathBuf, String)]) -> BTreeSet<PathBuf> {
    let is_tests = |path: &Path| path.file_name().is_some_and(|name| name == "tests.rs");
    let mut files: BTreeSet<PathBuf> =
        sources.iter().map(|(path, _)| path.clone()).filter(|path| is_tests(path)).collect();
    for (path, text) in sources {
        let folder: PathBuf = module_path(path).iter().collect();
        for name in without_tests(&tokens(text)).1 {
            files.insert(folder.join(format!("{name}.rs")));
            files.insert(folder.join(name).join("mod.rs"));
        }
    }
    files
}

/// The module a file is: `a/b.rs` is a::b, `a/mod.rs` is a.
fn module_path(path: &Path) -> Vec<String> {
    let mut parts: Vec<String> =
        path.with_extension("").iter().map(|part| part.to_string_lossy().into_owned()).collect();
    if parts.last().is_some_and(|last| last == "mod" || last == "lib") {
        parts.pop();
    }
    parts
}

/// The imports of one file that its module may not have, as messages.
fn wrong_arrows(path: &Path, text: &str, root_names: &BTreeMap<String, String>) -> Vec<String> {
    let module = module_path(path);
    let Some((_, may_use)) = MAY_USE.iter().find(|(name, _)| *name == module[0]) else {
        return vec![format!("{}: module {} has no place in the flow", path.display(), module[0])];
    };
    let mut wrong = BTreeSet::new();
    for used in used_paths(&without_tests(&tokens(text)).0, &module) {
        let Some(first) = used.first() else { continue };
        let target = root_names.get(first).unwrap_or(first).as_str();
        if target == FOREIGN || target == module[0] || may_use.contains(&target) {
            continue;
        }
        let problem = if known(target) { "may not be used there" } else { "has no place in the flow" };
        wrong.insert(format!("{}: {} ({target} {problem})", path.display(), used.join("::")));
    }
    wrong.into_iter().collect()
}

/// Every path from the crate's root that the code names, `super` resolved.
fn used_paths(tokens: &[String], module: &[String]) -> Vec<Vec<String>> {
    let mut paths = vec![];
    // Inline modules that are open: `super` counts from the innermost.
    let (mut here, mut depth, mut opened) = (module.to_vec(), 0u32, vec![]);
    let mut at = 0;
    while at < tokens.len() {
        let next = tokens.get(at + 1).map_or("", String::as_str);
        match tokens[at].as_str() {
            "mod" if tokens.get(at + 2).is_some_and(|token| token == "{") => {
                here.push(next.to_owned());
                opened.push(depth);
                depth += 1;
                at += 2;
            }
            "{" => depth += 1,
            "}" => {
                depth = depth.saturating_sub(1);
                if opened.last() == Some(&depth) {
                    opened.pop();
                    here.pop();
                }
            }
            "crate" | "package" if next == "::" => paths.extend(path_tree(tokens, at + 2)),
            "super" if next == "::" => {
                let mut base = here.clone();
                base.pop();
                at += 2;
                while tokens.get(at).is_some_and(|token| token == "super") {
                    base.pop();
                    at += 2;
                }
                paths.extend(path_tree(tokens, at).into_iter().map(|rest| [base.clone(), rest].concat()));
                continue;
            }
            _ => {}
        }
        at += 1;
    }
    paths
}

/// The paths of a use tree that starts at a token: `a::{b, c::*}` is a::b and a::c.
fn path_tree(tokens: &[String], at: usize) -> Vec<Vec<String>> {
    let (mut at, mut prefix) = (at, vec![]);
    while let Some(token) = tokens.get(at) {
        if token == "{" {
            return group(tokens, at).into_iter().map(|rest| [prefix.clone(), rest].concat()).collect();
        }
        if !is_word(token) {
            break;
        }
        prefix.push(token.clone());
        at += 1;
        if tokens.get(at).is_none_or(|token| token != "::") {
            break;
        }
        at += 1;
    }
    if prefix.is_empty() { vec![] } else { vec![prefix] }
}

/// The paths of a `{…}` group of a use tree.
fn group(tokens: &[String], open: usize) -> Vec<Vec<String>> {
    let (mut paths, mut depth, mut member_starts) = (vec![], 0, false);
    for at in open..tokens.len() {
        match tokens[at].as_str() {
            "{" => (depth, member_starts) = (depth + 1, true),
            "}" => depth -= 1,
            "," => member_starts = true,
            _ if depth == 1 && member_starts => {
                paths.extend(path_tree(tokens, at));
                member_starts = false;
            }
            _ => member_starts = false,
        }
        if depth == 0 {
            break;
        }
    }
    paths
}

/// The tokens without `#[cfg(test)]` items, and the names of test modules that live in their own files.
fn without_tests(tokens: &[String]) -> (Vec<String>, Vec<String>) {
    let (mut kept, mut modules, mut at) = (vec![], vec![], 0);
    while at < tokens.len() {
        let end = attribute_end(tokens, at);
        let attribute = &tokens[at..end];
        let is = |word: &str| attribute.iter().any(|token| token == word);
        if end == at || !(is("cfg") && is("test") && !is("not")) {
            kept.push(tokens[at].clone());
            at += 1;
            continue;
        }
        at = end;
        while attribute_end(tokens, at) > at {
            at = attribute_end(tokens, at);
        }
        let item = at;
        let mut depth = 0;
        while let Some(token) = tokens.get(at) {
            at += 1;
            match token.as_str() {
                "{" => depth += 1,
                "}" if depth == 1 => break,
                "}" => depth -= 1,
                ";" if depth == 0 => break,
                _ => {}
            }
        }
        // `use` groups end with a semicolon after their brace.
        if tokens.get(at).is_some_and(|token| token == ";") {
            at += 1;
        }
        let words: Vec<&str> = tokens[item..at].iter().map(String::as_str).collect();
        if let [.., "mod", name, ";"] = words[..] {
            modules.push(name.to_owned());
        }
    }
    (kept, modules)
}

/// The token after the attribute `#[…]` that starts at `at`; `at` itself if none does.
fn attribute_end(tokens: &[String], at: usize) -> usize {
    if tokens.get(at).is_none_or(|token| token != "#") || tokens.get(at + 1).is_none_or(|token| token != "[") {
        return at;
    }
    let mut depth = 0;
    for (end, token) in tokens.iter().enumerate().skip(at + 1) {
        match token.as_str() {
            "[" => depth += 1,
            "]" => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            return end + 1;
        }
    }
    tokens.len()
}

fn is_word(token: &str) -> bool {
    token.starts_with(|c: char| c.is_alphabetic() || c == '_')
}

/// Words, `::` and single characters of Rust or WESL code; comments, strings, characters and lifetimes left out.
fn tokens(text: &str) -> Vec<String> {
    let (mut tokens, mut rest) = (vec![], text);
    while let Some(c) = rest.chars().next() {
        let after_word = rest.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(rest.len());
        if rest.starts_with("//") {
            rest = rest.find('\n').map_or("", |end| &rest[end..]);
        } else if rest.starts_with("/*") {
            rest = skip_comment(rest);
        } else if let Some(end) = raw_string_end(rest) {
            rest = &rest[end..];
        } else if c == '"' {
            rest = skip_quoted(&rest[1..], '"');
        } else if c == '\'' {
            let mut after = rest[1..].chars();
            let is_character = after.next() == Some('\\') || after.next() == Some('\'');
            rest = if is_character { skip_quoted(&rest[1..], '\'') } else { &rest[1..] };
        } else if after_word > 0 {
            tokens.push(rest[..after_word].to_owned());
            // A raw identifier is the identifier.
            rest = if &rest[..after_word] == "r" && rest[1..].starts_with('#') {
                tokens.pop();
                &rest[2..]
            } else {
                &rest[after_word..]
            };
        } else if rest.starts_with("::") {
            tokens.push("::".to_owned());
            rest = &rest[2..];
        } else {
            if !c.is_whitespace() {
                tokens.push(c.to_string());
            }
            rest = &rest[c.len_utf8()..];
        }
    }
    tokens
}

/// What follows a block comment, which may hold others.
fn skip_comment(text: &str) -> &str {
    let (mut depth, mut rest) = (0, text);
    while !rest.is_empty() {
        if rest.starts_with("/*") || rest.starts_with("*/") {
            depth += if rest.starts_with("/*") { 1 } else { -1 };
            rest = &rest[2..];
        } else {
            rest = &rest[rest.chars().next().map_or(1, char::len_utf8)..];
        }
        if depth == 0 {
            break;
        }
    }
    rest
}

/// What follows the closing quote, escapes skipped.
fn skip_quoted(text: &str, quote: char) -> &str {
    let mut escaped = false;
    for (at, c) in text.char_indices() {
        if c == quote && !escaped {
            return &text[at + 1..];
        }
        escaped = c == '\\' && !escaped;
    }
    ""
}

/// Length of the raw string `r"…"`, `br#"…"#` … that the text starts with.
fn raw_string_end(text: &str) -> Option<usize> {
    let prefix = ["br", "cr", "r"].into_iter().find(|prefix| text.starts_with(prefix))?;
    let hashes = text[prefix.len()..].bytes().take_while(|&b| b == b'#').count();
    let start = prefix.len() + hashes + 1;
    if text.as_bytes().get(start - 1) != Some(&b'"') {
        return None;
    }
    let close = format!("\"{}", "#".repeat(hashes));
    Some(text[start..].find(&close).map_or(text.len(), |end| start + end + close.len()))
}
