//! `nearfield-bench everyday`: clusters, outliers and fewer points of generated sets, with copies to the device and back.
//!
//! The radius is chosen for a mean number of neighbours, which is measured and printed. Labels of the device are compared with those of
//! the CPU: they must be equal but where a distance is within rounding of the radius, which is at most one point in 10,000.

use nearfield::application::{
    Clusters, DbscanSettings, FarthestStart, OutlierRule, PoissonDiskSettings, RadiusOutlierSettings,
    StatisticalOutlierSettings, VoxelSettings, Watch, dbscan, dbscan_on_gpu, duplicates, duplicates_on_gpu,
    farthest_points, farthest_points_on_gpu, poisson_disk, radius_outliers, radius_outliers_on_gpu,
    statistical_outliers, statistical_outliers_on_gpu, voxel_downsample, voxel_downsample_on_gpu,
};
use nearfield::gpu::{DeviceChoice, Gpu};
use nearfield::query::{Clock, Stage};

use crate::measure::{Effort, Measured, repeat};
use crate::provenance::{COMMIT, Device, Machine};
use crate::sets::Set;
use crate::{Error, Result};

/// The share of labels that may differ between devices: distances within rounding of the radius.
const MAY_DIFFER: f64 = 1e-4;

/// Arguments of the subcommand.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// The sets, such as uniform-1m
    #[arg(long, value_name = "SET", value_delimiter = ',', default_value = "uniform-100k,uniform-1m")]
    pub sets: Vec<Set>,

    /// auto, cpu, gpu, gpu:N or part of a device name
    #[arg(long, default_value = "auto")]
    pub device: DeviceChoice,

    /// Mean points within eps that are aimed at, the point itself among them
    #[arg(long, value_name = "N", default_value_t = 10.0)]
    pub mean: f64,

    /// Fewest points of a core point
    #[arg(long, value_name = "N", default_value_t = 10)]
    pub min_points: u32,

    /// Only the clusters
    #[arg(long)]
    pub only_dbscan: bool,

    /// Timed runs
    #[arg(long, value_name = "N", default_value_t = 5)]
    pub runs: usize,
}

/// Runs what was asked for and prints a line a task.
///
/// # Errors
/// Of the library, and where devices disagree.
pub fn run(arguments: &Arguments) -> Result<()> {
    let machine = Machine::open(&arguments.device)?;
    println!("{} ({}), {}, commit {COMMIT}", machine.name, machine.driver, machine.host);
    for set in &arguments.sets {
        let points = set.points();
        let arrays: Vec<[f32; 3]> = points.iter().map(|p| p.to_array()).collect();
        let (eps, mean) = eps_for(set, &arrays, arguments.mean)?;
        println!("{set}: eps {eps:.5}, {mean:.2} points within it on average");
        let bench = Bench { arguments, set: *set, arrays, eps };
        match &machine.device {
            Device::Cpu => bench.on_cpu()?,
            Device::Gpu(gpu) => bench.on_gpu(gpu, &points)?,
        }
    }
    Ok(())
}

/// A radius within which a point of the set should have about so many, itself among them, and how many it has on average.
///
/// # Errors
/// As the count.
pub(crate) fn eps_for(set: &Set, points: &[[f32; 3]], wanted: f64) -> Result<(f64, f64)> {
    // The volume of a ball grows with the cube of its radius; that of the set holds some 49.
    let eps = f64::from(set.radius()) * (wanted / 49.0).cbrt();
    let within = radius_outliers(points, &RadiusOutlierSettings::new(eps, 0), &mut Watch::none())?;
    let mean = 1.0 + within.neighbors.iter().map(|&n| f64::from(n)).sum::<f64>() / points.len() as f64;
    Ok((eps, mean))
}

struct Bench<'a> {
    arguments: &'a Arguments,
    set: Set,
    arrays: Vec<[f32; 3]>,
    eps: f64,
}

