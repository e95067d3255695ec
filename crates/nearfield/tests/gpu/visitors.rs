//! Callers' own WGSL on every neighbour: right sums, early exit, own bindings, and everything a caller can get wrong.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicU32, Ordering};

use libtest_mimic::Trial;
use nearfield::gpu::{Access, Bind, Buffer, Gpu};
use nearfield::query::Report;
use nearfield::{
    BruteForce, Error, FixedRadius, ForEachNeighbor, ForEachOnDevice, GpuBruteForce, GpuUniformGrid, GridSettings,
    Result, UniformGrid, Vec3, Visitor,
};

use crate::support::gpu_trial;
use crate::{RADIUS, lattice_points, rows_by_loop};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("the_documented_visitor_sums_distances", the_documented_visitor_sums_distances),
        gpu_trial("visitors_sum_what_the_cpu_sums", visitors_sum_what_the_cpu_sums),
        gpu_trial("a_visitor_ends_its_row_early", a_visitor_ends_its_row_early),
        gpu_trial("visitors_know_query_and_neighbor", visitors_know_query_and_neighbor),
        gpu_trial("a_visitor_that_does_not_compile_is_rejected_readably", a_bad_visitor_is_rejected_readably),
        gpu_trial("a_visitor_that_writes_out_of_bounds_does_no_harm", a_visitor_out_of_bounds_does_no_harm),
        gpu_trial("a_visitor_sees_the_length_of_its_buffer", a_visitor_sees_the_length_of_its_buffer),
        gpu_trial("wrong_bindings_of_a_visitor_are_an_error", wrong_bindings_of_a_visitor_are_an_error),
    ]
}

/// A visitor that keeps one number a query.
fn source(bindings: &str, start: &str, visit: &str, finish: &str) -> String {
    format!(
        "import package::structure::question::{{Query, Neighbor}};

{bindings}

struct State {{ value: u32 }}

fn begin(query: Query) -> State {{ return State({start}); }}

fn visit(state: ptr<function, State>, query: Query, neighbor: Neighbor) -> bool {{ {visit} }}

fn finish(state: ptr<function, State>, query: Query) {{ {finish} }}
"
    )
}

const VALUES: &str = "@group(1) @binding(0) var<storage, read_write> values: array<u32>;";
const STORE: &str = "values[query.slot] = (*state).value;";

struct Both {
    points: Vec<Vec3>,
    brute_force: GpuBruteForce,
    grid: GpuUniformGrid,
}

impl Both {
    fn new(gpu: &Gpu, n: usize) -> Self {
        let points = lattice_points(n);
        let brute_force = GpuBruteForce::build(gpu, &points).unwrap();
        let grid = GpuUniformGrid::build(gpu, &points, &GridSettings::for_radius(RADIUS)).unwrap();
        Self { points, brute_force, grid }
    }

    fn run(&self, question: &FixedRadius<'_>, visitor: &Visitor<'_>, by_grid: bool) -> Result<Report> {
        if by_grid {
            self.grid.for_each_on_device(question, visitor)
        } else {
            self.brute_force.for_each_on_device(question, visitor)
        }
    }
}

/// Runs a visitor with `values` as its first binding and returns them.
fn values_of(
    gpu: &Gpu,
    both: &Both,
    question: &FixedRadius<'_>,
    source: &str,
    more: &[(Access, Bind)],
    by_grid: bool,
) -> Vec<u32> {
    let poison = vec![0xdead_beefu32; question.len(both.points.len())];
    let values = gpu.upload("poisoned values", &poison).unwrap();
    let bindings = [&[(Access::ReadWrite, (&values).into())], more].concat();
    let report = both.run(question, &Visitor::new(source, &bindings), by_grid).unwrap();
    assert_eq!(report.structure, if by_grid { "uniform-grid" } else { "brute-force" });
    assert_eq!(report.device, gpu.name());
    gpu.read(&values).unwrap()
}

fn the_documented_visitor_sums_distances(gpu: &Gpu) {
    let documented = "
import package::structure::question::{Query, Neighbor};

@group(1) @binding(0) var<storage, read_write> sums: array<f32>;

struct State { sum: f32 }

fn begin(query: Query) -> State { return State(0.0); }

fn visit(state: ptr<function, State>, query: Query, neighbor: Neighbor) -> bool {
    (*state).sum += sqrt(neighbor.dist2);
    return true; // false ends the row of this query
}

fn finish(state: ptr<function, State>, query: Query) { sums[query.slot] = (*state).sum; }
";
    let in_the_manual = include_str!("../../src/query/gpu/visitor.rs").replace("/// ", "").replace("///", "");
    assert!(in_the_manual.contains(documented.trim()), "the example of the manual is another one");
    let both = Both::new(gpu, 3000);
    let rows = rows_by_loop(&both.points, &both.points, RADIUS);
    for by_grid in [false, true] {
        let question = FixedRadius::new(RADIUS);
        let sums = values_of(gpu, &both, &question, documented, &[], by_grid);
        for (i, row) in rows.iter().enumerate() {
            let expected: f64 = row.iter().map(|&(_, d2)| f64::from(d2).sqrt()).sum();
            // Every root is within 3 units in the last place, and so is each of the additions within half of one.
            let bound = (row.len() as f64 + 6.0) * f64::from(f32::EPSILON) * expected;
            let found = f64::from(f32::from_bits(sums[i]));
            assert!((found - expected).abs() <= bound, "query {i}, by grid {by_grid}: {found}, expected {expected}");
        }
    }
}

