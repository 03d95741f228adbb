//! Darknet's loss for one image:
//!
//! ```text
//! sum over positives  (2 - w h) [ BCE(x, x*) + BCE(y, y*) + (tw - tw*)^2 / 2 + (th - th*)^2 / 2 ] + BCE(o, 1) + sum over classes BCE(c, c*)
//! + sum over negatives BCE(o, 0)
//! ```
//!
//! x, y, o and c are sigmoids of logits; tw and th are logits. Darknet writes x and y like a squared error, but hands `target - sigmoid` on
//! as the gradient of the logit, which is cross-entropy's. Mix-up weights are not part of it.
use super::{ImageLogits, LossTerms, class_targets, logistic};
use crate::{
    fields::BoxFields,
    targets::{Positive, Truth},
};

pub(super) fn image(image: &mut ImageLogits, truths: &[Truth], positives: &[Positive], ignore_iou: f32) -> LossTerms {
    let mut terms = LossTerms::default();
    image.each_negative(truths, positives, ignore_iou, |image, at| {
        let (p, bce) = logistic(image.logit(at, BoxFields::OBJECTNESS), 0.0);
        image.add(at, BoxFields::OBJECTNESS, p);
        terms.objectness += f64::from(bce);
    });
    for positive in positives {
        let Positive { at, scale, target, .. } = *positive;
        for (field, &target) in target.iter().enumerate().take(2) {
            let (p, bce) = logistic(image.logit(at, field), target);
            image.add(at, field, scale * (p - target));
            terms.center += f64::from(scale * bce);
        }
        for (field, &target) in target.iter().enumerate().skip(2) {
            let error = image.logit(at, field) - target;
            image.add(at, field, scale * error);
            terms.size += f64::from(scale * error * error / 2.0);
        }
        let (p, bce) = logistic(image.logit(at, BoxFields::OBJECTNESS), 1.0);
        image.add(at, BoxFields::OBJECTNESS, p - 1.0);
        terms.objectness += f64::from(bce);
        for (field, target) in class_targets(&image.geometry.fields, positive) {
            let (p, bce) = logistic(image.logit(at, field), target);
            image.add(at, field, p - target);
            terms.class += f64::from(bce);
        }
    }
    terms
}

#[cfg(test)]
mod tests {
    use super::super::{Loss, LossKind, tests as shared};
    use crate::{Architecture, ModelConfig, NetSize, Truth};
    use tcross_dataset::PixelBox;

    #[test]
    fn gradient_is_that_of_the_terms() {
        shared::check_gradient(Loss::new(LossKind::Darknet, 0.6));
    }

    /// All logits 0 in a 32 x 32 input: every sigmoid is 1/2 and every cross-entropy ln 2, boxes are the anchors in the cells' middles.
    #[test]
    fn values_by_hand() {
        let geometry = ModelConfig::of(Architecture::YoloV3Tiny).geometry(NetSize::square(32));
        let logits: Vec<Vec<f32>> = (0..2).map(|head| vec![0.0; geometry.head_len(head)]).collect();
        // 10 x 14 around (8, 8): anchor 0 of the fine head, cell 0, target (1/2, 1/2, 0, 0), scale 2 - 140 / 1024. It overlaps no other
        // predictor by more than 0.6: anchor 1 in the same place has 140 / 621.
        let truths = [vec![Truth::from_net_box(&PixelBox::from([3.0, 1.0, 13.0, 15.0]), 0, NetSize::square(32))]];
        let got = Loss::new(LossKind::Darknet, 0.6).evaluate(&geometry, &logits, &truths).unwrap();
        let ln2 = std::f64::consts::LN_2;
        let scale = 2.0 - 140.0 / 1024.0;
        let close = |a: f64, b: f64| (a - b).abs() < 1e-5;
        assert!(close(got.terms.center, 2.0 * scale * ln2), "{:?}", got.terms);
        assert!(close(got.terms.size, 0.0) && close(got.terms.class, ln2));
        assert!(close(got.terms.objectness, 15.0 * ln2)); // (1 + 4) cells of 3 anchors, one of them positive
        assert_eq!(got.gradients[1][4 * 4], -0.5); // objectness of the positive
        assert_eq!(got.gradients[1][4 * 4 + 1], 0.5); // of its neighbour
    }
}
