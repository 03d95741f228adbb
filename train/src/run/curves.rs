//! Curves of a run: loss terms, rate, scores over the epochs.
use super::history::{History, Row};
use tcross_eval::figures::{Axis, LinePlot, Series};

/// A loss term's name and how to read it from a row.
type Term = (&'static str, fn(&Row) -> f64);

const TERMS: [Term; 6] = [
    ("sum", |r| r.loss.total()),
    ("centre", |r| r.loss.center),
    ("size", |r| r.loss.size),
    ("objectness", |r| r.loss.objectness),
    ("class", |r| r.loss.class),
    ("keypoints", |r| r.loss.keypoints),
];

/// Each figure with its file's name.
#[must_use]
pub fn plots(history: &History) -> Vec<(&'static str, LinePlot)> {
    let epoch = || Axis::linear("epoch");
    let curve = |label: &str, of: &dyn Fn(&Row) -> Option<f64>| {
        let points: Vec<[f64; 2]> = history.rows.iter().filter_map(|row| Some([row.epoch, of(row)?])).collect();
        let few = points.len() <= 30;
        let series = Series::line(label, points);
        if few { series.marked() } else { series }
    };
    let mut loss = LinePlot::new("Loss", epoch(), Axis::log("loss per image"));
    for (label, term) in TERMS {
        if history.rows.iter().any(|row| term(row) > 0.0) {
            loss = loss.with(curve(label, &|row| Some(term(row)).filter(|v| *v > 0.0)));
        }
    }
    let mut scores = LinePlot::new("Validation", epoch(), Axis::linear("score").from_to(0.0, 1.0));
    for (k, label) in [(0, "AP"), (1, "AP50"), (2, "mean IoU"), (3, "precision"), (4, "recall")] {
        scores = scores.with(curve(label, &|row| row.scores[k]));
    }
    let rate = LinePlot::new("Learning rate", epoch(), Axis::linear("rate")).with(curve("", &|row| Some(row.rate)));
    let speed = LinePlot::new("Speed", epoch(), Axis::linear("images / s")).with(curve("", &|row| Some(row.images_per_second)));
    vec![("loss", loss), ("scores", scores), ("rate", rate), ("speed", speed)]
}
