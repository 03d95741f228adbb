//! `tcross eval TRUTH DETECTIONS...`
use super::{ConfigArgs, Part, eval_coco, example, must_exist, refuse};
use crate::{
    config, console,
    exit::{Failure, Outcome},
    work,
};
use std::path::{Path, PathBuf};
use tcross_dataset::{Split, files};
use tcross_eval::{Evaluation, Factor, Protocol, Report, Run, Truth, evaluate, sweep, sweep::Sweep};

const EXAMPLE: &str = "eval data/hand-drawn detections.jsonl --protocol paper,coco --out report";

/// Scores detections: metrics, tables, curves, report
#[derive(clap::Args)]
#[command(after_help = example(EXAMPLE))]
pub struct Args {
    /// A dataset's folder, one of its lists, or COCO's instances as .json (then DETECTIONS are COCO's results)
    #[arg(required_unless_present_any = ["sweep", "print_config"])]
    truth: Option<PathBuf>,
    /// Files of detections; several are compared
    #[arg(required_unless_present_any = ["sweep", "print_config"])]
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
    /// Which part of the dataset: train, val, test or all [default: test]
    #[arg(long)]
    split: Option<Part>,
    /// Curves over a one-factor dataset: FACTOR is blur, tilt, size, occlusion, noise or light; may be repeated
    #[arg(long, num_args = 3, value_names = ["FACTOR", "DATASET", "DETECTIONS"])]
    sweep: Vec<String>,
    /// Detections of the validation split by the same detector, one file for each of DETECTIONS: the threshold of highest F1
    /// there is applied here
    #[arg(long, value_name = "F.jsonl")]
    validation: Vec<PathBuf>,
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
    if let Some(truth) = args.truth.as_deref().filter(|truth| eval_coco::is_instances(truth)) {
        let idle = [
            ("--protocol", args.protocol.iter().any(|p| *p != Protocol::Coco)),
            ("--split", args.split.is_some()),
            ("--sweep", !args.sweep.is_empty()),
            ("--validation", !args.validation.is_empty()),
            ("--thresholds", !args.thresholds.is_empty()),
            ("--config", args.config.is_some()),
            ("--set", !args.config_args.set.is_empty()),
        ];
        let why = "COCO's files are scored by --protocol coco alone; `tcross dataset convert --to native` makes a dataset of them";
        refuse(idle, format_args!("{}: {why}", truth.display()))?;
        return eval_coco::run(truth, &args.detections, args.out.as_deref(), args.lenient);
    }
    let mut provenance = work::provenance();
    let truth = match &args.truth {
        Some(path) => open(path, args.split, &mut provenance)?,
        None => Truth::new(Vec::new(), Default::default(), None),
    };
    let mut evaluations = Vec::new();
    for (path, name) in args.detections.iter().zip(names_of(&args.detections)) {
        evaluations.push(score(&truth, path, &name, &config.eval, args.lenient, &mut provenance)?);
    }
    let validations = validations(&args, &config.eval, &mut provenance)?;
    let sweeps = sweeps(&args, &config.eval, &mut provenance)?;
    provenance.push(("config".into(), config::commented(&config)?));
    let title = match evaluations.as_slice() {
        [] => "Sweeps".into(),
        [one] => format!("Detections of {}", one.name),
        _ => "Detections compared".into(),
    };
    let run = |(k, e)| Run { validation: validations.get(k), ..Run::new(&truth, e) };
    let runs = evaluations.iter().enumerate().map(run).collect();
    let built = Report { title, runs, sweeps, extras: Vec::new(), provenance }.build();
    for problem in &built.problems {
        console::warn(problem);
    }
    match &args.out {
        Some(out) => {
            built.write(out)?;
            for named in built.tables.iter().filter(|t| work::SHORT_TABLES.contains(&t.key.as_str())) {
                console::result(&format!("{}\n", named.table.markdown()));
            }
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

/// Opens a truth and notes what it is.
fn open(path: &Path, part: Option<Part>, provenance: &mut Vec<(String, String)>) -> Outcome<Truth> {
    must_exist(path, "dataset or list")?;
    if path.is_file() {
        refuse([("--split", part.is_some())], format_args!("{} is the list of one split", path.display()))?;
    }
    let truth = match part {
        Some(Part::All) => Truth::open_all(path)?,
        Some(Part::One(split)) => Truth::open(path, Some(split))?,
        None => Truth::open(path, None)?,
    };
    provenance.push(("truth".into(), format!("{}: {} images, {} markers", truth.path.display(), truth.records.len(), truth.markers())));
    if truth.path.is_file() {
        provenance.push(("digest of the truth".into(), files::digest(&truth.path)?));
    }
    Ok(truth)
}

/// Scores a file of detections and notes its digest.
fn score(
    truth: &Truth,
    path: &Path,
    name: &str,
    config: &tcross_eval::Config,
    lenient: bool,
    provenance: &mut Vec<(String, String)>,
) -> Outcome<Evaluation> {
    must_exist(path, "file of detections")?;
    provenance.push((format!("digest of {}", path.display()), files::digest(path)?));
    Ok(evaluate(truth, name, path.into(), config, lenient)?)
}

/// The curves over one-factor datasets.
fn sweeps(args: &Args, config: &tcross_eval::Config, provenance: &mut Vec<(String, String)>) -> Outcome<Vec<Sweep>> {
    let paths: Vec<PathBuf> = args.sweep.chunks(3).map(|s| PathBuf::from(&s[2])).collect();
    let names = names_of(&paths);
    let one = |(k, words): (usize, &[String])| {
        let factor: Factor = words[0].parse().map_err(|e| Failure::usage(format!("--sweep: {e}")))?;
        let truth = open(Path::new(&words[1]), args.split, provenance)?;
        let evaluation = score(&truth, &paths[k], &names[k], config, args.lenient, provenance)?;
        Ok(sweep(&truth, &evaluation, factor)?)
    };
    args.sweep.chunks(3).enumerate().map(one).collect()
}

/// The files of validation detections scored against the validation split of the truth's dataset.
fn validations(args: &Args, config: &tcross_eval::Config, provenance: &mut Vec<(String, String)>) -> Outcome<Vec<Evaluation>> {
    if args.validation.is_empty() {
        return Ok(Vec::new());
    }
    if args.validation.len() != args.detections.len() {
        let (n, of) = (args.validation.len(), args.detections.len());
        return Err(Failure::usage(format!("--validation: {n} files for {of} of DETECTIONS; give one for each, in the same order")));
    }
    let Some(path) = &args.truth else { return Err(Failure::usage("--validation needs TRUTH and DETECTIONS")) };
    let dir = if path.is_file() { files::folder_of(path) } else { path };
    let truth = open(dir, Some(Part::One(Split::Val)), provenance)?;
    let config = config.for_a_threshold();
    args.validation.iter().map(|path| score(&truth, path, "validation", &config, args.lenient, provenance)).collect()
}

/// What files are called, no two alike: by their names without ending; those that share one by as many of their folders as
/// tell them apart, and by a number where the folders do not.
pub(super) fn names_of(files: &[PathBuf]) -> Vec<String> {
    let name = |(path, depth): (&PathBuf, &usize)| {
        let folders: Vec<_> = path.parent().into_iter().flat_map(Path::iter).map(|f| f.to_string_lossy()).collect();
        match folders.len().min(*depth) {
            0 => path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
            depth => folders[folders.len() - depth..].join("/"),
        }
    };
    let deepest = files.iter().map(|path| path.iter().count()).max().unwrap_or(0);
    let mut depths = vec![0; files.len()];
    loop {
        let names: Vec<String> = files.iter().zip(&depths).map(name).collect();
        let shared = |k: &usize| names.iter().filter(|other| **other == names[*k]).count() > 1;
        let alike: Vec<usize> = (0..files.len()).filter(shared).collect();
        if alike.iter().all(|k| depths[*k] >= deepest) {
            let numbered = |k: usize| if alike.contains(&k) { format!("{} {}", names[k], k + 1) } else { names[k].clone() };
            return (0..files.len()).map(numbered).collect();
        }
        alike.into_iter().for_each(|k| depths[k] += 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_files_are_told_apart() {
        let names = |files: &[&str]| names_of(&files.iter().map(PathBuf::from).collect::<Vec<_>>());
        assert_eq!(names(&["runs/a/ours.jsonl", "theirs.jsonl"]), ["ours", "theirs"]);
        assert_eq!(names(&["runs/a/found.jsonl", "runs/b/found.jsonl", "ours.jsonl"]), ["a", "b", "ours"]);
        assert_eq!(names(&["x/a/found.jsonl", "y/a/found.jsonl"]), ["x/a", "y/a"]);
        assert_eq!(names(&["x/b.jsonl", "b/found.jsonl", "c/found.jsonl"]), ["x", "b", "c"]);
        assert_eq!(names(&["found.jsonl", "a/found.jsonl"]), ["found", "a"]);
        assert_eq!(names(&["a/found.jsonl", "a/found.json"]), ["a 1", "a 2"]);
    }
}
