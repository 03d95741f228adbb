//! The parts a network is made of, on burn's tensors. The insides are plain compositions of burn's operations, which every backend
//! has; [`ConvBlock::forward`] and [`residual`] are the seams where faster ones fit.
use crate::{
    graph::Conv,
    weights::{ConvWeights, NormWeights},
};
use burn::{
    module::{Module, Param, RunningState},
    tensor::{
        Device, Tensor, TensorData, activation,
        module::{batch_norm, batch_norm_train, conv2d, interpolate, max_pool2d},
        ops::{ConvOptions, InterpolateMode, InterpolateOptions, MaxPoolOptions},
    },
};

/// Slope of the leaky ReLU for negative values.
pub const LEAKY_SLOPE: f64 = 0.1;

/// Which mean and variance batch norm divides by.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Statistics {
    /// Those of the batch while training (on an autodiff device), which also move the running averages; else the running ones.
    #[default]
    Batch,
    /// The running averages, also in training.
    Running,
}

/// A convolution with bias, or with batch norm, and an activation.
#[derive(Module, Debug)]
pub struct ConvBlock {
    /// `[out, in, kernel, kernel]`.
    pub kernel: Param<Tensor<4>>,
    /// The bias; with batch norm its beta. `[out]`.
    pub bias: Param<Tensor<1>>,
    /// Batch norm, if there is one.
    pub norm: Option<Norm>,
    /// 1 or 2.
    #[module(skip)]
    pub stride: usize,
    /// Leaky ReLU, or linear.
    #[module(skip)]
    pub leaky: bool,
}

/// Batch norm's own numbers.
#[derive(Module, Debug)]
pub struct Norm {
    /// The scale, `[out]`.
    pub gamma: Param<Tensor<1>>,
    /// Running average of the mean, `[out]`.
    pub mean: RunningState<Tensor<1>>,
    /// Running average of the (population) variance, `[out]`.
    pub variance: RunningState<Tensor<1>>,
    /// Added to the variance inside the root.
    #[module(skip)]
    pub epsilon: f64,
    /// Weight of a batch in the running averages.
    #[module(skip)]
    pub momentum: f64,
    /// Which statistics are used.
    #[module(skip)]
    pub statistics: Statistics,
}

impl ConvBlock {
    /// From stored parameters, whose lengths fit `conv`.
    #[must_use]
    pub fn new(conv: &Conv, weights: &ConvWeights, epsilon: f64, momentum: f64, device: &Device) -> Self {
        let vector = |values: &[f32]| Tensor::<1>::from_data(TensorData::new(values.to_vec(), [values.len()]), device);
        let shape = [conv.filters, conv.in_channels, conv.kernel, conv.kernel];
        Self {
            kernel: Param::from_tensor(Tensor::from_data(TensorData::new(weights.kernel.clone(), shape), device)),
            bias: Param::from_tensor(vector(&weights.bias)),
            norm: weights.norm.as_ref().map(|norm| Norm {
                gamma: Param::from_tensor(vector(&norm.gamma)),
                mean: RunningState::new(vector(&norm.mean)),
                variance: RunningState::new(vector(&norm.variance)),
                epsilon,
                momentum,
                statistics: Statistics::Batch,
            }),
            stride: conv.stride,
            leaky: conv.leaky,
        }
    }

    /// `[batch, in, height, width]` to `[batch, out, height / stride, width / stride]`.
    #[must_use]
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let padding = self.kernel.shape()[2] / 2;
        let options = ConvOptions::new([self.stride; 2], [padding; 2], [1; 2], 1);
        let y = match &self.norm {
            Some(norm) => norm.forward(conv2d(x, self.kernel.val(), None, options), self.bias.val()),
            None => conv2d(x, self.kernel.val(), Some(self.bias.val()), options),
        };
        if self.leaky { activation::leaky_relu(y, LEAKY_SLOPE) } else { y }
    }

    /// Reads the parameters back.
    #[must_use]
    pub fn weights(&self) -> ConvWeights {
        ConvWeights {
            bias: values(self.bias.val()),
            norm: self.norm.as_ref().map(|norm| NormWeights {
                gamma: values(norm.gamma.val()),
                mean: values(norm.mean.value_sync()),
                variance: values(norm.variance.value_sync()),
            }),
            kernel: values(self.kernel.val()),
        }
    }
}

impl Norm {
    fn forward(&self, x: Tensor<4>, beta: Tensor<1>) -> Tensor<4> {
        let device = x.device();
        if !device.is_autodiff() || self.statistics == Statistics::Running {
            let (mean, variance) = (self.mean.value_sync(), self.variance.value_sync());
            return batch_norm(x, self.gamma.val(), beta, mean.to_device(&device), variance.to_device(&device), self.epsilon);
        }
        let batch = batch_norm_train(x, self.gamma.val(), beta, self.epsilon);
        self.observe(batch.mean, batch.variance);
        batch.output
    }

    /// Moves the running averages towards a batch's statistics.
    pub fn observe(&self, mean: Tensor<1>, variance: Tensor<1>) {
        for (state, seen) in [(&self.mean, mean), (&self.variance, variance)] {
            state.update((state.value_sync() * (1.0 - self.momentum) + seen.detach() * self.momentum).detach());
        }
    }
}

/// The residual unit: `x + expand(squeeze(x))`.
#[must_use]
pub fn residual(squeeze: &ConvBlock, expand: &ConvBlock, x: Tensor<4>) -> Tensor<4> {
    x.clone() + expand.forward(squeeze.forward(x))
}

/// Each pixel repeated 2 x 2.
#[must_use]
pub fn upsample(x: Tensor<4>) -> Tensor<4> {
    interpolate(x, InterpolateOptions::new(InterpolateMode::Nearest).with_scale_factor([2.0, 2.0]))
}

/// Maximum over 2 x 2; at stride 1 the right column and the bottom row are padded so that the size stays.
#[must_use]
pub fn max_pool(x: Tensor<4>, stride: usize) -> Tensor<4> {
    let end = usize::from(stride == 1);
    let padding = [(0, end), (0, end)];
    max_pool2d(x, MaxPoolOptions { kernel_size: [2; 2], stride: [stride; 2], padding, dilation: [1; 2], ceil_mode: false })
}

fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.try_into_vec_as().expect("a float tensor reads as f32")
}
