//! Finds paths that the documents name and the repository does not have.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

const DOCUMENTS: [&str; 3] = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md"];

/// Where a path in a document may start.
const BASES: [&str; 4] = ["", "crates", "crates/nearfield", "crates/nearfield/src"];

/// Extensions that make a name without a slash a path; outputs such as `demo.png` are no paths of ours.
const SOURCE_EXTENSIONS: [&str; 6] = [".md", ".rs", ".wesl", ".toml", ".cff", ".lock"];

/// Checks all documents; an error lists each path that is not there.
pub(crate) fn check(root: &Path) -> Result<(), String> {
    let mut names = BTreeSet::new();
    collect_names(root, &mut names);
    let mut missing = vec![];
    for document in DOCUMENTS {
        let text = fs::read_to_string(root.join(document)).map_err(|error| format!("{document}: {error}"))?;
        // A bare file name stands for the file of that name in whichever folder the sentence is about.
        let exists = |path: &str| names.contains(path) || BASES.iter().any(|base| root.join(base).join(path).exists());
        let absent = missing_paths(&text, exists);
        missing.extend(absent.into_iter().map(|(line, path)| format!("\n  {document}:{line}: {path}")));
    }
    if missing.is_empty() { Ok(()) } else { Err(format!("these paths do not exist:{}", missing.concat())) }
}

/// Names of all files, but for hidden folders and build output.
fn collect_names(folder: &Path, names: &mut BTreeSet<String>) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        if !entry.path().is_dir() {
            names.insert(name);
        } else if name != "target" && !name.starts_with('.') {
            collect_names(&entry.path(), names);
        }
    }
}

/// Line numbers and paths, of those named in code spans and links outside code blocks, that do not exist.
fn missing_paths(text: &str, exists: impl Fn(&str) -> bool) -> Vec<(usize, String)> {
    let mut missing = vec![];
    let mut in_block = false;
    for (index, line) in text.lines().enumerate() {
        if line.trim_start().starts_with("```") {
            in_block = !in_block;
            continue;
        }
        if in_block {
            continue;
        }
        let spans = line.split('`').skip(1).step_by(2);
        let links = line.split("](").skip(1).filter_map(|rest| rest.split([')', '#']).next());
        for name in spans.chain(links) {
            let known_start = || name.split('/').next().is_some_and(&exists);
            if is_path(name, known_start) && !exists(name) {
                missing.push((index + 1, name.to_owned()));
            }
        }
    }
    missing
}

/// Whether `name` is meant as a path inside the repository.
fn is_path(name: &str, starts_in_repository: impl Fn() -> bool) -> bool {
    let plain = name.chars().all(|c| c.is_ascii_alphanumeric() || "._-/".contains(c));
    if !plain || name.is_empty() || name.starts_with(['/', '-']) || name.starts_with("..") {
        return false;
    }
    let source = SOURCE_EXTENSIONS.iter().any(|extension| name.len() > extension.len() && name.ends_with(extension));
    // A ratio such as `r/2` has a slash too: it starts with no folder of ours.
    source || (name.contains('/') && (name.ends_with('/') || starts_in_repository()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planted_wrong_paths_are_found_and_other_words_are_not() {
        let text = "\
Read `ARCHITECTURE.md`, `structure/grid/` and [the rules](docs/rules.md#top).
Cells are `r/2` wide; `nearfield info FILE` prints; `demo.png` is written; see https://example.org/a/b.
```
cargo run --release -- crates/none.rs
```
Copy `crates/absent/x` to `../elsewhere/y.rs`, `crates/nearfield`, or [a site](https://example.org/x.md).
";
        let there = ["ARCHITECTURE.md", "crates", "crates/nearfield"];
        let missing = missing_paths(text, |path| there.contains(&path));
        let found: Vec<(usize, &str)> = missing.iter().map(|(line, path)| (*line, path.as_str())).collect();
        assert_eq!(found, [(1, "structure/grid/"), (1, "docs/rules.md"), (6, "crates/absent/x")]);
    }
}
