//! The paper's metrics for markers of at least some size.
//!
//! For a least short side of S pixels, with the one matching that feeds every other number:
//!
//! - A marker counts if the short side of its true box is at least S; a smaller one is ignored: neither found nor missed.
//! - A detection matched to an ignored marker (as its hit or as a duplicate) is ignored with it, whatever its own size.
//! - A detection matched to a marker that counts is a true positive or a duplicate, whatever its own size.
//! - A detection that no marker overlaps enough is a false positive if its own short side is at least S; a smaller one is
//!   ignored, for it claims no marker of that size.
//!
//! So TP + FN is the number of markers of at least S, precision = TP / (TP + FP), recall = TP / (TP + FN), and S = 0 is the
//! paper's protocol itself. COCO's size classes ignore boxes in the same way. The short side is `max - min` of the shorter
//! side in continuous pixels; under the inclusive convention one more.
use crate::{
    evaluation::Evaluation,
    matching::{Claim, MarkerIndex, Verdict},
    protocol::paper::{MatchedImage, Row, Scores},
    truth::Truth,
};
use rayon::prelude::*;
use serde::Serialize;
use std::borrow::Cow;
use tcross_dataset::PixelBox;

/// The metrics of markers of at least one size.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MinSide {
    /// Least short side of a box that counts, in pixels.
    pub min_side_px: f64,
    /// Markers that count.
    pub markers: u64,
    /// Smaller ones, which do not.
    pub ignored_markers: u64,
    /// At the configured threshold.
    pub headline: Row,
    /// At the configured thresholds, rising.
    pub rows: Vec<Row>,
}

/// The shorter side of a box in pixels; `extra` is what the dataset's convention adds to `max - min`.
#[must_use]
pub fn short_side(bounds: &PixelBox, extra: f64) -> f64 {
    bounds.width().min(bounds.height()) + extra
}

/// The metrics for each of the configured least sizes.
#[must_use]
pub fn min_sides(truth: &Truth, evaluation: &Evaluation) -> Vec<MinSide> {
    let config = &evaluation.config;
    let mut thresholds: Vec<f64> = config.thresholds.iter().copied().chain([config.threshold]).collect();
    thresholds.sort_by(f64::total_cmp);
    thresholds.dedup_by(|a, b| (*a - *b).abs() < 1e-12);
    let extra = truth.boxes.extra();
    let one = |&min_side_px: &f64| {
        let kept = |i: usize| {
            let counts = |m: usize| short_side(&truth.records[i].markers[m].bounds, extra) >= min_side_px;
            Cow::Owned(of_at_least(&evaluation.images[i], counts, (min_side_px - extra) as f32, thresholds[0]))
        };
        let scores = Scores::from_fn(evaluation.images.len(), kept, &thresholds, config.bootstrap_draws, config.seed);
        let row = |t: f64| scores.position(t).map(|k| scores.row(k));
        Some(MinSide {
            min_side_px,
            markers: scores.markers(),
            ignored_markers: evaluation.scores.markers() - scores.markers(),
            headline: row(config.threshold)?,
            rows: config.thresholds.iter().filter_map(|t| row(*t)).collect(),
        })
    };
    config.min_side_px.par_iter().filter_map(one).collect()
}

/// What is left of an image if only markers for which `counts` holds, and unmatched detections of at least `min_side`
/// pixels (`max - min`), count; claims of a score below `least` are left out. A false positive too small to count keeps its overlap with a marker that does: the mean IoU
/// takes a marker's best IoU as it is.
fn of_at_least(image: &MatchedImage, counts: impl Fn(usize) -> bool, min_side: f32, least: f64) -> MatchedImage {
    let mut kept = 0;
    let renumbered: Vec<Option<MarkerIndex>> = (0..image.markers as usize)
        .map(|m| {
            let index = counts(m).then_some(kept)?;
            kept += 1;
            MarkerIndex::new(index)
        })
        .collect();
    let claim = |c: &Claim| {
        let marker = c.marker.and_then(|m| renumbered[m.get()]);
        let iou = if marker.is_some() { c.iou } else { 0.0 };
        let verdict = match c.verdict {
            Verdict::FalsePositive if c.side < min_side => Verdict::Ignored,
            Verdict::Hit | Verdict::Duplicate if marker.is_none() => Verdict::Ignored,
            other => other,
        };
        Claim { marker, iou, verdict, ..*c }
    };
    let claims = image.claims.iter().take_while(|c| c.score >= least).map(claim);
    // An ignored claim without a marker says nothing to anyone.
    let claims = claims.filter(|c| c.marker.is_some() || c.verdict != Verdict::Ignored);
    MatchedImage { markers: kept as u32, claims: claims.collect() }
}

#[cfg(test)]
mod reference {
    //! The definition with lists, one threshold, one marker to each detection: for images whose markers lie apart.
    use tcross_dataset::{Detection, Marker, geom::boxes::iou_inclusive};

