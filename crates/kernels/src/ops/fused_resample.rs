//! Upsampling and max pooling as single operations of burn's Flex backend.
use super::fused::{register, tensor, values};
use crate::resample;
use burn::{
    backend::{
        Autodiff, Dispatch, Flex, TensorMetadata,
        autodiff::{
            checkpoint::{base::Checkpointer, strategy::CheckpointStrategy},
            grads::Gradients,
            ops::{Backward, Ops, OpsKind},
        },
        backend_extension,
        flex::FlexTensor,
        tensor::FloatTensor,
    },
    tensor::Tensor,
};
use std::sync::Arc;

/// The fused operations, on the backends that have them.
#[backend_extension(Flex, Autodiff)]
pub trait FusedResampling: burn::backend::Backend {
    /// Each pixel repeated 2 x 2.
    fn fused_upsample(x: FloatTensor<Self>) -> FloatTensor<Self>;
    /// Maximum over 2 x 2.
    fn fused_max_pool(x: FloatTensor<Self>, stride: usize) -> FloatTensor<Self>;
}

pub fn upsample(x: Tensor<4>) -> Tensor<4> {
    Tensor::from_dispatch(Dispatch::fused_upsample(x.into_dispatch()))
}

pub fn max_pool(x: Tensor<4>, stride: usize) -> Tensor<4> {
    Tensor::from_dispatch(Dispatch::fused_max_pool(x.into_dispatch(), stride))
}

fn pooled(x: &FlexTensor, stride: usize) -> (FlexTensor, Vec<u8>) {
    let [batch, height, width, channels] = x.shape().dims();
    let (y, winners) = resample::max_pool(values(x), [batch, height, width, channels], stride);
    (tensor(y, [batch, height.div_ceil(stride), width.div_ceil(stride), channels]), winners)
}

impl FusedResampling for Flex {
    fn fused_upsample(x: FlexTensor) -> FlexTensor {
        let x = x.to_contiguous();
        let [batch, height, width, channels] = x.shape().dims();
        tensor(resample::upsample(values(&x), [batch, height, width, channels]), [batch, 2 * height, 2 * width, channels])
    }

    fn fused_max_pool(x: FlexTensor, stride: usize) -> FlexTensor {
        pooled(&x.to_contiguous(), stride).0
    }
}

#[derive(Debug)]
struct UpsampleBackward;

impl Backward<Flex, 1> for UpsampleBackward {
    type State = [usize; 4];

    fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, _: &mut Checkpointer) {
        let gradient = grads.consume::<Flex>(&ops.node).to_contiguous();
        let [parent] = ops.parents.map(|p| p.map(|node| node.id));
        register(grads, parent, || tensor(resample::upsample_gradient(values(&gradient), ops.state), ops.state));
    }
}

#[derive(Debug)]
struct MaxPoolBackward;

impl Backward<Flex, 1> for MaxPoolBackward {
    type State = ([usize; 4], usize, Arc<Vec<u8>>);

    fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, _: &mut Checkpointer) {
        let gradient = grads.consume::<Flex>(&ops.node).to_contiguous();
        let [parent] = ops.parents.map(|p| p.map(|node| node.id));
        let (size, stride, winners) = ops.state;
        register(grads, parent, || tensor(resample::max_pool_gradient(values(&gradient), &winners, size, stride), size));
    }
}

impl<C: CheckpointStrategy> FusedResampling for Autodiff<Flex, C> {
    fn fused_upsample(x: FloatTensor<Self>) -> FloatTensor<Self> {
        let y = Flex::fused_upsample(x.primitive().clone());
        match UpsampleBackward.prepare::<C>([x.node()]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(x.primitive().shape().dims(), y),
            OpsKind::UnTracked(prep) => prep.finish(y),
        }
    }

    fn fused_max_pool(x: FloatTensor<Self>, stride: usize) -> FloatTensor<Self> {
        let (y, winners) = pooled(&x.primitive().to_contiguous(), stride);
        match MaxPoolBackward.prepare::<C>([x.node()]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((x.primitive().shape().dims(), stride, Arc::new(winners)), y),
            OpsKind::UnTracked(prep) => prep.finish(y),
        }
    }
}