impl Bench<'_> {
    fn dbscan(&self) -> DbscanSettings {
        DbscanSettings::new(self.eps, self.arguments.min_points)
    }

    /// Repeats the work and prints its times.
    fn row<T>(
        &self,
        task: &str,
        work: impl Fn() -> Result<(T, Vec<Stage>)>,
        words: impl Fn(&T) -> String,
    ) -> Result<T> {
        let effort = Effort { warm_up: 0.2, runs: self.arguments.runs, seconds: 20.0 };
        let (answer, measured) = repeat(effort, work)?;
        println!(
            "{:<15}{task:<26}{:>10.2} ms  {}{}",
            self.set.to_string(),
            measured.wall.median,
            words(&answer),
            stages(&measured)
        );
        Ok(answer)
    }

    fn on_cpu(&self) -> Result<()> {
        let settings = self.dbscan();
        self.row("dbscan", || clustered(dbscan(&self.arrays, &settings, &mut Watch::none())), told)?;
        if self.arguments.only_dbscan {
            return Ok(());
        }
        let (n, arrays) = (self.arrays.len(), &self.arrays);
        let statistical = StatisticalOutlierSettings { k: 20, ratio: 2.0, rule: OutlierRule::Pcl };
        let radius = RadiusOutlierSettings::new(self.eps, 5);
        self.row(
            "statistical, 20 nearest",
            || untimed(statistical_outliers(arrays, &statistical, &mut Watch::none())),
            |f| kept(&f.kept),
        )?;
        self.row(
            "radius, 5 neighbours",
            || untimed(radius_outliers(arrays, &radius, &mut Watch::none())),
            |f| kept(&f.kept),
        )?;
        self.row("duplicates", || untimed(duplicates(arrays, 0.0, &mut Watch::none())), |f| kept(&f.kept))?;
        let voxels = VoxelSettings::new(self.eps);
        self.row(
            "voxels",
            || untimed(voxel_downsample(arrays, &voxels, &mut Watch::none())),
            |f| format!("{} cells", f.points.len()),
        )?;
        let tenth = PoissonDiskSettings { count: n / 10, extent: nearfield::application::Extent::Solid };
        self.row(
            "poisson disk, a tenth",
            || untimed(poisson_disk(arrays, &tenth, &mut Watch::none())),
            |f| format!("{} points", f.indices.len()),
        )?;
        let start = FarthestStart::Index(0);
        self.row(
            "farthest, 1,024",
            || untimed(farthest_points(arrays, 1024.min(n), start, &mut Watch::none())),
            |f| format!("{} points", f.indices.len()),
        )?;
        Ok(())
    }

    fn on_gpu(&self, gpu: &Gpu, points: &[nearfield::Vec3]) -> Result<()> {
        let settings = self.dbscan();
        let there =
            self.row("dbscan", || clustered(dbscan_on_gpu(gpu, points, &settings, &mut Watch::none())), told)?;
        let [labels, cores] = agree(&there, &dbscan(&self.arrays, &settings, &mut Watch::none())?)?;
        let n = self.arrays.len();
        println!("{:<15}{labels} labels and {cores} core points differ from the CPU's, of {n}", "");
        if self.arguments.only_dbscan {
            return Ok(());
        }
        let statistical = StatisticalOutlierSettings { k: 20, ratio: 2.0, rule: OutlierRule::Pcl };
        let radius = RadiusOutlierSettings::new(self.eps, 5);
        self.row(
            "statistical, 20 nearest",
            || untimed(statistical_outliers_on_gpu(gpu, points, &statistical, &mut Watch::none())),
            |f| kept(&f.kept),
        )?;
        self.row(
            "radius, 5 neighbours",
            || untimed(radius_outliers_on_gpu(gpu, points, &radius, &mut Watch::none())),
            |f| kept(&f.kept),
        )?;
        self.row("duplicates", || untimed(duplicates_on_gpu(gpu, points, 0.0, &mut Watch::none())), |f| kept(&f.kept))?;
        let voxels = VoxelSettings::new(self.eps);
        self.row(
            "voxels",
            || untimed(voxel_downsample_on_gpu(gpu, points, &voxels, &mut Watch::none())),
            |f| format!("{} cells", f.points.len()),
        )?;
        let (count, start) = (1024.min(points.len()), FarthestStart::Index(0));
        let there = self.row(
            "farthest, 1,024",
            || untimed(farthest_points_on_gpu(gpu, points, count, start, &mut Watch::none())),
            |f| format!("{} points", f.indices.len()),
        )?;
        if there != farthest_points(&self.arrays, count, start, &mut Watch::none())? {
            return Err(Error::from("the farthest points of the device are not those of the CPU".to_owned()));
        }
        Ok(())
    }
}

