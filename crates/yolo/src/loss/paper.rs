//! The loss of the paper's code for one image:
//!
//! ```text
//! sum over positives  m (2 - w h) [ (x - x*)^2 + (y - y*)^2 + (tw - tw*)^2 + (th - th*)^2 ] + m |1 - o|^2 BCE(o, 1) + m sum over classes BCE(c, c')
//! + sum over negatives |o|^2 BCE(o, 0)
//! ```
//!
//! x, y, o and c are sigmoids of logits, m is the mix-up weight, and c' = 0.99 c* + 0.01 / classes: smoothed, which changes nothing
//! with one class.
use super::{ImageLogits, LossTerms, class_targets, logistic};
use crate::{
    fields::BoxFields,
    geometry::{Predictor, sigmoid},
    targets::{Positive, Truth},
};

/// How much of a class's target is spread over all classes.
const SMOOTHING: f32 = 0.01;

pub(super) fn image(image: &mut ImageLogits, truths: &[Truth], positives: &[Positive], ignore_iou: f32) -> LossTerms {
    let mut terms = LossTerms::default();
    image.each_negative(truths, positives, ignore_iou, |image, at| terms.objectness += focal(image, at, 0.0, 1.0));
    let classes = image.geometry.fields.classes as f32;
    for positive in positives {
        let (at, mix) = (positive.at, positive.truth.weight);
        let scale = mix * positive.scale;
        for (field, &target) in positive.target.iter().enumerate().take(2) {
            let p = sigmoid(image.logit(at, field));
            image.add(at, field, 2.0 * scale * (p - target) * p * (1.0 - p));
            terms.center += f64::from(scale * (p - target).powi(2));
        }
        for (field, &target) in positive.target.iter().enumerate().skip(2) {
            let error = image.logit(at, field) - target;
            image.add(at, field, 2.0 * scale * error);
            terms.size += f64::from(scale * error * error);
        }
        terms.objectness += focal(image, at, 1.0, mix);
        for (field, target) in class_targets(&image.geometry.fields, positive) {
            let target = (1.0 - SMOOTHING) * target + SMOOTHING / classes;
            let (p, bce) = logistic(image.logit(at, field), target);
            image.add(at, field, mix * (p - target));
            terms.class += f64::from(mix * bce);
        }
    }
    terms
}

/// `weight |target - o|^2 BCE(o, target)`, with its gradient added.
fn focal(image: &mut ImageLogits, at: Predictor, target: f32, weight: f32) -> f64 {
    let (p, bce) = logistic(image.logit(at, BoxFields::OBJECTNESS), target);
    let error = p - target;
    image.add(at, BoxFields::OBJECTNESS, weight * error * (error * error + 2.0 * bce * p * (1.0 - p)));
    f64::from(weight * error * error * bce)
}

#[cfg(test)]
mod tests {
    use super::super::{Loss, LossKind, tests as shared};
    use crate::{Architecture, ModelConfig, NetSize, Truth};
    use tcross_dataset::PixelBox;

    #[test]
    fn gradient_is_that_of_the_terms() {
        shared::check_gradient(Loss::new(LossKind::Paper, 0.5));
    }

    /// As in [`super::super::darknet`]: all logits 0, one truth that is exactly its anchor but for a shift of a quarter cell.
    #[test]
    fn values_by_hand() {
        let geometry = ModelConfig::of(Architecture::YoloV3Tiny).geometry(NetSize::square(32));
        let logits: Vec<Vec<f32>> = (0..2).map(|head| vec![0.0; geometry.head_len(head)]).collect();
        let plain = Truth::from_net_box(&PixelBox::from([-1.0, 1.0, 9.0, 15.0]), 0, NetSize::square(32));
        let truths = [vec![Truth { weight: 0.5, ..plain }]];
        let got = Loss::new(LossKind::Paper, 0.6).evaluate(&geometry, &logits, &truths).unwrap();
        let ln2 = std::f64::consts::LN_2;
        let scale = 0.5 * (2.0 - 140.0 / 1024.0);
        let close = |a: f64, b: f64| (a - b).abs() < 1e-5;
        assert!(close(got.terms.center, scale / 16.0), "{:?}", got.terms);
        assert!(close(got.terms.size, 0.0) && close(got.terms.class, 0.5 * ln2)); // one class: smoothing changes nothing
        assert!(close(got.terms.objectness, (14.0 + 0.5) * ln2 / 4.0));
        assert!(close(f64::from(got.gradients[1][0]), 2.0 * scale * 0.25 * 0.25)); // x: 1/2 against 1/4
    }
}
