//! Convolutions with what surrounds them as single operations of burn's Flex backend, with backward passes written by hand.
//!
//! The forward pass of a normalised convolution keeps its raw result `z` and nothing else; the backward pass turns that buffer into the
//! gradient of `z`. A residual unit keeps two of them: its inner activation is recomputed as the next convolution reads it.
use super::{ConvNorm, NormSettings, Statistics};
use crate::{
    ConvShape, Isa,
    buffer::buffer,
    conv::{self, Epilogue},
    norm::{self, Affine},
    pack,
    weight_gradient::weight_gradient,
};
use burn::{
    backend::{
        Autodiff, AutodiffBackend, Dispatch, Flex, TensorMetadata,
        autodiff::{
            NodeId,
            checkpoint::{base::Checkpointer, strategy::CheckpointStrategy},
            grads::Gradients,
            ops::{Backward, Ops, OpsKind},
        },
        backend_extension,
        flex::{FlexTensor, Layout},
        tensor::FloatTensor,
    },
    tensor::{Bytes, DType, Shape, Tensor},
};
use std::sync::Arc;

/// The fused operations, on the backends that have them.
#[backend_extension(Flex, Autodiff)]
pub trait FusedConvolutions: burn::backend::Backend {
    /// Output, mean, variance.
    #[allow(clippy::too_many_arguments)]
    fn fused_conv_norm(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        mean: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        settings: NormSettings,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>);

    /// Output, and mean and variance of both convolutions.
    #[allow(clippy::too_many_arguments, clippy::type_complexity)]
    fn fused_residual(
        x: FloatTensor<Self>,
        weight_1: FloatTensor<Self>,
        gamma_1: FloatTensor<Self>,
        beta_1: FloatTensor<Self>,
        mean_1: FloatTensor<Self>,
        variance_1: FloatTensor<Self>,
        weight_2: FloatTensor<Self>,
        gamma_2: FloatTensor<Self>,
        beta_2: FloatTensor<Self>,
        mean_2: FloatTensor<Self>,
        variance_2: FloatTensor<Self>,
        settings: NormSettings,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>);

    /// Convolution with bias, stride 1.
    fn fused_conv_bias(x: FloatTensor<Self>, weight: FloatTensor<Self>, bias: FloatTensor<Self>) -> FloatTensor<Self>;
}

pub fn conv_norm(x: Tensor<4>, conv: ConvNorm, settings: NormSettings) -> (Tensor<4>, Statistics) {
    let ConvNorm { weight, gamma, beta, mean, variance } = conv;
    let (y, mean, variance) = Dispatch::fused_conv_norm(
        x.into_dispatch(),
        weight.into_dispatch(),
        gamma.into_dispatch(),
        beta.into_dispatch(),
        mean.into_dispatch(),
        variance.into_dispatch(),
        settings,
    );
    (Tensor::from_dispatch(y), Statistics { mean: Tensor::from_dispatch(mean), variance: Tensor::from_dispatch(variance) })
}

pub fn residual(x: Tensor<4>, squeeze: ConvNorm, expand: ConvNorm, settings: NormSettings) -> (Tensor<4>, [Statistics; 2]) {
    let (y, mean_1, variance_1, mean_2, variance_2) = Dispatch::fused_residual(
        x.into_dispatch(),
        squeeze.weight.into_dispatch(),
        squeeze.gamma.into_dispatch(),
        squeeze.beta.into_dispatch(),
        squeeze.mean.into_dispatch(),
        squeeze.variance.into_dispatch(),
        expand.weight.into_dispatch(),
        expand.gamma.into_dispatch(),
        expand.beta.into_dispatch(),
        expand.mean.into_dispatch(),
        expand.variance.into_dispatch(),
        settings,
    );
    let first = Statistics { mean: Tensor::from_dispatch(mean_1), variance: Tensor::from_dispatch(variance_1) };
    let second = Statistics { mean: Tensor::from_dispatch(mean_2), variance: Tensor::from_dispatch(variance_2) };
    (Tensor::from_dispatch(y), [first, second])
}

