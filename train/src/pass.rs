//! One pass of images through a network: to logits, to a loss and its gradient, to the gradient of each parameter.
use crate::{data::Batch, error::TrainError, features::FeatureCache};
use burn::{
    module::{Module, ModuleVisitor, Param},
    tensor::{Device, Gradients, Tensor, TensorData},
};
use tcross_kernels::ops::{self, Path};
use tcross_yolo::{Loss, LossTerms, ModelConfig, Yolo, network::read_logits};

/// What a pass needs besides a network and images.
pub struct Pass {
    /// What the network is.
    pub model: ModelConfig,
    /// How it is judged.
    pub loss: Loss,
    /// Where it is.
    pub device: Device,
    /// Which kernels run.
    pub path: Path,
}

/// What a pass has found.
pub struct Passed {
    /// How many images it saw.
    pub images: usize,
    /// The parts of the loss, divided by their number.
    pub terms: LossTerms,
    /// What the second stage said of each image; the detector's is not kept.
    pub said: Vec<f32>,
    /// The loss's gradient, one a float of the network, in the order in which it is walked; none for what does not learn.
    pub gradients: Vec<Option<TensorData>>,
}

impl Pass {
    /// Takes a batch through a network, the backbone's share from `features` if there are some.
    ///
    /// # Errors
    /// If a truth is out of range.
    pub fn run(&self, network: &Yolo, batch: Batch, features: Option<&mut FeatureCache>) -> Result<Passed, TrainError> {
        let net = batch.request.input.net;
        let shape = [batch.truths.len(), 3, net.height, net.width];
        let images = Tensor::from_data(TensorData::new(batch.images, shape), &self.device);
        let heads = match features {
            Some(cache) => network.heads(cache.of_batch(network, &batch.sources, images)),
            None => network.forward(images),
        };
        let logits: Vec<Vec<f32>> = heads.iter().map(read_logits).collect();
        let output = self.loss.evaluate(&self.model.geometry(net), &logits, &batch.truths)?;
        let gradients = parameter_gradients(network, self.path, heads.into_iter().zip(output.gradients));
        Ok(Passed { images: batch.truths.len(), terms: output.terms, said: Vec::new(), gradients })
    }
}

/// The gradient of each parameter, in the order in which a network is walked, from that of each of its outputs; none for what does not learn.
pub fn parameter_gradients<N: Module>(
    network: &N,
    path: Path,
    outputs: impl IntoIterator<Item = (Tensor<4>, Vec<f32>)>,
) -> Vec<Option<TensorData>> {
    let surrogate = outputs.into_iter().map(|(output, gradient)| {
        let (shape, device) = (output.dims(), output.device());
        ops::seed(path, output, Tensor::from_data(TensorData::new(gradient, shape), &device))
    });
    #[expect(clippy::expect_used, reason = "`ModelConfig::validate` refuses networks without a head, and the refiner has one")]
    let surrogate = surrogate.reduce(|a, b| a + b).expect("a network has a head");
    let mut collected = Collect { gradients: surrogate.backward(), values: Vec::new() };
    network.visit(&mut collected);
    collected.values
}

impl Passed {
    /// What a pass of all their images would have found, were it not for batch norm, which sees each part alone.
    #[must_use]
    pub fn sum(parts: Vec<Self>) -> Self {
        let images: usize = parts.iter().map(|part| part.images).sum();
        let share = |part: &Self| part.images as f64 / images.max(1) as f64;
        let terms = LossTerms::weighted_sum(parts.iter().map(|part| (part.terms, share(part))));
        let said = parts.iter().flat_map(|part| part.said.iter().copied()).collect();
        let mut parts = parts.into_iter().map(|part| (share(&part) as f32, part.gradients));
        let (first, mut gradients) = parts.next().unwrap_or_default();
        gradients.iter_mut().flatten().for_each(|g| floats_mut(g).iter_mut().for_each(|v| *v *= first));
        for (share, part) in parts {
            for (sum, g) in gradients.iter_mut().flatten().zip(part.iter().flatten()) {
                floats_mut(sum).iter_mut().zip(floats(g)).for_each(|(sum, v)| *sum += share * v);
            }
        }
        Self { images, terms, said, gradients }
    }
}

/// The numbers of a parameter or of its gradient.
#[expect(clippy::expect_used, reason = "parameters and their gradients are made of f32 in `ConvBlock::new`")]
pub fn floats(data: &TensorData) -> &[f32] {
    data.as_slice::<f32>().expect("parameters and gradients are f32")
}

/// As [`floats`], to be changed.
#[expect(clippy::expect_used, reason = "parameters and their gradients are made of f32 in `ConvBlock::new`")]
pub fn floats_mut(data: &mut TensorData) -> &mut [f32] {
    data.as_mut_slice::<f32>().expect("parameters and gradients are f32")
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
