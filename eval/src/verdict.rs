//! Is a number above, within or below the paper's, given the uncertainty of both?
use crate::{
    interval::{Z95, wilson},
    paper_tables::PaperRow,
    protocol::paper::Row,
};
use serde::Serialize;

/// How our value stands to the paper's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Significantly higher.
    Above,
    /// The difference may be chance.
    Within,
    /// Significantly lower.
    Below,
}

impl Verdict {
    /// As written in tables.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Above => "above",
            Self::Within => "within",
            Self::Below => "below",
        }
    }

    /// True where this is good, for a quantity of which more is better or worse; `None` within.
    #[must_use]
    pub fn is_good(self, more_is_better: bool) -> Option<bool> {
        match self {
            Self::Within => None,
            Self::Above => Some(more_is_better),
            Self::Below => Some(!more_is_better),
        }
    }

    fn of(lo: f64, hi: f64) -> Self {
        if lo > 0.0 {
            Self::Above
        } else if hi < 0.0 {
            Self::Below
        } else {
            Self::Within
        }
    }
}

/// Ours against the paper's: rates by Newcombe's interval of the difference of two proportions, built from both Wilson
/// intervals. `None` where a rate is undefined.
#[must_use]
pub fn rates((hits, trials): (u64, u64), (paper_hits, paper_trials): (u64, u64)) -> Option<Verdict> {
    let ([l1, u1], [l2, u2]) = (wilson(hits, trials)?, wilson(paper_hits, paper_trials)?);
    let (p1, p2) = (hits as f64 / trials as f64, paper_hits as f64 / paper_trials as f64);
    let lo = p1 - p2 - ((p1 - l1).powi(2) + (u2 - p2).powi(2)).sqrt();
    let hi = p1 - p2 + ((u1 - p1).powi(2) + (p2 - l2).powi(2)).sqrt();
    Some(Verdict::of(lo, hi))
}

/// Ours against the paper's false positives an image, both taken as Poisson counts (half a count is added, so that none is
/// not taken for certainty).
#[must_use]
pub fn counts_per_image((count, images): (u64, u64), (paper_count, paper_images): (u64, u64)) -> Option<Verdict> {
    if images == 0 || paper_images == 0 {
        return None;
    }
    let rate = |c: u64, n: u64| (c as f64 / n as f64, (c as f64 + 0.5) / (n as f64).powi(2));
    let ((r1, v1), (r2, v2)) = (rate(count, images), rate(paper_count, paper_images));
    let half = Z95 * (v1 + v2).sqrt();
    Some(Verdict::of(r1 - r2 - half, r1 - r2 + half))
}

/// Ours against the paper's mean IoU. The paper does not tell the spread of its IoUs; it is taken to be ours, over its own
/// number of markers.
#[must_use]
pub fn mean_iou(row: &Row, markers: u64, paper: &PaperRow) -> Option<Verdict> {
    let (mean, [lo, hi]) = (row.mean_iou?, row.mean_iou_ci?);
    let half = (hi - lo) / 2.0;
    let both = half * (1.0 + markers as f64 / paper.markers as f64).sqrt();
    Some(Verdict::of(mean - paper.mean_iou - both, mean - paper.mean_iou + both))
}

/// The verdict of every cell of a row.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RowVerdict {
    /// Of the mean IoU.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mean_iou: Option<Verdict>,
    /// Of false positives an image.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fp: Option<Verdict>,
    /// Of the fraction of markers missed.
    #[serde(rename = "fn", skip_serializing_if = "Option::is_none")]
    pub fn_: Option<Verdict>,
    /// Of precision.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub precision: Option<Verdict>,
    /// Of recall.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recall: Option<Verdict>,
}

impl RowVerdict {
    /// Our row, over `images` images, against the paper's (one marker an image).
    #[must_use]
    pub fn new(row: &Row, images: u64, paper: &PaperRow) -> Self {
        let markers = row.tp + row.fn_;
        Self {
            mean_iou: mean_iou(row, markers, paper),
            fp: counts_per_image((row.fp, images), (paper.fp, paper.markers)),
            fn_: rates((row.fn_, markers), (paper.fn_, paper.markers)),
            precision: rates((row.tp, row.tp + row.fp), (paper.tp(), paper.tp() + paper.fp)),
            recall: rates((row.tp, markers), (paper.tp(), paper.markers)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn newcombes_example() {
        // Newcombe 1998, comparison (a): 56/70 - 48/80 has the 95 % interval 0.0524 to 0.3339 (method 10).
        assert_eq!(rates((56, 70), (48, 80)), Some(Verdict::Above));
        assert_eq!(rates((48, 80), (56, 70)), Some(Verdict::Below));
        // (b): 9/10 - 3/10: 0.1705 to 0.8090; (c): 6/7 - 2/7: 0.0582 to 0.8062; (d): 5/56 - 0/29: -0.0381 to 0.1926.
        assert_eq!(rates((9, 10), (3, 10)), Some(Verdict::Above));
        assert_eq!(rates((5, 56), (0, 29)), Some(Verdict::Within));
        assert_eq!(rates((0, 0), (5, 9)), None);
    }

    #[test]
    fn words_say_which_way_is_good() {
        assert_eq!(counts_per_image((90, 1079), (5, 1079)), Some(Verdict::Above));
        assert_eq!((Verdict::Above.word(), Verdict::Above.is_good(false)), ("above", Some(false)));
        assert_eq!(counts_per_image((3, 1079), (5, 1079)), Some(Verdict::Within));
    }
}
