//! `reproduce`: data, training, detections, report, in order; what still matches its inputs is skipped.
//!
//! A config without `[[run]]` is one row and lies in the folder as `data`, `run`, `detections.jsonl`. With rows, each has a
//! folder of its own with the same names. The report over all rows is `eval` and `report.html` at the top.
mod expect;
mod ledger;
mod report;

use crate::{
    config::{self, Config, Extends},
    console,
    exit::{Failure, Outcome},
    nearest, stop, work,
};
use ledger::{Entry, Ledger};
use std::{
    path::{Path, PathBuf},
    time::Instant,
};
use tcross_datagen::{GenerateOptions, manifest::fingerprint};
use tcross_dataset::{Split, files};
use tcross_eval::report::slug;
use tcross_infer::{Boxes, Detector, Source};
use tcross_yolo::refiner::REFINER;

/// One of the four.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub enum Stage {
    Data,
    Train,
    Infer,
    Eval,
}

impl Stage {
    const BEFORE_EVAL: [Self; 3] = [Self::Data, Self::Train, Self::Infer];

    fn name(self) -> &'static str {
        match self {
            Self::Data => "data",
            Self::Train => "train",
            Self::Infer => "infer",
            Self::Eval => "eval",
        }
    }
}

/// What the user wants of the stages.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Rows by name; none: all.
    pub rows: Vec<String>,
    pub only: Option<Stage>,
    pub force: Option<Stage>,
    pub dry_run: bool,
}

/// One experiment of the table.
pub struct Row {
    pub name: String,
    dir: PathBuf,
    pub config: Config,
    /// Index of the row whose network is used.
    network_of: Option<usize>,
}

impl Row {
    pub fn data(&self) -> PathBuf {
        self.dir.join("data")
    }

    pub fn run(&self) -> PathBuf {
        self.dir.join("run")
    }

    pub fn detections(&self) -> PathBuf {
        self.dir.join("detections.jsonl")
    }

    /// Detections of the validation split, which choose a threshold; `None` where there is no such split.
    pub fn validation(&self) -> Option<PathBuf> {
        let some = std::fs::metadata(self.data().join("val.jsonl")).is_ok_and(|m| m.len() > 0);
        (some && !self.tests_on_all()).then(|| self.dir.join("validation.jsonl"))
    }

    /// True where every split is for testing: a one-factor dataset seen with the network of another row.
    pub fn tests_on_all(&self) -> bool {
        self.config.eval.sweep.is_some() && self.network_of.is_some()
    }

    /// What must be there for a stage to count as done.
    fn results(&self, stage: Stage) -> Vec<PathBuf> {
        match stage {
            Stage::Data => vec![self.data().join("dataset.toml")],
            Stage::Train => {
                let refiner = Some(self.run().join(REFINER)).filter(|path| path.is_file());
                [self.run().join("best.safetensors"), self.run().join("model.toml")].into_iter().chain(refiner).collect()
            }
            Stage::Infer => [self.detections()].into_iter().chain(self.validation()).collect(),
            Stage::Eval => vec![self.dir.join("eval/metrics.json"), self.dir.join("report.html")],
        }
    }
}

/// Runs an experiment.
pub fn reproduce(config: &Config, origin: &Path, out: &Path, plan: Plan) -> Outcome {
    let names = names(config);
    if let Some(wanted) = config.expect.iter().filter_map(|e| e.run.as_deref()).find(|wanted| !names.contains(wanted)) {
        let hint = nearest::hint(wanted, names.iter().copied());
        return Err(Failure::new(format!("{}: expect: no run '{wanted}'{hint}", origin.display())));
    }
    let rows = rows(&chosen(config, &plan.rows)?, origin, out)?;
    if !plan.dry_run {
        files::create_dir(out)?;
        files::write_atomically(out.join("config.toml"), config::commented(config)?)?;
    }
    let mut job = Job { out, rows: &rows, plan, ledger: Ledger::open(out.join("stages.toml"))? };
    for index in 0..rows.len() {
        for stage in Stage::BEFORE_EVAL {
            job.bring(stage, index)?;
        }
    }
    let title = origin.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    job.report(&title, config)
}

