//! How near noisy samples of known surfaces come to the truth by each method, beside the time: a torus with about 256 neighbours, a
//! cube with its edges, and the drift of a sphere that is smoothed 30 times.

use std::time::Instant;

use nearfield::application::{GpuMlsProjection, GpuMlsSmoothing, PlaneSearch, Support, Watch};
use nearfield::{
    AabbTreeN, AabbTreeNSettings, AabbTreeSettings, GpuAabbTree, MlsMethod, MlsProjection, MlsSettings, MlsSmoothing,
    Vec3,
};

use super::Workshop;
use super::surfaces::{Surface, cube, sphere, torus};
use crate::Result;
use crate::paper::lab::Lab;
use crate::paper::rows::{Row, Sheet};

const OFF: &str = "distance from the surface, RMS";
const BIAS: &str = "distance from the surface, mean";
const TIME: &str = "time, with builds and copies";
/// Steps of a projection, as in the published figures.
const STEPS: u32 = 5;
/// Iterations after which a sphere is looked at.
const LOOKS: [usize; 4] = [1, 5, 10, 30];
/// Nearest of a jet.
const JET: u32 = 96;
/// Share of the points that one device may bring to another place than the other, farther than this part of the diagonal.
const MOST_APART: f64 = 0.01;
const APART: f64 = 1e-4;

const fn pss(degree: u8, plane: PlaneSearch) -> MlsMethod {
    MlsMethod::Pss { degree, plane }
}

/// Methods, and the names of their rows.
const METHODS: [(&str, MlsMethod); 9] = [
    ("PSS degree 0", pss(0, PlaneSearch::Fast)),
    ("PSS degree 1", pss(1, PlaneSearch::Fast)),
    ("PSS degree 2", pss(2, PlaneSearch::Fast)),
    ("PSS degree 3", pss(3, PlaneSearch::Fast)),
    ("PSS full, degree 2", pss(2, PlaneSearch::Full)),
    ("APSS", MlsMethod::APSS),
    ("RIMLS", MlsMethod::RIMLS),
    ("bilateral", MlsMethod::BILATERAL),
    ("jet of 96 nearest", MlsMethod::Jet),
];

/// What other implementations reach on such sets, in percent of the diagonal.
const TORUS: [(&str, &str); 6] = [
    ("PSS degree 0", "a script in f64: 0.138"),
    ("PSS degree 2", "a script in f64: 0.088"),
    ("APSS", "a script in f64: 0.070; PyMeshLab at scale 6: 0.097"),
    ("RIMLS", "PyMeshLab at scale 4: 0.240"),
    ("bilateral", "CGAL, 96 nearest: 0.173"),
    ("jet of 96 nearest", "CGAL: 0.099; Open3D's smoothing by planes: 0.328"),
];
const CUBE: [(&str, &str); 4] = [
    ("PSS degree 2", "a script in f64: 0.112"),
    ("APSS", "a script in f64: 0.099"),
    ("bilateral", "CGAL, 96 nearest: 0.140"),
    ("jet of 96 nearest", "CGAL: 0.129"),
];

/// Measures every method on every set, on each device.
///
/// # Errors
/// What a method returns; a wrong answer; a file that cannot be written.
pub fn measure(workshop: &Workshop) -> Result<Vec<Row>> {
    let lab = &workshop.lab;
    let mut sheet = Sheet::begin(lab, "quality")?;
    let stretch = |n: usize| (n as f64 / lab.points(n) as f64).sqrt();
    let n = 100_000;
    for (make, radius, published) in [(torus as fn(usize, f64) -> Surface, 0.126, &TORUS[..]), (cube, 0.142, &CUBE[..])]
    {
        let surface = make(lab.points(n), 0.005);
        let set = Set::new(lab, &surface, radius * stretch(n), n)?;
        set.measure(&mut sheet, "projected onto the samples", published, |method, on_gpu| {
            set.projected(method, on_gpu)
        })?;
    }
    let n = 20_000;
    let surface = sphere(lab.points(n), 0.0025);
    let set = Set::new(lab, &surface, 0.089 * stretch(n), n)?;
    for iterations in LOOKS {
        let name = format!("smoothed {iterations} times");
        set.measure(&mut sheet, &name, &[], |method, on_gpu| set.smoothed(method, on_gpu, iterations))?;
    }
    Ok(sheet.into_rows())
}

