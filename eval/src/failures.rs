//! Where a detector fails: four kinds of error, told apart by overlap.
use crate::{
    evaluation::Evaluation,
    matching::{MarkerIndex, Verdict, by_falling_score},
    truth::Truth,
};
use serde::Serialize;
use tcross_dataset::PixelBox;

/// A kind of error.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// A marker that no detection overlaps enough.
    Missed,
    /// A detection where no marker is (IoU below 0.05 with every marker).
    Background,
    /// A further detection of a marker already found.
    Duplicate,
    /// A detection that overlaps a marker, but badly: a false positive with IoU of 0.05 or more, or a found marker whose
    /// best IoU is below 0.5.
    Misplaced,
}

impl Kind {
    /// All four.
    pub const ALL: [Self; 4] = [Self::Missed, Self::Background, Self::Duplicate, Self::Misplaced];

    /// As a folder's name.
    #[must_use]
    pub fn key(self) -> &'static str {
        match self {
            Self::Missed => "missed",
            Self::Background => "background",
            Self::Duplicate => "duplicate",
            Self::Misplaced => "misplaced",
        }
    }

    /// As a heading.
    #[must_use]
    pub fn title(self) -> &'static str {
        match self {
            Self::Missed => "Missed: markers without a detection",
            Self::Background => "Background: detections where no marker is",
            Self::Duplicate => "Duplicate: further detections of a found marker (not counted as false)",
            Self::Misplaced => "Poorly placed: overlap below 0.5",
        }
    }
}

const TOUCHING: f64 = 0.05;
const WELL_PLACED: f64 = 0.5;

/// One error.
#[derive(Debug, Clone, PartialEq)]
pub struct Failure {
    /// Its kind.
    pub kind: Kind,
    /// Index of the record.
    pub image: usize,
    /// The marker's box, where one is involved.
    pub truth: Option<PixelBox>,
    /// The detection's position by falling score, where one is involved.
    pub claim: Option<usize>,
    /// Its score.
    pub score: Option<f64>,
    /// Its overlap.
    pub iou: f64,
}

/// Every error at a threshold, by kind; within a kind the gravest first: the largest missed marker, the most certain false
/// detection, the worst overlap.
#[must_use]
pub fn failures(truth: &Truth, evaluation: &Evaluation, threshold: f64) -> Vec<Failure> {
    let mut out = Vec::new();
    visit(truth, evaluation, threshold, |failure| out.push(failure));
    let gravity = |f: &Failure| match f.kind {
        Kind::Missed => f.truth.map_or(0.0, |b| b.width().min(b.height())),
        Kind::Background | Kind::Duplicate => f.score.unwrap_or(0.0),
        Kind::Misplaced => -f.iou,
    };
    out.sort_by(|a, b| a.kind.cmp(&b.kind).then(gravity(b).total_cmp(&gravity(a))).then(a.image.cmp(&b.image)));
    out
}

/// How many errors of each kind there are, in the order of [`Kind::ALL`].
#[must_use]
pub fn count(truth: &Truth, evaluation: &Evaluation, threshold: f64) -> [(Kind, u64); 4] {
    let mut counts = Kind::ALL.map(|kind| (kind, 0));
    visit(truth, evaluation, threshold, |failure| counts[failure.kind as usize].1 += 1);
    counts
}

/// Hands over every error, in order of the truth.
fn visit(truth: &Truth, evaluation: &Evaluation, threshold: f64, mut take: impl FnMut(Failure)) {
    for (image, matched) in evaluation.images.iter().enumerate() {
        let markers = &truth.records[image].markers;
        let kept = matched.claims.iter().take_while(|c| c.score >= threshold);
        let mut best: Vec<Option<(f64, usize, f64)>> = vec![None; markers.len()];
        let mut found = vec![false; markers.len()];
        for (k, claim) in kept.enumerate() {
            let marker = claim.marker.map(MarkerIndex::get);
            let failure = |kind| Failure {
                kind,
                image,
                truth: marker.map(|m| markers[m].bounds),
                claim: Some(k),
                score: Some(claim.score),
                iou: claim.iou,
            };
            match claim.verdict {
                Verdict::Duplicate => take(failure(Kind::Duplicate)),
                Verdict::FalsePositive if claim.iou < TOUCHING => take(Failure { truth: None, ..failure(Kind::Background) }),
                Verdict::FalsePositive => take(failure(Kind::Misplaced)),
                Verdict::Hit | Verdict::Ignored => {}
            }
            if let Some(m) = marker {
                found[m] |= claim.verdict == Verdict::Hit;
                if best[m].is_none_or(|b| claim.iou > b.0) {
                    best[m] = Some((claim.iou, k, claim.score));
                }
            }
        }
        for (m, marker) in markers.iter().enumerate() {
            let truth = Some(marker.bounds);
            match (found[m], best[m]) {
                (false, _) => take(Failure { kind: Kind::Missed, image, truth, claim: None, score: None, iou: 0.0 }),
                (true, Some((iou, k, score))) if iou < WELL_PLACED => {
                    take(Failure { kind: Kind::Misplaced, image, truth, claim: Some(k), score: Some(score), iou });
                }
                _ => {}
            }
        }
    }
}

/// The box of the claim of a failure, read again from the detections.
#[must_use]
pub fn claimed_box(evaluation: &Evaluation, failure: &Failure) -> Option<PixelBox> {
    let detections = evaluation.located.detections(failure.image);
    let order = by_falling_score(&detections);
    Some(detections[*order.get(failure.claim?)?].bounds)
}
