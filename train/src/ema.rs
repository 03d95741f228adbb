//! The moving average of the weights, which is smoother than the weights themselves: it is validated and kept.
use rayon::prelude::*;
use tcross_yolo::Weights;

/// `average = decay * average + (1 - decay) * weights`, batch norm's statistics included.
#[derive(Debug, Clone, PartialEq)]
pub struct Ema {
    /// The average.
    pub weights: Weights,
    /// 0..1; 0 keeps the last weights.
    pub decay: f64,
}

impl Ema {
    /// Starts at these weights.
    #[must_use]
    pub fn new(weights: Weights, decay: f64) -> Self {
        Self { weights, decay }
    }

    /// Takes in the weights after `step` (0-based). At first the average forgets faster, so that it leaves the start behind.
    pub fn update(&mut self, weights: &Weights, step: u64) {
        let decay = self.decay.min((1.0 + step as f64) / (10.0 + step as f64)) as f32;
        self.weights.seen = weights.seen;
        self.weights.convolutions.par_iter_mut().zip(&weights.convolutions).for_each(|(average, now)| {
            for ((_, average), (_, now)) in average.parts_mut().into_iter().zip(now.parts()) {
                average.iter_mut().zip(now).for_each(|(a, v)| *a += (1.0 - decay) * (v - *a));
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tcross_yolo::weights::ConvWeights;

    fn weights(value: f32) -> Weights {
        Weights { seen: 0, convolutions: vec![ConvWeights { bias: vec![value], norm: None, kernel: vec![-value; 3] }] }
    }

    #[test]
    fn values_by_hand() {
        let mut ema = Ema::new(weights(1.0), 0.9);
        ema.update(&weights(2.0), 0); // decay 1 / 10
        assert!((ema.weights.convolutions[0].bias[0] - 1.9).abs() < 1e-6);
        ema.update(&weights(4.0), 1_000); // decay 0.9
        assert!((ema.weights.convolutions[0].kernel[2] + (0.9 * 1.9 + 0.4)).abs() < 1e-6);
        let mut none = Ema::new(weights(1.0), 0.0);
        none.update(&weights(3.0), 5_000);
        assert_eq!(none.weights, weights(3.0));
    }
}