/// A surface, normals of its samples, and a radius.
struct Set<'a> {
    lab: &'a Lab,
    surface: &'a Surface,
    paper_points: usize,
    arrays: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    radius: f32,
}

/// Points, mean neighbours of the first step, milliseconds.
type Made = (Vec<[f32; 3]>, f64, f64);

impl<'a> Set<'a> {
    fn new(lab: &'a Lab, surface: &'a Surface, radius: f64, paper_points: usize) -> Result<Self> {
        let normals = surface.plane_normals(radius)?;
        Ok(Self { lab, surface, paper_points, arrays: surface.arrays(), normals, radius: radius as f32 })
    }

    fn row(&self, on_gpu: bool, setting: &str, method: &str) -> Row {
        let radius = f64::from(self.radius);
        Row {
            device: self.lab.device(on_gpu),
            paper_points: self.paper_points,
            points: self.surface.points.len(),
            dimension: 3,
            setting: format!("{}, {setting}, {}", self.surface.name, if on_gpu { "GPU" } else { "CPU" }),
            r_over_l: (radius / self.surface.diagonal * 1e5).round() / 1e5,
            radius,
            mean_neighbors: None,
            method: method.to_owned(),
            quantity: OFF,
            unit: "% of L",
            value: None,
            device_milliseconds: None,
            paper: None,
            recall: None,
            runs: 1,
            note: String::new(),
        }
    }

    fn measure(
        &self,
        sheet: &mut Sheet<'_>,
        setting: &str,
        published: &[(&str, &str)],
        make: impl Fn(MlsMethod, bool) -> Result<Made>,
    ) -> Result<()> {
        let (before, _) = self.surface.error(self.arrays.iter());
        for (name, method) in METHODS {
            let mut on_cpu: Option<Vec<[f32; 3]>> = None;
            for on_gpu in [false, true].into_iter().filter(|on_gpu| !on_gpu || self.lab.gpu().is_some()) {
                let row = self.row(on_gpu, setting, name);
                sheet.attempt(row.clone(), || {
                    let (points, mean_neighbors, milliseconds) = make(method, on_gpu)?;
                    let (rms, mean) = self.surface.error(points.iter());
                    if points.len() != self.arrays.len() || !rms.is_finite() {
                        return Err("wrong answer: points are missing, or are no place".into());
                    }
                    let compared = match &on_cpu {
                        Some(points_there) => {
                            self.check(&points, points_there)?;
                            ", points where the CPU brings them"
                        }
                        None => "",
                    };
                    if !on_gpu {
                        on_cpu = Some(points);
                    }
                    let other = published.iter().find(|(known, _)| *known == name).map(|(_, text)| *text);
                    let other = other.unwrap_or("no figure of others");
                    let note = format!("{:.4} before{compared}; {other}", 100.0 * before);
                    let row = Row { mean_neighbors: Some(mean_neighbors), ..row };
                    Ok(vec![
                        row.of(OFF, "% of L").value(100.0 * rms).note(note.clone()),
                        row.of(BIAS, "% of L").value(100.0 * mean).note(note.clone()),
                        row.of(TIME, "ms").value(milliseconds).note(note),
                    ])
                })?;
            }
        }
        Ok(())
    }

