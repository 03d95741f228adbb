//! `metrics.json`: every figure unrounded; what is undefined is absent.
use crate::{
    calibration::calibration, curves, evaluation::Evaluation, failures, input::ProblemCounts, interval::Interval, slices::slices,
    truth::Truth, validate::best_f1, verdict::RowVerdict,
};
use serde_json::{Map, Value, json};

/// The blocks of one run.
#[must_use]
pub fn metrics(truth: &Truth, evaluation: &Evaluation, validation: Option<&Evaluation>) -> Map<String, Value> {
    let mut out = Map::new();
    if evaluation.config.wants(crate::Protocol::Paper) {
        out.insert("paper".into(), paper(truth, evaluation, validation));
    }
    if let Some(coco) = &evaluation.coco {
        out.insert("coco".into(), json!(coco));
    }
    if let Some(pose) = &evaluation.pose {
        out.insert("pose".into(), json!(pose.scores()));
    }
    if !evaluation.problems.is_empty() {
        out.insert("problems".into(), problems(&evaluation.problems));
    }
    if let Some(ms) = &evaluation.ms {
        out.insert("ms".into(), json!(ms));
    }
    out
}

/// How often each kind of fault was met.
#[must_use]
pub fn problems(counts: &ProblemCounts) -> Value {
    Value::Object(counts.iter().map(|(kind, n)| (kind.key().into(), json!(n))).collect())
}

fn paper(truth: &Truth, evaluation: &Evaluation, validation: Option<&Evaluation>) -> Value {
    let scores = &evaluation.scores;
    let mut out = json!({
        "images": scores.images,
        "markers": scores.markers(),
        "rows": evaluation.rows(),
        "headline": evaluation.headline(),
        "min_side": evaluation.min_sides,
        "slices": slices(truth, evaluation),
        "calibration": calibration(&evaluation.images),
    });
    if let Some((area, interval)) = curves::froc_area(&evaluation.images, scores) {
        out["froc_area"] = json!(area);
        insert_some(&mut out, "froc_area_ci", interval);
    }
    if let Some((rate, interval)) = false_positives_per_1000(evaluation) {
        out["fp_per_1000_without_marker"] = json!({"images": scores.empty_images, "value": rate, "ci": interval});
    }
    let counts = failures::count(truth, evaluation, evaluation.config.threshold);
    let counts: Map<String, Value> = counts.into_iter().map(|(kind, n)| (kind.key().into(), json!(n))).collect();
    out["errors"] = Value::Object(counts);
    if let Some(paper) = evaluation.config.paper.as_ref().and_then(|p| crate::paper_tables::find(p).ok()) {
        out["verdict"] = json!(RowVerdict::new(&evaluation.headline(), scores.images, paper));
    }
    if let Some((threshold, f1)) = validation.and_then(chosen_threshold) {
        out["chosen_on_validation"] = json!({"threshold": threshold, "validation_f1": f1, "test": evaluation.row_at(threshold)});
    }
    out
}

fn insert_some(out: &mut Value, key: &str, interval: Option<Interval>) {
    if let Some(interval) = interval {
        out[key] = json!(interval);
    }
}

/// The threshold of highest F1 at steps of 0.01, and that F1; `None` where nothing is found at any.
#[must_use]
pub fn chosen_threshold(validation: &Evaluation) -> Option<(f64, f64)> {
    let steps: Vec<f64> = (1..100).map(|k| f64::from(k) / 100.0).collect();
    let f1: Vec<Option<f64>> = steps.iter().map(|t| validation.scores.counts[validation.scores.position(*t)?].f1()).collect();
    best_f1(&steps, &f1).filter(|(_, f1)| *f1 > 0.0)
}

/// False positives a thousand photos without a marker, at the configured threshold, with a 95 % interval of the Poisson
/// count (Byar's approximation). `None` where every image has a marker.
#[must_use]
pub fn false_positives_per_1000(evaluation: &Evaluation) -> Option<(f64, Interval)> {
    let scores = &evaluation.scores;
    if scores.empty_images == 0 {
        return None;
    }
    let count = scores.fp_on_empty[scores.position(evaluation.config.threshold)?] as f64;
    let scale = 1000.0 / scores.empty_images as f64;
    let byar = |n: f64, z: f64| n * (1.0 - 1.0 / (9.0 * n) + z / (3.0 * n.sqrt())).powi(3);
    let lo = if count > 0.0 { byar(count, -crate::interval::Z95) } else { 0.0 };
    Some((count * scale, [lo * scale, byar(count + 1.0, crate::interval::Z95) * scale]))
}
