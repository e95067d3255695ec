//! The built command as a user runs it: every subcommand, its files, its JSON and its exit codes.

mod everyday;
mod failures;
mod nearest;
mod neighbors;
mod normals;
mod octree;
mod rays;
mod render;
mod resample;
mod sdf;
mod simulate;
mod smooth;
mod sort;
mod surfaces;
mod verbs;

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use serde_json::Value;

/// A folder of its own for each test, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("nearfield-command-{name}-{}", std::process::id()));
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// Runs the command in this folder.
    fn run(&self, arguments: &str) -> Output {
        self.command(arguments).stdin(Stdio::null()).output().unwrap()
    }

    fn command(&self, arguments: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_nearfield"));
        command.args(arguments.split_whitespace()).current_dir(&self.0);
        command
    }

    /// Runs the command on `input` as standard input.
    fn pipe(&self, arguments: &str, input: &[u8]) -> Output {
        let mut child = self
            .command(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        child.stdin.take().unwrap().write_all(input).unwrap();
        child.wait_with_output().unwrap()
    }

    fn ok(&self, arguments: &str) -> String {
        let output = self.run(arguments);
        assert!(output.status.success(), "{arguments}: {output:?}");
        String::from_utf8(output.stdout).unwrap()
    }

    fn json(&self, arguments: &str) -> Value {
        serde_json::from_str(&self.ok(arguments)).unwrap()
    }

    /// Runs a command that must fail with `code` and exactly one line that contains `told`.
    fn fails(&self, arguments: &str, code: i32, told: &str) {
        let output = self.run(arguments);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{arguments}: {stderr}");
        let ours: Vec<&str> = stderr.lines().filter(|line| line.starts_with("nearfield: ")).collect();
        assert!(ours.len() == 1 && ours[0].contains(told), "{arguments}: expected {told:?} in {stderr}");
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Four points: two at distance exactly 0.5, one at 1 from the first, one far away.
const FOUR: &str = "0 0 0\n0.5 0 0\n0 1 0\n100 0 0\n";

fn with_four(name: &str) -> Folder {
    let folder = Folder::new(name);
    fs::write(folder.path("four.xyz"), FOUR).unwrap();
    folder
}

/// The GPU of the tests, as `--device` takes it. Without one the test is named as skipped, or fails where
/// `NEARFIELD_REQUIRE_GPU` is 1.
fn gpu_or_skip(test: &str) -> Option<String> {
    let device = std::env::var("NEARFIELD_TEST_DEVICE").unwrap_or_else(|_| "gpu".to_owned());
    let opened = device.parse().and_then(|choice| nearfield::Gpu::open(&choice));
    if matches!(opened, Ok(Some(_))) {
        return Some(device);
    }
    let required = std::env::var_os("NEARFIELD_REQUIRE_GPU").is_some_and(|v| v == "1");
    assert!(!required, "{test}: no GPU like {device:?}: {:?}", opened.err());
    if let Some(path) = std::env::var_os("NEARFIELD_SKIPPED") {
        let mut file = fs::OpenOptions::new().append(true).create(true).open(path).unwrap();
        writeln!(file, "{test}").unwrap();
    }
    None
}

/// Width and height of a PNG, after its signature is checked.
fn png_size(path: &Path) -> (u32, u32) {
    let bytes = fs::read(path).unwrap();
    assert!(bytes.starts_with(b"\x89PNG\r\n\x1a\n") && bytes.ends_with(b"IEND\xaeB`\x82"));
    let side = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap());
    (side(16), side(20))
}
