//! `tcross reproduce CONFIG`
use super::{ConfigArgs, example, required};
use crate::{
    exit::Outcome,
    stages::{self, Plan, Stage},
};
use std::path::PathBuf;

const EXAMPLE: &str = "reproduce configs/quickstart.toml --out runs/quickstart";

/// Runs a whole experiment, data to report, and skips what is already done
#[derive(clap::Args)]
#[command(after_help = example(EXAMPLE))]
pub struct Args {
    /// The experiment
    config: PathBuf,
    /// Folder for everything
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Photos to draw on; without it those of the config, or embedded scenes
    #[arg(long, value_name = "DIR")]
    backgrounds: Option<PathBuf>,
    /// Only this row of the config's table; may be repeated
    #[arg(long, value_name = "NAME")]
    row: Vec<String>,
    /// Only this stage, on what the earlier ones have left
    #[arg(long, value_name = "STAGE")]
    only: Option<Stage>,
    /// Does this stage again even if it still matches
    #[arg(long, value_name = "STAGE")]
    force: Option<Stage>,
    /// Says what would be done
    #[arg(long)]
    dry_run: bool,
    /// Seed of every random choice
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    #[command(flatten)]
    config_args: ConfigArgs,
}

pub fn run(args: Args) -> Outcome {
    let config = args.config_args.load(Some(&args.config), |c| {
        c.seed = args.seed.unwrap_or(c.seed);
        c.backgrounds = args.backgrounds.clone().or(c.backgrounds.take());
    })?;
    let Some(config) = config else { return Ok(()) };
    let out = required(&args.out, "--out DIR", EXAMPLE)?;
    let plan = Plan { rows: args.row, only: args.only, force: args.force, dry_run: args.dry_run };
    stages::reproduce(&config, &args.config, out, plan)
}
