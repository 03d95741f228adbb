//! The tables of a report.
use super::Run;
use crate::{
    calibration::calibration,
    compare::Comparison,
    curves,
    error::EvalError,
    evaluation::Evaluation,
    failures, metrics,
    paper_tables::{self, PaperRow},
    protocol::{
        coco::CocoScores,
        paper::Row,
        pose::{PoseScores, Spread},
    },
    slices::Slice,
    table::{Cell, Table},
    verdict::RowVerdict,
};
use std::path::Path;
use tcross_dataset::files;

/// A table and its file name.
#[derive(Debug, Clone)]
pub struct Named {
    /// As a file's name.
    pub key: String,
    /// What is tabled.
    pub table: Table,
}

impl Named {
    /// Of a key that can be a file's name.
    pub fn new(key: impl Into<String>, table: Table) -> Self {
        Self { key: key.into(), table }
    }

    /// Writes `tables/KEY.md`, `.csv` and `.tex` in a folder.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, out: &Path) -> Result<(), EvalError> {
        files::create_dir(out.join("tables"))?;
        let write = |kind: &str, text: String| files::write_atomically(out.join(format!("tables/{}.{kind}", self.key)), text);
        write("md", self.table.markdown())?;
        write("csv", self.table.csv())?;
        Ok(write("tex", self.table.latex(&self.key))?)
    }
}

/// The six metrics of each run at its threshold in the paper's layout, the paper's row above, the verdicts below.
pub fn headline(runs: &[Run]) -> Table {
    let columns = ["shape", "whose", "markers", "mean IoU", "95 %", "FP", "FN", "% of FN", "precision", "95 %", "recall", "95 %"];
    let threshold = runs.first().map_or(0.3, |r| r.evaluation.config.threshold);
    let mut table = Table::new(format!("The paper's metrics at score threshold {threshold}."), &columns);
    let mut above: Option<&PaperRow> = None;
    for run in runs {
        let row = run.evaluation.headline();
        // Runs that follow each other and name one row of the paper share it.
        if let Some(paper) = run.paper().filter(|p| above.is_none_or(|a| a != *p)) {
            table.rows.extend(paper_rows(paper));
            if let Some(fault) = paper.fault {
                table.notes.push(format!("The printed row '{}' of table {} contradicts itself: {fault}.", paper.name, paper.table));
            }
        }
        above = run.paper();
        table.rows.push(our_row(&run.evaluation.name, "ours", &row));
        if let Some(paper) = run.paper() {
            table.rows.push(verdict_row(&RowVerdict::new(&row, run.evaluation.scores.images, paper)));
        }
        if let Some((chosen, _)) = run.validation.and_then(metrics::chosen_threshold) {
            table.rows.push(our_row(&run.evaluation.name, &format!("ours at {chosen:.2} *"), &run.evaluation.row_at(chosen)));
        }
    }
    if runs.iter().any(|r| r.validation.is_some()) {
        table.notes.push("* The threshold of highest F1 on the validation split, applied to this one.".into());
    }
    table.notes.push(
        "Intervals: bootstrap over images for the mean IoU, Wilson for rates. Verdict: ours is above, within or below the paper's value \
         at 95 %, given the uncertainty of both."
            .into(),
    );
    table
}

fn paper_rows(p: &PaperRow) -> Vec<Vec<Cell>> {
    use Cell::{Count, Number, Undefined};
    let (iou, markers) = (Number(p.mean_iou, 3), Count(p.markers));
    let printed = |v: Option<f64>, digits| Cell::number(v, digits);
    let whose = |w: &str| [Cell::text(p.name), Cell::text(w), markers.clone(), iou.clone(), Undefined, Count(p.fp), Count(p.fn_)];
    let row = |w: &str, percent: Cell, precision: Cell, recall: Cell| {
        whose(w).into_iter().chain([percent, precision, Undefined, recall, Undefined]).collect()
    };
    let table = p.table;
    let printed = row(&format!("paper, table {table}"), printed(p.percent_fn, 1), printed(p.precision, 3), printed(p.recall, 3));
    if p.fault.is_none() && p.precision.is_some() {
        return vec![printed];
    }
    vec![printed, row("paper, recomputed", Number(p.percent_fn(), 1), Number(p.precision(), 3), Number(p.recall(), 3))]
}

