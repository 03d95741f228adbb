//! `tcross dataset check,stats,preview,audit,verify,convert,merge,split DIR`
mod audit;
mod merge;
mod stats;

use super::{example, must_exist, required};
use crate::{
    console,
    exit::{Failure, Outcome},
};
use clap::Subcommand;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};
use tcross_dataset::{
    Dataset, Split,
    check::{Fault, check},
    digest,
    formats::{Format, Labelled},
    preview::{Sheet, contact_sheet},
    resplit::resplit,
};

const CONVERT: &str = "dataset convert data/hand-drawn --to coco --out data/hand-drawn-coco";
const SPLIT: &str = "dataset split data/mine --parts 7:2:1 --out data/mine-split";
const PREVIEW: &str = "dataset preview data/hand-drawn --out sheet.jpg";

/// Looks at or changes a dataset, ours or a foreign one
#[derive(clap::Args)]
#[command(after_help = example("dataset check data/hand-drawn"), subcommand_required = true)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    /// Looks for everything that can be wrong: unreadable images, bad boxes, duplicates, leaks between splits
    #[command(after_help = example("dataset check data/hand-drawn"))]
    Check {
        /// The dataset's folder
        dir: PathBuf,
    },
    /// Counts images and markers and draws their distributions
    #[command(after_help = example("dataset stats data/hand-drawn --out stats"))]
    Stats {
        /// The dataset's folder
        dir: PathBuf,
        /// Only this split
        #[arg(long, value_parser = |s: &str| s.parse::<Split>())]
        split: Option<Split>,
        /// Folder for a drawing (SVG) of each distribution
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
    },
    /// Draws a contact sheet with the truth on it
    #[command(after_help = example(PREVIEW))]
    Preview {
        /// The dataset's folder
        dir: PathBuf,
        /// Picture to write, .jpg or .png
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
        /// Which split
        #[arg(long, default_value = "test", value_parser = |s: &str| s.parse::<Split>())]
        split: Split,
        /// Number of images, spread evenly over the split
        #[arg(long, default_value_t = 30, value_name = "N")]
        images: usize,
        /// Images a row
        #[arg(long, default_value_t = 6, value_name = "N")]
        columns: usize,
        /// Side of each image in pixels
        #[arg(long, default_value_t = 256, value_name = "PX", value_parser = clap::value_parser!(u32).range(16..=2048))]
        tile: u32,
        /// Leaves the truth out
        #[arg(long)]
        plain: bool,
    },
    /// Compares what was asked for with what came out: every distribution, and every pair that should be independent
    #[command(after_help = example("dataset audit data/hand-drawn --out audit"))]
    Audit {
        /// The dataset's folder, made by `tcross datagen`
        dir: PathBuf,
        /// Folder for audit.json and a drawing of the correlations
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
    },
    /// Compares every file with the digests it was written with
    #[command(after_help = example("dataset verify data/hand-drawn"))]
    Verify {
        /// The dataset's folder
        dir: PathBuf,
    },
    /// Writes a dataset in another form
    #[command(after_help = example(CONVERT))]
    Convert {
        /// The dataset's folder, in any form that can be written
        dir: PathBuf,
        /// native, yolo, yolo-pose, coco, voc or paper
        #[arg(long, value_parser = |s: &str| s.parse::<Format>())]
        to: Format,
        /// The form of DIR, where its files do not tell
        #[arg(long, value_parser = |s: &str| s.parse::<Format>())]
        from: Option<Format>,
        /// Folder to write
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
    },
    /// Puts datasets, or the shards of one, together
    #[command(after_help = example(merge::EXAMPLE))]
    Merge {
        /// Datasets of our form
        #[arg(required = true)]
        dirs: Vec<PathBuf>,
        /// Folder to write
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
    },
    /// Deals the images anew to train, val and test; those of one photo, of one video or nearly the same stay together
    #[command(after_help = example(SPLIT))]
    Split {
        /// The dataset's folder, in any form
        dir: PathBuf,
        /// Shares of train, val and test
        #[arg(long, default_value = "7:2:1", value_parser = parts)]
        parts: Parts,
        /// Seed of the order
        #[arg(long, default_value_t = 0, value_name = "S")]
        seed: u64,
        /// Folder to write
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
    },
}

/// Train, val, test.
#[derive(Clone, Copy)]
struct Parts([u32; 3]);

fn parts(text: &str) -> Result<Parts, String> {
    let numbers: Option<Vec<u32>> = text.split(':').map(|p| p.parse().ok()).collect();
    let parts = numbers.and_then(|n| <[u32; 3]>::try_from(n).ok()).filter(|p| p.iter().any(|v| *v > 0));
    parts.map(Parts).ok_or_else(|| "expected three whole numbers, not all zero, such as 7:2:1".into())
}