pub fn conv_bias(x: Tensor<4>, weight: Tensor<4>, bias: Tensor<1>) -> Tensor<4> {
    Tensor::from_dispatch(Dispatch::fused_conv_bias(x.into_dispatch(), weight.into_dispatch(), bias.into_dispatch()))
}

/// A tensor that owns `values`.
pub(super) fn tensor(values: Vec<f32>, shape: impl Into<Shape>) -> FlexTensor {
    FlexTensor::new(Bytes::from_elems(values), Layout::contiguous(shape.into()), DType::F32)
}

/// The tensor with its values in order. The view of planes as channels, in which images and the heads' gradients arrive, is copied by all
/// threads; burn's own copy takes one.
pub(super) fn contiguous(x: &FlexTensor) -> FlexTensor {
    let [batch, height, width, channels] = x.shape().dims();
    let (plane, layout) = (height * width, x.layout());
    let view = [channels * plane, width, 1, plane].map(|s| s as isize);
    let whole = layout.start_offset() == 0 && x.storage::<f32>().len() == batch * plane * channels;
    if channels > 1 && plane > 1 && whole && layout.strides() == view {
        return tensor(crate::resample::interleave(x.storage(), batch, plane, channels), [batch, height, width, channels]);
    }
    x.to_contiguous()
}

/// The values of a tensor that was made contiguous.
#[expect(clippy::expect_used, reason = "callers hand over what `contiguous` returned, and the backend's floats are f32")]
pub(super) fn values(tensor: &FlexTensor) -> &[f32] {
    tensor.as_slice().expect("a contiguous f32 tensor")
}

/// Hands a gradient to a parent that wants one.
pub(super) fn register(grads: &mut Gradients, parent: Option<NodeId>, gradient: impl FnOnce() -> FlexTensor) {
    if let Some(id) = parent {
        grads.register::<Flex>(id, gradient());
    }
}

fn shape_of(x: &FlexTensor, weight: &FlexTensor, stride: usize) -> ConvShape {
    let [batch, height, width, in_channels] = x.shape().dims();
    let [out_channels, _, kernel, _] = weight.shape().dims();
    ConvShape { batch, height, width, in_channels, out_channels, kernel, stride }
}

fn out_shape(shape: &ConvShape) -> [usize; 4] {
    [shape.batch, shape.out_height(), shape.out_width(), shape.out_channels]
}

/// One convolution with its norm, as a forward pass leaves it for the backward pass.
#[derive(Debug, Clone)]
struct Saved {
    shape: ConvShape,
    weight: FlexTensor,
    affine: Affine,
    /// The raw convolution; shared only if the graph is walked twice.
    z: Arc<Vec<f32>>,
}

/// Parameters of one convolution with norm, contiguous.
struct Parameters {
    weight: FlexTensor,
    gamma: FlexTensor,
    beta: FlexTensor,
    mean: FlexTensor,
    variance: FlexTensor,
}

impl Parameters {
    fn new(weight: &FlexTensor, gamma: &FlexTensor, beta: &FlexTensor, mean: &FlexTensor, variance: &FlexTensor) -> Self {
        let [weight, gamma, beta, mean, variance] = [weight, gamma, beta, mean, variance].map(FlexTensor::to_contiguous);
        Self { weight, gamma, beta, mean, variance }
    }

