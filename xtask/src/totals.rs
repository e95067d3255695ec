//! Adds up what test binaries print.

use std::ops::AddAssign;

/// Numbers of tests over all binaries, and the names of those that failed.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Totals {
    pub(crate) passed: u64,
    pub(crate) failed: u64,
    /// Marked as ignored, GPU tests without a GPU among them.
    pub(crate) skipped: u64,
    /// Those of `skipped` whose name, or kind, says that they need a GPU.
    pub(crate) gpu_skipped: u64,
    pub(crate) failures: Vec<String>,
}

impl Totals {
    /// Takes in one line of standard output.
    pub(crate) fn read(&mut self, line: &str) {
        if let Some(counts) = line.strip_prefix("test result: ") {
            let count = |what: &str| {
                let part = counts.split([';', '.']).map(str::trim).find_map(|part| part.strip_suffix(what))?;
                part.trim().parse::<u64>().ok()
            };
            self.passed += count("passed").unwrap_or(0);
            self.failed += count("failed").unwrap_or(0);
            self.skipped += count("ignored").unwrap_or(0);
        } else if let Some((name, outcome)) = line.strip_prefix("test ").and_then(|test| test.rsplit_once(" ... ")) {
            if outcome.starts_with("ignored") && name.to_lowercase().contains("gpu") {
                self.gpu_skipped += 1;
            } else if outcome == "FAILED" {
                self.failures.push(name.trim_end().to_owned());
            }
        }
    }
}

impl AddAssign for Totals {
    fn add_assign(&mut self, other: Self) {
        self.passed += other.passed;
        self.failed += other.failed;
        self.skipped += other.skipped;
        self.gpu_skipped += other.gpu_skipped;
        self.failures.extend(other.failures);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn totals_add_up_over_binaries_and_both_harnesses() {
        let output = "\
running 3 tests
test geometry::a ... ok
test geometry::b ... FAILED
test slow ... ignored, only with --long
test result: FAILED. 1 passed; 1 failed; 1 ignored; 0 measured; 2 filtered out; finished in 0.28s
test [gpu] grid/uniform      ... ignored
test cpu/uniform ... ok
test result: ok. 1 passed; 0 failed; 1 ignored; 0 measured; 0 filtered out; finished in 1.00s
";
        let mut totals = Totals::default();
        output.lines().for_each(|line| totals.read(line));
        let failures = vec!["geometry::b".to_owned()];
        assert_eq!(totals, Totals { passed: 2, failed: 1, skipped: 2, gpu_skipped: 1, failures });
    }
}
