//! The second stage: each claim of a detector is looked at again, alone and in polar coordinates around its middle, and gets a new score
//! and a new box. A narrow detector finds nearly all markers but is slow to learn to count their arms; where arms are parallel bars, that
//! is easy. (Second stages that refine boxes: Faster R-CNN, S. Ren and others, 2015; Cascade R-CNN, Z. Cai and N. Vasconcelos, 2018.)
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
use image::RgbImage;
pub use net::{Opinion, RefinerNet};
pub use polar::{Glance, Patch};
use std::path::Path;
use tcross_dataset::Detection;

/// Name of its parameters in a run's folder.
pub const REFINER: &str = "refiner.safetensors";
/// Claims of a lower score are not worth a look.
pub const LEAST_SCORE: f32 = 0.02;
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

    /// Looks at claims twice, first where the detector, then where the first look saw them, there also in a mirror; keeps what `options` say, by falling score.
    #[must_use]
    pub fn refine(&self, image: &RgbImage, claims: &[Detection], options: &DetectOptions) -> Vec<Detection> {
        let extra = self.boxes.extra();
        let grown: Vec<_> = claims.iter().map(|d| d.bounds.grown(extra)).collect();
        let patches: Vec<Patch> = grown.iter().map(|claim| Patch::cut(image, claim)).collect();
        let look = |glances: &[Glance]| -> Vec<Opinion> {
            let mut views = vec![0.0; patches.len() * polar::VIEW];
            let rows = views.chunks_exact_mut(polar::VIEW);
            rows.zip(&patches).zip(glances).for_each(|((view, patch), glance)| glance.look(patch, view));
            self.net.opinions(views)
        };
        let first = look(&vec![Glance::default(); patches.len()]);
        let glances: Vec<Glance> = first.iter().map(|opinion| Glance::at(sound(opinion.bounds))).collect();
        let mirrored: Vec<Glance> = glances.iter().map(|glance| glance.mirrored()).collect();
        let second = [&glances, &mirrored].map(|glances| (glances, look(glances)));
        let refined = claims.iter().zip(&grown).enumerate().map(|(k, (claim, grown))| {
            let opinion = mean(second.each_ref().map(|(glances, opinions)| {
                let Opinion { logit, bounds } = opinions[k];
                Opinion { logit, bounds: glances[k].unseen(sound(bounds)) }
            }));
            let mut bounds = polar::in_pixels(grown, opinion.bounds);
            if options.clip {
                bounds = bounds.clipped(f64::from(image.width()), f64::from(image.height()));
            }
            Detection { score: joined(claim.score, opinion.logit), bounds: bounds.grown(-extra), ..claim.clone() }
        });
        let worth = refined.filter(|d| d.score >= f64::from(options.score) && d.bounds.grown(extra).area() > 0.0).collect();
        nms::nms(worth, options.nms_iou, options.most)
    }
}

/// A claim's logit as the second stage takes it up.
#[must_use]
pub fn logit(score: f64) -> f32 {
    let score = score.clamp(1.0 - MOST_SCORE, MOST_SCORE);
    (score / (1.0 - score)).ln() as f32
}

/// The score after a look: the logits of both stages add up.
fn joined(score: f64, look: f32) -> f64 {
    1.0 / (1.0 + f64::from(-(logit(score) + look)).exp())
}

/// What two looks say together.
fn mean([a, b]: [Opinion; 2]) -> Opinion {
    Opinion { logit: (a.logit + b.logit) / 2.0, bounds: std::array::from_fn(|k| (a.bounds[k] + b.bounds[k]) / 2.0) }
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
    use tcross_dataset::PixelBox;

    /// A second stage that says the same of everything.
    fn saying(logit: f32, bounds: [f32; 4], boxes: BoxConvention) -> Refiner {
        let mut weights = Weights::zeros(&net::layers());
        let count = weights.convolutions.len();
        weights.convolutions[count - 2].bias = vec![logit];
        weights.convolutions[count - 1].bias = bounds.to_vec();
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
        let found = saying(0.0, [0.0; 4], BoxConvention::Continuous).refine(&noise(), &claims, &DetectOptions::default());
        assert_eq!(found.iter().map(|d| (d.score * 100.0).round()).collect::<Vec<_>>(), [60.0], "one suppressed, one too low");
        let cut = saying(4.0, [-5.0, 0.0, 0.0, 0.0], BoxConvention::Continuous).refine(&noise(), &claims[2..], &DetectOptions::default());
        assert_eq!(cut[0].bounds.x_min, 0.0);
        assert!(saying(0.0, [0.0; 4], BoxConvention::Continuous).refine(&noise(), &[], &DetectOptions::default()).is_empty());
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