/// What the rows of a config are called.
fn names(config: &Config) -> Vec<&str> {
    match config.run.as_slice() {
        [] => vec![config.eval.paper.as_ref().map_or("ours", |paper| paper.row.as_str())],
        runs => runs.iter().map(|run| run.name.as_str()).collect(),
    }
}

/// The config with the named rows only, and those whose networks they use.
fn chosen(config: &Config, names: &[String]) -> Outcome<Config> {
    let known = || config.run.iter().map(|r| r.name.as_str());
    if let Some(stranger) = names.iter().find(|n| known().all(|k| k != n.as_str())) {
        let hint = nearest::hint(stranger, known());
        return Err(Failure::usage(format!("--row {stranger}: the config has no such row{hint}")));
    }
    let mut wanted = names.to_vec();
    // Backwards, for lenders stand before those who borrow of them.
    for run in config.run.iter().rev() {
        if wanted.contains(&run.name) {
            wanted.extend(run.network_of.clone());
        }
    }
    Ok(Config { run: config.run.iter().filter(|r| names.is_empty() || wanted.contains(&r.name)).cloned().collect(), ..config.clone() })
}

/// The rows of a config, each with its own effective config.
fn rows(config: &Config, origin: &Path, out: &Path) -> Outcome<Vec<Row>> {
    let base = Config { run: Vec::new(), expect: Vec::new(), extends: Extends::default(), ..config.clone() };
    if config.run.is_empty() {
        let name = names(&base)[0].to_owned();
        return Ok(vec![Row { name, dir: out.to_owned(), config: base, network_of: None }]);
    }
    let mut rows: Vec<Row> = Vec::new();
    for run in &config.run {
        let place = format!("{}: run '{}'", origin.display(), run.name);
        let dir = out.join(slug(&run.name));
        if rows.iter().any(|r| r.dir == dir) {
            return Err(Failure::new(format!("{place}: another run has this name; name each differently")));
        }
        // Only earlier runs lend, so that no circle can arise; one that borrows itself hands on what it has borrowed.
        let lender = |wanted: &String| match rows.iter().position(|r| r.name == *wanted) {
            Some(lender) => Ok(rows[lender].network_of.unwrap_or(lender)),
            None => {
                let hint = nearest::hint(wanted, rows.iter().map(|r| r.name.as_str()));
                Err(Failure::new(format!("{place}: network_of '{wanted}' is no earlier run{hint}")))
            }
        };
        let network_of = run.network_of.as_ref().map(lender).transpose()?;
        let config = config::with(&base, &run.set, &place)?;
        config.validate().map_err(|e| Failure::new(format!("{place}: {e}")))?;
        rows.push(Row { name: run.name.clone(), dir, config, network_of });
    }
    Ok(rows)
}

/// The stages of all rows under way.
struct Job<'a> {
    out: &'a Path,
    rows: &'a [Row],
    plan: Plan,
    ledger: Ledger,
}

