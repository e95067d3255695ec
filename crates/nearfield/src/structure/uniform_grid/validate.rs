//! The invariants of the grid as code; the numbers are those of the module's page.

use super::UniformGrid;
use crate::structure::CpuStructure;

impl UniformGrid {
    /// The first broken invariant, in words; `None` for a sound grid. For tests and for debugging.
    pub fn broken_invariant(&self) -> Option<String> {
        let n = self.points.len();
        let entry = |i: usize| self.layout.entry_of(self.layout.cell_of(self.points.position(i)));
        let mut seen = vec![false; n];
        for i in 0..n {
            let id = self.points.id(i) as usize;
            if id >= n || std::mem::replace(&mut seen[id], true) {
                return Some(format!("1: index {id} at place {i} is out of range or stands twice"));
            }
            if i > 0 && (entry(i - 1), self.points.id(i - 1)) >= (entry(i), self.points.id(i)) {
                return Some(format!("1: places {} and {i} are not in order", i - 1));
            }
            let own = entry(i) as usize;
            if !(self.starts[own] as usize..self.starts[own + 1] as usize).contains(&i) {
                return Some(format!("2: place {i} is outside the range of its entry {own}"));
            }
        }
        if self.starts.len() != self.layout.table_size as usize + 1
            || self.starts.first() != Some(&0)
            || self.starts.last() != Some(&(n as u32))
            || !self.starts.is_sorted()
        {
            return Some("2: starts are not monotone from 0 to n".into());
        }
        let packs = self.packs();
        if packs.last() != Some(&(n as u32)) || (n > 0 && packs[0] != 0) || !packs.is_sorted_by(|a, b| a < b) {
            return Some("3: packs are not ascending from 0 to n".into());
        }
        let row = |i: u32| self.layout.cell_of(self.points.position(i as usize))[1..].to_vec();
        packs
            .windows(2)
            .find(|pack| (pack[0]..pack[1]).any(|i| row(i) != row(pack[0])))
            .map(|pack| format!("3: pack {pack:?} holds points of two rows"))
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use crate::structure::{GridSettings, UniformGrid};

    #[test]
    fn a_planted_break_is_found() {
        let points: Vec<Vec3> = (0..100).map(|i| Vec3::splat(i as f32)).collect();
        let sound = UniformGrid::build(&points, &GridSettings::for_radius(3.0)).unwrap();
        assert_eq!(sound.broken_invariant(), None);
        let mut broken = sound.clone();
        broken.starts[3] = 0;
        assert!(broken.broken_invariant().is_some_and(|b| b.starts_with('2')));
        let mut broken = sound;
        broken.packs = vec![0, 100];
        assert!(broken.broken_invariant().is_some_and(|b| b.starts_with('3')));
    }
}
