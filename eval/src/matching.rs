//! One matching of detections to markers, from which every number of the paper's protocol follows.
//!
//! The rule, quoted: a detection with IoU < 0.2 with the image's marker is a false positive; of several detections with
//! IoU >= 0.2 on one marker the best counts and the rest are neither false nor true positives; a marker without a
//! detection, or whose best IoU is below 0.2, is a false negative; the mean IoU takes a marker's best IoU as it is, and 0
//! where there is no detection.
//!
//! With several markers an image, detections are taken by falling score, each to the marker not yet found that it overlaps
//! most. Which marker a detection belongs to then depends on detections of higher score only, so one matching serves
//! every threshold, and with one marker an image it is the rule above exactly.
use crate::config::{Config, IouKind};
use std::num::NonZeroU16;
use tcross_dataset::{
    Detection, Marker, PixelBox,
    geom::boxes::{iou, iou_inclusive},
};

/// What became of a detection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// The first to find its marker.
    Hit,
    /// A further one on a marker already found: neither a true nor a false positive.
    Duplicate,
    /// Overlaps no marker enough.
    FalsePositive,
    /// Counts neither way, since what it is about is left out, such as markers below a least size.
    Ignored,
}

/// Index of a marker in its record. `Option<MarkerIndex>` is two bytes: claims are what memory is spent on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MarkerIndex(NonZeroU16);

impl MarkerIndex {
    /// The most markers of one image.
    pub const MOST: usize = u16::MAX as usize;

    /// Of a marker's position in its record; `None` from [`Self::MOST`] on.
    #[must_use]
    pub fn new(position: usize) -> Option<Self> {
        u16::try_from(position).ok()?.checked_add(1).and_then(NonZeroU16::new).map(Self)
    }

    /// The position.
    #[must_use]
    pub fn get(self) -> usize {
        usize::from(self.0.get()) - 1
    }
}

/// A detection after matching.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Claim {
    /// As detected, 0..1.
    pub score: f64,
    /// With `marker`; 0 without one.
    pub iou: f64,
    /// The shorter side of its box in pixels, `max - min`.
    pub side: f32,
    /// Index of the marker it belongs to; of a false positive the one it overlaps most, if it overlaps any.
    pub marker: Option<MarkerIndex>,
    /// What became of it.
    pub verdict: Verdict,
}

/// What the matching needs to know.
#[derive(Debug, Clone, PartialEq)]
pub struct Rule {
    /// Overlap below which a detection is a false positive.
    pub min_iou: f64,
    /// How overlap is measured.
    pub iou: IouKind,
    /// Names of the classes; empty: all are one.
    pub classes: Vec<String>,
}

impl From<&Config> for Rule {
    fn from(config: &Config) -> Self {
        Self { min_iou: config.min_iou, iou: config.iou, classes: config.classes.clone() }
    }
}

impl Default for Rule {
    fn default() -> Self {
        Self::from(&Config::default())
    }
}

impl Rule {
    /// Overlap of two boxes by this rule.
    #[must_use]
    pub fn overlap(&self, a: &PixelBox, b: &PixelBox) -> f64 {
        match self.iou {
            IouKind::Inclusive => iou_inclusive(a, b),
            IouKind::Continuous => iou(a, b),
        }
    }

    /// The class of a marker: 0 where classes are not told apart, `None` for a shape that no class names.
    #[must_use]
    pub fn class_of(&self, marker: &Marker) -> Option<u32> {
        if self.classes.is_empty() { Some(0) } else { self.classes.iter().position(|c| *c == marker.shape).map(|k| k as u32) }
    }

    /// The class of a detection: 0 where classes are not told apart.
    #[must_use]
    pub fn class_of_detection(&self, detection: &Detection) -> u32 {
        if self.classes.is_empty() { 0 } else { detection.class }
    }
}

/// Indices of detections by falling score; those of equal score keep their order.
#[must_use]
pub fn by_falling_score(detections: &[Detection]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..detections.len()).collect();
    // Adding 0 turns -0 into 0, so that the two are equal here as everywhere else.
    order.sort_by(|&a, &b| (detections[b].score + 0.0).total_cmp(&(detections[a].score + 0.0)));
    order
}