impl Job<'_> {
    /// Does a stage of a row, unless it is done already or not wanted.
    fn bring(&mut self, stage: Stage, index: usize) -> Outcome {
        let rows = self.rows;
        let row = &rows[index];
        // What follows the only stage that is asked for need not be there.
        if (stage == Stage::Train && row.network_of.is_some()) || self.plan.only.is_some_and(|only| stage > only) {
            return Ok(());
        }
        stop::check(&format!("{} keeps every finished stage; the same command goes on", self.out.display()))?;
        let key = if row.dir == self.out { stage.name().to_owned() } else { format!("{}/{}", row.name, stage.name()) };
        let inputs = self.inputs(stage, index)?;
        let outputs = digest_of_files(&row.results(stage));
        let entry = self.ledger.get(&key);
        let matches = entry.is_some_and(|e| e.inputs == inputs && e.outputs.is_some() && e.outputs == outputs);
        let forced = self.plan.force == Some(stage);
        let wanted = self.plan.only.is_none_or(|only| only == stage);
        if matches && !(forced && wanted) {
            console::note(&format!("{key}: still matches, skipped"));
            return Ok(());
        }
        let reason = match entry {
            _ if forced => "forced",
            None => "not done yet",
            Some(e) if e.inputs != inputs => "its inputs changed",
            Some(e) if e.outputs.is_none() => "not finished",
            Some(_) => "its files changed",
        };
        if self.plan.dry_run {
            console::result(&format!("{key}: would run ({reason})"));
            return Ok(());
        }
        if !wanted {
            return Err(Failure::new(format!("{key}: {reason}; run it first, without --only or with --only {}", stage.name())));
        }
        console::detail(&format!("{key}: {reason}"));
        let unfinished = !forced && entry.is_some_and(|e| e.inputs == inputs && e.outputs.is_none());
        let known = entry.is_some();
        self.ledger.set(&key, Entry { inputs: inputs.clone(), outputs: None, seconds: None })?;
        let start = Instant::now();
        match stage {
            Stage::Data => data(row, unfinished, known)?,
            Stage::Train => train(row, unfinished, known)?,
            Stage::Infer => infer(row, &rows[row.network_of.unwrap_or(index)])?,
            Stage::Eval => {}
        }
        let seconds = start.elapsed().as_secs_f64();
        self.ledger.set(&key, Entry { inputs, outputs: digest_of_files(&row.results(stage)), seconds: Some(seconds) })?;
        console::note(&format!("{key}: done in {}", console::seconds(start.elapsed())));
        Ok(())
    }

    /// The digest of everything a stage's result depends on.
    fn inputs(&self, stage: Stage, index: usize) -> Outcome<String> {
        let row = &self.rows[index];
        let c = &row.config;
        let data = || digest_of_files(&row.results(Stage::Data)).unwrap_or_default();
        let parts = match stage {
            Stage::Data => vec![fingerprint(&c.data, c.seed, &work::backgrounds(c)?)],
            Stage::Train => {
                let init = c.train.init.as_ref().map(|file| files::digest(file).unwrap_or_default());
                let parts = [config::digest_of(&c.model)?, config::digest_of(&c.train)?, c.seed.to_string(), data()];
                parts.into_iter().chain(init).collect()
            }
            Stage::Infer => {
                let network = &self.rows[row.network_of.unwrap_or(index)];
                vec![config::digest_of(&c.infer)?, digest_of_files(&network.results(Stage::Train)).unwrap_or_default(), data()]
            }
            Stage::Eval => {
                vec![row.name.clone(), config::digest_of(&c.eval)?, digest_of_files(&row.results(Stage::Infer)).unwrap_or_default(), data()]
            }
        };
        Ok(files::digest_bytes(parts.join("\n")))
    }

    /// Scores all rows together, unless nothing changed, and prints the table.
    fn report(&mut self, title: &str, config: &Config) -> Outcome {
        if self.plan.only.is_some_and(|only| only != Stage::Eval) {
            return Ok(());
        }
        let key = Stage::Eval.name();
        let mut inputs: Vec<String> = (0..self.rows.len()).map(|k| self.inputs(Stage::Eval, k)).collect::<Outcome<_>>()?;
        inputs.push(serde_json::json!(config.expect).to_string());
        let inputs = files::digest_bytes(inputs.join("\n"));
        let results = [self.out.join("eval/metrics.json"), self.out.join("report.html")];
        let done =
            self.ledger.get(key).is_some_and(|e| e.inputs == inputs && e.outputs.is_some() && e.outputs == digest_of_files(&results));
        if self.plan.dry_run {
            console::result(if done { "eval: still matches" } else { "eval: would run" });
            return Ok(());
        }
        if done && self.plan.force != Some(Stage::Eval) {
            console::note("eval: still matches, skipped");
        } else {
            let start = Instant::now();
            let known = self.ledger.get(key).is_some();
            self.ledger.set(key, Entry { inputs: inputs.clone(), outputs: None, seconds: None })?;
            // What an earlier report has drawn of other rows or protocols is not of this one.
            ["tables", "figures", "galleries"].iter().try_for_each(|part| clear(&self.out.join("eval").join(part), known))?;
            report::write(title, config, self.rows, &self.ledger, self.out)?;
            self.ledger.set(key, Entry { inputs, outputs: digest_of_files(&results), seconds: Some(start.elapsed().as_secs_f64()) })?;
        }
        report::print(config, self.rows, self.out)
    }
}

