//! Choosing a device, a caller's own device, buffers, dispatches, pipelines and refused work.

use std::sync::Arc;

use libtest_mimic::Trial;
use nearfield::gpu::shader::Fill;
use nearfield::gpu::{
    Access, AdapterKind, Bind, Buffer, DeviceChoice, Gpu, Kernel, Pipeline, Workgroups, adapters, wgpu,
};
use nearfield::parallel::histogram::GpuHistogram;
use nearfield::parallel::radix_sort::{GpuRadixSort, RankMethod};
use nearfield::query::Clock;
use nearfield::{Error, FixedRadius};

use crate::support::gpu_trial;
use crate::{RADIUS, lattice_points, own_context, rows_by_loop, structures, wrong_row};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("adapters_are_listed_hardware_first", adapters_are_listed_hardware_first),
        gpu_trial("choices_mean_what_they_say", choices_mean_what_they_say),
        gpu_trial("a_callers_bare_device_gives_the_same_answers", a_callers_bare_device_gives_the_same_answers),
        gpu_trial("a_device_of_few_workgroups_folds_every_dispatch", a_device_of_few_workgroups_folds_every_dispatch),
        gpu_trial("more_than_65535_workgroups_fold", more_than_65535_workgroups_fold),
        gpu_trial("buffers_of_any_length_come_back", buffers_of_any_length_come_back),
        gpu_trial("much_is_written_whole", much_is_written_whole),
        gpu_trial("parts_of_words_are_read_but_not_written", parts_of_words_are_read_but_not_written),
        gpu_trial("sizes_that_do_not_fit_are_refused", sizes_that_do_not_fit_are_refused),
        gpu_trial("pipelines_are_compiled_once", pipelines_are_compiled_once),
        gpu_trial("a_callers_own_module_is_a_kernel", a_callers_own_module_is_a_kernel),
        gpu_trial("repeated_work_runs_as_often_as_asked", repeated_work_runs_as_often_as_asked),
        gpu_trial("work_that_the_driver_refuses_is_an_error", work_that_the_driver_refuses_is_an_error),
        gpu_trial("a_wrong_access_is_rejected_with_the_kernel", a_wrong_access_is_rejected_with_the_kernel),
        gpu_trial("every_stage_has_its_time", every_stage_has_its_time),
    ]
}

fn adapters_are_listed_hardware_first(gpu: &Gpu) {
    let found = adapters();
    assert!(found.iter().any(|a| a.name == gpu.name() && a.kind == gpu.kind()));
    assert!(found.is_sorted_by_key(|a| a.kind));
    assert!(found.iter().all(|a| !a.name.is_empty() && !a.driver.is_empty()));
}

fn choices_mean_what_they_say(gpu: &Gpu) {
    let found = adapters();
    let name = |choice: &DeviceChoice| choice.resolve().unwrap().map(|a| a.name);
    assert_eq!(name(&DeviceChoice::Cpu), None);
    assert_eq!(name(&DeviceChoice::Gpu), Some(found[0].name.clone()));
    for (number, adapter) in found.iter().enumerate() {
        assert_eq!(name(&DeviceChoice::Number(number)), Some(adapter.name.clone()));
    }
    let part = gpu.name()[1..gpu.name().len().min(6)].to_uppercase();
    assert!(name(&DeviceChoice::Name(part.clone())).is_some_and(|n| n.to_uppercase().contains(&part)));
    let hardware = found.iter().find(|a| a.kind != AdapterKind::Software).map(|a| a.name.clone());
    assert_eq!(name(&DeviceChoice::Auto), hardware, "auto takes no software adapter");
    for missing in [DeviceChoice::Number(found.len()), DeviceChoice::Name("no such device".into())] {
        match missing.resolve() {
            Err(Error::NoDevice { asked, found: names }) => {
                assert_eq!(asked, missing.to_string());
                assert!(names.contains(&gpu.name().to_owned()));
            }
            other => panic!("{missing}: {other:?}"),
        }
    }
}

