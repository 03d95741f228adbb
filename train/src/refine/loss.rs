//! The second stage's loss, over what is said of one view: `bce(detector's logit + own logit, is a marker)` and, of a marker, the sum of
//! `huber(said - true)` over the four sides of the box, where it is a box that is looked at, and over the five numbers of the frame, in the
//! view's units.
use super::claims::Truth;
use tcross_yolo::refiner::{Frame, Opinion, net::OUTPUTS};

/// Where the loss of the box and of the frame goes over from a square to a line, in the view's units.
const BEND: f32 = 0.1;

/// The loss of one view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewLoss {
    /// Of the score.
    pub score: f32,
    /// Of the box; 0 where none is looked at, or no marker is there.
    pub bounds: f32,
    /// Of the frame; 0 where no marker is there.
    pub frame: f32,
    /// Gradient of their sum with respect to the network's outputs.
    pub gradient: [f32; OUTPUTS],
}

impl ViewLoss {
    /// As if there were `count` such views.
    #[must_use]
    pub fn times(self, count: f32) -> Self {
        Self {
            score: count * self.score,
            bounds: count * self.bounds,
            frame: count * self.frame,
            gradient: self.gradient.map(|g| count * g),
        }
    }
}

/// Judges `outputs` of a view of a claim's box, or of the frame in which it was seen, whose claim has this logit; `truth` is the marker
/// as it is seen, none for no marker.
#[must_use]
pub fn judge(outputs: &[f32], framed: bool, logit: f32, truth: Option<Truth>) -> ViewLoss {
    let opinion = Opinion::of(outputs);
    let sum = logit + opinion.logits[usize::from(framed)];
    let target = if truth.is_some() { 1.0 } else { 0.0 };
    let score = sum.max(0.0) - sum * target + (-sum.abs()).exp().ln_1p();
    let slope = 1.0 / (1.0 + (-sum).exp()) - target;
    let slopes = if framed { [0.0, slope] } else { [slope, 0.0] };
    let Some(truth) = truth else {
        return ViewLoss { score, bounds: 0.0, frame: 0.0, gradient: Opinion::gradient(slopes, [0.0; 4], [0.0; 5]) };
    };
    let (bounds, of_bounds) = if framed { (0.0, [0.0; 4]) } else { huber(opinion.bounds, truth.bounds) };
    let numbers = |f: &Frame| [f.center[0], f.center[1], f.axes[0][0], f.axes[1][1], f.axes[0][1]];
    let (frame, of_frame) = huber(numbers(&opinion.frame), numbers(&truth.frame));
    ViewLoss { score, bounds, frame, gradient: Opinion::gradient(slopes, of_bounds, of_frame) }
}

/// Huber's loss of numbers, and its slope for each.
fn huber<const N: usize>(said: [f32; N], is: [f32; N]) -> (f32, [f32; N]) {
    let off: [f32; N] = std::array::from_fn(|k| said[k] - is[k]);
    let loss = off.iter().map(|d| if d.abs() < BEND { 0.5 * d * d / BEND } else { d.abs() - 0.5 * BEND }).sum();
    (loss, off.map(|d| (d / BEND).clamp(-1.0, 1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn truth(bounds: [f32; 4], center: [f32; 2]) -> Option<Truth> {
        Some(Truth { bounds, frame: Frame { center, axes: [[0.8, 0.0], [0.0, 0.8]] } })
    }

    #[test]
    fn values_by_hand() {
        let mut outputs = [0.0; OUTPUTS];
        // Nothing said, nothing known: ln 2; the box is off by 0.05 (0.5 * 0.0025 / 0.1) and by 0.5 (0.5 - 0.05) half sides, the frame by 0.2.
        let loss = judge(&outputs, false, 0.0, truth([-1.0, -0.95, 1.0, 0.5], [0.2, 0.0]));
        assert!((loss.score - 2f32.ln()).abs() < 1e-6 && (loss.bounds - (0.0125 + 0.45)).abs() < 1e-6, "{loss:?}");
        // In a frame, the box means nothing.
        let framed = judge(&outputs, true, 0.0, truth([-1.0, -0.95, 1.0, 0.5], [0.2, 0.0]));
        assert!((framed.frame - 0.15).abs() < 1e-6 && framed.frame == loss.frame, "{framed:?}");
        assert!(framed.bounds == 0.0 && framed.gradient[2..6] == [0.0; 4], "{framed:?}");
        // The detector says 4, the second stage -1: no marker costs ln(1 + e^3), twice if it stands for two.
        (outputs[0], outputs[1], outputs[2], outputs[8]) = (-1.0, 2.0, 9.0, 9.0);
        let loss = judge(&outputs, false, 4.0, None).times(2.0);
        assert!(
            (loss.score - 2.0 * 3f32.exp().ln_1p()).abs() < 1e-5
                && loss.bounds + loss.frame == 0.0
                && loss.gradient[1..] == [0.0; OUTPUTS - 1]
        );
        assert!((judge(&outputs, true, 4.0, None).score - 6f32.exp().ln_1p()).abs() < 1e-5);
    }

    #[test]
    fn the_gradient_is_the_slope() {
        let outputs: [f32; OUTPUTS] = [0.7, -0.6, 0.4, -3.0, 0.2, 2.0, 0.3, 4.0, -0.4, 0.1, -2.0];
        for framed in [false, true] {
            let loss = |outputs: &[f32]| judge(outputs, framed, -0.4, truth([-1.1, -0.9, 1.02, 1.4], [0.1, -0.2])).times(1.5);
            for k in 0..OUTPUTS {
                let [mut up, mut down] = [outputs; 2];
                up[k] += 1e-2;
                down[k] -= 1e-2;
                let total = |outputs: &[f32]| f64::from(loss(outputs).score + loss(outputs).bounds + loss(outputs).frame);
                let slope = (total(&up) - total(&down)) / 2e-2;
                let gradient = f64::from(loss(&outputs).gradient[k]);
                assert!((slope - gradient).abs() < 2e-3, "{framed} {k}: {slope} {gradient}");
            }
        }
    }
}
