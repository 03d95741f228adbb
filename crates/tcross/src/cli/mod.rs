//! The words of the command line: one file a command.
mod completions;
mod datagen;
mod dataset;
mod eval;
mod eval_coco;
mod infer;
mod model;
mod reproduce;
mod train;

use crate::{
    config::{self, Config},
    console,
    exit::{Failure, Outcome},
    nearest, stop,
};
use clap::{
    CommandFactory, FromArgMatches, Parser, Subcommand,
    error::{ContextKind, ErrorKind},
};
use std::path::{Path, PathBuf};
use tcross_dataset::Split;

const ABOUT: &str =
    "Draws fiducial markers like a hand, trains a YOLOv3 on them, finds them and their pose, and scores it all as the paper did.";

#[derive(Parser)]
#[command(name = "tcross", version = concat!(env!("CARGO_PKG_VERSION"), " (", env!("TCROSS_COMMIT"), ")"), about = ABOUT)]
#[command(after_help = example("reproduce configs/quickstart.toml --out runs/quickstart"))]
#[command(subcommand_required = true, disable_help_subcommand = true, max_term_width = 110)]
struct Cli {
    #[command(flatten)]
    global: Global,
    #[command(subcommand)]
    command: Command,
}

/// Options of every command.
#[derive(clap::Args)]
struct Global {
    /// Say nothing but results, warnings and errors
    #[arg(long, global = true, help_heading = "Everywhere")]
    quiet: bool,
    /// Say more; twice: also the causes of an error
    #[arg(short, long, action = clap::ArgAction::Count, global = true, conflicts_with = "quiet", help_heading = "Everywhere")]
    verbose: u8,
    /// Threads to use [default: all cores]
    #[arg(long, value_name = "N", global = true, value_parser = clap::value_parser!(u16).range(1..), help_heading = "Everywhere")]
    threads: Option<u16>,
}

#[derive(Subcommand)]
enum Command {
    Datagen(datagen::Args),
    Dataset(dataset::Args),
    Train(train::Args),
    Infer(infer::Args),
    Eval(eval::Args),
    Reproduce(reproduce::Args),
    Model(model::Args),
    Completions(completions::Args),
}

/// What `--help` shows under the options.
fn example(words: &str) -> String {
    format!("Example:\n  tcross {words}")
}

/// Runs the command that was typed.
pub fn run() -> Outcome {
    let matches = match Cli::command().try_get_matches() {
        Ok(matches) => matches,
        Err(error) => return usage(&error),
    };
    let cli = Cli::from_arg_matches(&matches).map_err(|e| Failure::usage(e.to_string()))?;
    console::set(cli.global.quiet, cli.global.verbose);
    if let Some(threads) = cli.global.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global()?;
    }
    stop::listen()?;
    match cli.command {
        Command::Datagen(args) => datagen::run(args),
        Command::Dataset(args) => dataset::run(args),
        Command::Train(args) => train::run(args),
        Command::Infer(args) => infer::run(args),
        Command::Eval(args) => eval::run(args),
        Command::Reproduce(args) => reproduce::run(args),
        Command::Model(args) => model::run(args),
        Command::Completions(args) => completions::run(args),
    }
}

/// Help and version are results; everything else is one line and what to type next.
fn usage(error: &clap::Error) -> Outcome {
    match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => {
            console::result(&error.to_string());
            return Ok(());
        }
        ErrorKind::MissingRequiredArgument | ErrorKind::MissingSubcommand | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            return Err(Failure::usage(missing(error)));
        }
        _ => {}
    }
    let text = error.to_string();
    let paragraph = |start: &str| text.lines().map(str::trim).find_map(|l| l.strip_prefix(start)).map(str::to_owned);
    let what = paragraph("error: ").unwrap_or_else(|| text.clone());
    let tip = paragraph("tip: ").map_or(String::new(), |t| format!("; {t}"));
    let known = match error.get(ContextKind::ValidValue) {
        Some(clap::error::ContextValue::Strings(all)) if !all.is_empty() && tip.is_empty() => {
            format!("; expected one of {}", all.join(", "))
        }
        _ => String::new(),
    };
    Err(Failure::usage(format!("{what}{tip}{known}; see tcross {}--help", typed_command())))
}

