//! One step: images to logits, logits to a loss and its gradient, gradient to parameters.
use crate::{
    config::{self, ClipBy, Config, Freeze},
    data::Batch,
    device::Accelerator,
    error::TrainError,
    features::FeatureCache,
    muon,
    optimizer::{Rule, Slot, clip_gains, squared_norm},
};
use burn::{
    module::{Module, ModuleMapper, ModuleVisitor, Param},
    tensor::{Device, Gradients, Tensor, TensorData},
};
use rayon::prelude::*;
use tcross_kernels::ops::{self, Path};
use tcross_yolo::{Loss, LossTerms, ModelConfig, Statistics, Weights, Yolo, network::read_logits};

/// A network with its optimiser.
pub struct Trainer {
    network: Option<Yolo>,
    model: ModelConfig,
    device: Device,
    path: Path,
    loss: Loss,
    optimizer: config::Optimizer,
    clip: f64,
    clip_by: ClipBy,
    features: Option<FeatureCache>,
    /// One a float of the network, in the order in which it is walked; those that do not learn stay empty.
    slots: Vec<Slot>,
}

/// What a step has found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepOutput {
    /// The parts of the loss, divided by the batch.
    pub terms: LossTerms,
    /// Norm of all gradients before clipping.
    pub gradient_norm: f64,
}

impl Trainer {
    /// A network of this description that starts from these weights.
    ///
    /// # Errors
    /// If the weights do not fit the description.
    pub fn new(config: &Config, model: &ModelConfig, weights: &Weights, accelerator: &Accelerator) -> Result<Self, TrainError> {
        let device = accelerator.device().autodiff();
        let mut trainer = Self {
            network: None,
            model: model.clone(),
            path: if config.fused { Path::for_device(&device) } else { Path::Composite },
            device,
            loss: Loss { kind: config.loss, ignore_iou: config.ignore_iou as f32, assign_iou: config.assign_iou as f32 },
            optimizer: config.optimizer.clone(),
            clip: config.clip,
            clip_by: config.clip_by,
            features: FeatureCache::of(config),
            slots: Vec::new(),
        };
        let network = Yolo::new(model, weights, &trainer.device)?.with_momentum(1.0 - config.batch_norm_decay);
        let network = network.with_path(trainer.path);
        let backbone = network.graph().backbone();
        trainer.network = Some(match config.freeze {
            Freeze::None => network,
            Freeze::Backbone => network.frozen(backbone),
            Freeze::BackboneRunning => network.frozen(backbone).with_statistics(backbone, Statistics::Running),
        });
        Ok(trainer)
    }

    /// Learns from a batch at this rate. `step` counts from 0.
    ///
    /// # Errors
    /// If a truth is out of range.
    pub fn step(&mut self, batch: Batch, rate: f64, step: u64) -> Result<StepOutput, TrainError> {
        #[expect(clippy::expect_used, reason = "made in `new`, and put back on every way out of this function")]
        let network = self.network.take().expect("every step puts the network back");
        let net = batch.request.input.net;
        let shape = [batch.truths.len(), 3, net.height, net.width];
        let images = Tensor::from_data(TensorData::new(batch.images, shape), &self.device);
        let heads = match &mut self.features {
            Some(cache) => network.heads(cache.of_batch(&network, &batch.sources, images)),
            None => network.forward(images),
        };
        let logits: Vec<Vec<f32>> = heads.iter().map(read_logits).collect();
        let output = match self.loss.evaluate(&self.model.geometry(net), &logits, &batch.truths) {
            Ok(output) => output,
            Err(error) => {
                self.network = Some(network);
                return Err(error.into());
            }
        };
        let surrogate = heads.into_iter().zip(output.gradients).map(|(head, gradient)| {
            let shape = head.dims();
            ops::seed(self.path, head, Tensor::from_data(TensorData::new(gradient, shape), &self.device))
        });
        #[expect(clippy::expect_used, reason = "`ModelConfig::validate` refuses networks without a head")]
        let surrogate = surrogate.reduce(|a, b| a + b).expect("a network has a head");
        let mut collected = Collect { gradients: surrogate.backward(), values: Vec::new() };
        network.visit(&mut collected);
        let squared: Vec<f64> = collected.values.iter().map(|g| g.as_ref().map_or(0.0, |g| squared_norm(floats(g)))).collect();
        let (gradient_norm, gains) = clip_gains(&squared, self.clip, self.clip_by);
        if gradient_norm.is_finite() {
            self.slots.resize(collected.values.len(), Slot::default());
            let rule = Rule::new(&self.optimizer, rate, step);
            let directions = match rule.orthogonal() {
                true => directions(&rule, &collected.values, &gains, &mut self.slots),
                false => vec![None; gains.len()],
            };
            let mut update =
                Update { rule, gradients: &collected.values, gains: &gains, directions: &directions, slots: &mut self.slots, at: 0 };
            self.network = Some(network.map(&mut update));
        } else {
            self.network = Some(network);
        }
        Ok(StepOutput { terms: output.terms, gradient_norm })
    }

