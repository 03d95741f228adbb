//! Losses over raw logits, in plain Rust: the terms to log, and the gradient of each logit.
//!
//! Training reads the heads back, asks for the gradient, and calls `(logits * gradient).sum().backward()`: the same code on every device.
pub mod darknet;
pub mod keypoints;
pub mod paper;

use crate::{
    error::YoloError,
    fields::BoxFields,
    geometry::{Geometry, NormBox, Predictor},
    targets::{self, Positive, Truth},
};
use rayon::prelude::*;
use std::path::PathBuf;

/// Which loss.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum LossKind {
    /// Darknet's: cross-entropy on x, y, objectness and classes, squared error on w, h.
    #[default]
    Darknet,
    /// The paper's: squared errors on the box, focal objectness, mix-up weights.
    Paper,
}

/// A loss with its settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Loss {
    /// Which formula.
    pub kind: LossKind,
    /// A predictor that learns no box, but whose box overlaps a truth by more than this, is no negative either.
    pub ignore_iou: f32,
    /// Besides the anchor of best shape, every one whose shape overlaps a truth's by more than this learns it too; 1 for none.
    pub assign_iou: f32,
}

impl Loss {
    /// As Darknet assigns: one anchor a truth.
    #[must_use]
    pub fn new(kind: LossKind, ignore_iou: f32) -> Self {
        Self { kind, ignore_iou, assign_iou: 1.0 }
    }
}

/// The parts of a loss, each summed over cells and heads and divided by the batch.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct LossTerms {
    /// Of x and y.
    pub center: f64,
    /// Of w and h.
    pub size: f64,
    /// Of the objectness.
    pub objectness: f64,
    /// Of the classes.
    pub class: f64,
    /// Of keypoints; 0 where there are none.
    pub keypoints: f64,
}

impl LossTerms {
    /// The sum that training makes small.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.center + self.size + self.objectness + self.class + self.keypoints
    }

    /// The sum of several, each times its weight.
    #[must_use]
    pub fn weighted_sum(all: impl Iterator<Item = (Self, f64)> + Clone) -> Self {
        let sum = |part: fn(&Self) -> f64| all.clone().map(|(terms, weight)| part(&terms) * weight).sum();
        Self {
            center: sum(|t| t.center),
            size: sum(|t| t.size),
            objectness: sum(|t| t.objectness),
            class: sum(|t| t.class),
            keypoints: sum(|t| t.keypoints),
        }
    }
}

/// What a loss says about a batch.
#[derive(Debug, Clone, PartialEq)]
pub struct LossOutput {
    /// The parts.
    pub terms: LossTerms,
    /// The gradient of the total for each head's logits, laid out as they are.
    pub gradients: Vec<Vec<f32>>,
}

impl Loss {
    /// Terms and gradients of a batch: each head's logits `[batch, anchor, field, row, column]`, and the truths of each image.
    /// Images run in parallel; the result does not depend on how many threads there are.
    ///
    /// # Errors
    /// If a truth is out of range, or a head does not have the geometry's number of logits.
    pub fn evaluate(&self, geometry: &Geometry, logits: &[Vec<f32>], truths: &[Vec<Truth>]) -> Result<LossOutput, YoloError> {
        check_lengths(geometry, logits, truths.len())?;
        let share = 1.0 / truths.len().max(1) as f32;
        let mut gradients: Vec<Vec<f32>> = logits.iter().map(|head| vec![0.0; head.len()]).collect();
        let mut images: Vec<ImageLogits> = (0..truths.len()).map(|_| ImageLogits { geometry, share, heads: Vec::new() }).collect();
        for (head, (logits, gradient)) in logits.iter().zip(&mut gradients).enumerate() {
            let length = geometry.head_len(head);
            for (image, pair) in images.iter_mut().zip(logits.chunks_exact(length).zip(gradient.chunks_exact_mut(length))) {
                image.heads.push(pair);
            }
        }
        let terms: Vec<LossTerms> = images
            .par_iter_mut()
            .zip(truths)
            .enumerate()
            .map(|(index, (image, truths))| {
                let positives = targets::assign(geometry, index, truths, self.assign_iou)?;
                let mut terms = match self.kind {
                    LossKind::Darknet => darknet::image(image, truths, &positives, self.ignore_iou),
                    LossKind::Paper => paper::image(image, truths, &positives, self.ignore_iou),
                };
                terms.keypoints = keypoints::image(image, &positives);
                Ok(terms)
            })
            .collect::<Result<_, YoloError>>()?;
        Ok(LossOutput { terms: LossTerms::weighted_sum(terms.iter().map(|t| (*t, f64::from(share)))), gradients })
    }
}

