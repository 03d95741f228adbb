//! `tcross datagen CONFIG` and `tcross datagen marker`
use super::{ConfigArgs, example, required};
use crate::{
    console,
    exit::{Failure, Outcome},
    work,
};
use image::Rgb;
use std::path::PathBuf;
use tcross_datagen::{GenerateOptions, MarkerSheet, Shape, color};

const EXAMPLE: &str = "datagen configs/presets/hand-drawn.toml --out data/hand-drawn --images 1000";
const MARKER: &str = "datagen marker --pdf marker.pdf --fill green --line blue --side-mm 100";

/// Generates a dataset of drawn markers with exact truth
#[derive(clap::Args)]
#[command(after_help = example(EXAMPLE), args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct Args {
    #[command(subcommand)]
    what: Option<What>,
    /// A generator preset, or any config with a [data] section
    #[arg(required = true)]
    config: Option<PathBuf>,
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

#[derive(clap::Subcommand)]
enum What {
    Marker(MarkerArgs),
}

/// Draws a marker to print, or to trace with a pen, with instructions
#[derive(clap::Args)]
#[command(after_help = example(MARKER))]
struct MarkerArgs {
    /// Vector drawing for browsers and drawing programs
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    /// Page for printers
    #[arg(long, value_name = "FILE")]
    pdf: Option<PathBuf>,
    /// Picture of the marker alone, 10 pixels a millimetre
    #[arg(long, value_name = "FILE")]
    png: Option<PathBuf>,
    /// Colour of the fill: #rrggbb or a name such as green
    #[arg(long, value_name = "COLOR", default_value = "#00c800", value_parser = color::parse)]
    fill: Rgb<u8>,
    /// Colour of the lines
    #[arg(long, value_name = "COLOR", default_value = "#0000c8", value_parser = color::parse)]
    line: Rgb<u8>,
    /// Side of the marker in millimetres, 5 to 2000
    #[arg(long, value_name = "MM", default_value_t = 100.0)]
    side_mm: f64,
    /// Width of the lines in millimetres [default: a twelfth of the side]
    #[arg(long, value_name = "MM")]
    line_mm: Option<f64>,
    /// One of the paper's shapes
    #[arg(long, default_value = "t_cross", value_parser = |s: &str| s.parse::<Shape>())]
    shape: Shape,
}

fn marker(args: &MarkerArgs) -> Outcome {
    let line_mm = args.line_mm.unwrap_or(args.side_mm / 12.0);
    let sheet = MarkerSheet { shape: args.shape, fill: args.fill, line: args.line, side_mm: args.side_mm, line_mm };
    let named: Vec<(&str, &PathBuf)> = [("svg", &args.svg), ("pdf", &args.pdf), ("png", &args.png)]
        .into_iter()
        .filter_map(|(ending, f)| Some((ending, f.as_ref()?)))
        .collect();
    if named.is_empty() {
        return Err(Failure::usage(format!("--svg, --pdf or --png FILE is missing; type for instance: tcross {MARKER}")));
    }
    for (ending, path) in named {
        sheet.save_as(ending, path)?;
        console::note(&format!("{}: a marker of {} mm; print at 100 %", path.display(), args.side_mm));
    }
    Ok(())
}

fn shard(text: &str) -> Result<(u64, u64), String> {
    let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
    parts.filter(|(i, n)| i < n).ok_or_else(|| "expected I/N with I from 0 to N-1, such as 0/8".into())
}

pub fn run(args: Args) -> Outcome {
    if let Some(What::Marker(args)) = &args.what {
        return marker(args);
    }
    let config = args.config_args.load(args.config.as_deref(), |c| {
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