    /// The raw convolution of `x` (activated on the way in, where asked for) and the affine map that normalises it.
    fn convolve(
        &self,
        isa: Isa,
        shape: ConvShape,
        x: &[f32],
        activation: Option<crate::Activation>,
        settings: NormSettings,
    ) -> (Saved, [FlexTensor; 2]) {
        let packed = pack::forward(isa, &shape, values(&self.weight));
        let mut z = buffer(shape.output_len());
        let sums = conv::forward_with_statistics(&shape, x, activation, &packed, &mut z);
        let (mean, variance) = if settings.batch_statistics {
            norm::mean_and_variance(&sums, shape.out_pixels())
        } else {
            (values(&self.mean).to_vec(), values(&self.variance).to_vec())
        };
        let statistics = [tensor(mean.clone(), [mean.len()]), tensor(variance.clone(), [variance.len()])];
        let affine = Affine::new(mean, &variance, values(&self.gamma), values(&self.beta), settings.epsilon);
        (Saved { shape, weight: self.weight.clone(), affine, z: Arc::new(z) }, statistics)
    }

    /// Without a backward pass to come and with given statistics, the norm is folded into weights and bias.
    fn infer(&self, isa: Isa, shape: ConvShape, x: &[f32], residual: Option<&[f32]>, settings: NormSettings) -> Vec<f32> {
        let affine =
            Affine::new(values(&self.mean).to_vec(), values(&self.variance), values(&self.gamma), values(&self.beta), settings.epsilon);
        let inputs = shape.weight_len() / shape.out_channels;
        let folded: Vec<f32> =
            values(&self.weight).chunks(inputs).zip(&affine.scale).flat_map(|(row, s)| row.iter().map(move |w| w * s)).collect();
        let packed = pack::forward(isa, &shape, &folded);
        let mut y = buffer(shape.output_len());
        conv::forward_activated(&shape, x, &packed, Epilogue { bias: &affine.shift, slope: settings.slope, residual }, &mut y);
        y
    }
}

/// What comes back from one convolution's backward pass.
struct ConvGradients {
    dz: Vec<f32>,
    gamma: FlexTensor,
    beta: FlexTensor,
}

impl Saved {
    fn activate(&self, isa: Isa, slope: f32, residual: Option<&[f32]>) -> Vec<f32> {
        let mut y = buffer(self.z.len());
        norm::activate(isa, &self.z, self.affine.activation(slope), residual, &mut y);
        y
    }

    /// The gradients of z, gamma and beta from that of the activated output.
    fn backward(&mut self, isa: Isa, gradient: &[f32], settings: NormSettings) -> ConvGradients {
        let mut dz = Arc::try_unwrap(std::mem::take(&mut self.z)).unwrap_or_else(|shared| (*shared).clone());
        let g = norm::backward(isa, gradient, &self.affine, settings.slope, !settings.batch_statistics, &mut dz);
        let channels = [g.gamma.len()];
        ConvGradients { dz, gamma: tensor(g.gamma, channels), beta: tensor(g.beta, channels) }
    }
}

impl FusedConvolutions for Flex {
    fn fused_conv_norm(
        x: FlexTensor,
        weight: FlexTensor,
        gamma: FlexTensor,
        beta: FlexTensor,
        mean: FlexTensor,
        variance: FlexTensor,
        settings: NormSettings,
    ) -> (FlexTensor, FlexTensor, FlexTensor) {
        let (isa, x) = (Isa::detect(), contiguous(&x));
        let parameters = Parameters::new(&weight, &gamma, &beta, &mean, &variance);
        let shape = shape_of(&x, &weight, settings.stride);
        if !settings.batch_statistics {
            return (tensor(parameters.infer(isa, shape, values(&x), None, settings), out_shape(&shape)), mean, variance);
        }
        let (saved, [mean, variance]) = parameters.convolve(isa, shape, values(&x), None, settings);
        (tensor(saved.activate(isa, settings.slope, None), out_shape(&shape)), mean, variance)
    }

