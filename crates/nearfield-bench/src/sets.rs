//! The sets of points that are measured, by name: kind and number, such as `uniform-1m` or `shell-100k`.

use std::fmt;
use std::str::FromStr;

use nearfield::Vec3;
use nearfield::geometry::generate::{CloudKind, cloud, radius_for};

use crate::Error;

/// Seed of every set.
pub const SEED: u64 = 7;

/// Points of one kind and number, with the radius that goes with them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Set {
    /// What the points look like: uniform, shell or clustered.
    pub kind: CloudKind,
    /// How many there are.
    pub n: usize,
}

impl Set {
    /// The points, in random order, the same on every machine.
    pub fn points(&self) -> Vec<Vec3> {
        cloud(self.kind, self.n, SEED).points
    }

    /// The search radius, about 49 neighbours for uniform and shell; see [`radius_for`].
    pub fn radius(&self) -> f32 {
        radius_for(self.kind, self.n).expect("a set should have a radius: only such kinds are parsed")
    }

    /// Whether one answer has hundreds of millions of entries.
    pub fn is_big(&self) -> bool {
        self.n > 2_000_000 || (self.kind == CloudKind::Clustered && self.n > 200_000)
    }
}

impl FromStr for Set {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let wrong = || {
            format!(
                "{text:?} is not a set: expected uniform, shell or clustered and a number, such as uniform-1m or shell-100k"
            )
        };
        let (kind, number) = text.rsplit_once('-').ok_or_else(wrong)?;
        let kind: CloudKind = kind.parse().map_err(|_| wrong())?;
        let (digits, unit) = match number.as_bytes().last() {
            Some(b'k') => (&number[..number.len() - 1], 1_000),
            Some(b'm') => (&number[..number.len() - 1], 1_000_000),
            _ => (number, 1),
        };
        let n: usize = digits.parse().map_err(|_| wrong())?;
        let n = n.checked_mul(unit).filter(|&n| n > 0 && n < u32::MAX as usize).ok_or_else(wrong)?;
        radius_for(kind, n).ok_or_else(wrong)?;
        Ok(Self { kind, n })
    }
}

impl fmt::Display for Set {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.n {
            n if n % 1_000_000 == 0 => write!(f, "{}-{}m", self.kind, n / 1_000_000),
            n if n % 1_000 == 0 => write!(f, "{}-{}k", self.kind, n / 1_000),
            n => write!(f, "{}-{n}", self.kind),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_are_read_and_printed_alike() {
        for text in ["uniform-1m", "uniform-10m", "shell-100k", "clustered-12345"] {
            assert_eq!(text.parse::<Set>().expect("a set").to_string(), text);
        }
        for text in ["uniform", "uniform-0", "line-1k", "uniform-1x", "uniform-9999m", ""] {
            assert!(text.parse::<Set>().is_err(), "{text:?}");
        }
    }
}
