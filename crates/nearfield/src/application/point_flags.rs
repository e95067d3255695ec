//! What an application says of a point instead of dropping it.

use std::fmt;
use std::ops::BitOrAssign;

use bytemuck::{Pod, Zeroable};

/// Flags of a point; none where all went well. `point_flags.wesl` is the twin.
#[repr(transparent)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Pod, Zeroable)]
pub struct PointFlags(pub u32);

impl PointFlags {
    /// Too few neighbours: the point was left as it was.
    pub const FEW_NEIGHBORS: Self = Self(1);
    /// Neighbours on a line or at one place, or a system without a unique answer: the point was left as it was.
    pub const DEGENERATE: Self = Self(2);
    /// Far from the mean of its neighbours: beyond the border of the surface.
    pub const OUTSIDE: Self = Self(4);
    /// The computed step was longer than allowed and was cut.
    pub const LIMITED: Self = Self(8);
    /// The iteration ended at its limit before it had converged.
    pub const NOT_CONVERGED: Self = Self(16);
    /// A coordinate or a normal that is not a finite number: the point was left as it was.
    pub const INVALID: Self = Self(32);
    /// Of samples that are drawn to a surface: no point of it draws this one, or next to none.
    pub const NO_ATTRACTION: Self = Self(64);

    /// Names in the order of the bits.
    pub const NAMES: [&'static str; 7] =
        ["few-neighbors", "degenerate", "outside", "limited", "not-converged", "invalid", "no-attraction"];

    /// Whether all of these are set.
    pub fn contains(self, flags: Self) -> bool {
        self.0 & flags.0 == flags.0
    }

    /// Whether none is set.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Number of points with each flag, in the order of [`PointFlags::NAMES`].
    pub fn totals(all: &[Self]) -> [u64; 7] {
        let mut totals = [0; 7];
        for flags in all.iter().filter(|flags| !flags.is_empty()) {
            totals.iter_mut().enumerate().for_each(|(bit, total)| *total += u64::from(flags.0 >> bit & 1));
        }
        totals
    }
}

impl BitOrAssign for PointFlags {
    fn bitor_assign(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

impl fmt::Display for PointFlags {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let set = Self::NAMES.iter().enumerate().filter(|(bit, _)| self.0 >> bit & 1 == 1);
        let names: Vec<&str> = set.map(|(_, name)| *name).collect();
        f.write_str(&names.join(" "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flags_are_counted_and_named() {
        let mut both = PointFlags::OUTSIDE;
        both |= PointFlags::LIMITED;
        assert!(both.contains(PointFlags::OUTSIDE) && !both.contains(PointFlags::INVALID) && !both.is_empty());
        assert_eq!(both.to_string(), "outside limited");
        assert_eq!(PointFlags::totals(&[both, PointFlags::default(), PointFlags::LIMITED]), [0, 0, 1, 2, 0, 0, 0]);
    }
}
