//! Keypoints of a box: squared errors of each point's offset from the middle of the cell, in units of the anchor, half each and weighted
//! like the box with `2 - w h` and the mix-up weight. A truth without points has no such error.
use super::ImageLogits;
use crate::targets::Positive;

pub(super) fn image(image: &mut ImageLogits, positives: &[Positive]) -> f64 {
    let mut term = 0.0;
    for positive in positives {
        let (at, weight) = (positive.at, positive.truth.weight * positive.scale);
        let ([cx, cy], [aw, ah]) = (image.geometry.cell_center(at), image.geometry.anchor(at));
        for (index, [x, y]) in positive.truth.keypoints.iter().enumerate() {
            let target = [(x - cx) / aw, (y - cy) / ah];
            for (field, target) in image.geometry.fields.keypoint(index).zip(target) {
                let error = image.logit(at, field) - target;
                image.add(at, field, weight * error);
                term += f64::from(weight * error * error / 2.0);
            }
        }
    }
    term
}
