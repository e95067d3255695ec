//! `nearfield-bench wlop`: locally optimal projection, its times, and its samples beside those of CGAL.
//!
//! Without options it times all variants on a noisy torus as large as the Kitten of Xing2017. Every run is checked: its first
//! iteration on a device against that on the CPU, and all samples for numbers.

mod cgal;
pub(crate) mod times;

use std::path::PathBuf;

use nearfield::Scalar;
use nearfield::geometry::vector;
use nearfield::gpu::DeviceChoice;

use crate::Result;
use crate::provenance::Machine;

/// What is timed and compared.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// auto, cpu, gpu, gpu:N or part of a device name
    #[arg(long, default_value = "auto")]
    device: DeviceChoice,
    /// A file of points, instead of the torus
    #[arg(long)]
    points: Option<PathBuf>,
    /// Samples
    #[arg(long, default_value_t = 20_000)]
    count: usize,
    /// Iterations
    #[arg(long, default_value_t = 100)]
    iterations: u32,
    /// The radius of all variants in spacings of the samples, instead of their defaults
    #[arg(long)]
    spacings: Option<f64>,
    /// Only compare with the program that scripts/build_cgal_peer.sh makes: one iteration within 1e-9 of the diagonal, 35 within 1e-6
    #[arg(long, value_name = "PROGRAM")]
    cgal: Option<PathBuf>,
}

/// Runs what was asked for.
///
/// # Errors
/// A wrong answer; files, programs and devices that cannot be used.
pub fn run(arguments: &Arguments) -> Result<()> {
    if let Some(program) = &arguments.cgal {
        return cgal::compare(program);
    }
    let machine = Machine::open(&arguments.device)?;
    times::run(&machine, arguments)
}

/// The largest distance of samples of one number; NaN where there is one, which no limit allows.
///
/// # Errors
/// Samples on one side only.
fn farthest<T: Scalar>(a: &[[T; 3]], b: &[[T; 3]]) -> Result<f64> {
    if a.len() != b.len() {
        return Err(format!("{} samples beside {}", a.len(), b.len()).into());
    }
    let far = |(a, b): (&[T; 3], &[T; 3])| vector::norm(vector::subtract(a.map(T::to_f64), b.map(T::to_f64)));
    let larger = |most: f64, far: f64| if most.is_nan() || far <= most { most } else { far };
    Ok(a.iter().zip(b).map(far).fold(0.0, larger))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_moved_sample_and_a_nan_are_seen() {
        let here = [[0.5, -1.0, 2.0], [3.0, 0.25, 0.0], [1.0, 1.0, 1.0]];
        assert_eq!(farthest(&here, &here).unwrap(), 0.0);
        let mut there = here;
        there[1][2] += 1e-8;
        let found = farthest(&here, &there).unwrap();
        assert!((found - 1e-8).abs() < 1e-15 && !(found <= 1e-9), "{found}");
        for place in 0..3 {
            let mut nan = there;
            nan[place][0] = f64::NAN;
            let found = [farthest(&here, &nan).unwrap(), farthest(&nan, &here).unwrap()];
            assert!(found.iter().all(|far| !(*far <= 1e9)), "{place}: {found:?}");
        }
        assert!(farthest(&here, &there[..2]).is_err());
        assert!(farthest::<f32>(&[], &[[0.0; 3]]).is_err());
    }
}
