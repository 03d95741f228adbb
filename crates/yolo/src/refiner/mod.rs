//! The second stage: each claim of a detector is looked at again, alone and in polar coordinates around its middle, and gets a new score
//! and a new box. A narrow detector finds nearly all markers but is slow to learn to count their arms; where arms are parallel bars, that
//! is easy, and easier still in the marker's own frame, where it is not tilted. (Second stages that refine boxes: Faster R-CNN,
//! S. Ren and others, 2015; Cascade R-CNN, Z. Cai and N. Vasconcelos, 2018.)
pub mod frame;
pub mod net;
pub mod polar;

use crate::{
    config::BoxConvention,
    decode::DetectOptions,
    error::YoloError,
    nms,
    weights::{Weights, safetensors},
};
use burn::tensor::Device;
pub use frame::Frame;
use image::RgbImage;
pub use net::{Opinion, RefinerNet};
pub use polar::{Glance, Patch};
use std::path::Path;
use tcross_dataset::{Detection, PixelBox};

/// Name of its parameters in a run's folder.
pub const REFINER: &str = "refiner.safetensors";
/// Claims of a lower score are not worth a look.
pub const LEAST_SCORE: f32 = 0.005;
/// Share of the score asked for that a claim must have kept after a look to be looked at again.
const HOPE: f64 = 0.1;
/// Share of the detector's logit that the second stage's is added to: of what the detector knows, the second stage sees most itself.
const TRUST: f32 = 0.4;
/// The score that a claim has, at most, when the second stage is asked: a certain detector may be wrong.
const MOST_SCORE: f64 = 0.999;

/// A second stage, ready to look.
#[derive(Debug, Clone)]
pub struct Refiner {
    net: RefinerNet,
    boxes: BoxConvention,
}

impl Refiner {
    /// With these parameters, for a detector whose boxes are counted like this.
    ///
    /// # Errors
    /// If the parameters do not fit.
    pub fn new(weights: &Weights, boxes: BoxConvention) -> Result<Self, YoloError> {
        Ok(Self { net: RefinerNet::new(weights, &Device::flex())?, boxes })
    }

    /// Reads `refiner.safetensors`.
    ///
    /// # Errors
    /// If the file cannot be read or is of another network.
    pub fn read(path: impl AsRef<Path>, boxes: BoxConvention) -> Result<Self, YoloError> {
        Self::new(&safetensors::read(path, &net::layers())?, boxes)
    }

    /// Looks at claims four times: where the detector saw them, where the first look saw their box, and twice in the frames in which those
    /// before saw them, the last in a mirror; no longer at those that a look has left no hope. Keeps what `options` say, by falling score.
    #[must_use]
    pub fn refine(&self, image: &RgbImage, claims: &[Detection], options: &DetectOptions) -> Vec<Detection> {
        let extra = self.boxes.extra();
        let mut all: Vec<Looked> = claims.iter().map(|claim| Looked::new(image, claim, extra)).collect();
        let hopeful = |all: &mut Vec<Looked>| all.retain(|one| joined(one.claim.score, one.logit) >= HOPE * f64::from(options.score));
        for _ in 0..2 {
            let seen = self.look(&all, |one| Glance::at(&Frame::of_box(one.bounds)));
            for (one, (glance, seen)) in all.iter_mut().zip(seen) {
                one.bounds = sound(glance.unseen(sound(seen.bounds)));
                one.frame = glance.unseen_frame(&seen.frame).sound();
                one.logit = seen.logits[0];
            }
            hopeful(&mut all);
        }
        let third = self.look(&all, |one| Glance::at(&one.frame));
        for (one, (glance, seen)) in all.iter_mut().zip(third) {
            one.frame = glance.unseen_frame(&seen.frame).sound();
            one.logit = seen.logits[1];
        }
        hopeful(&mut all);
        let fourth = self.look(&all, |one| Glance::at(&one.frame).mirrored());
        all.iter_mut().zip(fourth).for_each(|(one, (_, seen))| one.logit = (one.logit + seen.logits[1]) / 2.0);
        let refined = all.iter().map(|one| {
            let mut bounds = polar::in_pixels(&one.grown, one.bounds);
            if options.clip {
                bounds = bounds.clipped(f64::from(image.width()), f64::from(image.height()));
            }
            Detection { score: joined(one.claim.score, one.logit), bounds: bounds.grown(-extra), ..one.claim.clone() }
        });
        let worth = refined.filter(|d| d.score >= f64::from(options.score) && d.bounds.grown(extra).area() > 0.0).collect();
        nms::nms(worth, options.nms_iou, options.most)
    }

