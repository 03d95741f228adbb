//! Where training starts from.
use super::{ConvWeights, Weights};
use crate::{
    fields::BoxFields,
    graph::{Conv, Graph, Layer},
};
use tcross_dataset::Rng;

/// Starting values of the heads; all other convolutions get He's normal values for leaky ReLU, gamma 1, beta 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Init {
    /// Bias of each objectness logit. -7: nearly nothing is claimed at first, so the many empty cells do not swamp the few boxes.
    pub objectness_bias: f32,
    /// Bias of each class logit.
    pub class_bias: f32,
    /// Deviation of the heads' kernels, relative to He's.
    pub head_gain: f64,
}

impl Default for Init {
    fn default() -> Self {
        Self { objectness_bias: -7.0, class_bias: 0.0, head_gain: 0.25 }
    }
}

pub(super) fn weights(graph: &Graph, fields: &BoxFields, init: &Init, seed: u64) -> Weights {
    let mut weights = Weights::zeros(graph);
    for ((layer, conv), values) in graph.convolutions().zip(&mut weights.convolutions) {
        let head = match graph.layers().get(layer + 1) {
            Some(Layer::Head { mask }) => Some(mask.len()),
            _ => None,
        };
        fill(conv, values, if head.is_some() { init.head_gain } else { 1.0 }, &mut Rng::for_item(seed, "yolo/init", layer as u64));
        for anchor in 0..head.unwrap_or(0) {
            let start = anchor * fields.len();
            values.bias[start + BoxFields::OBJECTNESS] = init.objectness_bias;
            fields.classes().for_each(|class| values.bias[start + class] = init.class_bias);
        }
    }
    weights
}

fn fill(conv: &Conv, weights: &mut ConvWeights, gain: f64, rng: &mut Rng) {
    let slope = if conv.leaky { crate::blocks::LEAKY_SLOPE } else { 1.0 };
    let fan_in = (conv.in_channels * conv.kernel * conv.kernel) as f64;
    let deviation = gain * (2.0 / ((1.0 + slope * slope) * fan_in)).sqrt();
    weights.kernel.iter_mut().for_each(|w| *w = (deviation * rng.normal()) as f32);
    if let Some(norm) = &mut weights.norm {
        norm.gamma.fill(1.0);
        norm.variance.fill(1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Architecture, ModelConfig};

    #[test]
    fn seeded_with_the_right_spread() {
        let config = ModelConfig { width: 0.25, ..ModelConfig::of(Architecture::YoloV3Tiny) };
        let graph = config.graph().unwrap();
        let start = |seed| Weights::init(&graph, &config.fields(), &Init::default(), seed);
        assert_eq!(start(3), start(3));
        assert_ne!(start(3), start(4));
        let weights = start(3);
        weights.check(&graph).unwrap();
        let kernel = &weights.convolutions[6].kernel; // 128 -> 256, 3x3
        let variance = kernel.iter().map(|w| f64::from(*w).powi(2)).sum::<f64>() / kernel.len() as f64;
        assert!((variance * 1.01 * 128.0 * 9.0 / 2.0 - 1.0).abs() < 0.02, "{variance}");
        let head = weights.convolutions.last().unwrap();
        assert_eq!(head.bias[4..6], [-7.0, 0.0]);
        assert_eq!(head.bias[6 + 4], -7.0);
    }
}
