//! From a graph to the steps that run it: residual units recognised, outputs dropped after their last reader.
use crate::graph::{Conv, Graph, Layer};

/// One step. Convolutions are named by their position in file order, other values by the index of their layer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Step {
    /// A convolution of the value before.
    Conv(usize),
    /// `x + expand(squeeze(x))`: a 1x1 convolution, a 3x3 convolution and a shortcut over both.
    Residual {
        /// The first convolution.
        squeeze: usize,
        /// The second.
        expand: usize,
    },
    /// The value before plus a kept one.
    Add(usize),
    /// Kept values, concatenated along the channels.
    Concat(Vec<usize>),
    /// Nearest neighbour, twice the size.
    Upsample,
    /// 2 x 2, of this stride.
    MaxPool(usize),
    /// The value before is a head's raw logits.
    Head,
}

/// A step, the layer whose output it gives, and the kept values that nobody reads after it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlanStep {
    /// What to do.
    pub step: Step,
    /// Index of the layer that this step completes.
    pub layer: usize,
    /// True if a later step reads this output by its index.
    pub kept: bool,
    /// Kept values to drop after this step.
    pub dropped: Vec<usize>,
}

/// Steps with residual units fused (`fused`), or one step a layer.
#[must_use]
pub fn plan(graph: &Graph, fused: bool) -> Vec<PlanStep> {
    let layers = graph.layers();
    let readers = |wanted: usize, except: usize| {
        layers.iter().enumerate().any(|(at, layer)| {
            at != except
                && match layer {
                    Layer::Shortcut { from } => *from == wanted,
                    Layer::Route { from } => from.contains(&wanted),
                    _ => false,
                }
        })
    };
    let residual = |at: usize| match (layers.get(at), layers.get(at + 1), layers.get(at + 2)) {
        (Some(Layer::Conv(first)), Some(Layer::Conv(second)), Some(Layer::Shortcut { from })) => {
            let inside = |c: &Conv, kernel| c.kernel == kernel && c.stride == 1 && c.leaky;
            inside(first, 1)
                && inside(second, 3)
                && first.batch_norm == second.batch_norm
                && from + 1 == at
                && !readers(at, at)
                && !readers(at + 1, at)
        }
        _ => false,
    };

    let (mut steps, mut at, mut conv) = (Vec::new(), 0, 0);
    while at < layers.len() {
        let (step, length) = match &layers[at] {
            Layer::Conv(_) if fused && residual(at) => (Step::Residual { squeeze: conv, expand: conv + 1 }, 3),
            Layer::Conv(_) => (Step::Conv(conv), 1),
            Layer::Shortcut { from } => (Step::Add(*from), 1),
            Layer::Route { from } => (Step::Concat(from.clone()), 1),
            Layer::Upsample => (Step::Upsample, 1),
            Layer::MaxPool { stride } => (Step::MaxPool(*stride), 1),
            Layer::Head { .. } => (Step::Head, 1),
        };
        conv += match step {
            Step::Conv(_) => 1,
            Step::Residual { .. } => 2,
            _ => 0,
        };
        at += length;
        steps.push(PlanStep { step, layer: at - 1, kept: false, dropped: Vec::new() });
    }
    mark_lifetimes(&mut steps);
    steps
}

fn mark_lifetimes(steps: &mut [PlanStep]) {
    let mut last_reader = std::collections::BTreeMap::new();
    for (at, step) in steps.iter().enumerate() {
        match &step.step {
            Step::Add(from) => last_reader.extend([(*from, at)]),
            Step::Concat(from) => last_reader.extend(from.iter().map(|&layer| (layer, at))),
            _ => {}
        }
    }
    for step in steps.iter_mut() {
        step.kept = last_reader.contains_key(&step.layer);
    }
    for (layer, at) in last_reader {
        steps[at].dropped.push(layer);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Architecture, ModelConfig};

    #[test]
    fn residual_units_are_recognised_and_values_dropped_once_read() {
        let graph = ModelConfig::of(Architecture::YoloV3).graph().unwrap();
        let steps = plan(&graph, true);
        assert_eq!(steps.iter().filter(|s| matches!(s.step, Step::Residual { .. })).count(), 23);
        assert_eq!(steps.len(), 107 - 2 * 23);
        let kept: Vec<usize> = steps.iter().filter(|s| s.kept).map(|s| s.layer).collect();
        assert_eq!(kept, [36, 61, 79, 85, 91, 97]);
        let mut dropped: Vec<usize> = steps.iter().flat_map(|s| s.dropped.clone()).collect();
        dropped.sort_unstable();
        assert_eq!(dropped, kept);
    }

    #[test]
    fn a_unit_whose_inside_is_read_elsewhere_stays_apart() {
        let mut graph = ModelConfig::of(Architecture::YoloV3).graph().unwrap();
        graph.push(Layer::Route { from: vec![2] }).unwrap();
        let steps = plan(&graph, true);
        assert_eq!(steps.iter().filter(|s| matches!(s.step, Step::Residual { .. })).count(), 22);
    }
}
