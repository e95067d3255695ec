//! The invariants of the dense octree as code; the numbers are those of the module's page.

use super::cpu::cell_key;
use super::{CellState, DenseOctree};

impl DenseOctree {
    /// The first broken invariant, in words; `None` for a sound tree. For tests and for debugging.
    pub fn broken_invariant(&self) -> Option<String> {
        self.broken_order().or_else(|| self.broken_states()).or_else(|| self.broken_counts())
    }

    /// Invariants 1 and 2.
    fn broken_order(&self) -> Option<String> {
        let n = self.points.len();
        if self.starts.len() != self.layout.finest() + 1
            || self.starts.first() != Some(&0)
            || self.starts.last() != Some(&(n as u32))
            || !self.starts.is_sorted()
        {
            return Some("2: starts are not monotone from 0 to n".into());
        }
        let key = |i: usize| cell_key(&self.domain, self.curve, self.layout, self.points.position(i));
        let mut seen = vec![false; n];
        for i in 0..n {
            let id = self.points.id(i) as usize;
            if id >= n || std::mem::replace(&mut seen[id], true) {
                return Some(format!("1: index {id} at place {i} is out of range or stands twice"));
            }
            if i > 0 && (key(i - 1), self.points.id(i - 1)) >= (key(i), self.points.id(i)) {
                return Some(format!("1: places {} and {i} are not in order", i - 1));
            }
            let own = key(i) as usize;
            if !(self.starts[own] as usize..self.starts[own + 1] as usize).contains(&i) {
                return Some(format!("2: place {i} is outside the range of its cell {own}"));
            }
        }
        None
    }

    /// Invariants 3 and 4.
    fn broken_states(&self) -> Option<String> {
        if self.states.len() != self.layout.cells() {
            return Some(format!("3: {} states of {} cells", self.states.len(), self.layout.cells()));
        }
        for (place, &found) in self.states.iter().enumerate() {
            let cell = self.layout.cell(place);
            let occupied = !self.points_in(cell).is_empty();
            let parent_is_occupied = cell.parent().is_none_or(|parent| !self.points_in(parent).is_empty());
            let (number, expected) = match (occupied, parent_is_occupied) {
                (true, _) if cell.level() == self.layout.levels() => (3, CellState::OccupiedLeaf),
                (true, _) => (3, CellState::Inner),
                (false, true) => (4, CellState::EmptyLeaf),
                (false, false) => (4, CellState::Null),
            };
            if found != expected {
                return Some(format!("{number}: {cell:?} is {found:?}, expected {expected:?}"));
            }
        }
        None
    }

    /// Invariant 5.
    fn broken_counts(&self) -> Option<String> {
        if self.nulls_before.len() != self.states.len() + 1 {
            return Some(format!("5: {} counts of {} cells", self.nulls_before.len(), self.states.len()));
        }
        let mut nulls = 0;
        for (place, &found) in self.nulls_before.iter().enumerate() {
            if found != nulls {
                return Some(format!("5: {found} null cells before place {place}, expected {nulls}"));
            }
            nulls += u32::from(self.states.get(place) == Some(&CellState::Null));
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use crate::geometry::OrderedPoints;
    use crate::structure::{CellState, DenseOctree, DenseOctreeSettings};

    #[test]
    fn a_planted_break_is_found() {
        let points: Vec<Vec3> = (0..100).map(|i| Vec3::splat((i % 7) as f32)).collect();
        let sound = DenseOctree::build(&points, &DenseOctreeSettings::with_levels(3)).unwrap();
        assert_eq!(sound.broken_invariant(), None);
        let broken = |number: char, plant: &dyn Fn(&mut DenseOctree)| {
            let mut tree = sound.clone();
            plant(&mut tree);
            let found = tree.broken_invariant();
            assert!(found.as_ref().is_some_and(|b| b.starts_with(number)), "{number}: {found:?}");
        };
        // Points 0 and 7 are equal and come first.
        let mut swapped = sound.points.ids().to_vec();
        swapped.swap(0, 1);
        broken('1', &|t| t.points = OrderedPoints::gather(&points, &swapped));
        let mut twice = sound.points.ids().to_vec();
        twice[1] = twice[0];
        broken('1', &|t| t.points = OrderedPoints::gather(&points, &twice));
        broken('2', &|t| t.starts[3] = 100);
        broken('2', &|t| *t.starts.last_mut().unwrap() = 99);
        broken('2', &|t| {
            let last = t.starts.len() - 1;
            t.starts[1..last].fill(100);
        });
        let place = |state: CellState| sound.states.iter().position(|&s| s == state).unwrap();
        broken('3', &|t| t.states[place(CellState::OccupiedLeaf)] = CellState::Inner);
        broken('3', &|t| t.states[place(CellState::Inner)] = CellState::EmptyLeaf);
        broken('4', &|t| t.states[place(CellState::EmptyLeaf)] = CellState::Null);
        broken('4', &|t| t.states[place(CellState::Null)] = CellState::EmptyLeaf);
        broken('5', &|t| *t.nulls_before.last_mut().unwrap() += 1);
        broken('5', &|t| t.nulls_before.truncate(5));
    }
}
