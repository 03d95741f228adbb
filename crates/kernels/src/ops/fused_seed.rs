//! A loss that is computed outside the graph enters it by its gradient.
use super::fused::{register, tensor};
use burn::{
    backend::{
        Autodiff, Dispatch, Flex,
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

/// The operation, on the backends that have it.
#[backend_extension(Flex, Autodiff)]
pub trait GradientSeed: burn::backend::Backend {
    /// A zero whose gradient with respect to `x` is `gradient`.
    fn gradient_seed(x: FloatTensor<Self>, gradient: FloatTensor<Self>) -> FloatTensor<Self>;
}

pub fn seed(x: Tensor<4>, gradient: Tensor<4>) -> Tensor<1> {
    Tensor::from_dispatch(Dispatch::gradient_seed(x.into_dispatch(), gradient.into_dispatch()))
}

impl GradientSeed for Flex {
    fn gradient_seed(_: FlexTensor, _: FlexTensor) -> FlexTensor {
        tensor(vec![0.0], [1])
    }
}

#[derive(Debug)]
struct SeedBackward;

impl Backward<Flex, 1> for SeedBackward {
    type State = FlexTensor;

    fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, _: &mut Checkpointer) {
        // The seeds are summed and walked back from, so that what arrives is 1.
        let _ = grads.consume::<Flex>(&ops.node);
        let [parent] = ops.parents.map(|p| p.map(|node| node.id));
        register(grads, parent, || ops.state);
    }
}

impl<C: CheckpointStrategy> GradientSeed for Autodiff<Flex, C> {
    fn gradient_seed(x: FloatTensor<Self>, gradient: FloatTensor<Self>) -> FloatTensor<Self> {
        let zero = tensor(vec![0.0], [1]);
        match SeedBackward.prepare::<C>([x.node()]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(gradient.into_primitive(), zero),
            OpsKind::UnTracked(prep) => prep.finish(zero),
        }
    }
}
