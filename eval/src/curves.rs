//! Curves over the threshold, each with a bootstrap band.
use crate::{
    interval::{Interval, percentile_interval},
    matching::Verdict,
    protocol::paper::{Drawn, MatchedImage, Scores},
};
use rayon::prelude::*;

/// A curve and its 95 % band.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Curve {
    /// By rising x.
    pub points: Vec<[f64; 2]>,
    /// `[x, low, high]`, by rising x.
    pub band: Vec<[f64; 3]>,
}

/// Sensitivity (recall) against false positives an image: at each x the highest recall that any threshold reaches with at
/// most x false positives an image.
#[must_use]
pub fn froc(scores: &Scores) -> Curve {
    let images = scores.images as f64;
    let last = scores.counts.iter().map(|c| c.fp).max().unwrap_or(0);
    if images == 0.0 || scores.markers() == 0 {
        return Curve::default();
    }
    let (lo, hi) = (1.0 / images, (last.max(1) as f64 / images).max(1.0));
    let xs: Vec<f64> = (0..=80).map(|k| lo * (hi / lo).powf(f64::from(k) / 80.0)).collect();
    let recalled = |xs: &[f64], at: &[(f64, f64)]| -> Vec<f64> {
        xs.iter().map(|x| at.iter().filter(|(fp, _)| *fp <= x * (1.0 + 1e-9)).map(|p| p.1).fold(0.0, f64::max)).collect()
    };
    let ours: Vec<(f64, f64)> = scores.counts.iter().map(|c| (c.fp as f64 / images, c.recall().unwrap_or(0.0))).collect();
    let drawn = |d: &[Drawn]| recalled(&xs, &d.iter().map(|d| (d.fp / d.images, d.tp / d.markers)).collect::<Vec<_>>());
    Curve { points: join(&xs, &recalled(&xs, &ours)), band: band(&xs, &scores.per_draw(drawn)) }
}

/// Precision against recall: at each recall the highest precision that any threshold reaches with at least that recall.
#[must_use]
pub fn precision_recall(scores: &Scores) -> Curve {
    if scores.markers() == 0 {
        return Curve::default();
    }
    let reach = scores.counts.iter().filter_map(|c| c.recall()).fold(0.0, f64::max);
    let xs: Vec<f64> = (0..=100).map(|k| f64::from(k) / 100.0).filter(|r| *r <= reach).chain([reach]).collect();
    let envelope = |at: &[(f64, f64)]| -> Vec<f64> {
        let reached = |r: f64| at.iter().filter(move |p| p.0 >= r - 1e-9 && p.1.is_finite()).map(|p| p.1);
        xs.iter().map(|r| reached(*r).fold(f64::NAN, f64::max)).collect()
    };
    let ours: Vec<(f64, f64)> = scores.counts.iter().filter_map(|c| Some((c.recall()?, c.precision()?))).collect();
    let drawn = |d: &[Drawn]| envelope(&d.iter().map(|d| (d.tp / d.markers, d.tp / (d.tp + d.fp))).collect::<Vec<_>>());
    Curve { points: join(&xs, &envelope(&ours)), band: band(&xs, &scores.per_draw(drawn)) }
}

/// A quantity against the threshold, at steps of 0.01.
#[must_use]
pub fn over_threshold(scores: &Scores, quantity: impl Fn(Drawn) -> f64 + Sync) -> Curve {
    let hundredths: Vec<usize> = (0..scores.thresholds.len())
        .filter(|&k| ((scores.thresholds[k] * 100.0).round() / 100.0 - scores.thresholds[k]).abs() < 1e-12)
        .collect();
    let value = |k: usize| {
        let c = &scores.counts[k];
        Drawn { tp: c.tp as f64, fp: c.fp as f64, iou: c.iou, markers: c.markers as f64, images: scores.images as f64 }
    };
    let points = hundredths.iter().map(|&k| [scores.thresholds[k], quantity(value(k))]).collect();
    let ends: Vec<Option<[f64; 3]>> =
        hundredths.par_iter().map(|&k| scores.interval(k, &quantity).map(|[lo, hi]| [scores.thresholds[k], lo, hi])).collect();
    Curve { points, band: ends.into_iter().flatten().collect() }
}

