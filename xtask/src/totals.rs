//! Adds up what test binaries print.

use std::ops::AddAssign;

/// Numbers of tests over all binaries, and the names of those that failed.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Totals {
    pub(crate) passed: u64,
    pub(crate) failed: u64,
    /// Marked as ignored, GPU tests without a GPU among them.
    pub(crate) skipped: u64,
    /// Those of `skipped` that need a GPU, by their name, their kind or their own word.
    pub(crate) gpu_skipped: Vec<String>,
    pub(crate) failures: Vec<String>,
}

impl Totals {
    /// Counts a test that passed without a GPU, having said so, as skipped.
    pub(crate) fn skip_passed(&mut self, name: &str) {
        self.passed = self.passed.saturating_sub(1);
        self.skipped += 1;
        self.gpu_skipped.push(name.to_owned());
    }

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
                self.gpu_skipped.push(name.trim_end().to_owned());
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
        self.gpu_skipped.extend(other.gpu_skipped);
        self.failures.extend(other.failures);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn totals_add_up_over_binaries_harnesses_and_ways_to_skip() {
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
        totals.skip_passed("gpu::buffer::c");
        let expected = Totals {
            passed: 1,
            failed: 1,
            skipped: 3,
            gpu_skipped: vec!["[gpu] grid/uniform".to_owned(), "gpu::buffer::c".to_owned()],
            failures: vec!["geometry::b".to_owned()],
        };
        assert_eq!(totals, expected);
    }
}
