//! The figures of a report, one or more runs in each.
use super::Run;
use crate::{
    calibration::Calibration,
    curves::{self, Curve},
    figures::{Axis, Canvas, Color, DotPlot, LinePlot, Series},
    paper_tables,
    protocol::{
        paper::Drawn,
        pose::{PoseError, PoseOutcomes},
    },
    slices::Slice,
};

/// A figure, its file name and its heading.
#[derive(Debug, Clone)]
pub struct Figure {
    /// As a file's name.
    pub key: String,
    /// As a heading.
    pub title: String,
    /// What is drawn.
    pub canvas: Canvas,
}

impl Figure {
    pub(super) fn new(key: &str, title: &str, plot: &LinePlot) -> Self {
        Self { key: key.into(), title: title.into(), canvas: plot.draw() }
    }
}

/// A run's name where there are several, else the quantity's.
fn label(runs: &[Run], k: usize, quantity: &str) -> String {
    if runs.len() == 1 { quantity.to_owned() } else { runs[k].evaluation.name.clone() }
}

/// Figure 20: recall against the number of false positives, a point a threshold, with the paper's own points.
pub fn figure_20(runs: &[Run]) -> Figure {
    let y = Axis::linear("true positive rate").from_to(0.0, 1.0);
    let mut plot = LinePlot::new("", Axis::linear("false positives (count)"), y).caption(
        "As the paper's Figure 20. Not a classical ROC: its x axis is a count, not a rate, for boxes have no true negatives. \
         Each point is a score threshold.",
    );
    for (k, run) in runs.iter().enumerate() {
        let rows = run.evaluation.rows();
        let points = rows.iter().rev().map(|r| [r.fp as f64, r.recall.unwrap_or(f64::NAN)]).collect();
        let mut series = Series::line(label(runs, k, "ours"), points).marked();
        series.notes = rows.iter().rev().enumerate().map(|(i, r)| (i, format!("{:.2}", r.threshold))).collect();
        plot = plot.with(series);
    }
    let paper: Vec<[f64; 2]> = paper_tables::table(6).collect::<Vec<_>>().iter().rev().map(|r| [r.fp as f64, r.recall()]).collect();
    plot = plot.with(Series::line("paper, 55 real images", paper).marked().dashed().colored(Color::GREY));
    Figure::new("figure20", "Figure 20: true positive rate against false positives", &plot)
}

fn curve_plot(runs: &[Run], key: &str, title: &str, x: Axis, y: Axis, quantity: &str, curve: impl Fn(&Run) -> Curve) -> Figure {
    let mut plot = LinePlot::new("", x, y);
    for (k, run) in runs.iter().enumerate() {
        let curve = curve(run);
        plot = plot.with(Series::line(label(runs, k, quantity), curve.points).within(curve.band));
    }
    let draws = runs.first().map_or(0, |r| r.evaluation.config.bootstrap_draws);
    if draws > 0 {
        plot = plot.caption(format!("Band: 95 %, {draws} bootstrap draws over images."));
    }
    Figure::new(key, title, &plot)
}

/// Sensitivity against false positives an image.
pub fn froc(runs: &[Run]) -> Figure {
    let x = Axis::log("false positives per image (log)");
    let y = Axis::linear("sensitivity (recall)").from_to(0.0, 1.0);
    curve_plot(runs, "froc", "FROC: sensitivity against false positives per image", x, y, "sensitivity", |r| {
        curves::froc(&r.evaluation.scores)
    })
}

/// Precision against recall.
pub fn precision_recall(runs: &[Run]) -> Figure {
    let x = Axis::linear("recall").from_to(0.0, 1.0);
    let y = Axis::linear("precision").from_to(0.0, 1.0);
    curve_plot(runs, "precision-recall", "Precision against recall", x, y, "precision", |r| curves::precision_recall(&r.evaluation.scores))
}

/// Precision, recall, F1 and mean IoU against the threshold, of one run.
pub fn over_threshold(run: &Run) -> Figure {
    let mut plot = LinePlot::new("", Axis::linear("score threshold").from_to(0.0, 1.0), Axis::linear("value").from_to(0.0, 1.0));
    let scores = &run.evaluation.scores;
    type Quantity = fn(Drawn) -> f64;
    let quantities: [(&str, Quantity); 4] = [
        ("precision", |d| d.tp / (d.tp + d.fp)),
        ("recall", |d| d.tp / d.markers),
        ("F1", |d| 2.0 * d.tp / (d.tp + d.fp + d.markers)),
        ("mean IoU", |d| d.iou / d.markers),
    ];
    for (name, quantity) in quantities {
        let curve = curves::over_threshold(scores, quantity);
        plot = plot.with(Series::line(name, curve.points).within(curve.band));
    }
    let draws = run.evaluation.config.bootstrap_draws;
    if draws > 0 {
        plot = plot.caption(format!("Bands: 95 %, {draws} bootstrap draws over images."));
    }
    Figure::new("threshold", "Precision, recall, F1 and mean IoU against the threshold", &plot)
}

