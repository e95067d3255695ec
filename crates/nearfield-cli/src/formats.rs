//! `nearfield formats`: what can be read and written.

use clap::Args;
use nearfield::io::FORMATS;
use serde_json::{Value, json};

use crate::exit::Failure;
use crate::report::{print, print_json, table};

/// List the file formats
#[derive(Debug, Args)]
#[command(after_help = "Example:
  nearfield formats --json")]
pub(crate) struct FormatsArgs {
    /// Print one JSON array
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &FormatsArgs) -> Result<(), Failure> {
    if args.json {
        let entry = |f: &nearfield::io::FormatInfo| {
            json!({
                "name": f.name,
                "summary": f.summary,
                "extensions": f.extensions,
                "reads_cloud": f.reads_cloud,
                "reads_mesh": f.reads_mesh,
                "writes_cloud": f.writes_cloud,
                "writes_mesh": f.writes_mesh,
            })
        };
        return print_json(&Value::Array(FORMATS.iter().map(entry).collect()));
    }
    let mut rows = vec![["format", "extensions", "reads", "writes", ""].map(str::to_owned).to_vec()];
    for f in &FORMATS {
        rows.push(vec![
            f.name.to_owned(),
            f.extensions.join(", "),
            what(f.reads_cloud, f.reads_mesh),
            what(f.writes_cloud, f.writes_mesh),
            f.summary.to_owned(),
        ]);
    }
    print(&table(&rows, &[]))
}

fn what(cloud: bool, mesh: bool) -> String {
    match (cloud, mesh) {
        (true, true) => "points, faces",
        (true, false) => "points",
        (false, true) => "faces",
        (false, false) => "-",
    }
    .to_owned()
}