    fn fused_residual(
        x: FlexTensor,
        weight_1: FlexTensor,
        gamma_1: FlexTensor,
        beta_1: FlexTensor,
        mean_1: FlexTensor,
        variance_1: FlexTensor,
        weight_2: FlexTensor,
        gamma_2: FlexTensor,
        beta_2: FlexTensor,
        mean_2: FlexTensor,
        variance_2: FlexTensor,
        settings: NormSettings,
    ) -> (FlexTensor, FlexTensor, FlexTensor, FlexTensor, FlexTensor) {
        let (isa, x) = (Isa::detect(), contiguous(&x));
        let first = Parameters::new(&weight_1, &gamma_1, &beta_1, &mean_1, &variance_1);
        let second = Parameters::new(&weight_2, &gamma_2, &beta_2, &mean_2, &variance_2);
        let shape = shape_of(&x, &weight_1, 1);
        if !settings.batch_statistics {
            let inner = first.infer(isa, shape, values(&x), None, settings);
            let inner_shape = ConvShape { in_channels: shape.out_channels, out_channels: shape.in_channels, kernel: 3, ..shape };
            let y = second.infer(isa, inner_shape, &inner, Some(values(&x)), settings);
            return (tensor(y, out_shape(&inner_shape)), mean_1, variance_1, mean_2, variance_2);
        }
        let unit = ResidualUnit::forward(isa, &x, &first, &second, settings);
        let ([mean_1, variance_1], [mean_2, variance_2]) = unit.statistics;
        (unit.output, mean_1, variance_1, mean_2, variance_2)
    }

    fn fused_conv_bias(x: FlexTensor, weight: FlexTensor, bias: FlexTensor) -> FlexTensor {
        let (isa, x, weight, bias) = (Isa::detect(), contiguous(&x), weight.to_contiguous(), bias.to_contiguous());
        let shape = shape_of(&x, &weight, 1);
        let mut y = buffer(shape.output_len());
        let packed = pack::forward(isa, &shape, values(&weight));
        conv::forward_activated(&shape, values(&x), &packed, Epilogue { bias: values(&bias), slope: 1.0, residual: None }, &mut y);
        tensor(y, out_shape(&shape))
    }
}

/// The forward pass of a residual unit.
struct ResidualUnit {
    output: FlexTensor,
    saved: [Saved; 2],
    statistics: ([FlexTensor; 2], [FlexTensor; 2]),
}

impl ResidualUnit {
    fn forward(isa: Isa, x: &FlexTensor, first: &Parameters, second: &Parameters, settings: NormSettings) -> Self {
        let shape = shape_of(x, &first.weight, 1);
        let (inner, inner_statistics) = first.convolve(isa, shape, values(x), None, settings);
        let outer_shape = ConvShape { in_channels: shape.out_channels, out_channels: shape.in_channels, kernel: 3, ..shape };
        let activation = inner.affine.activation(settings.slope);
        let (outer, outer_statistics) = second.convolve(isa, outer_shape, &inner.z, Some(activation), settings);
        let output = tensor(outer.activate(isa, settings.slope, Some(values(x))), out_shape(&outer_shape));
        Self { output, saved: [inner, outer], statistics: (inner_statistics, outer_statistics) }
    }
}

#[derive(Debug)]
struct ConvNormBackward;

impl Backward<Flex, 4> for ConvNormBackward {
    type State = (FlexTensor, Saved, NormSettings);

    fn backward(self, ops: Ops<Self::State, 4>, grads: &mut Gradients, _: &mut Checkpointer) {
        let isa = Isa::detect();
        let gradient = contiguous(&grads.consume::<Flex>(&ops.node));
        let [x_node, weight_node, gamma_node, beta_node] = ops.parents.map(|p| p.map(|node| node.id));
        let (x, mut saved, settings) = ops.state;
        let ConvGradients { dz, gamma, beta } = saved.backward(isa, values(&gradient), settings);
        drop(gradient);
        register(grads, gamma_node, || gamma);
        register(grads, beta_node, || beta);
        register(grads, weight_node, || tensor(weight_gradient(isa, &saved.shape, values(&x), None, &dz), saved.weight.shape()));
        register(grads, x_node, || {
            let mut dx = buffer(saved.shape.input_len());
            conv::input_gradient(isa, &saved.shape, &dz, values(&saved.weight), false, &mut dx);
            tensor(dx, x.shape())
        });
    }
}