fn our_row(name: &str, whose: &str, r: &Row) -> Vec<Cell> {
    vec![
        Cell::text(name),
        Cell::text(whose),
        Cell::Count(r.tp + r.fn_),
        Cell::number(r.mean_iou, 3),
        Cell::range(r.mean_iou_ci, 3),
        Cell::Count(r.fp),
        Cell::Count(r.fn_),
        Cell::number(r.percent_fn, 1),
        Cell::number(r.precision, 3),
        Cell::range(r.precision_ci, 3),
        Cell::number(r.recall, 3),
        Cell::range(r.recall_ci, 3),
    ]
}

fn verdict_cell(v: Option<crate::verdict::Verdict>, more_is_better: bool) -> Cell {
    v.map_or(Cell::Undefined, |v| Cell::Verdict(v.word(), v.is_good(more_is_better)))
}

fn verdict_row(v: &RowVerdict) -> Vec<Cell> {
    let word = verdict_cell;
    let blank = || Cell::text("");
    vec![
        blank(),
        Cell::text("verdict"),
        blank(),
        word(v.mean_iou, true),
        blank(),
        word(v.fp, false),
        word(v.fn_, false),
        word(v.fn_, false),
        word(v.precision, true),
        blank(),
        word(v.recall, true),
        blank(),
    ]
}

/// Every threshold of one run.
pub fn thresholds(evaluation: &Evaluation) -> Table {
    let columns = ["threshold", "mean IoU", "95 %", "TP", "FP", "FN", "% of FN", "precision", "95 %", "recall", "95 %", "F1", "duplicates"];
    let mut table = Table::new("The paper's metrics over the score threshold.", &columns);
    for r in evaluation.rows() {
        table.rows.push(vec![
            Cell::Number(r.threshold, 2),
            Cell::number(r.mean_iou, 3),
            Cell::range(r.mean_iou_ci, 3),
            Cell::Count(r.tp),
            Cell::Count(r.fp),
            Cell::Count(r.fn_),
            Cell::number(r.percent_fn, 1),
            Cell::number(r.precision, 3),
            Cell::range(r.precision_ci, 3),
            Cell::number(r.recall, 3),
            Cell::range(r.recall_ci, 3),
            Cell::number(r.f1, 3),
            Cell::Count(r.duplicates),
        ]);
    }
    table.notes.push("Duplicates, further detections of a found marker, count neither as true nor as false positives.".into());
    table
}

/// Table 6 of the paper: every printed threshold, ours below it and the verdict; `None` for a run that names another table.
pub fn table_6(run: &Run) -> Option<Table> {
    run.paper().filter(|p| p.table == 6)?;
    let evaluation = run.evaluation;
    let columns = ["threshold", "whose", "markers", "mean IoU", "95 %", "TP", "FP", "FN", "precision", "95 %", "recall", "95 %"];
    let mut table = Table::new("Table 6 of the paper, threshold by threshold.", &columns);
    for p in paper_tables::table(6) {
        let row = evaluation.row_at(p.threshold);
        let v = RowVerdict::new(&row, evaluation.scores.images, p);
        let threshold = || Cell::Number(p.threshold, 2);
        table.rows.push(vec![
            threshold(),
            Cell::text("paper"),
            Cell::Count(p.markers),
            Cell::Number(p.mean_iou, 3),
            Cell::Undefined,
            Cell::Count(p.tp()),
            Cell::Count(p.fp),
            Cell::Count(p.fn_),
            Cell::Number(p.precision(), 3),
            Cell::Undefined,
            Cell::Number(p.recall(), 3),
            Cell::Undefined,
        ]);
        table.rows.push(vec![
            threshold(),
            Cell::text("ours"),
            Cell::Count(row.tp + row.fn_),
            Cell::number(row.mean_iou, 3),
            Cell::range(row.mean_iou_ci, 3),
            Cell::Count(row.tp),
            Cell::Count(row.fp),
            Cell::Count(row.fn_),
            Cell::number(row.precision, 3),
            Cell::range(row.precision_ci, 3),
            Cell::number(row.recall, 3),
            Cell::range(row.recall_ci, 3),
        ]);
        let blank = || Cell::text("");
        table.rows.push(vec![
            blank(),
            Cell::text("verdict"),
            blank(),
            verdict_cell(v.mean_iou, true),
            blank(),
            blank(),
            verdict_cell(v.fp, false),
            verdict_cell(v.fn_, false),
            verdict_cell(v.precision, true),
            blank(),
            verdict_cell(v.recall, true),
            blank(),
        ]);
    }
    table.notes.push("Precision and recall of the paper are recomputed from its counts, which it prints.".into());
    Some(table)
}

