//! `tcross train CONFIG`
use super::{ConfigArgs, example, must_exist, required};
use crate::{
    config::{self, Config},
    console,
    exit::Outcome,
    stop, work,
};
use std::path::{Path, PathBuf};
use tcross_train::{Accelerator, Repeats, RunSummary};

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
    /// Trains N times, with N seeds from the first on, into OUT/seed-S, and reports mean and deviation
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(2..))]
    seeds: Option<u16>,
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
    match args.seeds {
        Some(count) => repeat(&args, config, data, out, count),
        None => train(&args, &config, data, out).map(|_| ()),
    }
}

/// One training.
fn train(args: &Args, config: &Config, data: &Path, out: &Path) -> Outcome<RunSummary> {
    let stop = stop::flag();
    let mut options = tcross_train::RunOptions::new(out, config.seed, &stop);
    options.resume = args.resume;
    options.accelerator = args.device;
    options.provenance = work::provenance().into_iter().map(|(k, v)| format!("{k}: {v}")).collect();
    options.effective_config = Some(config::commented(config)?);
    let summary = work::train(config, data, &options)?;
    let best = summary.best.map_or(String::new(), |(value, step)| format!("; best validation {value:.3}, after step {step}"));
    let time = console::seconds(std::time::Duration::from_secs_f64(summary.seconds));
    console::note(&format!("{}: {} steps, {:.1} epochs in {time}{best}", out.display(), summary.steps, summary.epochs));
    Ok(summary)
}

/// The same training under several seeds; with --resume, those that are done are left as they are.
fn repeat(args: &Args, mut config: Config, data: &Path, out: &Path, count: u16) -> Outcome {
    let mut repeats = Repeats::default();
    let first = config.seed;
    for seed in (0..u64::from(count)).map(|k| first.wrapping_add(k)) {
        config.seed = seed;
        repeats.runs.push((seed, train(args, &config, data, &out.join(format!("seed-{seed}")))?));
        tcross_dataset::files::write_atomically(out.join("seeds.csv"), repeats.to_csv())?;
    }
    console::result(&repeats.table());
    Ok(())
}
