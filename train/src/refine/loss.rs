//! The second stage's loss, over what is said of one view: `bce(detector's logit + own logit, is a marker)` and, of a marker,
//! `sum over the four sides of huber(side - true side)`, sides in half sides of the box that was looked at.
use tcross_yolo::refiner::{Opinion, net::OUTPUTS, polar::UnitBox};

/// Where the box's loss goes over from a square to a line, in half sides.
const BEND: f32 = 0.1;

/// The loss of one view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewLoss {
    /// Of the score.
    pub score: f32,
    /// Of the box.
    pub bounds: f32,
    /// Gradient of their sum with respect to the network's outputs.
    pub gradient: [f32; OUTPUTS],
}

/// Judges `outputs` of a view whose claim has this logit; `truth` is the marker's box as it is seen, none for no marker.
#[must_use]
pub fn judge(outputs: &[f32], logit: f32, truth: Option<UnitBox>) -> ViewLoss {
    let opinion = Opinion::of(outputs);
    let sum = logit + opinion.logit;
    let target = if truth.is_some() { 1.0 } else { 0.0 };
    let score = sum.max(0.0) - sum * target + (-sum.abs()).exp().ln_1p();
    let slope = 1.0 / (1.0 + (-sum).exp()) - target;
    let Some(truth) = truth else { return ViewLoss { score, bounds: 0.0, gradient: Opinion::gradient(slope, [0.0; 4]) } };
    let off: [f32; 4] = std::array::from_fn(|k| opinion.bounds[k] - truth[k]);
    let bounds = off.iter().map(|d| if d.abs() < BEND { 0.5 * d * d / BEND } else { d.abs() - 0.5 * BEND }).sum();
    ViewLoss { score, bounds, gradient: Opinion::gradient(slope, off.map(|d| (d / BEND).clamp(-1.0, 1.0))) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_by_hand() {
        // Nothing said, nothing known: ln 2; the box is off by 0.05 (0.5 * 0.0025 / 0.1) and by 0.5 (0.5 - 0.05) half sides.
        let loss = judge(&[0.0; 5], 0.0, Some([-1.0, -0.95, 1.0, 0.5]));
        assert!((loss.score - 2f32.ln()).abs() < 1e-6 && (loss.bounds - (0.0125 + 0.45)).abs() < 1e-6, "{loss:?}");
        // The detector says 4, the second stage -1: no marker costs ln(1 + e^3).
        let loss = judge(&[-1.0, 9.0, 9.0, 9.0, 9.0], 4.0, None);
        assert!((loss.score - 3f32.exp().ln_1p()).abs() < 1e-5 && loss.bounds == 0.0 && loss.gradient[1..] == [0.0; 4]);
    }

    #[test]
    fn the_gradient_is_the_slope() {
        let (outputs, truth) = ([0.7f32, 0.4, -3.0, 0.2, 2.0], Some([-1.1, -0.9, 1.02, 1.4]));
        let total = |outputs: &[f32]| {
            let loss = judge(outputs, -0.4, truth);
            f64::from(loss.score + loss.bounds)
        };
        for k in 0..OUTPUTS {
            let [mut up, mut down] = [outputs; 2];
            up[k] += 1e-2;
            down[k] -= 1e-2;
            let slope = (total(&up) - total(&down)) / 2e-2;
            let gradient = f64::from(judge(&outputs, -0.4, truth).gradient[k]);
            assert!((slope - gradient).abs() < 2e-3, "{k}: {slope} {gradient}");
        }
    }
}