#[derive(Debug)]
struct ResidualBackward;

impl Backward<Flex, 7> for ResidualBackward {
    type State = (FlexTensor, [Saved; 2], NormSettings);

    fn backward(self, ops: Ops<Self::State, 7>, grads: &mut Gradients, _: &mut Checkpointer) {
        let isa = Isa::detect();
        let mut gradient = contiguous(&grads.consume::<Flex>(&ops.node));
        let [x_node, weight_1, gamma_1, beta_1, weight_2, gamma_2, beta_2] = ops.parents.map(|p| p.map(|node| node.id));
        let (x, [mut inner, mut outer], settings) = ops.state;

        let second = outer.backward(isa, values(&gradient), settings);
        register(grads, gamma_2, || second.gamma);
        register(grads, beta_2, || second.beta);
        register(grads, weight_2, || {
            let activation = inner.affine.activation(settings.slope);
            tensor(weight_gradient(isa, &outer.shape, &inner.z, Some(activation), &second.dz), outer.weight.shape())
        });
        let mut d_inner = buffer(outer.shape.input_len());
        conv::input_gradient(isa, &outer.shape, &second.dz, values(&outer.weight), false, &mut d_inner);
        drop(second.dz);

        let first = inner.backward(isa, &d_inner, settings);
        drop(d_inner);
        register(grads, gamma_1, || first.gamma);
        register(grads, beta_1, || first.beta);
        register(grads, weight_1, || tensor(weight_gradient(isa, &inner.shape, values(&x), None, &first.dz), inner.weight.shape()));
        register(grads, x_node, || {
            // The shortcut hands its gradient on; the branch adds to it, in place where nobody else holds it.
            conv::input_gradient(isa, &inner.shape, &first.dz, values(&inner.weight), true, gradient.storage_mut());
            gradient
        });
    }
}

#[derive(Debug)]
struct ConvBiasBackward;

impl Backward<Flex, 3> for ConvBiasBackward {
    type State = (FlexTensor, FlexTensor);

    fn backward(self, ops: Ops<Self::State, 3>, grads: &mut Gradients, _: &mut Checkpointer) {
        let isa = Isa::detect();
        let gradient = contiguous(&grads.consume::<Flex>(&ops.node));
        let [x_node, weight_node, bias_node] = ops.parents.map(|p| p.map(|node| node.id));
        let (x, weight) = ops.state;
        let shape = shape_of(&x, &weight, 1);
        let dz = values(&gradient);
        register(grads, bias_node, || {
            let mut sums = vec![0f64; shape.out_channels];
            for pixel in dz.chunks_exact(shape.out_channels) {
                sums.iter_mut().zip(pixel).for_each(|(s, g)| *s += f64::from(*g));
            }
            tensor(sums.iter().map(|s| *s as f32).collect(), [shape.out_channels])
        });
        register(grads, weight_node, || tensor(weight_gradient(isa, &shape, values(&x), None, dz), weight.shape()));
        register(grads, x_node, || {
            let mut dx = buffer(shape.input_len());
            conv::input_gradient(isa, &shape, dz, values(&weight), false, &mut dx);
            tensor(dx, x.shape())
        });
    }
}