fn check_lengths(geometry: &Geometry, logits: &[Vec<f32>], batch: usize) -> Result<(), YoloError> {
    let wrong = |name: String, expected: usize, found: usize| {
        Err(YoloError::Tensor { path: PathBuf::new(), name, expected: expected.to_string(), found: found.to_string() })
    };
    if logits.len() != geometry.heads.len() {
        return wrong("number of heads".into(), geometry.heads.len(), logits.len());
    }
    match (0..logits.len()).find(|&head| logits[head].len() != batch * geometry.head_len(head)) {
        Some(head) => wrong(format!("logits of head {head}"), batch * geometry.head_len(head), logits[head].len()),
        None => Ok(()),
    }
}

/// One image's logits in each head, and the gradients to be written.
pub(crate) struct ImageLogits<'a> {
    geometry: &'a Geometry,
    /// One over the batch.
    share: f32,
    heads: Vec<(&'a [f32], &'a mut [f32])>,
}

impl ImageLogits<'_> {
    fn logit(&self, at: Predictor, field: usize) -> f32 {
        self.heads[at.head].0[self.geometry.index(at, field)]
    }

    /// Adds a gradient of this image's own loss.
    fn add(&mut self, at: Predictor, field: usize, gradient: f32) {
        let index = self.geometry.index(at, field);
        self.heads[at.head].1[index] += gradient * self.share;
    }

    /// Calls `visit` with every predictor that is to learn that nothing is there: neither positive, nor with a box that overlaps a truth
    /// by more than `ignore_iou`.
    fn each_negative(&mut self, truths: &[Truth], positives: &[Positive], ignore_iou: f32, mut visit: impl FnMut(&mut Self, Predictor)) {
        let geometry = self.geometry;
        for head in 0..geometry.heads.len() {
            let mut taken: Vec<Predictor> = positives.iter().map(|p| p.at).filter(|at| at.head == head).collect();
            taken.sort_by_key(|at| (at.anchor, at.cell));
            let mut taken = taken.into_iter().peekable();
            for at in geometry.predictors(head) {
                let positive = taken.next_if_eq(&at).is_some();
                if !positive && !self.overlaps(at, truths, ignore_iou) {
                    visit(self, at);
                }
            }
        }
    }

    /// Whether a predictor's box overlaps a truth by more than `ignore_iou`.
    fn overlaps(&self, at: Predictor, truths: &[Truth], ignore_iou: f32) -> bool {
        // Two intervals whose centres are d apart, the one t long, overlap by at most t / (t + 2 d), whatever the other's length. A box has
        // its centre in or near its cell, so nearly all cells are too far away, and need no exponentials.
        let reach = (1.0 - ignore_iou) / (2.0 * ignore_iou) + 1e-3;
        let grid = &self.geometry.heads[at.head];
        let (column, row) = ((at.cell % grid.columns) as f32, (at.cell / grid.columns) as f32);
        let half = self.geometry.scale_xy / 2.0;
        let away = |centre: f32, cell: f32, cells: usize| (cell + 0.5 - centre * cells as f32).abs() / cells as f32 - half / cells as f32;
        let near = |b: &NormBox| away(b.x, column, grid.columns) <= reach * b.w && away(b.y, row, grid.rows) <= reach * b.h;
        if !truths.iter().any(|truth| near(&truth.bounds)) {
            return false;
        }
        let bounds: NormBox = self.geometry.decode_box(at, self.geometry.box_logits(at, self.heads[at.head].0));
        truths.iter().any(|truth| bounds.iou(&truth.bounds) > ignore_iou)
    }
}

/// Sigmoid and binary cross-entropy of a logit against a target, without overflow.
fn logistic(logit: f32, target: f32) -> (f32, f32) {
    let e = (-logit.abs()).exp();
    let p = if logit >= 0.0 { 1.0 / (1.0 + e) } else { e / (1.0 + e) };
    (p, logit.max(0.0) - logit * target + e.ln_1p())
}

