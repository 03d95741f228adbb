//! The burn module that walks a graph.
use crate::{
    blocks::{self, ConvBlock, Norm, Statistics},
    config::ModelConfig,
    error::YoloError,
    graph::Graph,
    plan::{PlanStep, Step, plan},
    weights::Weights,
};
use burn::{
    module::{Module, RunningState},
    tensor::{Device, Tensor},
};
use tcross_kernels::ops::{self, Path};

/// How much a batch moves the running averages of batch norm: Darknet's `0.99 old + 0.01 new`.
pub const BATCH_NORM_MOMENTUM: f64 = 0.01;

/// A network of convolutions that learns, however they are joined.
pub trait Network: Module {
    /// In file order.
    fn convolutions(&self) -> &[ConvBlock];

    /// Reads all parameters back, as training left them.
    fn weights(&self) -> Weights {
        Weights { seen: 0, convolutions: self.convolutions().iter().map(ConvBlock::weights).collect() }
    }

    /// Gives several copies of one network, that have seen a batch each, the same running averages: the mean of theirs.
    fn share_statistics(copies: &[Self]) {
        if copies.len() < 2 {
            return;
        }
        let norms = |index: usize| copies.iter().filter_map(move |copy| copy.convolutions()[index].norm.as_ref());
        for index in 0..copies[0].convolutions().len() {
            for state in [|norm: &Norm| norm.mean.clone(), |norm: &Norm| norm.variance.clone()] {
                let states: Vec<_> = norms(index).map(state).collect();
                let sum = states.iter().map(RunningState::value_sync).reduce(|a, b| a + b);
                let Some(mean) = sum.map(|sum| sum / copies.len() as f32) else { continue };
                states.iter().for_each(|state| blocks::set(state, mean.clone()));
            }
        }
    }
}

impl Network for Yolo {
    fn convolutions(&self) -> &[ConvBlock] {
        &self.convolutions
    }
}

/// A YOLO network. On a device with autodiff it trains, on a plain one it infers.
#[derive(Module, Debug)]
pub struct Yolo {
    /// In file order.
    pub convolutions: Vec<ConvBlock>,
    #[module(skip)]
    steps: Vec<PlanStep>,
    #[module(skip)]
    graph: Graph,
    #[module(skip)]
    path: Path,
}

impl Yolo {
    /// A network of this description with these parameters.
    ///
    /// # Errors
    /// If the description is not valid or the parameters do not fit it.
    pub fn new(config: &ModelConfig, weights: &Weights, device: &Device) -> Result<Self, YoloError> {
        config.validate()?;
        Self::from_graph(config.graph()?, weights, config.epsilon, device)
    }

    /// A network of these layers with these parameters; `epsilon` stands inside batch norm's root.
    ///
    /// # Errors
    /// If the parameters do not fit the layers.
    pub fn from_graph(graph: Graph, weights: &Weights, epsilon: f64, device: &Device) -> Result<Self, YoloError> {
        weights.check(&graph)?;
        let block = |((_, conv), weights)| ConvBlock::new(conv, weights, epsilon, BATCH_NORM_MOMENTUM, device);
        let convolutions = graph.convolutions().zip(&weights.convolutions).map(block).collect();
        Ok(Self { convolutions, steps: plan(&graph, true), graph, path: Path::for_device(device) })
    }

    /// The same network, one step a layer, so that [`Self::forward_watched`] sees the output of each.
    #[must_use]
    pub fn layerwise(mut self) -> Self {
        self.steps = plan(&self.graph, false);
        self
    }

    /// Which kernels run (default: the fastest that the device has).
    #[must_use]
    pub fn with_path(mut self, path: Path) -> Self {
        self.path = path;
        self
    }

    /// The network's layers.
    #[must_use]
    pub fn graph(&self) -> &Graph {
        &self.graph
    }

    /// How much a batch moves the running averages of batch norm (default: [`BATCH_NORM_MOMENTUM`]).
    #[must_use]
    pub fn with_momentum(mut self, momentum: f64) -> Self {
        self.convolutions.iter_mut().filter_map(|c| c.norm.as_mut()).for_each(|norm| norm.momentum = momentum);
        self
    }

    /// Which statistics the batch norms of the first `layers` layers use in training.
    #[must_use]
    pub fn with_statistics(mut self, layers: usize, statistics: Statistics) -> Self {
        let count = self.convolutions_below(layers);
        self.convolutions[..count].iter_mut().filter_map(|c| c.norm.as_mut()).for_each(|norm| norm.statistics = statistics);
        self
    }

