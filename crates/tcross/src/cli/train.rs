//! `tcross train CONFIG`
use super::{ConfigArgs, example, must_exist, required};
use crate::{config, console, exit::Outcome, stop, work};
use std::path::PathBuf;
use tcross_train::Accelerator;

const EXAMPLE: &str = "train configs/recipes/cpu.toml --data data/hand-drawn --out runs/mine";

/// Trains a detector on a dataset
#[derive(clap::Args)]
#[command(after_help = example(EXAMPLE))]
pub struct Args {
    /// A training recipe, or any config with [model] and [train] sections
    config: PathBuf,
    /// The dataset's folder
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Folder of the run: weights, curves, log
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Goes on with the run in --out, exactly where it ended
    #[arg(long)]
    resume: bool,
    /// Where to compute: cpu, wgpu or cuda
    #[arg(long, default_value = "cpu", value_parser = |s: &str| s.parse::<Accelerator>())]
    device: Accelerator,
    /// Plans the schedule so that training ends after M minutes
    #[arg(long, value_name = "M")]
    max_minutes: Option<f64>,
    /// Seed of every random choice
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    #[command(flatten)]
    config_args: ConfigArgs,
}

pub fn run(args: Args) -> Outcome {
    let config = args.config_args.load(Some(&args.config), |c| {
        c.train.max_minutes = args.max_minutes.or(c.train.max_minutes);
        c.seed = args.seed.unwrap_or(c.seed);
    })?;
    let Some(config) = config else { return Ok(()) };
    let data = required(&args.data, "--data DIR", EXAMPLE)?;
    let out = required(&args.out, "--out DIR", EXAMPLE)?;
    must_exist(data, "dataset")?;
    let stop = stop::flag();
    let mut options = tcross_train::RunOptions::new(out, config.seed, &stop);
    options.resume = args.resume;
    options.accelerator = args.device;
    options.provenance = work::provenance().into_iter().map(|(k, v)| format!("{k}: {v}")).collect();
    options.effective_config = Some(config::commented(&config)?);
    let summary = work::train(&config, data, &options)?;
    let best = summary.best.map_or(String::new(), |(value, step)| format!("; best validation {value:.3}, after step {step}"));
    let time = console::seconds(std::time::Duration::from_secs_f64(summary.seconds));
    console::note(&format!("{}: {} steps, {:.1} epochs in {time}{best}", out.display(), summary.steps, summary.epochs));
    Ok(())
}
