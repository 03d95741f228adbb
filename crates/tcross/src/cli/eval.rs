//! `tcross eval TRUTH DETECTIONS...`
use super::{ConfigArgs, example, must_exist};
use crate::{console, exit::Outcome, work};
use std::path::{Path, PathBuf};
use tcross_dataset::Split;
use tcross_eval::{Protocol, Report, Run, Truth, evaluate};

const EXAMPLE: &str = "eval data/hand-drawn detections.jsonl --protocol paper,coco --out report";

/// Scores detections: metrics, tables, curves, report
#[derive(clap::Args)]
#[command(after_help = example(EXAMPLE))]
pub struct Args {
    /// A dataset's folder, or one of its lists
    truth: PathBuf,
    /// Files of detections; several are compared
    #[arg(required = true)]
    detections: Vec<PathBuf>,
    /// What to compute: paper, coco, pose
    #[arg(long, value_delimiter = ',', value_name = "P", value_parser = protocol)]
    protocol: Vec<Protocol>,
    /// Folder for metrics, tables, figures and report; without it the tables are printed
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Counts faults of the detections in the report in place of refusing them
    #[arg(long)]
    lenient: bool,
    /// Which part of the dataset
    #[arg(long, value_parser = |s: &str| s.parse::<Split>())]
    split: Option<Split>,
    /// Scores at which the paper's metrics are given
    #[arg(long, value_delimiter = ',', value_name = "T")]
    thresholds: Vec<f64>,
    /// A config with an [eval] section
    #[arg(long)]
    config: Option<PathBuf>,
    #[command(flatten)]
    config_args: ConfigArgs,
}

fn protocol(text: &str) -> Result<Protocol, String> {
    match text {
        "paper" => Ok(Protocol::Paper),
        "coco" => Ok(Protocol::Coco),
        "pose" => Ok(Protocol::Pose),
        _ => Err("expected paper, coco or pose".into()),
    }
}

pub fn run(args: Args) -> Outcome {
    let config = args.config_args.load(args.config.as_deref(), |c| {
        if !args.protocol.is_empty() {
            c.eval.protocols = args.protocol.clone();
        }
        if !args.thresholds.is_empty() {
            c.eval.thresholds = args.thresholds.clone();
        }
    })?;
    let Some(config) = config else { return Ok(()) };
    must_exist(&args.truth, "dataset or list")?;
    let truth = Truth::open(&args.truth, args.split)?;
    let mut evaluations = Vec::new();
    for path in &args.detections {
        must_exist(path, "file of detections")?;
        evaluations.push(evaluate(&truth, &name_of(path, &args.detections), path.as_path().into(), &config.eval, args.lenient)?);
    }
    let mut provenance = work::provenance();
    provenance.push(("truth".into(), format!("{}, {} images, {} markers", args.truth.display(), truth.records.len(), truth.markers())));
    let title = if evaluations.len() == 1 { format!("Detections of {}", evaluations[0].name) } else { "Detections compared".into() };
    let runs = evaluations.iter().map(|e| Run::new(&truth, e)).collect();
    let built = Report { title, runs, extras: Vec::new(), provenance }.build();
    for problem in &built.problems {
        console::warn(problem);
    }
    match &args.out {
        Some(out) => {
            built.write(out)?;
            console::result(&built.tables[0].table.markdown());
            console::note(&format!("{}", out.join("report.html").display()));
        }
        None => {
            for table in &built.tables {
                console::result(&format!("{}\n", table.table.markdown()));
            }
        }
    }
    Ok(())
}

/// The file's name without its ending, or its folder's where several files have one name.
fn name_of(path: &Path, all: &[PathBuf]) -> String {
    let stem = |p: &Path| p.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let alone = all.iter().filter(|p| stem(p) == stem(path)).count() == 1;
    let folder = path.parent().and_then(Path::file_name).map(|n| n.to_string_lossy().into_owned());
    if alone { stem(path) } else { folder.unwrap_or_else(|| path.display().to_string()) }
}