    /// Checks that a device brings points to where the CPU does.
    fn check(&self, found: &[[f32; 3]], expected: &[[f32; 3]]) -> Result<()> {
        let limit = APART * self.surface.diagonal;
        let is_apart =
            |(a, b): &(&[f32; 3], &[f32; 3])| f64::from(Vec3::from_array(**a).distance(Vec3::from_array(**b))) > limit;
        let apart = found.iter().zip(expected).filter(is_apart).count();
        if apart as f64 > MOST_APART * expected.len() as f64 {
            return Err(
                format!("wrong answer: {apart} of {} points are not where the CPU brings them", found.len()).into()
            );
        }
        Ok(())
    }

    fn support(&self, method: MlsMethod) -> Support<'_, f32> {
        if method == MlsMethod::Jet { Support::Nearest(JET) } else { Support::Radius(self.radius) }
    }

    fn projected(&self, method: MlsMethod, on_gpu: bool) -> Result<Made> {
        let settings = MlsSettings { most_steps: STEPS, ..MlsSettings::new(method) };
        let support = self.support(method);
        let normals = Some(&self.normals[..]).filter(|_| method.needs_normals());
        if let Some(gpu) = self.lab.gpu().filter(|_| on_gpu) {
            let wide = |arrays: &[[f32; 3]]| arrays.iter().map(|a| Vec3::from_array(*a)).collect::<Vec<Vec3>>();
            let (points, normals) = (wide(&self.arrays), normals.map(wide));
            let run = || -> Result<Made> {
                let begin = Instant::now();
                let tree = GpuAabbTree::build(gpu, &points, &AabbTreeSettings::default())?;
                let mut projection = GpuMlsProjection::new(&tree, normals.as_deref(), &points, &support, &settings)?;
                let reports = projection.run(&mut Watch::none())?;
                let moved = projection.points()?.positions.iter().map(|p| p.to_array()).collect();
                let neighbors = reports.first().map_or(0.0, |report| report.mean_neighbors);
                Ok((moved, neighbors, 1e3 * begin.elapsed().as_secs_f64()))
            };
            // Kernels are made in a run that is not timed, where the device is fast enough for one.
            if self.lab.effort().warm_up > 0.0 {
                run()?;
            }
            return run();
        }
        let begin = Instant::now();
        let tree = AabbTreeN::build(&self.arrays, &AabbTreeNSettings::default())?;
        let mut projection = MlsProjection::new(&tree, normals, &self.arrays, &support, &settings)?;
        let reports = projection.run(&mut Watch::none())?;
        let neighbors = reports.first().map_or(0.0, |report| report.mean_neighbors);
        Ok((projection.positions().to_vec(), neighbors, 1e3 * begin.elapsed().as_secs_f64()))
    }

    fn smoothed(&self, method: MlsMethod, on_gpu: bool, iterations: usize) -> Result<Made> {
        let settings = MlsSettings::new(method);
        let support = self.support(method);
        let normals = Some(&self.normals[..]).filter(|_| method.needs_normals());
        let mut neighbors = 0.0;
        if let Some(gpu) = self.lab.gpu().filter(|_| on_gpu) {
            let wide = |arrays: &[[f32; 3]]| arrays.iter().map(|a| Vec3::from_array(*a)).collect::<Vec<Vec3>>();
            let (points, normals) = (wide(&self.arrays), normals.map(wide));
            let begin = Instant::now();
            let mut smoothing = GpuMlsSmoothing::new(gpu, &points, normals.as_deref(), &support, &settings)?;
            for _ in 0..iterations {
                neighbors = smoothing.iterate()?.mean_neighbors;
            }
            let moved = smoothing.points()?.positions.iter().map(|p| p.to_array()).collect();
            return Ok((moved, neighbors, 1e3 * begin.elapsed().as_secs_f64()));
        }
        let begin = Instant::now();
        let mut smoothing = MlsSmoothing::new(&self.arrays, normals, &support, &settings)?;
        for _ in 0..iterations {
            neighbors = smoothing.iterate()?.mean_neighbors;
        }
        Ok((smoothing.positions().to_vec(), neighbors, 1e3 * begin.elapsed().as_secs_f64()))
    }
}
