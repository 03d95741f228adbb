//! The operations as compositions of burn's own, for every device; also what the fused ones are tested against.
use super::{ConvNorm, NormSettings, Statistics, channels_first, channels_last};
use burn::tensor::{
    Tensor, activation,
    module::{batch_norm, batch_norm_train, conv2d, interpolate, max_pool2d},
    ops::{ConvOptions, InterpolateMode, InterpolateOptions, MaxPoolOptions},
};

fn options(weight: &Tensor<4>, stride: usize) -> ConvOptions<2> {
    ConvOptions::new([stride; 2], [weight.dims()[2] / 2; 2], [1; 2], 1)
}

pub fn conv_norm(x: Tensor<4>, conv: ConvNorm, settings: NormSettings) -> (Tensor<4>, Statistics) {
    let options = options(&conv.weight, settings.stride);
    let z = conv2d(channels_first(x), conv.weight, None, options);
    let epsilon = f64::from(settings.epsilon);
    let (y, statistics) = if settings.batch_statistics {
        let batch = batch_norm_train(z, conv.gamma, conv.beta, epsilon);
        (batch.output, Statistics { mean: batch.mean, variance: batch.variance })
    } else {
        let (mean, variance) = (conv.mean.clone(), conv.variance.clone());
        (batch_norm(z, conv.gamma, conv.beta, conv.mean, conv.variance, epsilon), Statistics { mean, variance })
    };
    let y = if settings.slope == 1.0 { y } else { activation::leaky_relu(y, f64::from(settings.slope)) };
    (channels_last(y), statistics)
}

pub fn residual(x: Tensor<4>, squeeze: ConvNorm, expand: ConvNorm, settings: NormSettings) -> (Tensor<4>, [Statistics; 2]) {
    let (inner, first) = conv_norm(x.clone(), squeeze, settings);
    let (y, second) = conv_norm(inner, expand, settings);
    (x + y, [first, second])
}

pub fn conv_bias(x: Tensor<4>, weight: Tensor<4>, bias: Tensor<1>, stride: usize) -> Tensor<4> {
    let options = options(&weight, stride);
    channels_last(conv2d(channels_first(x), weight, Some(bias), options))
}

pub fn upsample(x: Tensor<4>) -> Tensor<4> {
    let options = InterpolateOptions::new(InterpolateMode::Nearest).with_scale_factor([2.0, 2.0]);
    channels_last(interpolate(channels_first(x), options))
}

pub fn max_pool(x: Tensor<4>, stride: usize) -> Tensor<4> {
    let end = usize::from(stride == 1);
    let options =
        MaxPoolOptions { kernel_size: [2; 2], stride: [stride; 2], padding: [(0, end), (0, end)], dilation: [1; 2], ceil_mode: false };
    channels_last(max_pool2d(channels_first(x), options))
}

pub fn wrap(x: Tensor<4>, first: usize, count: usize, margin: usize) -> Tensor<4> {
    let columns = (0..count + 2 * margin).map(|k| x.clone().narrow(2, first + (k + count * margin - margin) % count, 1));
    Tensor::cat(columns.collect(), 2)
}

pub fn around(x: Tensor<4>, first: usize, count: usize, arc: usize) -> Tensor<4> {
    let [batch, height, _, channels] = x.dims();
    let wrapped = wrap(x, first, count, arc / 2).swap_dims(1, 2);
    let turned = |k| wrapped.clone().narrow(1, k, count).reshape([batch, 1, count, height * channels]);
    Tensor::cat((0..arc).map(turned).collect(), 3)
}