fn visitors_sum_what_the_cpu_sums(gpu: &Gpu) {
    let both = Both::new(gpu, 3000);
    // Squared distances on the lattice are whole in this unit.
    let sum = source(VALUES, "0u", "(*state).value += u32(neighbor.dist2 * 16384.0) + 1u; return true;", STORE);
    let cpu_brute_force = BruteForce::build(&both.points).unwrap();
    let cpu_grid = UniformGrid::build(&both.points, &GridSettings::for_radius(RADIUS)).unwrap();
    let radii: Vec<f32> = (0..both.points.len()).map(|i| (i % 19) as f32 / 128.0).collect();
    let others = lattice_points(777);
    let questions = [
        FixedRadius::new(RADIUS),
        FixedRadius::new(RADIUS).exclude_self(),
        FixedRadius::each(&radii),
        FixedRadius::each(&radii[..777]).queries(&others),
    ];
    for (number, question) in questions.iter().enumerate() {
        let sums: Vec<AtomicU32> = (0..question.len(both.points.len())).map(|_| AtomicU32::new(0)).collect();
        let add = |query: u32, neighbor: nearfield::Neighbor| {
            sums[query as usize].fetch_add((neighbor.dist2 * 16384.0) as u32 + 1, Ordering::Relaxed);
            ControlFlow::Continue(())
        };
        let mut expected = Vec::new();
        for by_grid in [false, true] {
            sums.iter().for_each(|s| s.store(0, Ordering::Relaxed));
            let run = if by_grid { cpu_grid.for_each(question, add) } else { cpu_brute_force.for_each(question, add) };
            run.unwrap();
            expected.push(sums.iter().map(|s| s.load(Ordering::Relaxed)).collect::<Vec<u32>>());
        }
        assert_eq!(expected[0], expected[1]);
        for by_grid in [false, true] {
            let found = values_of(gpu, &both, question, &sum, &[], by_grid);
            let wrong = found.iter().zip(&expected[0]).position(|(f, e)| f != e);
            assert_eq!(wrong, None, "question {number}, by grid {by_grid}");
        }
    }
}

fn a_visitor_ends_its_row_early(gpu: &Gpu) {
    let both = Both::new(gpu, 3000);
    let rows = rows_by_loop(&both.points, &both.points, RADIUS);
    assert!(rows.iter().any(|row| row.len() < 5) && rows.iter().any(|row| row.len() > 5));
    let five = source(VALUES, "0u", "(*state).value += 1u; return (*state).value < 5u;", STORE);
    for by_grid in [false, true] {
        let counts = values_of(gpu, &both, &FixedRadius::new(RADIUS), &five, &[], by_grid);
        let wrong = counts.iter().zip(&rows).position(|(&count, row)| count as usize != row.len().min(5));
        assert_eq!(wrong, None, "by grid {by_grid}");
    }
}

fn visitors_know_query_and_neighbor(gpu: &Gpu) {
    let both = Both::new(gpu, 1500);
    let rows = rows_by_loop(&both.points, &both.points, RADIUS);
    let weights: Vec<u32> = (0..both.points.len() as u32).map(|i| i.wrapping_mul(2_654_435_761) >> 12).collect();
    let (weight_buffer, scale) = (gpu.upload("weights", &weights).unwrap(), gpu.uniform("scale", &[3u32; 4]).unwrap());
    let more = [(Access::Read, (&weight_buffer).into()), (Access::Uniform, (&scale).into())];
    let bindings = format!(
        "{VALUES}
        @group(1) @binding(1) var<storage, read> weights: array<u32>;
        @group(1) @binding(2) var<uniform> scale: vec4<u32>;"
    );
    // The difference, taken apart into whole numbers, must give the squared distance again.
    let visit = "let d = neighbor.difference * 128.0;
        if u32(dot(d, d)) == u32(neighbor.dist2 * 16384.0) && query.id == query.slot && query.radius2 == query.radius * query.radius {
            (*state).value += scale.x * weights[neighbor.id];
        }
        return true;";
    let sum = source(&bindings, "weights[query.id]", visit, STORE);
    for by_grid in [false, true] {
        let found = values_of(gpu, &both, &FixedRadius::new(RADIUS), &sum, &more, by_grid);
        for (i, row) in rows.iter().enumerate() {
            let expected = weights[i] + row.iter().map(|&(id, _)| 3 * weights[id as usize]).sum::<u32>();
            assert_eq!(found[i], expected, "query {i}, by grid {by_grid}");
        }
    }
}