/// A device that the caller opened without any feature.
fn bare_device(gpu: &Gpu, limits: wgpu::Limits) -> (wgpu::Device, wgpu::Queue) {
    let backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends,
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    });
    let all = pollster::block_on(instance.enumerate_adapters(backends));
    let adapter = all.into_iter().find(|a| a.get_info().name == gpu.name()).unwrap();
    let descriptor = wgpu::DeviceDescriptor { required_limits: limits, ..Default::default() };
    pollster::block_on(adapter.request_device(&descriptor)).unwrap()
}

fn a_callers_bare_device_gives_the_same_answers(gpu: &Gpu) {
    let (device, queue) = bare_device(gpu, wgpu::Limits::default());
    let own = Gpu::from_device(device.clone(), queue);
    assert_eq!((own.limits().subgroup, own.limits().timestamp_period), (None, None));
    assert_eq!(own.name(), gpu.name());
    assert!(matches!(GpuRadixSort::<u32>::with_method(&own, 10, RankMethod::Ballot), Err(Error::Unsupported { .. })));

    let points = lattice_points(2000);
    let expected = rows_by_loop(&points, &points, RADIUS);
    for search in structures(&own, &points) {
        let list = search.list(&FixedRadius::new(RADIUS)).unwrap();
        assert_eq!(wrong_row(&list, &expected), None, "{}", search.structure());
        assert!(list.report.stages.iter().all(|s| s.clock == Clock::Host), "a device without timestamps has no times");
        assert!(search.build_stages().iter().all(|s| s.clock == Clock::Host));
        assert_eq!(list.report.device, gpu.name());
    }
    // A buffer of the caller's takes part like any other.
    let raw = device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: 16,
        usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    let used = own.memory_used();
    let buffer = Buffer::<u32>::from_wgpu("the caller's", raw, 4).unwrap();
    own.write(&buffer, 0, &[1, 2, 3, 4]).unwrap();
    assert_eq!(own.read(&buffer).unwrap(), [1, 2, 3, 4]);
    drop(buffer);
    assert_eq!(own.memory_used(), used, "a caller's buffer does not count");
}

fn a_device_of_few_workgroups_folds_every_dispatch(gpu: &Gpu) {
    // By two passes 32 workgroups of queries and 16 of points, in rows of 7; with masks 34 of queries and 1081 of their
    // words, in rows of 33: the last row is never full.
    let plain = FixedRadius::new(RADIUS);
    for (limit, n, question) in [(7, 4000, plain.distances()), (33, 4324, plain)] {
        let limits = wgpu::Limits { max_compute_workgroups_per_dimension: limit, ..Default::default() };
        let (device, queue) = bare_device(gpu, limits);
        let own = Gpu::from_device(device, queue);
        assert_eq!(own.limits().workgroups, limit);
        let points = lattice_points(n);
        let expected = rows_by_loop(&points, &points, RADIUS);
        for search in structures(&own, &points) {
            let list = search.list(&question).unwrap();
            assert_eq!(wrong_row(&list, &expected), None, "{} in rows of {limit}", search.structure());
        }
    }
}

fn more_than_65535_workgroups_fold(gpu: &Gpu) {
    // One invocation a bin clears the counts.
    let n_bins = 65_536 * 256 + 1000;
    let plan = GpuHistogram::new(gpu, n_bins).unwrap();
    let values = [0, 7, 7, n_bins as u32 - 1, n_bins as u32 + 5];
    let input = gpu.upload("values", &values).unwrap();
    let counts: Buffer<u32> = gpu.upload("poisoned counts", &vec![0xdead_beef; n_bins + 1]).unwrap();
    let mut commands = gpu.commands("histogram");
    plan.record(&mut commands, &input, &counts, values.len()).unwrap();
    commands.submit().unwrap();
    let found = gpu.read(&counts).unwrap();
    let filled: Vec<(usize, u32)> = found.iter().copied().enumerate().filter(|(_, count)| *count != 0).collect();
    assert_eq!(filled, [(0, 1), (7, 2), (n_bins - 1, 1), (n_bins, 1)]);
}

