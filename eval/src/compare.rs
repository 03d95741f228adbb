//! Two detectors on one truth: differences with paired uncertainty, and where they disagree.
//!
//! Draw `k` of the bootstrap resamples the same images for every run of one truth and seed, so a difference of draws is a
//! draw of the difference: what both find hard cancels out.
use crate::{
    evaluation::Evaluation,
    interval::{Interval, percentile_interval},
    protocol::paper::{Counts, Drawn},
    truth::Truth,
};
use serde::Serialize;

/// First minus second, at the configured threshold of each.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    /// Of what, as a key of `metrics.json`.
    pub metric: &'static str,
    /// Of the first run.
    pub first: f64,
    /// Of the second run.
    pub second: f64,
    /// First minus second.
    pub difference: f64,
    /// 95 %, paired bootstrap over images.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ci: Option<Interval>,
}

/// An image on which one run finds more markers, or claims fewer false ones, than the other.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Disagreement {
    /// Index of the image among the truth's records.
    pub index: usize,
    /// As in the truth.
    pub image: String,
    /// Markers found by the first and by the second.
    pub found: [u64; 2],
    /// False positives of the first and of the second.
    pub fp: [u64; 2],
}

/// Two runs side by side.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// Name of the first run.
    pub first: String,
    /// Name of the second run.
    pub second: String,
    /// Mean IoU, precision, recall, F1; those defined for both.
    pub differences: Vec<Difference>,
    /// Markers that only the first and only the second finds.
    pub found_by_one: [u64; 2],
    /// Images on which they disagree, in order of the truth.
    pub disagreements: Vec<Disagreement>,
}

type Metric = (&'static str, fn(&Counts) -> Option<f64>, fn(Drawn) -> f64);

const METRICS: [Metric; 4] = [
    ("mean_iou", Counts::mean_iou, |d| d.iou / d.markers),
    ("precision", Counts::precision, |d| d.tp / (d.tp + d.fp)),
    ("recall", Counts::recall, |d| d.tp / d.markers),
    ("f1", Counts::f1, |d| 2.0 * d.tp / (d.tp + d.fp + d.markers)),
];

/// Compares two runs that were scored against the same truth; intervals need the same seed and number of draws.
#[must_use]
pub fn compare(truth: &Truth, a: &Evaluation, b: &Evaluation) -> Comparison {
    let both = [a, b];
    let [ka, kb] = both.map(|e| e.scores.position(e.config.threshold));
    let mut differences = Vec::new();
    if let (Some(ka), Some(kb)) = (ka, kb) {
        let paired = a.config.seed == b.config.seed && a.config.bootstrap_draws == b.config.bootstrap_draws;
        for (metric, point, drawn) in METRICS {
            let (Some(first), Some(second)) = (point(&a.scores.counts[ka]), point(&b.scores.counts[kb])) else { continue };
            let draws = a.scores.values(ka, drawn).into_iter().zip(b.scores.values(kb, drawn)).map(|(x, y)| x - y);
            let ci = if paired { percentile_interval(draws) } else { None };
            differences.push(Difference { metric, first, second, difference: first - second, ci });
        }
    }
    let mut found_by_one = [0, 0];
    for (x, y) in a.markers_at(a.config.threshold).iter().zip(b.markers_at(b.config.threshold)) {
        found_by_one[0] += u64::from(x.found && !y.found);
        found_by_one[1] += u64::from(y.found && !x.found);
    }
    let disagreement = |(k, record): (usize, &tcross_dataset::Record)| {
        let [x, y] = both.map(|e| e.tally_at(k, e.config.threshold));
        let differ = (x.tp, x.fp) != (y.tp, y.fp);
        differ.then(|| Disagreement { index: k, image: record.image.clone(), found: [x.tp, y.tp], fp: [x.fp, y.fp] })
    };
    let disagreements = truth.records.iter().enumerate().filter_map(disagreement).collect();
    Comparison { first: a.name.clone(), second: b.name.clone(), differences, found_by_one, disagreements }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Config, evaluate};
    use tcross_dataset::{ImageDetections, Record, dataset::BoxConvention};

    /// 100 images; `hits` of them with their marker found, and a false positive on those before `fps`.
    fn run(truth: &Truth, name: &str, hits: std::ops::Range<usize>, fps: usize) -> Evaluation {
        let row = |(k, r): (usize, &Record)| -> ImageDetections {
            let mut claims = Vec::new();
            if hits.contains(&k) {
                claims.push(serde_json::json!({"score": 0.9, "class": 0, "box": [10, 10, 30, 30]}));
            }
            if k < fps {
                claims.push(serde_json::json!({"score": 0.8, "class": 0, "box": [60, 60, 80, 80]}));
            }
            serde_json::from_value(serde_json::json!({"image": r.image, "width": 100, "height": 100, "detections": claims})).unwrap()
        };
        let rows: Vec<_> = truth.records.iter().enumerate().map(row).collect();
        evaluate(truth, name, rows.into(), &Config::default(), false).unwrap()
    }

    #[test]
    fn pairs_cancel_what_both_find_hard() {
        let record = |k: usize| -> Record {
            let json = serde_json::json!({"image": format!("{k}"), "width": 100, "height": 100,
                "markers": [{"shape": "t_cross", "box": [10, 10, 30, 30]}]});
            serde_json::from_value(json).unwrap()
        };
        let truth = Truth::new((0..100).map(record).collect(), BoxConvention::Continuous, None);
        // The second finds all that the first finds, and ten more.
        let c = compare(&truth, &run(&truth, "a", 0..60, 0), &run(&truth, "b", 0..70, 0));
        let recall = c.differences.iter().find(|d| d.metric == "recall").unwrap();
        let [lo, hi] = recall.ci.unwrap();
        // Unpaired, the interval would be wider than 0.26; paired it is that of ten of a hundred.
        assert!((recall.difference + 0.1).abs() < 1e-12 && hi < 0.0 && hi - lo < 0.14, "{lo} {hi}");
        assert_eq!((c.found_by_one, c.disagreements.len()), ([0, 10], 10));
        assert_eq!(c.disagreements[0], Disagreement { index: 60, image: "60".into(), found: [0, 1], fp: [0, 0] });
        // A run against itself does not differ at all.
        let a = run(&truth, "a", 0..60, 3);
        let same = compare(&truth, &a, &a);
        assert!(same.differences.iter().all(|d| d.difference == 0.0 && d.ci == Some([0.0, 0.0])) && same.disagreements.is_empty());
    }
}
