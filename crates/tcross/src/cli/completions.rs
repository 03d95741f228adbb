//! `tcross completions SHELL`
use super::{Cli, example};
use crate::{console, exit::Outcome};
use clap::CommandFactory;

/// Writes completions for a shell
#[derive(clap::Args)]
#[command(after_help = example("completions bash > ~/.local/share/bash-completion/completions/tcross"))]
pub struct Args {
    shell: clap_complete::Shell,
}

pub fn run(args: Args) -> Outcome {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "tcross", &mut text);
    console::result(&String::from_utf8_lossy(&text));
    Ok(())
}