/// COCO's numbers, a row a run; `None` where a run has none.
pub fn coco(runs: &[Run]) -> Option<Table> {
    runs.first()?;
    let rows: Option<Vec<(&str, CocoScores)>> = runs.iter().map(|r| Some((r.evaluation.name.as_str(), r.evaluation.coco?))).collect();
    Some(coco_scores(&rows?))
}

/// COCO's numbers, a row a name.
#[must_use]
pub fn coco_scores(rows: &[(&str, CocoScores)]) -> Table {
    let columns = ["run", "AP", "AP50", "AP75", "AP small", "AP medium", "AP large", "AR1", "AR10", "AR100"];
    let mut table = Table::new("COCO's average precision and recall.", &columns);
    for (name, c) in rows {
        let numbers = [c.ap, c.ap50, c.ap75, c.ap_small, c.ap_medium, c.ap_large, c.ar1, c.ar10, c.ar100];
        table.rows.push([Cell::text(*name)].into_iter().chain(numbers.map(|n| Cell::number(n, 3))).collect());
    }
    table.notes.push("Small: area below 32 x 32 px; large: above 96 x 96 px.".into());
    table
}

/// The metrics of markers of at least some size, a row a run and size; `None` where no size is asked for.
pub fn min_side(runs: &[Run]) -> Option<Table> {
    let columns = ["run", "short side", "markers", "ignored", "mean IoU", "TP", "FP", "FN", "precision", "95 %", "recall", "95 %", "F1"];
    let threshold = runs.first()?.evaluation.config.threshold;
    let mut table =
        Table::new(format!("Markers whose box has a short side of at least so many pixels, at score threshold {threshold}."), &columns);
    for run in runs {
        let mut row = |side: String, ignored: u64, r: &Row| {
            table.rows.push(vec![
                Cell::text(&run.evaluation.name),
                Cell::text(side),
                Cell::Count(r.tp + r.fn_),
                Cell::Count(ignored),
                Cell::number(r.mean_iou, 3),
                Cell::Count(r.tp),
                Cell::Count(r.fp),
                Cell::Count(r.fn_),
                Cell::number(r.precision, 3),
                Cell::range(r.precision_ci, 3),
                Cell::number(r.recall, 3),
                Cell::range(r.recall_ci, 3),
                Cell::number(r.f1, 3),
            ]);
        };
        row("all".into(), 0, &run.evaluation.headline());
        for at in &run.evaluation.min_sides {
            row(format!(">= {} px", at.min_side_px), at.ignored_markers, &at.headline);
        }
    }
    table.notes.push(
        "Smaller markers are ignored, and so is what is matched to them; a detection that matches nothing is a false positive only if its \
         own short side is at least that."
            .into(),
    );
    runs.iter().any(|r| !r.evaluation.min_sides.is_empty()).then_some(table)
}

/// Recall and mean IoU of the classes of a factor.
pub fn slice(slice: &Slice) -> Table {
    let pose = slice.classes.iter().any(|c| c.pose.is_some());
    let mut columns = vec![slice.label.as_str(), "markers", "found", "recall", "95 %", "mean IoU", "FP", "precision"];
    if pose {
        columns.extend(["poses", "centre %", "corners %", "angle"]);
    }
    let mut table = Table::new(format!("Found by {}.", slice.label), &columns);
    for c in &slice.classes {
        let mut row = vec![
            Cell::text(&c.label),
            Cell::Count(c.markers),
            Cell::Count(c.found),
            Cell::Number(c.recall, 3),
            Cell::Range(c.recall_ci, 3),
            Cell::Number(c.mean_iou, 3),
            Cell::Count(c.fp),
            Cell::number(c.precision, 3),
        ];
        if pose {
            row.push(c.pose.map_or(Cell::Undefined, |p| Cell::Count(p.recovered)));
            row.extend(
                [c.pose.map(|p| p.center_percent), c.pose.map(|p| p.corner_percent), c.pose.map(|p| p.angle_deg)]
                    .map(|v| Cell::number(v, 2)),
            );
        }
        table.rows.push(row);
    }
    table.notes.push("FP: false positives in the images that hold these markers.".into());
    table
}

