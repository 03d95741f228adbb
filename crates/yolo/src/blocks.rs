//! The parts a network is made of, on burn's tensors laid out as `[batch, height, width, channels]`. What they compute is in
//! `tcross_kernels::ops`: fused on the CPU, a composition of burn's operations elsewhere.
use crate::{
    graph::Conv,
    weights::{ConvWeights, NormWeights},
};
use burn::{
    module::{Module, Param, RunningState},
    tensor::{Device, Tensor, TensorData, activation},
};
use tcross_kernels::ops::{self, ConvNorm, NormSettings, Path};

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

    /// `[batch, height, width, in]` to `[batch, height / stride, width / stride, out]`.
    #[must_use]
    pub fn forward(&self, x: Tensor<4>, path: Path) -> Tensor<4> {
        let Some(norm) = &self.norm else {
            let y = ops::conv_bias(path, x, self.kernel.val(), self.bias.val(), self.stride);
            return if self.leaky { activation::leaky_relu(y, LEAKY_SLOPE) } else { y };
        };
        let settings = norm.settings(self.stride, self.leaky, &x.device());
        let (y, seen) = ops::conv_norm(path, x, self.parameters(norm), settings);
        norm.observe(settings, seen);
        y
    }

    fn parameters(&self, norm: &Norm) -> ConvNorm {
        let device = self.kernel.val().device();
        ConvNorm {
            weight: self.kernel.val(),
            gamma: norm.gamma.val(),
            beta: self.bias.val(),
            mean: norm.mean.value_sync().to_device(&device),
            variance: norm.variance.value_sync().to_device(&device),
        }
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
    fn settings(&self, stride: usize, leaky: bool, device: &Device) -> NormSettings {
        NormSettings {
            stride,
            epsilon: self.epsilon as f32,
            slope: if leaky { LEAKY_SLOPE as f32 } else { 1.0 },
            batch_statistics: device.is_autodiff() && self.statistics == Statistics::Batch,
        }
    }

    /// Moves the running averages towards a batch's statistics, where those were used.
    fn observe(&self, settings: NormSettings, seen: ops::Statistics) {
        if !settings.batch_statistics {
            return;
        }
        for (state, seen) in [(&self.mean, seen.mean), (&self.variance, seen.variance)] {
            set(state, (state.value_sync() * (1.0 - self.momentum) + seen.detach() * self.momentum).detach());
        }
    }
}

/// Gives a running average its value, for every thread: burn keeps what one thread has set from the others until that thread reads it.
pub(crate) fn set(state: &RunningState<Tensor<1>>, value: Tensor<1>) {
    state.update(value);
    let _ = state.value_sync();
}

/// The residual unit: `x + expand(squeeze(x))`, both with batch norm.
#[must_use]
pub fn residual(squeeze: &ConvBlock, expand: &ConvBlock, x: Tensor<4>, path: Path) -> Tensor<4> {
    if let (Some(first), Some(second)) = (&squeeze.norm, &expand.norm)
        && first.statistics == second.statistics
    {
        let settings = first.settings(1, squeeze.leaky, &x.device());
        let (y, [seen_first, seen_second]) = ops::residual(path, x, squeeze.parameters(first), expand.parameters(second), settings);
        first.observe(settings, seen_first);
        second.observe(settings, seen_second);
        return y;
    }
    x.clone() + expand.forward(squeeze.forward(x, path), path)
}

/// A tensor's values, row-major.
#[expect(clippy::expect_used, reason = "a float tensor of any backend turns into f32")]
pub(crate) fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.try_into_vec_as().expect("a float tensor reads as f32")
}
