//! Embeds every WESL module under `src/`, named by its path: `src/geometry/aabb.wesl` is `package::geometry::aabb`.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::{env, fs, io};

fn main() -> io::Result<()> {
    println!("cargo::rerun-if-changed=src");
    let root = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").expect("cargo sets it")).join("src");
    let mut modules = Vec::new();
    collect(&root, "package", &mut modules)?;
    modules.sort();
    let mut code = String::from("[\n");
    for (path, file) in modules {
        let _ = writeln!(code, "    ({path:?}, include_str!({:?})),", file.display().to_string());
    }
    code.push_str("]\n");
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets it"));
    fs::write(out.join("wesl_modules.rs"), code)
}

fn collect(folder: &Path, prefix: &str, modules: &mut Vec<(String, PathBuf)>) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        if path.is_dir() {
            collect(&path, &format!("{prefix}::{stem}"), modules)?;
        } else if path.extension().is_some_and(|e| e == "wesl") {
            modules.push((format!("{prefix}::{stem}"), path));
        }
    }
    Ok(())
}
