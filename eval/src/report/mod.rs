//! Everything that is written about one or more runs: `metrics.json`, tables, figures, galleries, `report.html`.
mod figures;
mod gallery;
mod html;
mod sweeps;
mod tables;

pub use figures::Figure;
pub use gallery::{Gallery, Picture, base64};
pub use tables::{Named as NamedTable, coco_scores};

use crate::{
    calibration::calibration,
    compare::{Comparison, compare},
    config::Protocol,
    error::EvalError,
    evaluation::Evaluation,
    failures::failures,
    metrics,
    paper_tables::{self, PaperRow},
    slices,
    sweep::Sweep,
    truth::Truth,
};
use rayon::prelude::*;
use serde_json::{Value, json};
use std::path::Path;
use tcross_dataset::files;

/// One scored file of detections.
#[derive(Debug, Clone, Copy)]
pub struct Run<'a> {
    /// What it is scored against.
    pub truth: &'a Truth,
    /// The scores.
    pub evaluation: &'a Evaluation,
    /// The same detector on the validation split: chooses a threshold, which is then applied here.
    pub validation: Option<&'a Evaluation>,
}

impl<'a> Run<'a> {
    /// A run without validation.
    #[must_use]
    pub fn new(truth: &'a Truth, evaluation: &'a Evaluation) -> Self {
        Self { truth, evaluation, validation: None }
    }

    /// The paper's row that the configuration names.
    #[must_use]
    pub fn paper(&self) -> Option<&'static PaperRow> {
        paper_tables::find(self.evaluation.config.paper.as_ref()?).ok()
    }
}

/// A further part of the page, such as training curves.
#[derive(Debug, Clone)]
pub struct Extra {
    /// Its heading.
    pub title: String,
    /// SVG or HTML, put into the page as it is.
    pub fragments: Vec<String>,
}

/// What a report is made of.
#[derive(Debug, Clone)]
pub struct Report<'a> {
    /// The page's title.
    pub title: String,
    /// One or more. Runs on the same [`Truth`] are also compared pair by pair.
    pub runs: Vec<Run<'a>>,
    /// Curves over one-factor datasets.
    pub sweeps: Vec<Sweep>,
    /// Further parts, after the figures.
    pub extras: Vec<Extra>,
    /// How it was made: configuration, seeds, digests, versions, machine, times; in this order.
    pub provenance: Vec<(String, String)>,
}

/// A report in memory, ready to be written or shown.
#[derive(Debug, Clone)]
pub struct Built {
    /// The page's title.
    pub title: String,
    /// One sentence a run: what came out.
    pub verdicts: Vec<String>,
    /// The content of `metrics.json`.
    pub metrics: Value,
    /// The first is the headline.
    pub tables: Vec<NamedTable>,
    /// In order.
    pub figures: Vec<Figure>,
    /// In order.
    pub galleries: Vec<Gallery>,
    /// As handed in.
    pub extras: Vec<Extra>,
    /// As handed in.
    pub provenance: Vec<(String, String)>,
    /// Faults of the files that a lenient reading counted.
    pub problems: Vec<String>,
}