fn a_bad_visitor_is_rejected_readably(gpu: &Gpu) {
    let both = Both::new(gpu, 100);
    let values: Buffer<u32> = gpu.buffer("values", 100).unwrap();
    let bindings = [(Access::ReadWrite, Bind::from(&values))];
    let good = source(VALUES, "0u", "(*state).value += 1u; return true;", STORE);
    let bad = [
        ("syntax", source(VALUES, "0u", "let oops = ; return true;", STORE), "oops"),
        ("type", source(VALUES, "0u", "(*state).value += 1.5f; return true;", STORE), "1.5"),
        ("unknown name", source(VALUES, "0u", "return not_declared_anywhere;", STORE), "not_declared_anywhere"),
        ("no finish", good.replace("fn finish", "fn finished"), "finish"),
        ("missing import", good.replace("question::{Query", "questions::{Query"), "questions"),
        ("unknown field", source(VALUES, "0u", "return neighbor.colour > 0u;", STORE), "colour"),
        ("empty", String::new(), "State"),
        ("no WGSL at all", "\u{1b}[31m{{{ \0 ∞".into(), ""),
    ];
    for (case, source, named) in &bad {
        match both.run(&FixedRadius::new(RADIUS), &Visitor::new(source, &bindings), true) {
            Err(Error::KernelRejected { kernel, message }) => {
                assert!(kernel.starts_with("package::query::fixed_radius"), "{case}: {kernel}");
                assert!(message.contains(named), "{case} does not name {named:?}: {message}");
                assert!(!message.contains('\u{1b}'), "{case} has escape codes: {message:?}");
                // A line of the source, by its number.
                let has_line = message.lines().any(|line| {
                    let number = line.trim_start().split([' ', '|', '│']).next().unwrap_or_default();
                    !number.is_empty() && number.chars().all(|c| c.is_ascii_digit())
                });
                let about_a_line = !matches!(*case, "no finish" | "empty" | "missing import" | "no WGSL at all");
                assert!(has_line || !about_a_line, "{case} has no line: {message}");
            }
            other => panic!("{case}: {other:?}"),
        }
    }
    both.run(&FixedRadius::new(RADIUS), &Visitor::new(&good, &bindings), true).unwrap();
}

fn a_visitor_out_of_bounds_does_no_harm(gpu: &Gpu) {
    let both = Both::new(gpu, 1000);
    let rows = rows_by_loop(&both.points, &both.points, RADIUS);
    let far = "values[query.slot + 1000000000u] = values[query.slot * 4000000u + 77777777u]; values[query.slot] = 7u;";
    let wild = source(
        VALUES,
        "values[query.slot + 4294960000u]",
        "(*state).value += values[neighbor.id * 1000003u]; return true;",
        far,
    );
    let short: Buffer<u32> = gpu.upload("one word", &[0xdead_beefu32]).unwrap();
    for by_grid in [false, true] {
        values_of(gpu, &both, &FixedRadius::new(RADIUS), &wild, &[], by_grid);
        // A buffer that is too short for the answers.
        let bindings = [(Access::ReadWrite, Bind::from(&short))];
        let count = source(VALUES, "0u", "(*state).value += 1u; return true;", STORE);
        both.run(&FixedRadius::new(RADIUS), &Visitor::new(&count, &bindings), by_grid).unwrap();
        // The structure is unharmed.
        let counts = values_of(gpu, &both, &FixedRadius::new(RADIUS), &count, &[], by_grid);
        assert!(counts.iter().zip(&rows).all(|(&count, row)| count as usize == row.len()), "by grid {by_grid}");
    }
}

fn a_visitor_sees_the_length_of_its_buffer(gpu: &Gpu) {
    let both = Both::new(gpu, 100);
    let length = source(VALUES, "arrayLength(&values)", "return false;", STORE);
    // Memory of a larger buffer that is not used any more may serve for a smaller one.
    drop(gpu.upload("larger", &[0u32; 120]).unwrap());
    assert_eq!(values_of(gpu, &both, &FixedRadius::new(RADIUS), &length, &[], true), [100; 100]);
}

fn wrong_bindings_of_a_visitor_are_an_error(gpu: &Gpu) {
    let both = Both::new(gpu, 100);
    let count = source(VALUES, "0u", "(*state).value += 1u; return true;", STORE);
    let values: Buffer<u32> = gpu.buffer("values", 100).unwrap();
    let uniform = gpu.uniform("four words", &[0u32; 4]).unwrap();
    let run = |bindings: &[(Access, Bind)]| {
        both.run(&FixedRadius::new(RADIUS), &Visitor::new(&count, bindings), true).map(drop)
    };
    assert!(matches!(run(&[]), Err(Error::KernelRejected { .. })), "none");
    assert!(matches!(run(&[(Access::Read, (&values).into())]), Err(Error::KernelRejected { .. })), "read only");
    assert!(matches!(run(&[(Access::Uniform, (&values).into())]), Err(Error::KernelRejected { .. })), "uniform");
    assert!(matches!(run(&[(Access::ReadWrite, (&uniform).into())]), Err(Error::Device { .. })), "of a uniform buffer");
    run(&[(Access::ReadWrite, (&values).into())]).unwrap();
    assert!(gpu.read(&values).unwrap().iter().all(|&n| n >= 1));
}