pub fn run(args: Args) -> Outcome {
    match args.what {
        What::Check { dir } => report_check(&dir),
        What::Stats { dir, split, out } => stats::run(&open(&dir)?, split, out.as_deref()),
        What::Preview { dir, out, split, images, columns, tile, plain } => {
            let out = required(&out, "--out FILE", PREVIEW)?;
            let page = contact_sheet(&open(&dir)?, split, &Sheet { images, columns, tile_px: tile, truth: !plain })?;
            page.save(out).map_err(|e| Failure::new(format!("{}: {e}", out.display())))
        }
        What::Audit { dir, out } => audit::run(&dir, out.as_deref()),
        What::Verify { dir } => report_verify(&dir),
        What::Convert { dir, to, from, out } => {
            let out = fresh(required(&out, "--out DIR", CONVERT)?)?;
            let set = read(&dir, from)?;
            to.write(&set, out)?;
            console::note(&format!("{}: {} images as {to}", out.display(), set.records().count()));
            Ok(())
        }
        What::Merge { dirs, out } => merge::run(&dirs, fresh(required(&out, "--out DIR", merge::EXAMPLE)?)?),
        What::Split { dir, parts, seed, out } => {
            let out = fresh(required(&out, "--out DIR", SPLIT)?)?;
            let set = resplit(&read(&dir, None)?, parts.0, seed);
            Format::Native.write(&set, out)?;
            let counts: Vec<String> = set.splits.iter().map(|(s, items)| format!("{} {s}", items.len())).collect();
            console::note(&format!("{}: {}", out.display(), counts.join(", ")));
            Ok(())
        }
    }
}

fn open(dir: &Path) -> Outcome<Dataset> {
    must_exist(dir, "dataset")?;
    Ok(Dataset::open(dir)?)
}

/// Reads a dataset of any form.
fn read(dir: &Path, from: Option<Format>) -> Outcome<Labelled> {
    must_exist(dir, "dataset")?;
    let format = from.or_else(|| Format::detect(dir)).ok_or_else(|| {
        Failure::new(format!(
            "{}: no known form of dataset; name it with --from {}",
            dir.display(),
            Format::ALL.map(Format::name).join(", ")
        ))
    })?;
    Ok(format.read(dir)?)
}

/// A folder that holds nothing yet: datasets are not written over each other.
fn fresh(dir: &Path) -> Outcome<&Path> {
    let taken = std::fs::read_dir(dir).is_ok_and(|mut entries| entries.next().is_some());
    if taken { Err(Failure::new(format!("{}: is not empty; name another folder for --out, or delete it", dir.display()))) } else { Ok(dir) }
}

fn report_check(dir: &Path) -> Outcome {
    must_exist(dir, "dataset")?;
    let report = check(dir)?;
    for problem in &report.problems {
        console::result(&problem.to_string());
    }
    let images: Vec<String> = report.images.iter().map(|(split, n)| format!("{n} {split}")).collect();
    console::note(&format!("{}: {} images, {} markers", dir.display(), images.join(", "), report.markers));
    let mut kinds: BTreeMap<Fault, usize> = BTreeMap::new();
    for problem in &report.problems {
        *kinds.entry(problem.fault).or_default() += 1;
    }
    if kinds.is_empty() {
        console::note("nothing is wrong");
        return Ok(());
    }
    let kinds: Vec<String> = kinds.iter().map(|(fault, n)| format!("{n} {}", fault.name())).collect();
    Err(Failure::new(format!("{}: {}; each is listed above", dir.display(), kinds.join(", "))))
}

fn report_verify(dir: &Path) -> Outcome {
    must_exist(dir, "dataset")?;
    let found = digest::verify(dir)?;
    let mut faults = Vec::new();
    for (names, what) in [(&found.missing, "missing"), (&found.unlisted, "not listed")] {
        names.iter().for_each(|name| console::result(&format!("{name}: {what}")));
        if !names.is_empty() {
            faults.push(format!("{} files {what}", names.len()));
        }
    }
    for split in &found.changed {
        console::result(&format!("{split}: changed"));
        faults.push(format!("{split} is not as it was written"));
    }
    if faults.is_empty() {
        console::note(&format!("{}: {} files are as they were written", dir.display(), found.files));
        return Ok(());
    }
    Err(Failure::new(format!("{}: {}; generate it again, or get another copy", dir.display(), faults.join(", "))))
}