impl Report<'_> {
    /// The runs for which the paper's protocol is asked.
    fn by_paper(&self) -> Vec<Run<'_>> {
        self.runs.iter().filter(|run| run.evaluation.config.wants(Protocol::Paper)).copied().collect()
    }

    /// Computes tables, figures and galleries.
    #[must_use]
    pub fn build(&self) -> Built {
        let several = self.runs.len() > 1;
        let by_paper = self.by_paper();
        let mut tables = Vec::new();
        if !by_paper.is_empty() {
            tables.push(NamedTable::new("headline", tables::headline(&by_paper)));
        }
        let mut galleries = Vec::new();
        for (k, ([a, b], c)) in self.pairs().iter().zip(self.comparisons()).enumerate() {
            tables.push(NamedTable::new(format!("compare-{}", k + 1), tables::comparison(&c)));
            let shown = gallery::disagreements(a.truth, [a.evaluation, b.evaluation], &c, a.evaluation.config.gallery);
            if !shown.pictures.is_empty() {
                galleries.push(Gallery { key: format!("{}-{}", shown.key, k + 1), ..shown });
            }
        }
        tables.extend(tables::min_side(&by_paper).map(|t| NamedTable::new("min-side", t)));
        tables.extend(tables::coco(&self.runs).map(|t| NamedTable::new("coco", t)));
        let mut figures = Vec::new();
        if !by_paper.is_empty() {
            figures.extend([figures::figure_20(&by_paper), figures::froc(&by_paper), figures::precision_recall(&by_paper)]);
        }
        tables.extend(sweeps::tables(&self.sweeps));
        figures.extend(sweeps::figures(&self.sweeps));
        let mut problems = Vec::new();
        for (run, slug) in self.runs.iter().zip(slugs(self.runs.iter().map(|run| run.evaluation.name.as_str()))) {
            let part = build_run(run);
            // Keys stay unique where several runs share a report.
            let prefix = if several { format!("{slug}-") } else { String::new() };
            let heading = if several { format!("{}: ", run.evaluation.name) } else { String::new() };
            tables.extend(part.tables.into_iter().map(|mut t| {
                t.key.insert_str(0, &prefix);
                t.table.caption.insert_str(0, &heading);
                t
            }));
            figures.extend(part.figures.into_iter().map(|mut f| {
                f.key.insert_str(0, &prefix);
                f.title.insert_str(0, &heading);
                f
            }));
            galleries.extend(part.galleries.into_iter().map(|mut g| {
                g.key.insert_str(0, &prefix);
                g.title.insert_str(0, &heading);
                g
            }));
            problems.extend(run.evaluation.problems.iter().map(|(kind, n)| format!("{heading}{n} {}", kind.words())));
        }
        if !by_paper.is_empty() {
            tables.push(NamedTable::new("paper", tables::paper()));
        }
        Built {
            title: self.title.clone(),
            verdicts: by_paper.iter().map(verdict).collect(),
            metrics: self.metrics(),
            tables,
            figures,
            galleries,
            extras: self.extras.clone(),
            provenance: self.provenance.clone(),
            problems,
        }
    }

    /// Every pair of runs that share one truth.
    fn pairs(&self) -> Vec<[Run<'_>; 2]> {
        let runs = self.by_paper();
        let pairs = runs.iter().enumerate().flat_map(|(k, a)| runs[k + 1..].iter().map(move |b| [*a, *b]));
        pairs.filter(|[a, b]| std::ptr::eq(a.truth, b.truth)).collect()
    }

    /// Every pair of runs that share one truth, by the paper's protocol.
    #[must_use]
    pub fn comparisons(&self) -> Vec<Comparison> {
        self.pairs().iter().map(|[a, b]| compare(a.truth, a.evaluation, b.evaluation)).collect()
    }

    /// The content of `metrics.json`.
    #[must_use]
    pub fn metrics(&self) -> Value {
        let blocks = |run: &Run| metrics::metrics(run.truth, run.evaluation, run.validation);
        let mut out = match self.runs.as_slice() {
            [run] => Value::Object(blocks(run)),
            runs => {
                let block = |run: &Run| {
                    let mut block = blocks(run);
                    block.insert("name".into(), json!(run.evaluation.name));
                    Value::Object(block)
                };
                let blocks: Vec<Value> = runs.iter().map(block).collect();
                let comparisons = self.comparisons();
                match comparisons.is_empty() {
                    true => json!({"runs": blocks}),
                    false => json!({"compare": {"files": blocks, "differences": comparisons}}),
                }
            }
        };
        if !self.sweeps.is_empty() {
            out["sweeps"] = json!(self.sweeps);
        }
        out
    }
}

struct Part {
    tables: Vec<NamedTable>,
    figures: Vec<Figure>,
    galleries: Vec<Gallery>,
}

fn build_run(run: &Run) -> Part {
    let Run { truth, evaluation, .. } = *run;
    let mut part = Part { tables: Vec::new(), figures: Vec::new(), galleries: Vec::new() };
    let sliced = [Protocol::Paper, Protocol::Pose].iter().any(|p| evaluation.config.wants(*p));
    let slices = if sliced { slices::slices(truth, evaluation) } else { Vec::new() };
    if evaluation.config.wants(Protocol::Paper) {
        part.tables.extend(tables::table_6(run).map(|t| NamedTable::new("table6", t)));
        part.tables.push(NamedTable::new("thresholds", tables::thresholds(evaluation)));
        part.tables.push(NamedTable::new("summary", tables::summary(run)));
        part.figures.push(figures::over_threshold(run));
        part.figures.push(figures::reliability(&calibration(&evaluation.images)));
    }
    part.tables.extend(slices.iter().map(|s| NamedTable::new(format!("by-{}", s.key), tables::slice(s))));
    part.figures.extend(slices.iter().filter_map(figures::slice));
    if let Some(pose) = &evaluation.pose {
        let scores = pose.scores();
        part.tables.insert(0, NamedTable::new("pose", tables::pose(&scores)));
        part.tables.insert(1, NamedTable::new("pose-shares", tables::pose_shares(&scores)));
        part.tables.insert(2, NamedTable::new("orientation", tables::orientation(&scores)));
        part.figures.insert(0, figures::pose_within(pose));
        part.figures.extend(slices.iter().filter_map(figures::pose_slice));
    }
    let count = evaluation.config.gallery;
    if count > 0 && truth.dir.is_some() {
        part.galleries.push(gallery::samples(truth, evaluation, count));
        let all = failures(truth, evaluation, evaluation.config.threshold);
        part.galleries.extend(gallery::of_failures(truth, evaluation, &all, count));
    }
    part
}