    /// Stops gradients at the parameters of the first `layers` layers; their batch norms go on as [`Self::with_statistics`] says.
    #[must_use]
    pub fn frozen(mut self, layers: usize) -> Self {
        let count = self.convolutions_below(layers);
        let tail = self.convolutions.split_off(count);
        self.convolutions = self.convolutions.into_iter().map(Module::no_grad).chain(tail).collect();
        self
    }

    /// How many convolutions the first `layers` layers hold.
    #[must_use]
    pub fn convolutions_below(&self, layers: usize) -> usize {
        self.graph.convolutions().filter(|(layer, _)| *layer < layers).count()
    }

    /// Images `[batch, 3, height, width]`, RGB in 0..1, to each head's raw logits
    /// `[batch, anchors * fields, rows, columns]`, coarse first.
    #[must_use]
    pub fn forward(&self, images: Tensor<4>) -> Vec<Tensor<4>> {
        self.forward_watched(images, &mut |_, _| {})
    }

    /// As [`Self::forward`], showing each step's output (`[batch, height, width, channels]`) with its layer's index.
    pub fn forward_watched(&self, images: Tensor<4>, watch: &mut dyn FnMut(usize, &Tensor<4>)) -> Vec<Tensor<4>> {
        self.walk(&self.steps, self.start(images), watch).0
    }

    /// The first half of [`Self::forward`]: the backbone alone.
    #[must_use]
    pub fn backbone(&self, images: Tensor<4>) -> Features {
        self.walk(&self.steps[..self.cut()], self.start(images), &mut |_, _| {}).1
    }

    /// The second half: what follows the backbone.
    #[must_use]
    pub fn heads(&self, features: Features) -> Vec<Tensor<4>> {
        self.walk(&self.steps[self.cut()..], features, &mut |_, _| {}).0
    }

    /// How many steps the backbone has.
    fn cut(&self) -> usize {
        let layers = self.graph.backbone();
        self.steps.iter().position(|s| s.layer >= layers).unwrap_or(self.steps.len())
    }

    fn start(&self, images: Tensor<4>) -> Features {
        Features { x: ops::channels_last(images), kept: vec![None; self.graph.layers().len()] }
    }

    /// Takes steps from where others ended: the logits of the heads on the way, and where it ends itself.
    fn walk(&self, steps: &[PlanStep], from: Features, watch: &mut dyn FnMut(usize, &Tensor<4>)) -> (Vec<Tensor<4>>, Features) {
        let Features { mut x, mut kept } = from;
        let mut heads = Vec::new();
        for PlanStep { step, layer, kept: keep, dropped } in steps {
            #[expect(clippy::expect_used, reason = "`plan` marks as kept, until their last reader, the layers that later steps read")]
            let read = |layer: &usize| kept[*layer].clone().expect("the plan keeps what a later step reads");
            x = match step {
                Step::Conv(index) => self.convolutions[*index].forward(x, self.path),
                Step::Residual { squeeze, expand } => {
                    blocks::residual(&self.convolutions[*squeeze], &self.convolutions[*expand], x, self.path)
                }
                Step::Add(from) => x + read(from),
                Step::Concat(from) if from.len() == 1 => read(&from[0]),
                Step::Concat(from) => ops::concat(from.iter().map(read).collect()),
                Step::Upsample => ops::upsample(self.path, x),
                Step::MaxPool(stride) => ops::max_pool(self.path, x, *stride),
                Step::Head => x,
            };
            watch(*layer, &x);
            if *step == Step::Head {
                heads.push(ops::channels_first(x.clone()));
            }
            if *keep {
                kept[*layer] = Some(x.clone());
            }
            dropped.iter().for_each(|&layer| kept[layer] = None);
        }
        (heads, Features { x, kept })
    }
}

/// Where a walk through the network has come to: its value (`[batch, height, width, channels]`) and those, by layer, that later steps read.
#[derive(Debug, Clone)]
pub struct Features {
    x: Tensor<4>,
    kept: Vec<Option<Tensor<4>>>,
}

impl Features {
    /// The value and the kept ones in the order of their layers.
    pub fn tensors(&self) -> impl Iterator<Item = &Tensor<4>> {
        std::iter::once(&self.x).chain(self.kept.iter().flatten())
    }

    /// Their numbers, each tensor's row-major.
    #[must_use]
    pub fn values(&self) -> Vec<Vec<f32>> {
        self.tensors().cloned().map(blocks::values).collect()
    }

    /// The same place in the network with other values, in the order of [`Self::tensors`]; none if there are fewer of them.
    #[must_use]
    pub fn with_tensors(&self, tensors: impl IntoIterator<Item = Tensor<4>>) -> Option<Self> {
        let mut tensors = tensors.into_iter();
        let x = tensors.next()?;
        let kept = self.kept.iter().map(|k| k.as_ref().map_or(Some(None), |_| tensors.next().map(Some))).collect::<Option<_>>()?;
        Some(Self { x, kept })
    }
}