fn join(xs: &[f64], ys: &[f64]) -> Vec<[f64; 2]> {
    xs.iter().zip(ys).map(|(x, y)| [*x, *y]).collect()
}

fn band(xs: &[f64], draws: &[Vec<f64>]) -> Vec<[f64; 3]> {
    let at = |k: usize| percentile_interval(draws.iter().map(|d| d[k])).map(|[lo, hi]| [xs[k], lo, hi]);
    (0..xs.len()).into_par_iter().map(at).collect::<Vec<_>>().into_iter().flatten().collect()
}

/// Area under the FROC curve from 0 to 1 false positive an image (0..1), and its 95 % interval. `None` without markers.
#[must_use]
pub fn froc_area(images: &[MatchedImage], scores: &Scores) -> Option<(f64, Option<Interval>)> {
    if scores.markers() == 0 {
        return None;
    }
    let drawn = |d: &[Drawn]| area_of_steps(d.iter().rev().map(|d| (d.fp / d.images, d.tp / d.markers)));
    let beyond = scores.counts.iter().rposition(|c| c.fp > scores.images);
    let floor = beyond.map_or(0.0, |k| scores.thresholds[k]);
    Some((exact_area(images, scores.markers() as f64, floor), scores.interval_of_all(drawn)))
}

/// The area under steps given by rising false positives an image.
fn area_of_steps(steps: impl Iterator<Item = (f64, f64)>) -> f64 {
    let (mut area, mut at, mut height) = (0.0, 0.0, 0.0f64);
    for (fp, recall) in steps {
        let next = fp.min(1.0);
        area += (next - at) * height;
        at = next;
        height = height.max(recall);
    }
    area + (1.0 - at) * height
}

/// The same from every score, rather than from a grid of them, down to `floor`: there false positives exceed one an image.
fn exact_area(images: &[MatchedImage], markers: f64, floor: f64) -> f64 {
    let all =
        images.iter().flat_map(|i| &i.claims).filter(|c| matches!(c.verdict, Verdict::Hit | Verdict::FalsePositive) && c.score >= floor);
    let mut claims: Vec<(f64, bool)> = all.map(|c| (c.score, c.verdict == Verdict::Hit)).collect();
    claims.par_sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
    let (mut tp, mut fp) = (0.0, 0.0);
    let steps = claims.chunk_by(|a, b| a.0 == b.0).map(|tied| {
        let hits = tied.iter().filter(|c| c.1).count();
        tp += hits as f64;
        fp += (tied.len() - hits) as f64;
        (fp / images.len() as f64, tp / markers)
    });
    area_of_steps(steps)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::{Claim, MarkerIndex};

    fn images() -> Vec<MatchedImage> {
        let claim = |score, verdict| Claim { score, iou: 0.8, side: 20.0, marker: MarkerIndex::new(0), verdict };
        let both = |hit: f64, fp: f64| {
            let mut claims = vec![claim(hit, Verdict::Hit), claim(fp, Verdict::FalsePositive)];
            claims.sort_by(|a, b| b.score.total_cmp(&a.score));
            MatchedImage { markers: 1, claims }
        };
        vec![both(0.9, 0.1), both(0.8, 0.2), both(0.5, 0.7), both(0.4, 0.3)]
    }

    #[test]
    fn area_under_the_steps() {
        // Falling scores: hits .9 .8, fp .7, hits .5 .4, fp .3 .2 .1. A recall of 1/2 up to 1/4, then 1.
        let images = images();
        let scores = Scores::new(&images, &[0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.8, 0.9], 0, 0);
        let (area, interval) = froc_area(&images, &scores).unwrap();
        assert!((area - (0.25 * 0.5 + 0.75)).abs() < 1e-12 && interval.is_none());
        let curve = froc(&scores);
        assert!((curve.points[0][0] - 0.25).abs() < 1e-12 && curve.points[0][1] == 1.0);
    }

    #[test]
    fn precision_is_an_envelope() {
        let scores = Scores::new(&images(), &[0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.8, 0.9], 200, 0);
        let curve = precision_recall(&scores);
        assert!(curve.points.windows(2).all(|w| w[1][1] <= w[0][1]));
        assert!((curve.points.last().unwrap()[1] - 0.8).abs() < 1e-12, "all four found beside one false positive");
        assert!(!curve.band.is_empty() && curve.band.iter().all(|b| b[1] <= b[2]));
    }
}