    /// Which kernels run.
    #[must_use]
    pub fn path(&self) -> Path {
        self.path
    }

    /// Reads the parameters back.
    #[must_use]
    pub fn weights(&self) -> Weights {
        self.network.as_ref().map(Yolo::weights).unwrap_or_default()
    }

    /// What the optimiser remembers, one a float of the network in the order in which it is walked.
    #[must_use]
    pub fn slots(&self) -> &[Slot] {
        &self.slots
    }

    /// Puts back what the optimiser remembered.
    pub fn set_slots(&mut self, slots: Vec<Slot>) {
        self.slots = slots;
    }
}

#[expect(clippy::expect_used, reason = "parameters and their gradients are made of f32 in `ConvBlock::new`")]
fn floats(data: &TensorData) -> &[f32] {
    data.as_slice::<f32>().expect("parameters and gradients are f32")
}

/// Takes each parameter's gradient, in the order in which the network is walked; none for what does not learn.
struct Collect {
    gradients: Gradients,
    values: Vec<Option<TensorData>>,
}

impl ModuleVisitor for Collect {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let tensor = param.val();
        self.values.push(tensor.grad_remove(&mut self.gradients).map(Tensor::into_data));
    }
}

/// The direction in which each kernel moves; none for other parameters. Kernels are independent of each other, so threads change nothing.
fn directions(rule: &Rule, gradients: &[Option<TensorData>], gains: &[f32], slots: &mut [Slot]) -> Vec<Option<Vec<f32>>> {
    let one = |((gradient, gain), slot): ((&Option<TensorData>, &f32), &mut Slot)| {
        let gradient = gradient.as_ref().filter(|g| g.shape().len() == 4)?;
        Some(muon::direction(floats(gradient), *gain, gradient.shape()[0], rule.momentum, slot))
    };
    gradients.par_iter().zip(gains).zip(slots).map(one).collect()
}

/// Moves each parameter.
struct Update<'a> {
    rule: Rule,
    gradients: &'a [Option<TensorData>],
    gains: &'a [f32],
    directions: &'a [Option<Vec<f32>>],
    slots: &'a mut [Slot],
    at: usize,
}

impl ModuleMapper for Update<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let at = self.at;
        self.at += 1;
        let Some(gradient) = &self.gradients[at] else { return param };
        let (id, tensor, mapper) = param.consume();
        let device = tensor.device();
        let mut data = tensor.inner().into_data();
        #[expect(clippy::expect_used, reason = "parameters are made of f32 in `ConvBlock::new`")]
        let values = data.as_mut_slice::<f32>().expect("parameters are f32");
        match &self.directions[at] {
            Some(direction) => self.rule.stride(values, direction),
            // Kernels have four dimensions; biases and batch norm's numbers have one and no decay.
            None => self.rule.update(values, floats(gradient), self.gains[at], D == 4, &mut self.slots[at]),
        }
        Param::from_mapped_value(id, Tensor::from_data(data, &device).require_grad(), mapper)
    }
}