/// One sentence about a run.
fn verdict(run: &Run) -> String {
    let row = run.evaluation.headline();
    let number = |v: Option<f64>| v.map_or("undefined".into(), |v| format!("{v:.3}"));
    let mut text = format!(
        "{}: of {} markers in {} images {} were found (recall {}) beside {} false positives (precision {}); mean IoU {}, at score threshold {}.",
        run.evaluation.name,
        row.tp + row.fn_,
        run.evaluation.scores.images,
        row.tp,
        number(row.recall),
        row.fp,
        number(row.precision),
        number(row.mean_iou),
        row.threshold,
    );
    if let Some(paper) = run.paper() {
        let v = crate::verdict::RowVerdict::new(&row, run.evaluation.scores.images, paper);
        let word = |name: &str, v: Option<crate::verdict::Verdict>| v.map(|v| format!("{name} {}", v.word()));
        let parts: Vec<String> =
            [word("mean IoU", v.mean_iou), word("precision", v.precision), word("recall", v.recall)].into_iter().flatten().collect();
        text += &format!(" Against the paper's '{}' (table {}): {}.", paper.name, paper.table, parts.join(", "));
    }
    text
}

/// A name made safe for files: the letters and digits of any script in lower case, a dash for what stands between.
#[must_use]
pub fn slug(name: &str) -> String {
    let lower = name.to_lowercase();
    let words: Vec<&str> = lower.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty()).collect();
    if words.is_empty() { "run".into() } else { words.join("-") }
}

/// A slug for each name, no two alike.
fn slugs<'a>(names: impl IntoIterator<Item = &'a str>) -> Vec<String> {
    let mut all: Vec<String> = Vec::new();
    for name in names {
        let mut unique = slug(name);
        for k in 2.. {
            if !all.contains(&unique) {
                break;
            }
            unique = format!("{}-{k}", slug(name));
        }
        all.push(unique);
    }
    all
}

impl Built {
    /// Writes `metrics.json`, `tables/`, `figures/`, `galleries/` and `report.html` into a folder.
    ///
    /// # Errors
    /// If the folder cannot be written.
    pub fn write(&self, out: impl AsRef<Path>) -> Result<(), EvalError> {
        let out = out.as_ref();
        files::create_dir(out.join("figures"))?;
        files::write_atomically(out.join("metrics.json"), format!("{:#}\n", self.metrics))?;
        self.tables.iter().try_for_each(|table| table.write(out))?;
        self.figures.par_iter().try_for_each(|Figure { key, canvas, .. }| -> Result<(), EvalError> {
            let write = |kind: &str, bytes: Vec<u8>| files::write_atomically(out.join(format!("figures/{key}.{kind}")), bytes);
            write("svg", canvas.svg().into_bytes())?;
            write("pdf", canvas.pdf())?;
            // 300 pixels an inch.
            Ok(write("png", canvas.png(300.0 / 72.0))?)
        })?;
        for gallery in &self.galleries {
            let dir = out.join("galleries").join(&gallery.key);
            files::create_dir(&dir)?;
            for picture in &gallery.pictures {
                files::write_atomically(dir.join(format!("{}.jpg", picture.name)), &picture.jpeg)?;
            }
        }
        files::write_atomically(out.join("report.html"), self.html())?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_any_script_make_different_files() {
        assert_eq!(slug("T cross, 2 px (ours)"), "t-cross-2-px-ours");
        assert_eq!((slug("Крест 2"), slug("十字"), slug("**")), ("крест-2".into(), "十字".into(), "run".into()));
        assert_eq!(slugs(["a b", "a-b", "A B", "c"]), ["a-b", "a-b-2", "a-b-3", "c"]);
    }
}