/// `COMMAND ` as typed, for hints.
fn typed_command() -> String {
    let words = std::env::args_os().skip(1).map(|w| w.to_string_lossy().into_owned()).take_while(|w| !w.starts_with('-'));
    let mut at = Cli::command();
    let mut path = String::new();
    for word in words {
        match at.find_subcommand(&word).cloned() {
            Some(next) => {
                path += &format!("{word} ");
                at = next;
            }
            None => break,
        }
    }
    path
}

fn missing(error: &clap::Error) -> String {
    let path = typed_command();
    let command = path.split_whitespace().fold(Cli::command(), |c, w| c.find_subcommand(w).cloned().unwrap_or(c));
    let what = match error.get(ContextKind::InvalidArg) {
        Some(clap::error::ContextValue::Strings(args)) => format!("{} is missing", args.join(" and ")),
        _ => {
            let names: Vec<String> = command.get_subcommands().map(|c| c.get_name().to_owned()).collect();
            format!("what to do is missing; one of {}", names.join(", "))
        }
    };
    let example = command.get_after_help().map(ToString::to_string).unwrap_or_default();
    let example = example.lines().nth(1).unwrap_or("tcross --help").trim();
    format!("tcross {path}: {what}; type for instance: {example}").replace(" :", ":")
}

/// Which part of a dataset: one split, or all of it.
#[derive(Debug, Clone, Copy)]
enum Part {
    One(Split),
    All,
}

impl std::str::FromStr for Part {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        if s == "all" { Ok(Self::All) } else { s.parse().map(Self::One).map_err(|e| format!("{e}, or all")) }
    }
}

/// A config and changes of it: shared by the commands that take one.
#[derive(clap::Args)]
struct ConfigArgs {
    /// Changes a key, such as --set train.batch_size=4; may be repeated
    #[arg(long, value_name = "SECTION.KEY=VALUE")]
    set: Vec<String>,
    /// Shows the effective config, every key with its comment, and does nothing
    #[arg(long)]
    print_config: bool,
}

impl ConfigArgs {
    /// The effective config; `None` where it was only to be shown.
    fn load(&self, path: Option<&Path>, adjust: impl FnOnce(&mut Config)) -> Outcome<Option<Config>> {
        let mut config = config::load(path, &self.set)?;
        adjust(&mut config);
        config.validate().map_err(|e| Failure::new(format!("{}: {e}", path.map_or("config".into(), |p| p.display().to_string()))))?;
        if self.print_config {
            console::result(&config::commented(&config)?);
            return Ok(None);
        }
        Ok(Some(config))
    }
}

/// Refuses a path that does not exist, with the nearest that does.
fn must_exist(path: &Path, what: &str) -> Outcome {
    if path.exists() {
        return Ok(());
    }
    Err(Failure::new(format!("{}: no such {what}{}", path.display(), nearest::path_hint(path))))
}

/// Refuses options that were given where they do nothing, and says why they do not.
fn refuse<'a>(options: impl IntoIterator<Item = (&'a str, bool)>, why: impl std::fmt::Display) -> Outcome {
    match options.into_iter().find(|(_, given)| *given) {
        Some((option, _)) => Err(Failure::usage(format!("{option} does nothing here: {why}"))),
        None => Ok(()),
    }
}

/// Asks for an option that the command cannot do without.
fn required<'a>(value: &'a Option<PathBuf>, option: &str, example: &str) -> Outcome<&'a Path> {
    value.as_deref().ok_or_else(|| Failure::usage(format!("{option} is missing; type for instance: tcross {example}")))
}
