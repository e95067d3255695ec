//! `nearfield devices`: the GPUs found, as `--device gpu:N` counts them.

use clap::Args;
use nearfield::gpu::{AdapterKind, Gpu, GpuLimits, adapters};
use serde_json::{Value, json};

use crate::exit::Failure;
use crate::report::{print, print_json, size, table};

/// List the GPUs that can be used
#[derive(Debug, Args)]
#[command(after_help = "Example:
  nearfield devices
  nearfield neighbors scan.ply --radius 1 --device gpu:0

A software renderer is the CPU in disguise: `--device auto` never takes it.")]
pub(crate) struct DevicesArgs {
    /// Print one JSON array
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &DevicesArgs) -> Result<(), Failure> {
    let found: Vec<_> = adapters().into_iter().map(|a| (Gpu::open_adapter(&a).map(|gpu| *gpu.limits()), a)).collect();
    if args.json {
        let entry = |(i, (limits, a)): (usize, &(nearfield::Result<GpuLimits>, nearfield::gpu::Adapter))| {
            json!({
                "device": format!("gpu:{i}"),
                "name": a.name,
                "kind": kind_name(a.kind),
                "driver": a.driver,
                "limits": limits.as_ref().ok().map(limits_json),
                "error": limits.as_ref().err().map(ToString::to_string),
            })
        };
        return print_json(&Value::Array(found.iter().enumerate().map(entry).collect()));
    }
    if found.is_empty() {
        return print("no GPU found; the CPU does the work (--device cpu)\n");
    }
    let heading = ["device", "name", "kind", "driver", "largest binding", "largest buffer", "subgroup", "timestamps"];
    let mut rows = vec![heading.map(str::to_owned).to_vec()];
    for (i, (limits, adapter)) in found.iter().enumerate() {
        let mut row =
            vec![format!("gpu:{i}"), adapter.name.clone(), kind_name(adapter.kind).into(), adapter.driver.clone()];
        match limits {
            Ok(limits) => row.extend([
                size(limits.binding_bytes),
                size(limits.buffer_bytes),
                limits.subgroup.map_or("none".to_owned(), subgroup_range),
                if limits.timestamp_period.is_some() { "yes" } else { "no" }.to_owned(),
            ]),
            Err(error) => row.push(error.to_string()),
        }
        rows.push(row);
    }
    print(&table(&rows, &[]))
}

fn subgroup_range((smallest, largest): (u32, u32)) -> String {
    if smallest == largest { smallest.to_string() } else { format!("{smallest} to {largest}") }
}

fn limits_json(limits: &GpuLimits) -> Value {
    json!({
        "binding_bytes": limits.binding_bytes,
        "buffer_bytes": limits.buffer_bytes,
        "workgroup_invocations": limits.workgroup_invocations,
        "workgroup_bytes": limits.workgroup_bytes,
        "workgroups": limits.workgroups,
        "subgroup": limits.subgroup.map(|(smallest, largest)| [smallest, largest]),
        "timestamp_period": limits.timestamp_period,
    })
}

fn kind_name(kind: AdapterKind) -> &'static str {
    match kind {
        AdapterKind::Discrete => "discrete",
        AdapterKind::Integrated => "integrated",
        AdapterKind::Virtual => "virtual",
        AdapterKind::Other => "other",
        AdapterKind::Software => "software",
    }
}