fn buffers_of_any_length_come_back(gpu: &Gpu) {
    let used = gpu.upload::<u32>("nothing", &[]).unwrap();
    assert!(used.is_empty() && gpu.read(&used).unwrap().is_empty());
    for n in 0..=9u8 {
        let bytes: Vec<u8> = (1..=n).collect();
        let buffer = gpu.upload("bytes", &bytes).unwrap();
        assert_eq!((buffer.len(), gpu.read(&buffer).unwrap()), (bytes.len(), bytes));
    }
    let points: Vec<[f32; 3]> = (0..1001).map(|i| [i as f32, -0.5, f32::NAN]).collect();
    let read = gpu.read(&gpu.upload("points", &points).unwrap()).unwrap();
    assert!(read.iter().flatten().map(|v| v.to_bits()).eq(points.iter().flatten().map(|v| v.to_bits())));
}

fn much_is_written_whole(gpu: &Gpu) {
    // Copied by many threads, in pieces of 1 MiB: lengths around those, and bytes beyond whole words.
    for bytes in [(4 << 20) - 1, 4 << 20, (5 << 20) + 7] {
        let data: Vec<u8> = (0..bytes as u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        let buffer = gpu.upload("bytes", &data).unwrap();
        assert!(gpu.read(&buffer).unwrap() == data, "{bytes} bytes");
        let behind = gpu.upload("bytes", &vec![9u8; bytes + 8]).unwrap();
        gpu.write(&behind, 8, &data).unwrap();
        let read = gpu.read(&behind).unwrap();
        assert!(read[..8] == [9; 8] && read[8..] == data, "{bytes} bytes behind others");
    }
}

fn parts_of_words_are_read_but_not_written(gpu: &Gpu) {
    let bytes: Vec<u8> = (0..11).collect();
    let buffer = gpu.upload("bytes", &bytes).unwrap();
    for start in 0..=bytes.len() {
        for end in start..=bytes.len() {
            assert_eq!(gpu.read_range(&buffer, start..end).unwrap(), bytes[start..end], "{start}..{end}");
        }
    }
    gpu.write(&buffer, 4, &[104u8, 105, 106, 107]).unwrap();
    gpu.write(&buffer, 8, &[108u8, 109, 110]).unwrap();
    for (start, data) in [(1, &[0u8; 4][..]), (4, &[0; 3])] {
        assert!(matches!(gpu.write(&buffer, start, data), Err(Error::Unsupported { .. })), "{start}");
    }
    assert_eq!(gpu.read(&buffer).unwrap(), [0, 1, 2, 3, 104, 105, 106, 107, 108, 109, 110]);
}

fn sizes_that_do_not_fit_are_refused(gpu: &Gpu) {
    let buffer = gpu.upload("four words", &[1u32, 2, 3, 4]).unwrap();
    assert!(matches!(
        Buffer::<u64>::from_wgpu("short", buffer.raw().clone(), 3),
        Err(Error::LengthMismatch { what: "short", found: 2, expected: 3 })
    ));
    assert!(matches!(gpu.write(&buffer, 2, &[0; 3]), Err(Error::LengthMismatch { found: 5, expected: 4, .. })));
    assert!(matches!(gpu.write(&buffer, usize::MAX, &[0; 3]), Err(Error::LengthMismatch { .. })));
    assert!(matches!(gpu.read_range(&buffer, 2..5), Err(Error::LengthMismatch { found: 5, expected: 4, .. })));
    for len in [usize::MAX, usize::MAX / 16 + 2, 1 << 60] {
        assert!(matches!(gpu.buffer::<[f32; 4]>("too long", len), Err(Error::OutOfDeviceMemory { .. })), "{len}");
    }
    let mut commands = gpu.commands("copy");
    commands.copy(&buffer, &gpu.buffer("short", 2).unwrap());
    assert!(matches!(commands.run(), Err(Error::LengthMismatch { found: 2, expected: 4, .. })));
}

const RESTORE: Kernel<'static> = Kernel {
    constants: &[("WORKGROUP", 64.0)],
    ..Kernel::new(
        "package::query::restore_order",
        "restore_order",
        &[Access::Uniform, Access::Read, Access::ReadWrite],
        64,
    )
};

