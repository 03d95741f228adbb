//! Do scores tell the truth? Of detections with a score near 0.8 about 80 % should be right.
use crate::{
    interval::{Interval, wilson},
    matching::Verdict,
    protocol::paper::MatchedImage,
};
use rayon::prelude::*;
use serde::Serialize;

/// Detections of similar score. Duplicates are left out: the protocol counts them neither way.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Bin {
    /// Mean score.
    pub score: f64,
    /// Fraction that found a marker.
    pub right: f64,
    /// 95 %, Wilson.
    pub right_ci: Interval,
    /// How many.
    pub detections: u64,
}

/// Reliability of the scores.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Calibration {
    /// Expected calibration error: mean over detections of |score - fraction right| of their bin.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ece: Option<f64>,
    /// Ten bins of equal width, those that hold anything.
    pub bins: Vec<Bin>,
}

/// Detections, right ones and sum of scores, a bin.
type Sums = [(u64, u64, f64); 10];

fn add_up(images: &[MatchedImage]) -> Sums {
    let mut sums = Sums::default();
    for claim in images.iter().flat_map(|i| &i.claims).filter(|c| matches!(c.verdict, Verdict::Hit | Verdict::FalsePositive)) {
        let (n, right, score) = &mut sums[((claim.score * 10.0) as usize).min(9)];
        *n += 1;
        *right += u64::from(claim.verdict == Verdict::Hit);
        *score += claim.score;
    }
    sums
}

/// Bins every detection of the file by its score.
#[must_use]
pub fn calibration(images: &[MatchedImage]) -> Calibration {
    // Chunks of fixed length, added in order: the same on any number of threads.
    let chunks: Vec<Sums> = images.par_chunks(1024).map(add_up).collect();
    let mut sums = Sums::default();
    for (bin, part) in chunks.iter().flat_map(|chunk| chunk.iter().enumerate()) {
        let sum = &mut sums[bin];
        *sum = (sum.0 + part.0, sum.1 + part.1, sum.2 + part.2);
    }
    let all: u64 = sums.iter().map(|s| s.0).sum();
    let bin = |&(n, right, score): &(u64, u64, f64)| {
        Some(Bin { score: score / n as f64, right: right as f64 / n as f64, right_ci: wilson(right, n)?, detections: n })
    };
    let bins: Vec<Bin> = sums.iter().filter_map(bin).collect();
    let error = bins.iter().map(|b| b.detections as f64 * (b.score - b.right).abs()).sum::<f64>();
    Calibration { ece: (all > 0).then(|| error / all as f64), bins }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::{Claim, MarkerIndex};

    #[test]
    fn scores_that_are_right_as_often_as_they_say_have_no_error() {
        let image = |score: f64, hits: usize, misses: usize| {
            let claim = |verdict| Claim { score, iou: 0.5, side: 20.0, marker: MarkerIndex::new(0), verdict };
            let claims = [vec![claim(Verdict::Hit); hits], vec![claim(Verdict::FalsePositive); misses]].concat();
            MatchedImage { markers: hits as u32, claims }
        };
        let honest = calibration(&[image(0.75, 3, 1), image(0.5, 2, 2), image(1.0, 5, 0)]);
        assert!(honest.ece.unwrap() < 1e-12 && honest.bins.len() == 3);
        let boastful = calibration(&[image(0.95, 1, 1)]);
        assert!((boastful.ece.unwrap() - 0.45).abs() < 1e-12);
        assert_eq!(calibration(&[]).ece, None);
    }
}