/// One digest of several files; `None` while one is missing.
fn digest_of_files(paths: &[PathBuf]) -> Option<String> {
    let digests: Option<Vec<String>> = paths.iter().map(|p| files::digest(p).ok()).collect();
    Some(files::digest_bytes(digests?.join("\n")))
}

/// Removes what an earlier run of ours has left; what is not ours is never touched.
fn clear(dir: &Path, ours: bool) -> Outcome {
    let taken = std::fs::read_dir(dir).is_ok_and(|mut entries| entries.next().is_some());
    if taken && !ours {
        return Err(Failure::new(format!(
            "{}: is there already and not from this experiment; name another folder for --out",
            dir.display()
        )));
    }
    if taken {
        std::fs::remove_dir_all(dir).map_err(|e| Failure::new(format!("{}: {e}", dir.display())))?;
    }
    Ok(())
}

fn data(row: &Row, resume: bool, ours: bool) -> Outcome {
    if !resume {
        clear(&row.data(), ours)?;
    }
    let options = GenerateOptions {
        out: row.data(),
        seed: row.config.seed,
        threads: Some(rayon::current_num_threads()),
        resume,
        commit: Some(work::COMMIT.into()),
        ..Default::default()
    };
    let summary = work::datagen(&row.config, &options)?;
    let counts: Vec<String> = summary.manifest.counts.iter().map(|(s, n)| format!("{n} {s}")).collect();
    console::note(&format!(
        "data: {} images, {} markers, on {} backgrounds",
        counts.join(", "),
        summary.manifest.markers,
        summary.manifest.backgrounds.kind
    ));
    Ok(())
}

fn train(row: &Row, resume: bool, ours: bool) -> Outcome {
    let resume = resume && row.run().join("state").is_dir();
    if !resume {
        clear(&row.run(), ours)?;
    }
    let stop = stop::flag();
    let mut options = tcross_train::RunOptions::new(row.run(), row.config.seed, &stop);
    options.resume = resume;
    options.provenance = work::provenance().into_iter().map(|(k, v)| format!("{k}: {v}")).collect();
    options.effective_config = Some(config::commented(&row.config)?);
    work::train(&row.config, &row.data(), &options)?;
    Ok(())
}

fn infer(row: &Row, network: &Row) -> Outcome {
    let detector = row.config.infer.configure(Detector::load(network.run())?);
    let mut boxes = Boxes::Detector(Box::new(detector));
    // Validation chooses a threshold, for which boxes are enough, unless a refused pose takes its box along.
    let poses = row.config.infer.pose && row.config.infer.pose_filter;
    let without_poses = tcross_infer::Config { pose: poses, ..row.config.infer.clone() };
    let test = (Split::Test, row.detections(), &row.config.infer);
    for (split, out, config) in [test].into_iter().chain(row.validation().map(|out| (Split::Val, out, &without_poses))) {
        let source = if row.tests_on_all() { work::all_splits(&[row.data()])? } else { Source::open(&[row.data()], Some(split))? };
        let options = tcross_infer::RunOptions { out: Some(out), ..Default::default() };
        let report = work::infer(&mut boxes, &source, config, &options, |_| {})?;
        console::note(&format!("infer: {split}: {} images, {} detections", report.images, report.detections));
    }
    Ok(())
}
