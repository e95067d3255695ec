//! Encoding of recorded stages as the driver takes them: passes, bindings, copies.

use super::commands::{Bind, Stage, Step, Workgroups};
use super::{Gpu, Pipeline};

/// Encodes one stage, with a compute pass for each run of dispatches; ticks go to the ends of its first and last pass.
pub(super) fn encode_stage(
    gpu: &Gpu,
    encoder: &mut wgpu::CommandEncoder,
    stage: &Stage,
    ticks: Option<(&wgpu::QuerySet, u32)>,
) {
    let is_dispatch = |step: &Step| matches!(step, Step::Dispatch { .. });
    let first_pass = stage.steps.iter().position(is_dispatch);
    let last_pass = stage.steps.iter().rposition(is_dispatch);
    if let (None, Some((set, first))) = (first_pass, ticks) {
        // A stage of copies only: two empty passes carry its ticks.
        empty_pass(encoder, set, first);
        copies(encoder, &stage.steps);
        empty_pass(encoder, set, first + 1);
        return;
    }
    let mut i = 0;
    while i < stage.steps.len() {
        let run = stage.steps[i..].iter().take_while(|s| is_dispatch(s)).count();
        if run == 0 {
            copies(encoder, &stage.steps[i..=i]);
            i += 1;
            continue;
        }
        let (begins, ends) = (first_pass == Some(i), last_pass == Some(i + run - 1));
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some(stage.name),
            timestamp_writes: ticks.filter(|_| begins || ends).map(|(query_set, first)| {
                wgpu::ComputePassTimestampWrites {
                    query_set,
                    beginning_of_pass_write_index: begins.then_some(first),
                    end_of_pass_write_index: ends.then_some(first + 1),
                }
            }),
        });
        for step in &stage.steps[i..i + run] {
            if let Step::Dispatch { pipeline, groups, made, workgroups } = step {
                let made = made.get_or_init(|| bind_groups(gpu, pipeline, groups));
                encode_dispatch(gpu, &mut pass, pipeline, made, workgroups);
            }
        }
        i += run;
    }
}

fn empty_pass(encoder: &mut wgpu::CommandEncoder, query_set: &wgpu::QuerySet, index: u32) {
    encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
        label: None,
        timestamp_writes: Some(wgpu::ComputePassTimestampWrites {
            query_set,
            beginning_of_pass_write_index: Some(index),
            end_of_pass_write_index: None,
        }),
    });
}

fn copies(encoder: &mut wgpu::CommandEncoder, steps: &[Step]) {
    for step in steps {
        match step {
            Step::Clear { buffer, bytes } => encoder.clear_buffer(&buffer.raw, 0, Some(*bytes)),
            Step::Copy { source, offset, destination, bytes } => {
                encoder.copy_buffer_to_buffer(&source.raw, *offset, &destination.raw, 0, *bytes);
            }
            Step::ReadBack { source, destination } => destination.encode(encoder, &source.raw),
            Step::Dispatch { .. } => {}
        }
    }
}

/// The bindings of a dispatch as the driver takes them.
fn bind_groups(gpu: &Gpu, pipeline: &Pipeline, groups: &[Vec<Bind>; 2]) -> Vec<wgpu::BindGroup> {
    let make = |(layout, binds): (&wgpu::BindGroupLayout, &Vec<Bind>)| {
        let entries: Vec<_> = binds.iter().enumerate().map(entry).collect();
        let descriptor = wgpu::BindGroupDescriptor { label: Some(pipeline.name()), layout, entries: &entries };
        gpu.device().create_bind_group(&descriptor)
    };
    pipeline.ready().groups.iter().zip(groups).map(make).collect()
}

fn entry((binding, bind): (usize, &Bind)) -> wgpu::BindGroupEntry<'_> {
    let size = std::num::NonZeroU64::new(bind.bytes);
    let buffer = wgpu::BufferBinding { buffer: &bind.raw, offset: 0, size };
    wgpu::BindGroupEntry { binding: binding as u32, resource: wgpu::BindingResource::Buffer(buffer) }
}

fn encode_dispatch(
    gpu: &Gpu,
    pass: &mut wgpu::ComputePass<'_>,
    pipeline: &Pipeline,
    groups: &[wgpu::BindGroup],
    workgroups: &Workgroups,
) {
    if matches!(workgroups, Workgroups::Count(0) | Workgroups::Covering(0)) {
        return;
    }
    pass.set_pipeline(&pipeline.ready().raw);
    for (number, group) in groups.iter().enumerate() {
        pass.set_bind_group(number as u32, group, &[]);
    }
    let count = match workgroups {
        Workgroups::Indirect(bind, offset) => return pass.dispatch_workgroups_indirect(&bind.raw, *offset),
        Workgroups::Count(count) => u64::from(*count),
        Workgroups::Covering(items) => items.div_ceil(u64::from(pipeline.workgroup_size)),
    };
    let width = count.min(u64::from(gpu.limits().workgroups));
    pass.dispatch_workgroups(width as u32, count.div_ceil(width) as u32, 1);
}
