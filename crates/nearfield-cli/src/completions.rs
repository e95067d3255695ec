//! `nearfield completions`: completion scripts for shells.

use clap::{Args, Command};
use clap_complete::Shell;

use crate::exit::Failure;
use crate::report::print;

/// Print a completion script for a shell
#[derive(Debug, Args)]
#[command(after_help = "Example:
  nearfield completions bash > ~/.local/share/bash-completion/completions/nearfield")]
pub(crate) struct CompletionsArgs {
    /// The shell
    shell: Shell,
}

pub(crate) fn run(args: &CompletionsArgs, mut command: Command) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, "nearfield", &mut script);
    print(&String::from_utf8_lossy(&script))
}