/// Matches the detections of one image to its markers. Claims come by falling score, as [`by_falling_score`] orders them.
#[must_use]
pub fn match_image(markers: &[Marker], detections: &[Detection], rule: &Rule) -> Vec<Claim> {
    let mut found = vec![false; markers.len()];
    let classes: Vec<Option<u32>> = markers.iter().map(|m| rule.class_of(m)).collect();
    let claim = |k: usize| {
        let detection = &detections[k];
        let class = Some(rule.class_of_detection(detection));
        // The marker it overlaps most, and the same among those not yet found; of equals the first.
        let (mut best, mut open) = ((0.0, None), (0.0, None));
        for (m, marker) in markers.iter().enumerate().filter(|(m, _)| classes[*m] == class) {
            let overlap = rule.overlap(&detection.bounds, &marker.bounds);
            if overlap > best.0 {
                best = (overlap, Some(m));
            }
            if overlap > open.0 && !found[m] {
                open = (overlap, Some(m));
            }
        }
        let ((iou, marker), verdict) = if open.0 >= rule.min_iou {
            (open, Verdict::Hit)
        } else if best.0 >= rule.min_iou {
            (best, Verdict::Duplicate)
        } else {
            (best, Verdict::FalsePositive)
        };
        if let (Verdict::Hit, Some(m)) = (verdict, marker) {
            found[m] = true;
        }
        let side = detection.bounds.width().min(detection.bounds.height()) as f32;
        Claim { score: detection.score, iou, side, marker: marker.and_then(MarkerIndex::new), verdict }
    };
    by_falling_score(detections).into_iter().map(claim).collect()
}

/// What one image adds at one threshold.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Tally {
    /// Markers found.
    pub tp: u64,
    /// False positives.
    pub fp: u64,
    /// Further detections of found markers.
    pub duplicates: u64,
    /// Sum over markers of the best IoU.
    pub iou: f64,
}

/// The tallies of one image at every threshold (rising), in one pass over its claims (falling score).
#[must_use]
pub fn tally(claims: &[Claim], markers: usize, thresholds: &[f64]) -> Vec<Tally> {
    let mut best = vec![0.0f64; markers];
    let mut now = Tally::default();
    let mut out = vec![now; thresholds.len()];
    let mut next = claims.iter().peekable();
    for (slot, threshold) in out.iter_mut().zip(thresholds).rev() {
        while let Some(claim) = next.next_if(|c| c.score >= *threshold) {
            match claim.verdict {
                Verdict::Hit => now.tp += 1,
                Verdict::Duplicate => now.duplicates += 1,
                Verdict::FalsePositive => now.fp += 1,
                Verdict::Ignored => {}
            }
            if let Some(best) = claim.marker.and_then(|m| best.get_mut(m.get())) {
                now.iou += (claim.iou - *best).max(0.0);
                *best = best.max(claim.iou);
            }
        }
        *slot = now;
    }
    out
}

#[cfg(test)]
mod reference {
    //! The paper's rule for one marker an image, word for word.
    use super::*;

    /// Several markers: the pairs of the whole image by falling score of the detection, then by falling IoU, then by the
    /// marker's place; each pair is taken if both are free. (TP, FP, duplicates) at a threshold.
    pub fn several(markers: &[Marker], detections: &[Detection], threshold: f64) -> (u64, u64, u64) {
        let mut pairs: Vec<(usize, usize, f64)> = Vec::new();
        for (d, detection) in detections.iter().enumerate().filter(|(_, d)| d.score >= threshold) {
            let over = |m: &Marker| iou_inclusive(&detection.bounds, &m.bounds);
            pairs.extend(markers.iter().enumerate().map(|(m, marker)| (d, m, over(marker))).filter(|p| p.2 >= 0.2));
        }
        let score = |p: &(usize, usize, f64)| detections[p.0].score;
        pairs.sort_by(|a, b| score(b).total_cmp(&score(a)).then(a.0.cmp(&b.0)).then(b.2.total_cmp(&a.2)).then(a.1.cmp(&b.1)));
        let (mut taken, mut found) = (vec![false; detections.len()], vec![false; markers.len()]);
        for (d, m, _) in &pairs {
            if !taken[*d] && !found[*m] {
                (taken[*d], found[*m]) = (true, true);
            }
        }
        let kept = detections.iter().filter(|d| d.score >= threshold).count();
        let touching = (0..detections.len()).filter(|d| pairs.iter().any(|p| p.0 == *d)).count();
        let tp = found.iter().filter(|f| **f).count();
        (tp as u64, (kept - touching) as u64, (touching - tp) as u64)
    }

