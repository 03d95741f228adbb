//! Columns that go around a circle, as single operations of burn's Flex backend.
use super::fused::{register, tensor, values};
use crate::circle::Circle;
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

/// The fused operations, on the backends that have them.
#[backend_extension(Flex, Autodiff)]
pub trait FusedCircle: burn::backend::Backend {
    /// A circle with a margin on each side.
    fn fused_wrap(x: FloatTensor<Self>, first: usize, count: usize, margin: usize) -> FloatTensor<Self>;
    /// Each column of a circle with its neighbours.
    fn fused_around(x: FloatTensor<Self>, first: usize, count: usize, arc: usize) -> FloatTensor<Self>;
}

pub fn wrap(x: Tensor<4>, first: usize, count: usize, margin: usize) -> Tensor<4> {
    Tensor::from_dispatch(Dispatch::fused_wrap(x.into_dispatch(), first, count, margin))
}

pub fn around(x: Tensor<4>, first: usize, count: usize, arc: usize) -> Tensor<4> {
    Tensor::from_dispatch(Dispatch::fused_around(x.into_dispatch(), first, count, arc))
}

fn circle(x: &FlexTensor, first: usize, count: usize) -> Circle {
    Circle { size: x.shape().dims(), first, count }
}

impl FusedCircle for Flex {
    fn fused_wrap(x: FlexTensor, first: usize, count: usize, margin: usize) -> FlexTensor {
        let x = x.to_contiguous();
        let circle = circle(&x, first, count);
        let [batch, height, _, channels] = circle.size;
        tensor(circle.wrap(values(&x), margin), [batch, height, count + 2 * margin, channels])
    }

    fn fused_around(x: FlexTensor, first: usize, count: usize, arc: usize) -> FlexTensor {
        let x = x.to_contiguous();
        let circle = circle(&x, first, count);
        let [batch, height, _, channels] = circle.size;
        tensor(circle.around(values(&x), arc), [batch, 1, count, arc * height * channels])
    }
}

/// [`Circle::wrap_gradient`] or [`Circle::around_gradient`].
type Gradient = fn(&Circle, &[f32], usize) -> Vec<f32>;

#[derive(Debug)]
struct CircleBackward;

impl Backward<Flex, 1> for CircleBackward {
    /// The circle, its margin or arc, and the way back.
    type State = (Circle, usize, Gradient);

    fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, _: &mut Checkpointer) {
        let gradient = grads.consume::<Flex>(&ops.node).to_contiguous();
        let [parent] = ops.parents.map(|p| p.map(|node| node.id));
        let (circle, reach, back) = ops.state;
        register(grads, parent, || tensor(back(&circle, values(&gradient), reach), circle.size));
    }
}

/// What has become of `x`, to be walked back from.
fn tracked<C: CheckpointStrategy>(
    x: &FloatTensor<Autodiff<Flex, C>>,
    y: FlexTensor,
    state: (Circle, usize, Gradient),
) -> FloatTensor<Autodiff<Flex, C>> {
    match CircleBackward.prepare::<C>([x.node()]).compute_bound().stateful() {
        OpsKind::Tracked(prep) => prep.finish(state, y),
        OpsKind::UnTracked(prep) => prep.finish(y),
    }
}

impl<C: CheckpointStrategy> FusedCircle for Autodiff<Flex, C> {
    fn fused_wrap(x: FloatTensor<Self>, first: usize, count: usize, margin: usize) -> FloatTensor<Self> {
        let y = Flex::fused_wrap(x.primitive().clone(), first, count, margin);
        tracked::<C>(&x, y, (circle(x.primitive(), first, count), margin, Circle::wrap_gradient))
    }

    fn fused_around(x: FloatTensor<Self>, first: usize, count: usize, arc: usize) -> FloatTensor<Self> {
        let y = Flex::fused_around(x.primitive().clone(), first, count, arc);
        tracked::<C>(&x, y, (circle(x.primitive(), first, count), arc, Circle::around_gradient))
    }
}
