//! The paper's six metrics over the threshold, with intervals.
use crate::{
    bootstrap::Bootstrap,
    interval::{Interval, wilson},
    matching::{Claim, Tally, tally},
};
use serde::Serialize;
use std::borrow::Cow;

/// Counts over a set of images at one threshold.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Counts {
    /// All markers.
    pub markers: u64,
    /// Markers found.
    pub tp: u64,
    /// False positives.
    pub fp: u64,
    /// Further detections of found markers, which count neither way.
    pub duplicates: u64,
    /// Sum over markers of the best IoU.
    pub iou: f64,
}

impl Counts {
    /// Markers not found.
    #[must_use]
    pub fn fn_(&self) -> u64 {
        self.markers - self.tp
    }

    /// Mean over markers of the best IoU, misses as 0; `None` without a marker.
    #[must_use]
    pub fn mean_iou(&self) -> Option<f64> {
        (self.markers > 0).then(|| self.iou / self.markers as f64)
    }

    /// TP / (TP + FP); `None` where nothing was claimed.
    #[must_use]
    pub fn precision(&self) -> Option<f64> {
        (self.tp + self.fp > 0).then(|| self.tp as f64 / (self.tp + self.fp) as f64)
    }

    /// TP / (TP + FN); `None` without a marker.
    #[must_use]
    pub fn recall(&self) -> Option<f64> {
        (self.markers > 0).then(|| self.tp as f64 / self.markers as f64)
    }

    /// 100 FN / markers; `None` without a marker.
    #[must_use]
    pub fn percent_fn(&self) -> Option<f64> {
        (self.markers > 0).then(|| 100.0 * self.fn_() as f64 / self.markers as f64)
    }

    /// 2 TP / (2 TP + FP + FN); `None` where there is neither a marker nor a claim.
    #[must_use]
    pub fn f1(&self) -> Option<f64> {
        let all = self.tp + self.fp + self.markers;
        (all > 0).then(|| 2.0 * self.tp as f64 / all as f64)
    }

    /// Adds one image.
    pub fn add(&mut self, markers: u64, tally: &Tally) {
        self.markers += markers;
        self.tp += tally.tp;
        self.fp += tally.fp;
        self.duplicates += tally.duplicates;
        self.iou += tally.iou;
    }

    /// Adds other images.
    fn append(&mut self, other: &Self) {
        self.markers += other.markers;
        self.tp += other.tp;
        self.fp += other.fp;
        self.duplicates += other.duplicates;
        self.iou += other.iou;
    }
}

/// The metrics at one threshold. What is undefined is absent.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// A detection is kept where its score >= threshold.
    pub threshold: f64,
    /// Mean over markers of the best IoU, misses as 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mean_iou: Option<f64>,
    /// Markers found.
    pub tp: u64,
    /// False positives.
    pub fp: u64,
    /// Markers not found.
    #[serde(rename = "fn")]
    pub fn_: u64,
    /// Further detections of found markers.
    pub duplicates: u64,
    /// 100 FN / markers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub percent_fn: Option<f64>,
    /// TP / (TP + FP).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub precision: Option<f64>,
    /// TP / (TP + FN).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recall: Option<f64>,
    /// Harmonic mean of precision and recall.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub f1: Option<f64>,
    /// 95 %, bootstrap over images.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mean_iou_ci: Option<Interval>,
    /// 95 %, Wilson.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub precision_ci: Option<Interval>,
    /// 95 %, Wilson.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recall_ci: Option<Interval>,
    /// 95 %, bootstrap over images.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub f1_ci: Option<Interval>,
}

impl Row {
    fn new(threshold: f64, counts: &Counts) -> Self {
        Self {
            threshold,
            mean_iou: counts.mean_iou(),
            tp: counts.tp,
            fp: counts.fp,
            fn_: counts.fn_(),
            duplicates: counts.duplicates,
            percent_fn: counts.percent_fn(),
            precision: counts.precision(),
            recall: counts.recall(),
            f1: counts.f1(),
            mean_iou_ci: None,
            precision_ci: wilson(counts.tp, counts.tp + counts.fp),
            recall_ci: wilson(counts.tp, counts.markers),
            f1_ci: None,
        }
    }
}

/// One image after matching.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MatchedImage {
    /// How many markers it has.
    pub markers: u32,
    /// By falling score.
    pub claims: Vec<Claim>,
}

/// Counts at every threshold (rising) over all images, and the draws that give them their uncertainty.
#[derive(Debug, Clone)]
pub struct Scores {
    /// How many images.
    pub images: u64,
    /// Images without a marker.
    pub empty_images: u64,
    /// Rising.
    pub thresholds: Vec<f64>,
    /// One a threshold.
    pub counts: Vec<Counts>,
    /// One a threshold: false positives on images without a marker.
    pub fp_on_empty: Vec<u64>,
    draws: Bootstrap,
}

/// What a block of images adds.
#[derive(Default)]
struct Sums {
    empty_images: u64,
    /// One a threshold: all counts, and false positives on images without a marker.
    counts: Vec<(Counts, u64)>,
}