/// Targets of a positive's class logits: (field, 1 for a class that claimed it, else 0).
fn class_targets<'a>(fields: &BoxFields, positive: &'a Positive) -> impl Iterator<Item = (usize, f32)> + 'a {
    fields.classes().enumerate().map(|(class, field)| (field, if positive.classes.contains(&(class as u32)) { 1.0 } else { 0.0 }))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::{Architecture, ModelConfig, NetSize};
    use tcross_dataset::{PixelBox, Rng};

    pub fn geometry() -> Geometry {
        ModelConfig { classes: 2, keypoints: 1, ..ModelConfig::of(Architecture::YoloV3Tiny) }.geometry(NetSize::square(64))
    }

    /// Two images; the second truth of the first claims the same predictor as the first.
    pub fn batch() -> (Vec<Vec<f32>>, Vec<Vec<Truth>>) {
        let mut rng = Rng::for_item(3, "test/loss", 0);
        let mut logits = |n: usize| (0..n).map(|_| 1.5 * rng.normal() as f32).collect::<Vec<f32>>();
        let geometry = geometry();
        let heads = (0..2).map(|head| logits(2 * geometry.head_len(head))).collect();
        let net = NetSize::square(64);
        let with = |b: [f64; 4], class, weight, keypoints: &[[f32; 2]]| Truth {
            weight,
            keypoints: keypoints.to_vec(),
            ..Truth::from_net_box(&PixelBox::from(b), class, net)
        };
        let truths = vec![
            vec![
                with([10.0, 10.0, 50.0, 60.0], 0, 1.0, &[[0.4, 0.6]]),
                with([12.0, 11.0, 52.0, 60.0], 1, 0.4, &[[0.3, 0.3]]),
                with([1.0, 2.0, 12.0, 17.0], 1, 0.7, &[]),
            ],
            vec![with([30.0, 30.0, 55.0, 52.0], 0, 1.0, &[[0.9, 0.1]])],
        ];
        (heads, truths)
    }

    /// The gradient equals central differences of the total wherever neither side changes what is ignored.
    pub fn check_gradient(loss: Loss) {
        let (geometry, (mut logits, truths)) = (geometry(), batch());
        let analytic = loss.evaluate(&geometry, &logits, &truths).unwrap().gradients;
        let step = 2e-3_f32;
        let mut checked = 0;
        for head in 0..logits.len() {
            for at in 0..logits[head].len() {
                let middle = logits[head][at];
                let mut total = |value: f32| {
                    logits[head][at] = value;
                    loss.evaluate(&geometry, &logits, &truths).unwrap().terms.total()
                };
                let (high, low) = (total(middle + step), total(middle - step));
                logits[head][at] = middle;
                let numeric = (high - low) / (2.0 * f64::from(step));
                let wanted = f64::from(analytic[head][at]);
                assert!((numeric - wanted).abs() < 2e-3 * wanted.abs().max(1.0), "head {head}, logit {at}: {numeric} {wanted}");
                checked += usize::from(wanted != 0.0);
            }
        }
        assert!(checked > 100, "{checked}");
    }

    #[test]
    fn extreme_logits_stay_finite() {
        for logit in [-200.0, -50.0, 0.0, 50.0, 200.0] {
            for target in [0.0, 1.0] {
                let (p, bce) = logistic(logit, target);
                assert!((0.0..=1.0).contains(&p) && bce.is_finite() && bce >= 0.0);
            }
        }
    }

    /// The naive twin of what is ignored: every predictor's box against every truth.
    #[test]
    fn exactly_the_overlapping_are_ignored() {
        [1.0, 2.0].into_iter().for_each(exactly_the_overlapping_are_ignored_at);
    }

    fn exactly_the_overlapping_are_ignored_at(scale_xy: f32) {
        let geometry = Geometry { scale_xy, ..geometry() };
        let mut rng = Rng::for_item(8, "test/ignored", 0);
        let mut ignored = 0;
        for ignore_iou in [0.1, 0.3, 0.5, 0.7] {
            let logits: Vec<Vec<f32>> = (0..2).map(|head| (0..geometry.head_len(head)).map(|_| rng.normal() as f32).collect()).collect();
            let mut side = || rng.uniform(4.0, 60.0);
            let boxes: Vec<PixelBox> = (0..4).map(|_| PixelBox::from_center(side(), side(), side(), side())).collect();
            let truths: Vec<Truth> = boxes.iter().map(|b| Truth::from_net_box(b, 0, geometry.net)).collect();
            let positives = targets::assign(&geometry, 0, &truths, 1.0).unwrap();
            let got = Loss::new(LossKind::Darknet, ignore_iou).evaluate(&geometry, &logits, std::slice::from_ref(&truths)).unwrap();
            for at in (0..2).flat_map(|head| geometry.predictors(head)) {
                let b = geometry.decode_box(at, geometry.box_logits(at, &logits[at.head]));
                let naive = truths.iter().any(|t| b.iou(&t.bounds) > ignore_iou) && positives.iter().all(|p| p.at != at);
                let gradient = got.gradients[at.head][geometry.index(at, BoxFields::OBJECTNESS)];
                assert_eq!(gradient == 0.0, naive, "{at:?} {ignore_iou}");
                ignored += usize::from(naive);
            }
        }
        assert!(ignored > 20, "{ignored}");
    }

    #[test]
    fn one_thread_and_many_agree_to_the_bit() {
        let (geometry, (logits, truths)) = (geometry(), batch());
        let loss = Loss::new(LossKind::Paper, 0.5);
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| loss.evaluate(&geometry, &logits, &truths).unwrap())
        };
        assert_eq!(run(1), run(3));
    }

    #[test]
    fn wrong_lengths_are_refused() {
        let (geometry, (mut logits, truths)) = (geometry(), batch());
        logits[1].pop();
        let message = Loss::new(LossKind::Darknet, 0.5).evaluate(&geometry, &logits, &truths).unwrap_err().to_string();
        assert!(message.contains("logits of head 1"), "{message}");
    }
}