/// Clusters with the stages of their report.
pub(crate) fn clustered(found: nearfield::Result<Clusters>) -> Result<(Clusters, Vec<Stage>)> {
    let found = found?;
    let stages = found.stages.clone();
    Ok((found, stages))
}

fn untimed<T>(found: nearfield::Result<T>) -> Result<(T, Vec<Stage>)> {
    Ok((found?, Vec::new()))
}

fn told(found: &Clusters) -> String {
    format!("{} clusters, {} points of noise", found.n_clusters, found.unlabelled())
}

fn kept(kept: &[bool]) -> String {
    format!("{} of {} stay", kept.iter().filter(|kept| **kept).count(), kept.len())
}

fn stages(measured: &Measured) -> String {
    let one = |stage: &Stage| {
        let clock = if stage.clock == Clock::Device { "" } else { " (host)" };
        format!("{}{clock} {:.2}", stage.name, stage.milliseconds)
    };
    let all: Vec<String> = measured.stages.iter().map(one).collect();
    if all.is_empty() { String::new() } else { format!("; {}", all.join(", ")) }
}

/// Checks that both devices found the same clusters, number by number; how many labels and core points differ.
///
/// # Errors
/// More differences than rounding explains.
pub(crate) fn agree(there: &Clusters, here: &Clusters) -> Result<[usize; 2]> {
    let n = here.labels.len();
    let differ = there.labels.iter().zip(&here.labels).filter(|(a, b)| a != b).count();
    let cores = there.is_core.iter().zip(&here.is_core).filter(|(a, b)| a != b).count();
    if differ == 0 && there.n_clusters != here.n_clusters {
        let found = format!("{} clusters on the device and {} on the CPU", there.n_clusters, here.n_clusters);
        return Err(Error::from(format!("{found}, with equal labels")));
    }
    if there.labels.len() == n && differ.max(cores) as f64 <= MAY_DIFFER * n as f64 {
        return Ok([differ, cores]);
    }
    Err(Error::from(format!("{differ} labels and {cores} core points differ between the devices")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clusters(labels: &[i32]) -> Clusters {
        let n_clusters = labels.iter().max().map_or(0, |most| (most + 1) as u32);
        Clusters { labels: labels.to_vec(), is_core: vec![true; labels.len()], n_clusters, ..Clusters::default() }
    }

    #[test]
    fn equal_labels_agree_and_others_do_not() {
        assert!(agree(&clusters(&[0, 0, 1, -1]), &clusters(&[0, 0, 1, -1])).is_ok());
        assert!(agree(&clusters(&[1, 1, 0, -1]), &clusters(&[0, 0, 1, -1])).is_err());
        // A cluster that is split, and two that are joined.
        assert!(agree(&clusters(&[0, 0, 1, 1]), &clusters(&[0, 0, 0, 0])).is_err());
        assert!(agree(&clusters(&[0, 0, 0, 0]), &clusters(&[0, 0, 1, 1])).is_err());
        assert!(agree(&clusters(&[0, 0, 1, -1]), &clusters(&[0, 0, 1, 1])).is_err());
        assert!(agree(&clusters(&[0, 1, 1, -1]), &clusters(&[0, 0, 1, -1])).is_err());
        let mut other = clusters(&[0, 0, 1, -1]);
        other.is_core[3] = false;
        assert!(agree(&other, &clusters(&[0, 0, 1, -1])).is_err());
        let more = Clusters { n_clusters: 3, ..clusters(&[0, 0, 1, -1]) };
        assert!(agree(&more, &clusters(&[0, 0, 1, -1])).is_err());
    }
}