fn pipelines_are_compiled_once(gpu: &Gpu) {
    let first = gpu.pipeline(&RESTORE).unwrap();
    assert!(Arc::ptr_eq(&first, &gpu.pipeline(&RESTORE).unwrap()));
    let other = Kernel { constants: &[("WORKGROUP", 32.0)], workgroup_size: 32, ..RESTORE };
    assert!(!Arc::ptr_eq(&first, &gpu.pipeline(&other).unwrap()), "other constants, another pipeline");
    assert_eq!(first.name(), "package::query::restore_order::restore_order");
    let huge = Kernel { workgroup_size: gpu.limits().workgroup_invocations + 1, ..RESTORE };
    assert!(matches!(gpu.pipeline(&huge), Err(Error::Unsupported { .. })));
    let missing = Kernel { module: "package::query::missing", ..RESTORE };
    assert!(matches!(gpu.pipeline(&missing), Err(Error::KernelRejected { .. })));
}

const DOUBLE: &str = "
import package::gpu::dispatch::workgroup_number;

@group(0) @binding(0) var<storage, read_write> values: array<u32>;

@compute @workgroup_size(64)
fn double(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = workgroup_number(group, groups) * 64u + lane;
    if i < arrayLength(&values) {
        values[i] *= 2u;
    }
}
";

fn a_callers_own_module_is_a_kernel(gpu: &Gpu) {
    let module = "package::callers::double";
    let fills = [(module, Fill::Caller(DOUBLE))];
    let kernel = Kernel { fills: &fills, ..Kernel::new(module, "double", &[Access::ReadWrite], 64) };
    let checked = gpu.pipeline(&kernel).unwrap();
    // SAFETY: the kernel guards its only index and has no loop.
    let unchecked = unsafe { gpu.pipeline_unchecked(&kernel) }.unwrap();
    assert!(!Arc::ptr_eq(&checked, &unchecked), "one is compiled with run-time checks");
    for pipeline in [checked, unchecked] {
        let values: Vec<u32> = (0..100).collect();
        let buffer = gpu.upload("values", &values).unwrap();
        let mut commands = gpu.commands("double");
        commands.dispatch(&pipeline, &[(&buffer).into()], Workgroups::Covering(100));
        commands.run().unwrap();
        assert!(gpu.read(&buffer).unwrap().iter().copied().eq((0..100).map(|v| 2 * v)));
    }
}

fn repeated_work_runs_as_often_as_asked(gpu: &Gpu) {
    let module = "package::callers::double";
    let fills = [(module, Fill::Caller(DOUBLE))];
    let kernel = Kernel { fills: &fills, ..Kernel::new(module, "double", &[Access::ReadWrite], 64) };
    let pipeline = gpu.pipeline(&kernel).unwrap();
    // Around the number of repetitions that are submitted together, and more than one for each thread that makes them ready.
    for times in [0, 1, 3, 4, 5, 8, 11, 27] {
        let (one, other) = (gpu.upload("values", &[3u32; 70]).unwrap(), gpu.upload("others", &[0u32; 50]).unwrap());
        let mut commands = gpu.commands("double");
        commands.stage("first").dispatch(&pipeline, &[(&one).into()], Workgroups::Covering(70));
        // What one repetition leaves is there for the next.
        commands.stage("second").copy_from(&one, 20, &other).dispatch(
            &pipeline,
            &[(&other).into()],
            Workgroups::Covering(50),
        );
        commands.submit_repeated(times).unwrap();
        assert_eq!(gpu.read(&one).unwrap(), vec![3 << times; 70], "{times} times");
        let last = if times == 0 { 0 } else { 3 << (times + 1) };
        assert_eq!(gpu.read(&other).unwrap(), vec![last; 50], "{times} times");
    }
    let (short, long) = (gpu.upload("short", &[1u32; 4]).unwrap(), gpu.upload("long", &[1u32; 5]).unwrap());
    let mut commands = gpu.commands("too much");
    commands.copy_from(&short, 0, &long);
    assert!(matches!(commands.submit(), Err(Error::LengthMismatch { found: 4, expected: 5, .. })));
}

fn run(gpu: &Gpu, pipeline: &Arc<Pipeline>, bindings: &[Bind]) -> nearfield::Result<()> {
    let mut commands = gpu.commands("restore order");
    commands.dispatch(pipeline, bindings, Workgroups::Count(1));
    commands.run().map(drop)
}

