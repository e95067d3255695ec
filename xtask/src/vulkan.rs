//! Makes sure, where that is possible, that the GPU tests find an adapter: a real one, or llvmpipe on the CPU.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};

use crate::process::{command, output, succeed};

const PACKAGES: [&str; 2] = ["libvulkan1", "mesa-vulkan-drivers"];

/// Installs the software driver if no driver is found and the system allows it; says what it did.
pub(crate) fn prepare() {
    if cfg!(any(target_os = "macos", target_os = "windows")) || (has_loader() && has_driver()) {
        return;
    }
    if !is_root() || find_in_path("apt-get").is_none() {
        println!(
            "No Vulkan driver found: GPU tests will be skipped (on Debian and Ubuntu: apt-get install {})",
            PACKAGES.join(" ")
        );
        return;
    }
    println!("No Vulkan driver found: installing {} to run the GPU tests on the CPU", PACKAGES.join(" and "));
    let install = || {
        let mut command = command("apt-get", &["install", "--yes", "--no-install-recommends"]);
        succeed(command.args(PACKAGES).env("DEBIAN_FRONTEND", "noninteractive"))
    };
    // A fresh image has no package lists, an old one outdated ones; most machines need no update.
    let result = install().or_else(|_| {
        succeed(&mut command("apt-get", &["update"]))?;
        install()
    });
    match result {
        Ok(()) => println!("Installed {}", PACKAGES.join(" and ")),
        Err(error) => println!("{error}: GPU tests will be skipped"),
    }
}

/// Whether a Vulkan driver is registered where the loader looks for one.
fn has_driver() -> bool {
    // The loader reads only these files if one of the variables is set.
    for variable in ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"] {
        if let Some(files) = env::var_os(variable).filter(|files| !files.is_empty()) {
            return env::split_paths(&files).any(|path| path.exists());
        }
    }
    let home = env::var_os("HOME").map(|home| PathBuf::from(home).join(".local/share"));
    let data = env::var_os("XDG_DATA_DIRS").map(|dirs| env::split_paths(&dirs).collect::<Vec<_>>());
    let fixed = ["/usr/share", "/etc", "/usr/local/share", "/usr/local/etc"].map(PathBuf::from);
    let folders = fixed.into_iter().chain(home).chain(data.into_iter().flatten());
    folders.map(|folder| folder.join("vulkan/icd.d")).any(|folder| has_manifest(&folder))
}

fn has_manifest(folder: &Path) -> bool {
    let Ok(entries) = fs::read_dir(folder) else { return false };
    entries.flatten().any(|entry| entry.path().extension().is_some_and(|extension| extension == "json"))
}

/// Whether the Vulkan loader is there; assumed where the linker's cache cannot be asked.
fn has_loader() -> bool {
    let name = "libvulkan.so.1";
    let library_path = env::var_os("LD_LIBRARY_PATH").unwrap_or_default();
    if env::split_paths(&library_path).any(|folder| folder.join(name).exists()) {
        return true;
    }
    let ask = |program: &str| output(&mut command(program, &["-p"]));
    let cache = ask("ldconfig").or_else(|| ask("/sbin/ldconfig"));
    cache.is_none_or(|cache| cache.contains(name))
}

fn is_root() -> bool {
    output(&mut command("id", &["-u"])).is_some_and(|id| id.trim() == "0")
}

fn find_in_path(program: &str) -> Option<PathBuf> {
    let path = env::var_os("PATH")?;
    env::split_paths(&path).map(|folder| folder.join(program)).find(|file| file.is_file())
}