    pub fn one_marker(marker: &Marker, detections: &[Detection], threshold: f64) -> Tally {
        let ious: Vec<f64> = detections.iter().filter(|d| d.score >= threshold).map(|d| iou_inclusive(&d.bounds, &marker.bounds)).collect();
        let hits = ious.iter().filter(|i| **i >= 0.2).count() as u64;
        let best = ious.iter().copied().fold(0.0, f64::max);
        Tally { tp: hits.min(1), fp: ious.len() as u64 - hits, duplicates: hits.saturating_sub(1), iou: best }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tcross_dataset::Rng;

    fn marker(b: [f64; 4]) -> Marker {
        Marker::from_box("t_cross", b.into())
    }

    fn detection(score: f64, b: [f64; 4]) -> Detection {
        Detection { score, class: 0, bounds: b.into(), pose: None }
    }

    #[test]
    fn one_marker_an_image_is_the_papers_rule() {
        let thresholds = Config::default().thresholds;
        for item in 0..2000 {
            let mut rng = Rng::for_item(3, "eval/test", item);
            let mut draw = |side: i64| {
                let (x, y) = (rng.int(0, 30) as f64, rng.int(0, 30) as f64);
                [x, y, x + rng.int(0, side) as f64, y + rng.int(0, side) as f64]
            };
            let truth = marker(draw(30));
            let boxes: Vec<_> = (0..6).map(|_| draw(40)).collect();
            let mut detections: Vec<_> = boxes.into_iter().map(|b| detection(rng.int(0, 20) as f64 / 20.0, b)).collect();
            detections.truncate(rng.index(7));
            let claims = match_image(std::slice::from_ref(&truth), &detections, &Rule::default());
            for (got, t) in tally(&claims, 1, &thresholds).iter().zip(&thresholds) {
                let want = reference::one_marker(&truth, &detections, *t);
                assert!((got.iou - want.iou).abs() < 1e-12, "{got:?} {want:?}");
                assert_eq!(Tally { iou: want.iou, ..*got }, want);
            }
        }
    }

    #[test]
    fn several_markers_an_image_are_matched_as_by_lists_of_pairs() {
        for item in 0..1000 {
            let mut rng = Rng::for_item(4, "eval/test/several", item);
            let mut draw = |n: usize, side: i64| -> Vec<[f64; 4]> {
                (0..rng.index(n))
                    .map(|_| {
                        let (x, y) = (rng.int(0, 40) as f64, rng.int(0, 40) as f64);
                        [x, y, x + rng.int(0, side) as f64, y + rng.int(0, side) as f64]
                    })
                    .collect()
            };
            let markers: Vec<Marker> = draw(5, 30).into_iter().map(marker).collect();
            let boxes = draw(10, 40);
            let detections: Vec<Detection> = boxes.into_iter().map(|b| detection(rng.int(0, 10) as f64 / 10.0, b)).collect();
            let claims = match_image(&markers, &detections, &Rule::default());
            for threshold in [0.0, 0.25, 0.5, 0.75] {
                let got = tally(&claims, markers.len(), &[threshold])[0];
                assert_eq!((got.tp, got.fp, got.duplicates), reference::several(&markers, &detections, threshold), "image {item}");
            }
        }
    }

    #[test]
    fn two_markers_are_found_once_each() {
        let markers = [marker([0.0, 0.0, 9.0, 9.0]), marker([6.0, 0.0, 15.0, 9.0])];
        let detections = [
            detection(0.9, [1.0, 0.0, 10.0, 9.0]),    // nearer the first
            detection(0.8, [2.0, 0.0, 11.0, 9.0]),    // nearer the first too, but that is found: takes the second
            detection(0.7, [0.0, 0.0, 9.0, 9.0]),     // a duplicate that sits better
            detection(0.6, [40.0, 40.0, 50.0, 50.0]), // nothing there
        ];
        let claims = match_image(&markers, &detections, &Rule::default());
        let verdicts: Vec<_> = claims.iter().map(|c| (c.verdict, c.marker.map(MarkerIndex::get))).collect();
        use Verdict::{Duplicate, FalsePositive, Hit};
        assert_eq!(verdicts, [(Hit, Some(0)), (Hit, Some(1)), (Duplicate, Some(0)), (FalsePositive, None)]);
        let all = tally(&claims, 2, &[0.0])[0];
        assert_eq!((all.tp, all.fp, all.duplicates), (2, 1, 1));
        assert!((all.iou - (1.0 + claims[1].iou)).abs() < 1e-12, "the duplicate's better box counts for the mean");
    }

    #[test]
    fn a_claim_takes_24_bytes() {
        assert_eq!(size_of::<Claim>(), 24);
        assert_eq!(MarkerIndex::new(MarkerIndex::MOST - 1).map(MarkerIndex::get), Some(MarkerIndex::MOST - 1));
        assert_eq!(MarkerIndex::new(MarkerIndex::MOST), None);
    }

    #[test]
    fn classes_are_kept_apart_where_named() {
        let rule = Rule { classes: vec!["t_cross".into(), "star".into()], ..Rule::default() };
        let b = [0.0, 0.0, 9.0, 9.0];
        let claims = match_image(&[marker(b)], &[Detection { class: 1, ..detection(0.9, b) }, detection(0.8, b)], &rule);
        assert_eq!(claims.iter().map(|c| c.verdict).collect::<Vec<_>>(), [Verdict::FalsePositive, Verdict::Hit]);
    }
}