impl<C: CheckpointStrategy> FusedConvolutions for Autodiff<Flex, C> {
    fn fused_conv_norm(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        beta: FloatTensor<Self>,
        mean: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        settings: NormSettings,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        let nodes = [x.node(), weight.node(), gamma.node(), beta.node()];
        let parameters = Parameters::new(weight.primitive(), gamma.primitive(), beta.primitive(), mean.primitive(), variance.primitive());
        let isa = Isa::detect();
        match ConvNormBackward.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let x = contiguous(x.primitive());
                let shape = shape_of(&x, &parameters.weight, settings.stride);
                let (saved, [mean, variance]) = parameters.convolve(isa, shape, values(&x), None, settings);
                let y = tensor(saved.activate(isa, settings.slope, None), out_shape(&shape));
                (prep.finish((x, saved, settings), y), untracked::<C>(mean), untracked::<C>(variance))
            }
            OpsKind::UnTracked(prep) => {
                let [x, weight, gamma, beta, mean, variance] = [x, weight, gamma, beta, mean, variance].map(|t| t.primitive().clone());
                let (y, mean, variance) = Flex::fused_conv_norm(x, weight, gamma, beta, mean, variance, settings);
                (prep.finish(y), untracked::<C>(mean), untracked::<C>(variance))
            }
        }
    }

    fn fused_residual(
        x: FloatTensor<Self>,
        weight_1: FloatTensor<Self>,
        gamma_1: FloatTensor<Self>,
        beta_1: FloatTensor<Self>,
        mean_1: FloatTensor<Self>,
        variance_1: FloatTensor<Self>,
        weight_2: FloatTensor<Self>,
        gamma_2: FloatTensor<Self>,
        beta_2: FloatTensor<Self>,
        mean_2: FloatTensor<Self>,
        variance_2: FloatTensor<Self>,
        settings: NormSettings,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        let nodes = [x.node(), weight_1.node(), gamma_1.node(), beta_1.node(), weight_2.node(), gamma_2.node(), beta_2.node()];
        let isa = Isa::detect();
        match ResidualBackward.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let x = contiguous(x.primitive());
                let first = Parameters::new(
                    weight_1.primitive(),
                    gamma_1.primitive(),
                    beta_1.primitive(),
                    mean_1.primitive(),
                    variance_1.primitive(),
                );
                let second = Parameters::new(
                    weight_2.primitive(),
                    gamma_2.primitive(),
                    beta_2.primitive(),
                    mean_2.primitive(),
                    variance_2.primitive(),
                );
                let unit = ResidualUnit::forward(isa, &x, &first, &second, settings);
                let y = prep.finish((x, unit.saved, settings), unit.output);
                let ([m1, v1], [m2, v2]) = unit.statistics;
                (y, untracked::<C>(m1), untracked::<C>(v1), untracked::<C>(m2), untracked::<C>(v2))
            }
            OpsKind::UnTracked(prep) => {
                let p = |t: &FloatTensor<Self>| t.primitive().clone();
                let (y, m1, v1, m2, v2) = Flex::fused_residual(
                    p(&x),
                    p(&weight_1),
                    p(&gamma_1),
                    p(&beta_1),
                    p(&mean_1),
                    p(&variance_1),
                    p(&weight_2),
                    p(&gamma_2),
                    p(&beta_2),
                    p(&mean_2),
                    p(&variance_2),
                    settings,
                );
                (prep.finish(y), untracked::<C>(m1), untracked::<C>(v1), untracked::<C>(m2), untracked::<C>(v2))
            }
        }
    }

    fn fused_conv_bias(x: FloatTensor<Self>, weight: FloatTensor<Self>, bias: FloatTensor<Self>) -> FloatTensor<Self> {
        match ConvBiasBackward.prepare::<C>([x.node(), weight.node(), bias.node()]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let (x, weight) = (contiguous(x.primitive()), weight.primitive().to_contiguous());
                let y = Flex::fused_conv_bias(x.clone(), weight.clone(), bias.into_primitive());
                prep.finish((x, weight), y)
            }
            OpsKind::UnTracked(prep) => {
                let y = Flex::fused_conv_bias(x.primitive().clone(), weight.primitive().clone(), bias.into_primitive());
                prep.finish(y)
            }
        }
    }
}

fn untracked<C: CheckpointStrategy>(primitive: FlexTensor) -> FloatTensor<Autodiff<Flex, C>> {
    <Autodiff<Flex, C> as AutodiffBackend>::from_inner(primitive)
}