fn work_that_the_driver_refuses_is_an_error(gpu: &Gpu) {
    let own = own_context(gpu);
    let pipeline = own.pipeline(&RESTORE).unwrap();
    let parameters = own.uniform("parameters", &[1u32, 0, 1, 0]).unwrap();
    let points = own.upload("points", &[[1.0f32, 2.0, 3.0, 0.0]]).unwrap();
    let output = own.upload("output", &[[0.0f32; 4]]).unwrap();
    let good: [Bind; 3] = [(&parameters).into(), (&points).into(), (&output).into()];
    let elsewhere = gpu.upload("on another device", &[[0.0f32; 4]]).unwrap();
    assert!(matches!(own.read(&elsewhere), Err(Error::Device { .. })), "reading from another device");
    assert!(matches!(own.write(&elsewhere, 0, &[[0.0; 4]]), Err(Error::Device { .. })), "writing to another device");
    let bad: [(&str, Vec<Bind>); 4] = [
        ("storage for a uniform", vec![(&points).into(), good[1].clone(), good[2].clone()]),
        ("a uniform for storage", vec![good[0].clone(), (&parameters).into(), good[2].clone()]),
        ("a binding too few", good[..2].to_vec()),
        ("another device", vec![good[0].clone(), good[1].clone(), (&elsewhere).into()]),
    ];
    for (case, bindings) in &bad {
        match run(&own, &pipeline, bindings) {
            Err(Error::Device { operation, message }) => {
                assert_eq!(operation, "restore order", "{case}");
                assert!(!message.is_empty(), "{case}");
            }
            other => panic!("{case}: {other:?}"),
        }
        run(&own, &pipeline, &good).unwrap_or_else(|error| panic!("after {case}: {error}"));
    }
    assert_eq!(own.read(&output).unwrap(), [[1.0, 2.0, 3.0, 0.0]]);
}

fn a_wrong_access_is_rejected_with_the_kernel(gpu: &Gpu) {
    for bindings in [
        &[Access::Uniform, Access::Read, Access::Read][..],
        &[Access::Read, Access::Read, Access::ReadWrite],
        &[Access::Uniform, Access::Read],
    ] {
        match gpu.pipeline(&Kernel { bindings, ..RESTORE }) {
            Err(Error::KernelRejected { kernel, message }) => {
                assert_eq!(kernel, "package::query::restore_order::restore_order");
                assert!(!message.is_empty() && !message.contains('\u{1b}'));
            }
            other => panic!("{bindings:?}: {other:?}"),
        }
    }
    let fills = [("package::structure::selected", Fill::Module("package::not::there"))];
    let unfilled = Kernel { module: "package::query::fixed_radius", fills: &fills, ..RESTORE };
    assert!(matches!(gpu.pipeline(&unfilled), Err(Error::KernelRejected { .. })));
}

fn every_stage_has_its_time(gpu: &Gpu) {
    assert!(gpu.commands("nothing").run().unwrap().is_empty());
    let (a, b) = (gpu.upload("a", &[1u32, 2, 3]).unwrap(), gpu.upload("b", &[9u32; 5]).unwrap());
    let mut commands = gpu.commands("copies");
    commands.stage("clear").clear(&b).stage("nothing").stage("copy").copy(&a, &b);
    let times = commands.run().unwrap();
    assert_eq!(times.iter().map(|t| t.name).collect::<Vec<_>>(), ["clear", "nothing", "copy"]);
    let timed = gpu.limits().timestamp_period.is_some();
    assert!(times.iter().all(|t| t.milliseconds.is_some_and(|ms| (0.0..60_000.0).contains(&ms)) == timed), "{times:?}");
    assert_eq!(gpu.read(&b).unwrap(), [1, 2, 3, 0, 0]);
    // More stages than a set of timestamps holds run, without times.
    let mut many = gpu.commands("many stages");
    for _ in 0..3000 {
        many.stage("empty");
    }
    many.clear(&b);
    let times = many.run().unwrap();
    assert_eq!(times.len(), 3000);
    assert!(times.iter().all(|t| t.milliseconds.is_none()));
    assert_eq!(gpu.read(&b).unwrap(), [0; 5]);
}
