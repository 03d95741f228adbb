//! The network's operations on burn's tensors, over activations laid out as `[batch, height, width, channels]`.
//!
//! Each one has two bodies: a fused one for the CPU (burn's Flex backend), with its own backward pass, and a composition of burn's
//! operations that runs on every device. [`Path`] says which is taken; both give the same result up to rounding.
mod composite;
mod fused;
mod fused_circle;
mod fused_resample;
mod fused_seed;

use burn::tensor::{Device, Tensor};

/// Which body of an operation runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Path {
    /// Hand-written kernels; CPU only.
    Fused,
    /// burn's own operations.
    Composite,
}

impl Path {
    /// The fastest one that a device can run.
    #[must_use]
    pub fn for_device(device: &Device) -> Self {
        if device.clone().inner() == Device::flex() { Self::Fused } else { Self::Composite }
    }

    /// This path, or the composite where there is no fast kernel for a convolution.
    fn covering(self, weight: &Tensor<4>, stride: usize) -> Self {
        if crate::covers(weight.dims()[2], stride) { self } else { Self::Composite }
    }
}

/// What a convolution with batch norm needs to know besides its tensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormSettings {
    /// 1 or 2.
    pub stride: usize,
    /// Added to the variance inside the root.
    pub epsilon: f32,
    /// Of the leaky unit; 1 for none.
    pub slope: f32,
    /// Normalise with the batch's own statistics, through which gradients flow; else with the given ones.
    pub batch_statistics: bool,
}

/// The parameters of one convolution with batch norm, and the statistics to use where the batch's are not wanted.
#[derive(Debug, Clone)]
pub struct ConvNorm {
    /// `[out, in, kernel, kernel]`.
    pub weight: Tensor<4>,
    /// `[out]`.
    pub gamma: Tensor<1>,
    /// `[out]`.
    pub beta: Tensor<1>,
    /// Running mean, `[out]`.
    pub mean: Tensor<1>,
    /// Running (population) variance, `[out]`.
    pub variance: Tensor<1>,
}

/// Mean and population variance a channel that a normalisation used.
#[derive(Debug, Clone)]
pub struct Statistics {
    /// `[out]`.
    pub mean: Tensor<1>,
    /// `[out]`.
    pub variance: Tensor<1>,
}

/// `[batch, channels, height, width]` to the layout of this module.
#[must_use]
pub fn channels_last(x: Tensor<4>) -> Tensor<4> {
    x.permute([0, 2, 3, 1])
}

/// Back to `[batch, channels, height, width]`.
#[must_use]
pub fn channels_first(x: Tensor<4>) -> Tensor<4> {
    x.permute([0, 3, 1, 2])
}

/// `leaky(norm(conv(x)))`.
#[must_use]
pub fn conv_norm(path: Path, x: Tensor<4>, conv: ConvNorm, settings: NormSettings) -> (Tensor<4>, Statistics) {
    match path.covering(&conv.weight, settings.stride) {
        Path::Fused => fused::conv_norm(x, conv, settings),
        Path::Composite => composite::conv_norm(x, conv, settings),
    }
}

/// The residual unit: `x + expand(squeeze(x))`, a 1x1 and a 3x3 convolution, each normalised and activated.
#[must_use]
pub fn residual(path: Path, x: Tensor<4>, squeeze: ConvNorm, expand: ConvNorm, settings: NormSettings) -> (Tensor<4>, [Statistics; 2]) {
    match path.covering(&squeeze.weight, settings.stride).covering(&expand.weight, settings.stride) {
        Path::Fused => fused::residual(x, squeeze, expand, settings),
        Path::Composite => composite::residual(x, squeeze, expand, settings),
    }
}

/// A convolution with bias and no activation, such as a head. (The fast kernel is one of stride 1.)
#[must_use]
pub fn conv_bias(path: Path, x: Tensor<4>, weight: Tensor<4>, bias: Tensor<1>, stride: usize) -> Tensor<4> {
    match path.covering(&weight, stride) {
        Path::Fused if stride == 1 => fused::conv_bias(x, weight, bias),
        _ => composite::conv_bias(x, weight, bias, stride),
    }
}

/// Each pixel repeated 2 x 2.
#[must_use]
pub fn upsample(path: Path, x: Tensor<4>) -> Tensor<4> {
    match path {
        Path::Fused => fused_resample::upsample(x),
        Path::Composite => composite::upsample(x),
    }
}

/// Maximum over 2 x 2; at stride 1 the right column and the bottom row are padded so that the size stays.
#[must_use]
pub fn max_pool(path: Path, x: Tensor<4>, stride: usize) -> Tensor<4> {
    match path {
        Path::Fused => fused_resample::max_pool(x, stride),
        Path::Composite => composite::max_pool(x, stride),
    }
}

/// `count` columns from `first` on, which go around a circle, with `margin` of them repeated on each side, so that what lies across the seam
/// is seen whole: `[batch, height, count + 2 * margin, channels]`.
#[must_use]
pub fn wrap(path: Path, x: Tensor<4>, first: usize, count: usize, margin: usize) -> Tensor<4> {
    match path {
        Path::Fused => fused_circle::wrap(x, first, count, margin),
        Path::Composite => composite::wrap(x, first, count, margin),
    }
}

/// Each of `count` columns from `first` on, which go around a circle, with its neighbours, `arc` in all from left to right, of each all rows
/// from top to bottom: `[batch, 1, count, arc * height * channels]`.
#[must_use]
pub fn around(path: Path, x: Tensor<4>, first: usize, count: usize, arc: usize) -> Tensor<4> {
    match path {
        Path::Fused => fused_circle::around(x, first, count, arc),
        Path::Composite => composite::around(x, first, count, arc),
    }
}

/// A number to walk back from, together with other seeds or alone: its gradient with respect to `x` is `gradient`, of the same shape. For
/// losses that are computed outside the graph. (The composite is a product and a sum, whose value nobody reads.)
#[must_use]
pub fn seed(path: Path, x: Tensor<4>, gradient: Tensor<4>) -> Tensor<1> {
    match path {
        Path::Fused => fused_seed::seed(x, gradient),
        Path::Composite => (x * gradient).sum(),
    }
}

/// Channels of several activations, one behind the other.
#[must_use]
pub fn concat(parts: Vec<Tensor<4>>) -> Tensor<4> {
    Tensor::cat(parts, 3)
}