/// Columns of a draw: per threshold found markers, false positives, IoU; then markers and images.
struct Columns(usize);

impl Columns {
    fn width(&self) -> usize {
        3 * self.0 + 2
    }
}

/// What a bootstrap draw says at one threshold.
#[derive(Debug, Clone, Copy)]
pub struct Drawn {
    /// Markers found.
    pub tp: f64,
    /// False positives.
    pub fp: f64,
    /// Sum of best IoUs.
    pub iou: f64,
    /// Markers.
    pub markers: f64,
    /// Images.
    pub images: f64,
}

impl Scores {
    /// Counts everything once; `draws` bootstrap draws over images.
    #[must_use]
    pub fn new(images: &[MatchedImage], thresholds: &[f64], draws: usize, seed: u64) -> Self {
        Self::from_fn(images.len(), |i| Cow::Borrowed(&images[i]), thresholds, draws, seed)
    }

    /// The same of images that are made one at a time.
    #[must_use]
    pub fn from_fn<'a>(
        images: usize,
        image: impl Fn(usize) -> Cow<'a, MatchedImage> + Sync,
        thresholds: &[f64],
        draws: usize,
        seed: u64,
    ) -> Self {
        let n = thresholds.len();
        let fill = |i: usize, row: &mut [f32], sums: &mut Sums| {
            let image = image(i);
            sums.counts.resize(n, (Counts::default(), 0));
            for (k, t) in tally(&image.claims, image.markers as usize, thresholds).iter().enumerate() {
                sums.counts[k].0.add(u64::from(image.markers), t);
                sums.counts[k].1 += if image.markers == 0 { t.fp } else { 0 };
                row[k] += t.tp as f32;
                row[n + k] += t.fp as f32;
                row[2 * n + k] += t.iou as f32;
            }
            sums.empty_images += u64::from(image.markers == 0);
            row[3 * n] += image.markers as f32;
            row[3 * n + 1] += 1.0;
        };
        let (bootstrap, blocks) = Bootstrap::with_sums(images, Columns(n).width(), draws, seed, fill);
        let mut scores = Self {
            images: images as u64,
            empty_images: 0,
            thresholds: thresholds.to_vec(),
            counts: vec![Counts::default(); n],
            fp_on_empty: vec![0; n],
            draws: bootstrap,
        };
        for block in blocks {
            scores.empty_images += block.empty_images;
            for (k, (counts, fp_on_empty)) in block.counts.iter().enumerate() {
                scores.counts[k].append(counts);
                scores.fp_on_empty[k] += fp_on_empty;
            }
        }
        scores
    }

    /// Markers of all images.
    #[must_use]
    pub fn markers(&self) -> u64 {
        self.counts.first().map_or(0, |c| c.markers)
    }

    /// 95 % of a quantity at threshold number `k`.
    pub fn interval(&self, k: usize, quantity: impl Fn(Drawn) -> f64) -> Option<Interval> {
        self.draws.interval(|sums| quantity(self.drawn(sums, k)))
    }

    /// A quantity at threshold number `k` of every draw.
    pub fn values(&self, k: usize, quantity: impl Fn(Drawn) -> f64) -> Vec<f64> {
        self.draws.values(|sums| quantity(self.drawn(sums, k)))
    }

    /// 95 % of a quantity that needs every threshold: it is given a draw's values in their order.
    pub fn interval_of_all(&self, quantity: impl Fn(&[Drawn]) -> f64) -> Option<Interval> {
        self.draws.interval(|sums| quantity(&self.all_drawn(sums)))
    }

    /// Every draw's values at every threshold, transformed.
    pub fn per_draw<T>(&self, transform: impl Fn(&[Drawn]) -> T) -> Vec<T> {
        self.draws.rows().map(|sums| transform(&self.all_drawn(sums))).collect()
    }

    fn all_drawn(&self, sums: &[f32]) -> Vec<Drawn> {
        (0..self.thresholds.len()).map(|k| self.drawn(sums, k)).collect()
    }

    fn drawn(&self, sums: &[f32], k: usize) -> Drawn {
        let n = self.thresholds.len();
        let at = |i: usize| f64::from(sums[i]);
        Drawn { tp: at(k), fp: at(n + k), iou: at(2 * n + k), markers: at(3 * n), images: at(3 * n + 1) }
    }

    /// The table: a row a threshold.
    #[must_use]
    pub fn rows(&self) -> Vec<Row> {
        (0..self.thresholds.len()).map(|k| self.row(k)).collect()
    }

    /// Row number `k` with its intervals.
    #[must_use]
    pub fn row(&self, k: usize) -> Row {
        let mut row = Row::new(self.thresholds[k], &self.counts[k]);
        row.mean_iou_ci = self.interval(k, |d| d.iou / d.markers);
        row.f1_ci = self.interval(k, |d| 2.0 * d.tp / (d.tp + d.fp + d.markers));
        row
    }

    /// The position of a threshold, which must be one of `thresholds`.
    #[must_use]
    pub fn position(&self, threshold: f64) -> Option<usize> {
        self.thresholds.iter().position(|t| (t - threshold).abs() < 1e-12)
    }
}