/// What became of the poses.
pub fn pose_shares(p: &PoseScores) -> Table {
    let mut table = Table::new(format!("Poses of {} markers.", p.markers), &["share", "of", "fraction"]);
    let mut share = |name: &str, of: &str, v: Option<f64>| {
        table.rows.push(vec![Cell::text(name), Cell::text(of), Cell::number(v, 4)]);
    };
    share("recovered", "markers", p.recovered);
    share("refused", "markers", p.refused);
    share("not detected", "markers", p.missed);
    share("within 2 % centre, 2 degrees, 4 % corners", "markers", p.within_tight);
    share("within 4 % centre, 5 degrees, 6 % corners", "markers", p.within_loose);
    share("turned by more than 45 degrees", "poses", p.wrong_orientation);
    share("true centre inside the stated 95 % ellipse (honest: 0.95)", "poses", p.ellipse_coverage);
    share("the authors' marks: centre 60 px, 30 degrees, IoU 0.3", "poses", p.authors_marks);
    share("a pose claimed where no marker is", "false positives", p.false_poses);
    if !p.reasons.is_empty() {
        let reasons: Vec<String> = p.reasons.iter().map(|(r, n)| format!("{r} ({n})")).collect();
        table.notes.push(format!("Refused: {}.", reasons.join(", ")));
    }
    table
}

/// Errors of the recovered poses.
pub fn pose(p: &PoseScores) -> Table {
    let mut table = Table::new("Errors of the recovered poses.", &["quantity", "median", "95th percentile", "mean"]);
    let mut spread = |name: &str, s: Option<Spread>| {
        let numbers = [s.map(|s| s.median), s.map(|s| s.p95), s.map(|s| s.mean)];
        table.rows.push([Cell::text(name)].into_iter().chain(numbers.map(|v| Cell::number(v, 3))).collect());
    };
    spread("centre (% of side)", p.center_percent);
    spread("centre (px)", p.center_px);
    spread("angle (degrees)", p.angle_deg);
    spread("corners (% of side)", p.corner_percent);
    spread("corners (px)", p.corner_px);
    spread("quadrilateral IoU", p.quad_iou);
    table.notes.push("Corners are compared by identity: a pose turned by a quarter is wrong by a side.".into());
    table
}

/// What one number can say about a run beside the six metrics.
pub fn summary(run: &Run) -> Table {
    let evaluation = run.evaluation;
    let mut table = Table::new("Other numbers.", &["what", "value", "95 %"]);
    let mut row = |what: String, value: Cell, range: Cell| table.rows.push(vec![Cell::Text(what), value, range]);
    if let Some((area, ci)) = curves::froc_area(&evaluation.images, &evaluation.scores) {
        row("area under FROC up to 1 false positive an image".into(), Cell::Number(area, 4), Cell::range(ci, 4));
    }
    if let Some((rate, ci)) = metrics::false_positives_per_1000(evaluation) {
        let images = evaluation.scores.empty_images;
        row(format!("false positives per 1,000 photos without a marker ({images} such photos)"), Cell::Number(rate, 1), Cell::Range(ci, 1));
    }
    row("expected calibration error".into(), Cell::number(calibration(&evaluation.images).ece, 4), Cell::Undefined);
    if let Some((threshold, _)) = run.validation.and_then(metrics::chosen_threshold) {
        let chosen = evaluation.row_at(threshold);
        row("threshold of highest F1 on validation".into(), Cell::Number(threshold, 2), Cell::Undefined);
        row("F1 on this split at that threshold".into(), Cell::number(chosen.f1, 4), Cell::range(chosen.f1_ci, 4));
        row("precision on this split at that threshold".into(), Cell::number(chosen.precision, 4), Cell::range(chosen.precision_ci, 4));
        row("recall on this split at that threshold".into(), Cell::number(chosen.recall, 4), Cell::range(chosen.recall_ci, 4));
    }
    for (kind, count) in failures::count(run.truth, evaluation, evaluation.config.threshold) {
        row(format!("errors: {}", kind.key()), Cell::Count(count), Cell::Undefined);
    }
    if let Some(ms) = evaluation.ms {
        let stages = [("decoding", Some(ms.decode)), ("network", Some(ms.network)), ("poses", ms.pose)];
        for (stage, value) in stages.into_iter().filter_map(|(s, v)| Some((s, v?))) {
            row(format!("{stage}, mean (ms an image)"), Cell::Number(value, 2), Cell::Undefined);
        }
    }
    table
}