/// Fraction right against score.
pub fn reliability(calibration: &Calibration) -> Figure {
    let unit = |label: &str| Axis::linear(label).from_to(0.0, 1.0);
    let points = calibration.bins.iter().map(|b| [b.score, b.right]).collect();
    let band = calibration.bins.iter().map(|b| [b.score, b.right_ci[0], b.right_ci[1]]).collect();
    let mut series = Series::line("detections, in ten bins", points).marked().within(band);
    series.notes = calibration.bins.iter().enumerate().map(|(k, b)| (k, format!("n={}", b.detections))).collect();
    let honest = Series::line("honest", vec![[0.0, 0.0], [1.0, 1.0]]).dashed().colored(Color::GREY);
    let plot = LinePlot::new("", unit("score"), unit("fraction right")).with(series).with(honest);
    let plot = plot.caption(format!("Expected calibration error {:.3}. Band: 95 %, Wilson.", calibration.ece.unwrap_or(0.0)));
    Figure::new("reliability", "Calibration: are scores probabilities?", &plot)
}

/// Recall and mean IoU against a factor that is a number.
pub fn slice(slice: &Slice) -> Option<Figure> {
    let classes: Vec<_> = slice.classes.iter().filter_map(|c| Some((c.middle?, c))).collect();
    if classes.is_empty() {
        return words(slice);
    }
    if classes.len() < 2 {
        return None;
    }
    let mut recall = Series::line("recall", classes.iter().map(|(x, c)| [*x, c.recall]).collect()).marked();
    recall.band = classes.iter().map(|(x, c)| [*x, c.recall_ci[0], c.recall_ci[1]]).collect();
    recall.notes = classes.iter().enumerate().map(|(k, (_, c))| (k, format!("n={}", c.markers))).collect();
    let iou = Series::line("mean IoU (misses as 0)", classes.iter().map(|(x, c)| [*x, c.mean_iou]).collect()).marked();
    let right = classes.iter().map(|(x, c)| [*x, c.precision.unwrap_or(f64::NAN)]).collect();
    let precision = Series::line("precision", right).dashed();
    let (first, last) = (classes[0].0, classes[classes.len() - 1].0);
    // Only lengths are read by their ratios; angles and fractions are not.
    let wide = slice.label.ends_with("(px)") && first >= 1.0 && last / first > 10.0;
    let x = if wide { Axis::log(&slice.label) } else { Axis::linear(&slice.label) };
    let plot = LinePlot::new("", x, Axis::linear("fraction").from_to(0.0, 1.0)).with(recall).with(iou).with(precision);
    let plot = plot.caption("Each point is a class at its mean; n counts its markers. Band: 95 %, Wilson.");
    Some(Figure::new(&format!("by-{}", slice.key), &format!("By {}", slice.name()), &plot))
}

/// Recall and mean IoU of classes that have words for names.
fn words(slice: &Slice) -> Option<Figure> {
    if slice.classes.len() < 2 || slice.classes.len() > 40 {
        return None;
    }
    let plot = DotPlot {
        label: "fraction".into(),
        quantities: vec!["recall".into(), "mean IoU (misses as 0)".into()],
        rows: slice.classes.iter().map(|c| (c.label.clone(), c.markers, vec![(c.recall, Some(c.recall_ci)), (c.mean_iou, None)])).collect(),
        caption: "n counts markers. Bar: 95 %, Wilson.".into(),
    };
    Some(Figure { key: format!("by-{}", slice.key), title: format!("By {}", slice.name()), canvas: plot.draw() })
}

/// The share of all markers whose pose is recovered within a given error.
pub fn pose_within(outcomes: &PoseOutcomes) -> Figure {
    let curve = |name: &str, f: &dyn Fn(&PoseError) -> f64| {
        let mut errors: Vec<f64> = outcomes.errors.iter().map(f).collect();
        errors.sort_by(f64::total_cmp);
        let points = (0..=120).map(|k| 0.05 * (2000f64).powf(f64::from(k) / 120.0));
        let within = |e: f64| errors.partition_point(|v| *v <= e) as f64 / (outcomes.markers.max(1)) as f64;
        Series::line(name, points.map(|e| [e, within(e)]).collect())
    };
    let x = Axis::log("error (% of side, degrees; log)").from_to(0.05, 100.0);
    let plot = LinePlot::new("", x, Axis::linear("fraction of all markers within").from_to(0.0, 1.0))
        .with(curve("centre (%)", &PoseError::center_percent))
        .with(curve("corners (%)", &PoseError::corner_percent))
        .with(curve("angle (degrees)", &|e| e.angle_deg.abs()));
    let plot = plot.caption(format!(
        "{} poses of {} markers; what is missed or refused counts as not within.",
        outcomes.errors.len(),
        outcomes.markers
    ));
    Figure::new("pose-within", "Markers whose pose is within a given error", &plot)
}

/// Errors of poses against a factor that is a number.
pub fn pose_slice(slice: &Slice) -> Option<Figure> {
    let classes: Vec<_> = slice.classes.iter().filter_map(|c| Some((c.middle?, c.pose?))).collect();
    if classes.len() < 2 {
        return None;
    }
    let line = |name: &str, f: fn(&crate::slices::ClassPose) -> f64| {
        Series::line(name, classes.iter().map(|(x, p)| [*x, f(p)]).collect()).marked()
    };
    let plot = LinePlot::new("", Axis::linear(&slice.label), Axis::linear("median error (% of side, degrees)"))
        .with(line("centre (%)", |p| p.center_percent))
        .with(line("corners (%)", |p| p.corner_percent))
        .with(line("angle (degrees)", |p| p.angle_deg));
    Some(Figure::new(&format!("pose-by-{}", slice.key), &format!("Pose errors by {}", slice.name()), &plot))
}
