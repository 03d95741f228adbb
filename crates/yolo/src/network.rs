//! The burn module that walks a graph.
use crate::{
    blocks::{self, ConvBlock, Statistics},
    config::ModelConfig,
    error::YoloError,
    graph::Graph,
    plan::{PlanStep, Step, plan},
    weights::Weights,
};
use burn::{
    module::Module,
    tensor::{Device, Tensor},
};
use tcross_kernels::ops::{self, Path};

/// How much a batch moves the running averages of batch norm: Darknet's `0.99 old + 0.01 new`.
pub const BATCH_NORM_MOMENTUM: f64 = 0.01;

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

    /// Reads all parameters back, as training left them.
    #[must_use]
    pub fn weights(&self) -> Weights {
        Weights { seen: 0, convolutions: self.convolutions.iter().map(ConvBlock::weights).collect() }
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
        let mut kept: Vec<Option<Tensor<4>>> = vec![None; self.graph.layers().len()];
        let mut heads = Vec::new();
        let mut x = ops::channels_last(images);
        for PlanStep { step, layer, kept: keep, dropped } in &self.steps {
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
        heads
    }
}

/// A head's logits as plain values, `[batch, anchor, field, row, column]`.
#[must_use]
pub fn read_logits(head: &Tensor<4>) -> Vec<f32> {
    head.clone().try_into_vec_as().expect("a float tensor reads as f32")
}