/// How recovered poses are turned against the truth.
pub fn orientation(p: &PoseScores) -> Table {
    let mut table = Table::new("Orientation of the recovered poses.", &["turned by (degrees)", "poses", "fraction", "95 %"]);
    let all: u64 = p.turned.iter().sum();
    for (k, n) in p.turned.iter().enumerate() {
        let fraction = (all > 0).then(|| *n as f64 / all as f64);
        let range = Cell::range(crate::interval::wilson(*n, all), 4);
        table.rows.push(vec![Cell::Count(90 * k as u64), Cell::Count(*n), Cell::number(fraction, 4), range]);
    }
    table.notes.push("Counter-clockwise as seen, to the nearest quarter.".into());
    table
}

/// Two runs on one truth.
pub fn comparison(c: &Comparison) -> Table {
    let columns = ["metric", c.first.as_str(), c.second.as_str(), "difference", "95 % (paired)"];
    let mut table = Table::new(format!("{} against {}.", c.first, c.second), &columns);
    for d in &c.differences {
        table.rows.push(vec![
            Cell::text(match d.metric {
                "mean_iou" => "mean IoU",
                "f1" => "F1",
                other => other,
            }),
            Cell::Number(d.first, 4),
            Cell::Number(d.second, 4),
            Cell::Number(d.difference, 4),
            Cell::range(d.ci, 4),
        ]);
    }
    let [a, b] = c.found_by_one;
    let names: Vec<&str> = c.disagreements.iter().take(20).map(|d| d.image.as_str()).collect();
    let more = if c.disagreements.len() > names.len() { ", ..." } else { "" };
    table.notes.push(format!(
        "Only the first finds {a} markers, only the second {b}. They disagree on {} images: {}{more}.",
        c.disagreements.len(),
        names.join(", ")
    ));
    table
}

/// Tables 2 to 7 as printed, with what can be recomputed from their counts.
pub fn paper() -> Table {
    let columns = [
        "table",
        "row",
        "threshold",
        "mean IoU",
        "FP",
        "FN",
        "% of FN",
        "precision",
        "recall",
        "N",
        "precision'",
        "recall'",
        "% of FN'",
        "fault",
    ];
    let mut table = Table::new("Tables 2 to 7 of the paper: printed values, and (') recomputed from the counts.", &columns);
    for r in &paper_tables::ROWS {
        table.rows.push(vec![
            Cell::Count(u64::from(r.table)),
            Cell::text(r.name),
            Cell::Number(r.threshold, 2),
            Cell::Number(r.mean_iou, 3),
            Cell::Count(r.fp),
            Cell::Count(r.fn_),
            Cell::number(r.percent_fn, 1),
            Cell::number(r.precision, 3),
            Cell::number(r.recall, 3),
            Cell::Count(r.markers),
            Cell::Number(r.precision(), 3),
            Cell::Number(r.recall(), 3),
            Cell::Number(r.percent_fn(), 1),
            Cell::text(r.fault.unwrap_or("")),
        ]);
    }
    table.notes.push(
        "N, which the paper does not print, is the number of test markers that reproduces the row; in table 3 any of 477 to 486 does."
            .into(),
    );
    table
}