    /// TP, FP, FN of one image.
    pub fn counts(markers: &[Marker], detections: &[Detection], threshold: f64, min_side: f64) -> (u64, u64, u64) {
        let large = |b: &tcross_dataset::PixelBox| (b.x_max - b.x_min).min(b.y_max - b.y_min) >= min_side;
        let kept: Vec<&Detection> = detections.iter().filter(|d| d.score >= threshold).collect();
        let over = |m: &Marker, d: &Detection| iou_inclusive(&m.bounds, &d.bounds) >= 0.2;
        let found = |m: &&Marker| kept.iter().any(|d| over(m, d));
        let counting: Vec<&Marker> = markers.iter().filter(|m| large(&m.bounds)).collect();
        let tp = counting.iter().copied().filter(found).count();
        let alone = |d: &&&Detection| !markers.iter().any(|m| over(m, d));
        let fp = kept.iter().filter(alone).filter(|d| large(&d.bounds)).count();
        (tp as u64, fp as u64, (counting.len() - tp) as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Config, evaluate};
    use tcross_dataset::{Detection, ImageDetections, Marker, Record, Rng, dataset::BoxConvention};

    fn scored(images: Vec<(Vec<Marker>, Vec<Detection>)>, min_side_px: Vec<f64>) -> Vec<MinSide> {
        let record = |k: usize, markers: Vec<Marker>| Record {
            image: k.to_string(),
            width: 900,
            height: 900,
            background: None,
            markers,
            confusers: Vec::new(),
            intrinsics: None,
            distortion: None,
            effects: serde_json::Map::new(),
        };
        let row = |k: usize, detections| ImageDetections { image: k.to_string(), width: 900, height: 900, detections, ms: None };
        let (markers, detections): (Vec<_>, Vec<_>) = images.into_iter().unzip();
        let records = markers.into_iter().enumerate().map(|(k, m)| record(k, m)).collect();
        let rows: Vec<_> = detections.into_iter().enumerate().map(|(k, d)| row(k, d)).collect();
        let truth = Truth::new(records, BoxConvention::Continuous, None);
        let config = Config { min_side_px, bootstrap_draws: 20, ..Config::default() };
        evaluate(&truth, "test", rows.into(), &config, false).unwrap().min_sides
    }

    fn marker(x: f64, side: f64) -> Marker {
        Marker::from_box("t_cross", [x, x, x + side, x + side].into())
    }

    fn detection(score: f64, x: f64, y: f64, side: f64) -> Detection {
        Detection { score, class: 0, bounds: [x, y, x + side, y + side].into(), pose: None }
    }

    #[test]
    fn each_sentence_of_the_definition() {
        let markers = vec![marker(100.0, 24.0), marker(300.0, 23.0), marker(500.0, 40.0)];
        let detections = vec![
            detection(0.9, 100.0, 100.0, 20.0), // small, but on a marker that counts: a true positive
            detection(0.9, 300.0, 300.0, 30.0), // large, but on a marker that is ignored: ignored
            detection(0.8, 300.0, 300.0, 28.0), // its duplicate too
            detection(0.9, 700.0, 0.0, 24.0),   // a false positive of just that size
            detection(0.9, 0.0, 700.0, 23.5),   // a smaller one: ignored
        ];
        let [at] = scored(vec![(markers.clone(), detections.clone())], vec![24.0]).try_into().unwrap();
        assert_eq!((at.markers, at.ignored_markers), (2, 1));
        assert_eq!((at.headline.tp, at.headline.fp, at.headline.fn_, at.headline.duplicates), (1, 1, 1, 0));
        assert_eq!((at.headline.precision, at.headline.recall), (Some(0.5), Some(0.5)));
        // Beyond every marker nothing is left to find, and no claim is that large.
        let [none] = scored(vec![(markers, detections)], vec![100.0]).try_into().unwrap();
        assert_eq!((none.markers, none.headline.recall, none.headline.precision), (0, None, None));
    }

    #[test]
    fn equals_the_definition_on_random_images() {
        let mut images = Vec::new();
        for item in 0..300 {
            let mut rng = Rng::for_item(8, "eval/test/min-side", item);
            // Places 200 px apart hold a marker or not; claims lie around places or anywhere between.
            let places: Vec<(f64, f64, bool)> = (0..4).map(|k| (f64::from(k) * 200.0, rng.int(4, 50) as f64, rng.chance(0.7))).collect();
            let markers: Vec<Marker> = places.into_iter().filter(|p| p.2).map(|(at, side, _)| marker(at, side)).collect();
            let near = |rng: &mut Rng| {
                let at = 200.0 * rng.int(0, 3) as f64;
                (at + rng.int(0, 20) as f64, at + rng.int(0, 20) as f64)
            };
            let detections = (0..rng.index(9))
                .map(|_| {
                    let (x, y) = near(&mut rng);
                    detection(rng.int(0, 20) as f64 / 20.0, x, y, rng.int(4, 50) as f64)
                })
                .collect();
            images.push((markers, detections));
        }
        let sizes = vec![0.5, 12.0, 24.0, 36.0];
        for at in scored(images.clone(), sizes) {
            for row in &at.rows {
                let mut want = (0, 0, 0);
                for (markers, detections) in &images {
                    let one = reference::counts(markers, detections, row.threshold, at.min_side_px);
                    want = (want.0 + one.0, want.1 + one.1, want.2 + one.2);
                }
                assert_eq!((row.tp, row.fp, row.fn_), want, "least side {} px, threshold {}", at.min_side_px, row.threshold);
            }
        }
    }
}
