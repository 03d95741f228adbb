//! `tcross datagen CONFIG`
use super::{ConfigArgs, example, required};
use crate::{console, exit::Outcome, work};
use std::path::PathBuf;
use tcross_datagen::GenerateOptions;

const EXAMPLE: &str = "datagen configs/presets/hand-drawn.toml --out data/hand-drawn --images 1000";

/// Generates a dataset of drawn markers with exact truth
#[derive(clap::Args)]
#[command(after_help = example(EXAMPLE))]
pub struct Args {
    /// A generator preset, or any config with a [data] section
    config: PathBuf,
    /// Folder to write
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Photos to draw on; without it, embedded scenes
    #[arg(long, value_name = "DIR")]
    backgrounds: Option<PathBuf>,
    /// Number of images over all splits
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    images: Option<u64>,
    /// Seed of every random choice
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// Only the I-th of N parts, counted from 0, for job arrays; `dataset merge` puts them together
    #[arg(long, value_name = "I/N", value_parser = shard)]
    shard: Option<(u64, u64)>,
    /// Only image K
    #[arg(long, value_name = "K", conflicts_with = "shard")]
    only: Option<u64>,
    /// Goes on where a stopped run ended
    #[arg(long)]
    resume: bool,
    #[command(flatten)]
    config_args: ConfigArgs,
}

fn shard(text: &str) -> Result<(u64, u64), String> {
    let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
    parts.filter(|(i, n)| i < n).ok_or_else(|| "expected I/N with I from 0 to N-1, such as 0/8".into())
}

pub fn run(args: Args) -> Outcome {
    let config = args.config_args.load(Some(&args.config), |c| {
        c.data.images = args.images.unwrap_or(c.data.images);
        c.seed = args.seed.unwrap_or(c.seed);
        c.backgrounds = args.backgrounds.clone().or(c.backgrounds.take());
    })?;
    let Some(config) = config else { return Ok(()) };
    let out = required(&args.out, "--out DIR", EXAMPLE)?;
    let options = GenerateOptions {
        out: out.to_owned(),
        seed: config.seed,
        images: None,
        threads: Some(rayon::current_num_threads()),
        shard: args.shard,
        only: args.only,
        resume: args.resume,
        commit: Some(work::COMMIT.into()),
    };
    let summary = work::datagen(&config, &options)?;
    let manifest = summary.manifest;
    let counts: Vec<String> = manifest.counts.iter().map(|(split, n)| format!("{n} {split}")).collect();
    console::note(&format!("{}: {} images with {} markers", out.display(), counts.join(", "), manifest.markers));
    Ok(())
}
