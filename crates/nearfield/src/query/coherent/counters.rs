//! What a search of the tree has done: traversals, nodes, tests, and how busy lanes in step were.

/// Work of one search, counted while it ran.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SearchCounters {
    /// Queries asked.
    pub queries: u64,
    /// Traversals of the tree: one a query for `Primary`, one a pack for `Coherent`.
    pub traversals: u64,
    /// Nodes whose boxes the traversals looked at, without those on the way down to a leaf.
    pub nodes_visited: u64,
    /// Points in the candidate lists of all packs; 0 for `Primary`, which keeps none.
    pub candidates: u64,
    /// Pairs of query and point whose distance was tested.
    pub tests: u64,
    /// Pairs that were neighbours.
    pub neighbors: u64,
    /// Lanes by phase, in order.
    pub phases: Vec<PhaseLanes>,
}

/// Rounds of the lanes that run in step, in one phase of a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PhaseLanes {
    /// "pack", "traverse", "extract"; "search" where there is one phase.
    pub name: &'static str,
    /// Rounds that lanes worked, summed over all lanes.
    pub worked: u64,
    /// Rounds of the slowest lane times the lanes of its group, summed over all groups in step.
    pub taken: u64,
}

impl PhaseLanes {
    /// Share of active lanes, from 0 to 1: the warp execution efficiency of Xing2017, section 5.1. 1 where nothing ran.
    pub fn active_share(&self) -> f64 {
        if self.taken == 0 { 1.0 } else { self.worked as f64 / self.taken as f64 }
    }

    /// Lanes with these rounds, `in_step` of which run together.
    pub(super) fn of_rounds(name: &'static str, rounds: &[u32], in_step: usize) -> Self {
        let sum = |group: &[u32]| group.iter().map(|&r| u64::from(r)).sum::<u64>();
        let slowest = |group: &[u32]| u64::from(group.iter().copied().max().unwrap_or(0)) * in_step as u64;
        let groups = || rounds.chunks(in_step.max(1));
        Self { name, worked: groups().map(sum).sum(), taken: groups().map(slowest).sum() }
    }
}

impl SearchCounters {
    /// Share of the traversals that were merged into others, from 0 to 1: the paper finds up to 0.99.
    pub fn merged_share(&self) -> f64 {
        if self.queries == 0 { 0.0 } else { 1.0 - self.traversals as f64 / self.queries as f64 }
    }

    /// Share of active lanes over all phases, from 0 to 1.
    pub fn active_share(&self) -> f64 {
        let sum = |part: fn(&PhaseLanes) -> u64| self.phases.iter().map(part).sum();
        PhaseLanes { name: "all", worked: sum(|p| p.worked), taken: sum(|p| p.taken) }.active_share()
    }

    /// The lanes of a phase.
    pub fn phase(&self, name: &str) -> Option<&PhaseLanes> {
        self.phases.iter().find(|phase| phase.name == name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lanes_wait_for_the_slowest_of_their_group() {
        let lanes = PhaseLanes::of_rounds("search", &[4, 1, 1, 2, 3, 3], 4);
        // 4 lanes of 4 rounds, then 4 lanes of 3 rounds, two of which have no work.
        assert_eq!((lanes.worked, lanes.taken), (14, 28));
        assert_eq!(lanes.active_share(), 0.5);
        let none = PhaseLanes::of_rounds("search", &[], 4);
        assert_eq!((none.worked, none.taken, none.active_share()), (0, 0, 1.0));
    }

    #[test]
    fn shares_are_those_of_all_phases() {
        let lanes = |worked, taken| PhaseLanes { name: "x", worked, taken };
        let counters = SearchCounters {
            queries: 100,
            traversals: 5,
            phases: vec![lanes(10, 10), lanes(20, 90)],
            ..SearchCounters::default()
        };
        assert_eq!((counters.merged_share(), counters.active_share()), (0.95, 0.3));
    }
}