/// A head's logits as plain values, `[batch, anchor, field, row, column]`.
#[must_use]
pub fn read_logits(head: &Tensor<4>) -> Vec<f32> {
    blocks::values(head.clone())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Architecture, NetSize};
    use tcross_dataset::Rng;

    fn config() -> ModelConfig {
        ModelConfig { width: 0.0625, depth: 0.25, input: NetSize::square(64), ..ModelConfig::of(Architecture::YoloV3) }
    }

    fn network(device: &Device) -> (Yolo, Weights) {
        let config = config();
        let weights = Weights::init(&config.graph().unwrap(), &config.fields(), &Default::default(), 3);
        (Yolo::new(&config, &weights, device).unwrap(), weights)
    }

    fn images(device: &Device) -> Tensor<4> {
        let mut rng = Rng::for_item(1, "test/network", 0);
        let values: Vec<f32> = (0..2 * 3 * 64 * 64).map(|_| rng.unit() as f32).collect();
        Tensor::from_data(burn::tensor::TensorData::new(values, [2, 3, 64, 64]), device)
    }

    #[test]
    fn parameters_come_back_as_they_went_in() {
        let (network, weights) = network(&Device::flex());
        assert_eq!(network.weights(), weights);
    }

    #[test]
    fn fused_units_equal_single_layers() {
        let device = Device::flex();
        let (network, _) = network(&device);
        let single = network.clone().layerwise().forward(images(&device));
        for (a, b) in network.forward(images(&device)).iter().zip(&single) {
            let (a, b) = (read_logits(a), read_logits(b));
            assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-5));
        }
    }

    #[test]
    fn training_moves_running_averages_and_inference_does_not() {
        let device = Device::flex();
        let (plain, weights) = network(&device);
        let _ = plain.forward(images(&device));
        assert_eq!(plain.weights(), weights);

        let device = device.autodiff();
        let (network, _) = network(&device);
        let _ = network.forward(images(&device));
        let (before, after) = (&weights.convolutions[0], &network.weights().convolutions[0]);
        let (before, after) = (before.norm.as_ref().unwrap(), after.norm.as_ref().unwrap());
        // Recompute the first layer's batch statistics from a network without batch norm's help.
        let raw = burn::tensor::module::conv2d(
            images(&Device::flex()),
            plain.convolutions[0].kernel.val(),
            None,
            burn::tensor::ops::ConvOptions::new([1, 1], [1, 1], [1, 1], 1),
        );
        let raw = read_logits(&raw);
        for channel in 0..before.mean.len() {
            let of = |image: usize| &raw[(image * before.mean.len() + channel) * 4096..][..4096];
            let all: Vec<f64> = of(0).iter().chain(of(1)).map(|v| f64::from(*v)).collect();
            let mean = all.iter().sum::<f64>() / all.len() as f64;
            let variance = all.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / all.len() as f64;
            assert!((f64::from(after.mean[channel]) - 0.01 * mean).abs() < 1e-5);
            assert!((f64::from(after.variance[channel]) - (0.99 + 0.01 * variance)).abs() < 1e-4);
        }
    }

    #[test]
    fn running_statistics_stand_still_on_request() {
        let device = Device::flex().autodiff();
        let (network, weights) = network(&device);
        let network = network.with_statistics(usize::MAX, Statistics::Running);
        let trained = network.forward(images(&device));
        assert_eq!(network.weights(), weights);
        let plain = Yolo::new(&config(), &weights, &Device::flex()).unwrap().forward(images(&Device::flex()));
        // The same function; on one of the two devices batch norm may be folded.
        let (trained, plain) = (read_logits(&trained[0]), read_logits(&plain[0]));
        assert!(trained.iter().zip(&plain).all(|(a, b)| (a - b).abs() < 1e-5));
    }

    #[test]
    fn a_frozen_backbone_gets_no_gradient_but_new_averages() {
        let device = Device::flex().autodiff();
        let (network, weights) = network(&device);
        let backbone = network.graph().backbone();
        let network = network.frozen(backbone);
        let count = network.convolutions_below(backbone);
        let heads = network.forward(images(&device));
        let gradients = heads.into_iter().map(|head| head.powf_scalar(2.0).sum()).reduce(|a, b| a + b).unwrap().backward();
        for (index, block) in network.convolutions.iter().enumerate() {
            assert_eq!(block.kernel.val().grad(&gradients).is_some(), index >= count, "convolution {index}");
        }
        assert_ne!(network.weights().convolutions[0].norm, weights.convolutions[0].norm);
    }
}