    /// Where each claim is looked at, and what the network says of it.
    fn look(&self, all: &[Looked], at: impl Fn(&Looked) -> Glance) -> Vec<(Glance, Opinion)> {
        let glances: Vec<Glance> = all.iter().map(at).collect();
        let mut views = vec![0.0; all.len() * polar::VIEW];
        let rows = views.chunks_exact_mut(polar::VIEW).zip(all);
        rows.zip(&glances).for_each(|((view, one), glance)| glance.look(&one.patch, view));
        glances.into_iter().zip(self.net.opinions(views)).collect()
    }
}

/// A claim that is looked at, and what is known of it so far.
struct Looked<'a> {
    claim: &'a Detection,
    /// Its box in continuous pixels.
    grown: PixelBox,
    patch: Patch,
    /// The marker's box, in the claim's units.
    bounds: polar::UnitBox,
    /// The marker's frame, in the claim's units.
    frame: Frame,
    /// What is added to the detector's logit.
    logit: f32,
}

impl<'a> Looked<'a> {
    fn new(image: &RgbImage, claim: &'a Detection, extra: f64) -> Self {
        let grown = claim.bounds.grown(extra);
        let bounds = [-1.0, -1.0, 1.0, 1.0];
        Self { claim, grown, patch: Patch::cut(image, &grown), bounds, frame: Frame::of_box(bounds), logit: 0.0 }
    }
}

/// What the second stage takes up of a claim's logit.
#[must_use]
pub fn logit(score: f64) -> f32 {
    let score = score.clamp(1.0 - MOST_SCORE, MOST_SCORE);
    TRUST * (score / (1.0 - score)).ln() as f32
}

/// The score after a look: what both stages say adds up.
fn joined(score: f64, look: f32) -> f64 {
    1.0 / (1.0 + f64::from(-(logit(score) + look)).exp())
}

/// A box within what a patch shows, of sides that are worth a look.
fn sound(b: polar::UnitBox) -> polar::UnitBox {
    let axis = |a: f32, b: f32| {
        let (middle, half) = (((a + b) / 2.0).clamp(-1.0, 1.0), ((b - a) / 2.0).clamp(0.2, 2.0));
        [middle - half, middle + half]
    };
    let ([left, right], [top, bottom]) = (axis(b[0], b[2]), axis(b[1], b[3]));
    [left, top, right, bottom]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fields::BoxFields;

    /// A second stage that says the same of everything, and a little less where it looks at a box.
    fn saying(logit: f32, bounds: [f32; 4], boxes: BoxConvention) -> Refiner {
        saying_both([logit - 0.5, logit], bounds, boxes)
    }

    fn saying_both(logits: [f32; 2], bounds: [f32; 4], boxes: BoxConvention) -> Refiner {
        let mut weights = Weights::zeros(&net::layers());
        let count = weights.convolutions.len();
        weights.convolutions[count - 2].bias = logits.to_vec();
        weights.convolutions[count - 1].bias = [bounds.as_slice(), &[0.0; 5]].concat();
        Refiner::new(&weights, boxes).unwrap()
    }

    fn claim(score: f64, bounds: [f64; 4]) -> Detection {
        Detection { score, class: 3, bounds: PixelBox::from(bounds), pose: None }
    }

    fn noise() -> RgbImage {
        RgbImage::from_fn(100, 80, |x, y| image::Rgb([x as u8, y as u8, (x * y) as u8]))
    }

    #[test]
    fn logits_add_up_and_boxes_move_twice() {
        // 10 % of the half sides further out on each side, twice: half sides of 10 become 12.1, around the same middle.
        let refiner = saying(1.0, [-1.0, -1.0, 1.0, 1.0], BoxConvention::Continuous);
        let found = refiner.refine(&noise(), &[claim(0.5, [30.0, 40.0, 50.0, 60.0])], &DetectOptions::default());
        assert_eq!((found.len(), found[0].class), (1, 3));
        assert!((found[0].score - 1.0 / (1.0 + (-1f64).exp())).abs() < 1e-6);
        // Of the detector's logit ln 9 two fifths count.
        let sure = refiner.refine(&noise(), &[claim(0.9, [30.0, 40.0, 50.0, 60.0])], &DetectOptions::default());
        assert!((sure[0].score - 1.0 / (1.0 + (-1.0 - 0.4 * 9f64.ln()).exp())).abs() < 1e-6);
        let want = [27.9, 37.9, 52.1, 62.1];
        assert!(<[f64; 4]>::from(found[0].bounds).iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-4), "{found:?}");
    }

    #[test]
    fn inclusive_boxes_come_back_inclusive() {
        let refiner = saying(0.0, [0.0; 4], BoxConvention::Inclusive);
        let given = claim(0.5, [30.0, 40.0, 49.0, 59.0]);
        let found = refiner.refine(&noise(), std::slice::from_ref(&given), &DetectOptions::default());
        assert!(<[f64; 4]>::from(found[0].bounds).iter().zip(<[f64; 4]>::from(given.bounds)).all(|(a, b)| (a - b).abs() < 1e-4));
        assert!((found[0].score - 0.5).abs() < 1e-6);
    }

    #[test]
    fn what_options_do_not_want_is_left_out() {
        let claims = [claim(0.3, [30.0, 40.0, 50.0, 60.0]), claim(0.6, [31.0, 40.0, 51.0, 60.0]), claim(0.02, [0.0, 0.0, 9.0, 9.0])];
        let found = saying(-2.0, [0.0; 4], BoxConvention::Continuous).refine(&noise(), &claims, &DetectOptions::default());
        assert_eq!(found.iter().map(|d| (d.score * 100.0).round()).collect::<Vec<_>>(), [14.0], "one suppressed, one too low");
        let cut = saying(4.0, [-5.0, 0.0, 0.0, 0.0], BoxConvention::Continuous).refine(&noise(), &claims[2..], &DetectOptions::default());
        assert_eq!(cut[0].bounds.x_min, 0.0);
        assert!(saying(0.0, [0.0; 4], BoxConvention::Continuous).refine(&noise(), &[], &DetectOptions::default()).is_empty());
    }

    /// What a look at its box leaves hardly any score is given up, though its frame would have brought it back.
    #[test]
    fn hopeless_claims_are_given_up() {
        let claims = [claim(0.5, [30.0, 40.0, 50.0, 60.0])];
        for (of_box, found) in [(-5.0, 1), (-5.6, 0)] {
            let refiner = saying_both([of_box, 3.0], [0.0; 4], BoxConvention::Continuous);
            // A tenth of the score asked for, 0.005, has a logit of -5.3.
            let options = DetectOptions { score: 0.05, ..DetectOptions::default() };
            assert_eq!(refiner.refine(&noise(), &claims, &options).len(), found, "{of_box}");
        }
    }

    #[test]
    fn files_are_read_back_and_others_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(REFINER);
        let weights = Weights::init(&net::layers(), &BoxFields::plain(1), &Default::default(), 1);
        safetensors::write(&path, &net::layers(), &weights).unwrap();
        let read = Refiner::read(&path, BoxConvention::Continuous).unwrap();
        assert_eq!(crate::Network::weights(&read.net), weights);
        std::fs::write(&path, "x").unwrap();
        let message = Refiner::read(&path, BoxConvention::Continuous).unwrap_err().to_string();
        assert!(message.contains(REFINER), "{message}");
    }
}
