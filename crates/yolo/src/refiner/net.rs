//! The refiner's network: convolutions over the view, then around the circle, then what all directions say together.
use super::{
    frame::Frame,
    polar::{COLUMNS, MARGIN, RAYS, RINGS, UnitBox},
};
use crate::{
    blocks::{ConvBlock, values},
    error::YoloError,
    graph::{Conv, Graph},
    network::Network,
    weights::Weights,
};
use burn::{
    module::Module,
    tensor::{Device, Tensor, TensorData},
};
use tcross_kernels::ops::{self, Path};

/// What stands inside batch norm's root.
const EPSILON: f64 = 1e-5;
/// Weight of a batch in the running averages.
const MOMENTUM: f64 = 0.01;

/// Channels of the convolutions over the view: one at full size, two at half, two at a quarter.
const VIEW_CHANNELS: [usize; 5] = [16, 32, 32, 48, 64];
/// After which of them the view is halved.
const POOLED_AFTER: [usize; 2] = [0, 2];
/// How many directions each layer around the circle sees.
const ARCS: [usize; 3] = [5, 7, 7];
/// Channels around the circle, and of the layer that sees all directions.
const CHANNELS: usize = 64;
/// Directions that are left around the circle.
const DIRECTIONS: usize = RAYS / 4;
/// Distances that are left.
const DISTANCES: usize = RINGS / 4;

/// Logits: of its being a marker where a box is looked at, and where its frame is.
const LOGITS: usize = 2;
/// Numbers of a box and of a frame.
const PLACES: usize = 4 + 5;
/// Numbers that the network says of a view.
pub const OUTPUTS: usize = LOGITS + PLACES;
/// How far a box's sides and a frame move for an output of 1, in half sides.
const REACH: f32 = 0.1;
/// Where they lie for outputs of 0: the box where it is looked for, the frame as that of a marker between upright and standing on a corner.
const START: [f32; PLACES] = [-1.0, -1.0, 1.0, 1.0, 0.0, 0.0, 0.8, 0.8, 0.0];

/// What the network says of a view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Opinion {
    /// Logits of its being a marker: if the view is of a box, and if it is of a marker's frame.
    pub logits: [f32; LOGITS],
    /// Where the marker's box lies, in the view's units; it means nothing in a view of a frame.
    pub bounds: UnitBox,
    /// Its frame, in the view's units.
    pub frame: Frame,
}

impl Opinion {
    /// From the network's [`OUTPUTS`].
    ///
    /// # Panics
    /// If there are fewer.
    #[must_use]
    pub fn of(outputs: &[f32]) -> Self {
        let [left, top, right, bottom, x, y, xx, yy, xy]: [f32; PLACES] = std::array::from_fn(|k| START[k] + REACH * outputs[LOGITS + k]);
        Self {
            logits: [outputs[0], outputs[1]],
            bounds: [left, top, right, bottom],
            frame: Frame { center: [x, y], axes: [[xx, xy], [xy, yy]] },
        }
    }

    /// The gradient with respect to the outputs, from that with respect to the logits, the box and the frame's centre, stretch along x and
    /// y, and slant.
    #[must_use]
    pub fn gradient(logits: [f32; LOGITS], bounds: [f32; 4], frame: [f32; 5]) -> [f32; OUTPUTS] {
        let mut out = [0.0; OUTPUTS];
        out[..LOGITS].copy_from_slice(&logits);
        out[LOGITS..].iter_mut().zip(bounds.iter().chain(&frame)).for_each(|(out, g)| *out = REACH * g);
        out
    }
}

/// The network.
#[derive(Module, Debug)]
pub struct RefinerNet {
    /// In file order: over the view, around the circle, all directions together, the logits, the box and the frame.
    pub convolutions: Vec<ConvBlock>,
    #[module(skip)]
    path: Path,
}

/// Its convolutions, as they are stored.
#[must_use]
pub fn layers() -> Graph {
    let conv = |in_channels, filters, kernel, hidden| Conv { in_channels, filters, kernel, stride: 1, batch_norm: hidden, leaky: hidden };
    let mut before = Graph::IMAGE_CHANNELS;
    let mut convs: Vec<Conv> = VIEW_CHANNELS.map(|channels| conv(std::mem::replace(&mut before, channels), channels, 3, true)).to_vec();
    before *= DISTANCES;
    convs.extend(ARCS.map(|arc| conv(arc * std::mem::replace(&mut before, CHANNELS), CHANNELS, 1, true)));
    convs.push(conv(3 * CHANNELS, CHANNELS, 1, true));
    convs.push(conv(CHANNELS, LOGITS, 1, false));
    convs.push(conv(DIRECTIONS * CHANNELS, PLACES, 1, false));
    Graph::of_convolutions(convs)
}

/// Adds to what all views' logits will be.
pub fn move_logits(weights: &mut Weights, by: f32) {
    let logits = weights.convolutions.iter_mut().rev().nth(1);
    logits.into_iter().flat_map(|layer| &mut layer.bias).for_each(|bias| *bias += by);
}

impl RefinerNet {
    /// A network with these parameters.
    ///
    /// # Errors
    /// If they do not fit.
    pub fn new(weights: &Weights, device: &Device) -> Result<Self, YoloError> {
        let layers = layers();
        weights.check(&layers)?;
        let block = |((_, conv), weights)| ConvBlock::new(conv, weights, EPSILON, MOMENTUM, device);
        let convolutions = layers.convolutions().zip(&weights.convolutions).map(block).collect();
        Ok(Self { convolutions, path: Path::for_device(device) })
    }

    /// Views `[batch, 3, RINGS, COLUMNS]` to `[batch, OUTPUTS, 1, 1]`.
    #[must_use]
    pub fn forward(&self, views: Tensor<4>) -> Tensor<4> {
        let (over_view, rest) = self.convolutions.split_at(VIEW_CHANNELS.len());
        let (around, rest) = rest.split_at(ARCS.len());
        let mut x = ops::channels_last(views);
        let batch = x.dims()[0];
        let mut count = RAYS;
        for (index, conv) in over_view.iter().enumerate() {
            x = conv.forward(x, self.path);
            if POOLED_AFTER.contains(&index) {
                // What the border has reached by now is half of the margin, which is made anew.
                x = ops::max_pool(self.path, x, 2);
                count /= 2;
                x = ops::wrap(self.path, x, MARGIN / 2, count, MARGIN);
            }
        }
        let mut first = MARGIN;
        for (conv, arc) in around.iter().zip(ARCS) {
            x = conv.forward(ops::around(self.path, x, first, DIRECTIONS, arc), self.path);
            first = 0;
        }
        let mean = x.clone().mean_dim(2);
        let spread = ((x.clone() - mean.clone()).powi_scalar(2).mean_dim(2) + EPSILON).sqrt();
        let together = ops::concat(vec![mean, x.clone().max_dim(2), spread]);
        let logits = rest[1].forward(rest[0].forward(together, self.path), self.path);
        let places = rest[2].forward(x.reshape([batch, 1, 1, DIRECTIONS * CHANNELS]), self.path);
        ops::channels_first(ops::concat(vec![logits, places]))
    }

    /// What it says of views, one behind the other.
    #[must_use]
    pub fn opinions(&self, views: Vec<f32>) -> Vec<Opinion> {
        let batch = views.len() / super::polar::VIEW;
        if batch == 0 {
            return Vec::new();
        }
        let device = self.convolutions[0].kernel.val().device();
        let views = Tensor::from_data(TensorData::new(views, [batch, 3, RINGS, COLUMNS]), &device);
        values(self.forward(views)).chunks_exact(OUTPUTS).map(Opinion::of).collect()
    }
}

impl Network for RefinerNet {
    fn convolutions(&self) -> &[ConvBlock] {
        &self.convolutions
    }
}

#[cfg(test)]
mod tests {
    use super::{super::polar::VIEW, *};
    use tcross_dataset::Rng;

    fn network(device: &Device) -> (RefinerNet, Weights) {
        let weights = Weights::init(&layers(), &crate::fields::BoxFields::plain(1), &Default::default(), 3);
        (RefinerNet::new(&weights, device).unwrap(), weights)
    }

    /// A view, turned by `rays`.
    fn view(rays: usize) -> Vec<f32> {
        let mut out = vec![0.0; VIEW];
        for (row, out) in out.chunks_exact_mut(COLUMNS).enumerate() {
            let mut rng = Rng::for_item(row as u64, "test/refiner", 0);
            let once: Vec<f32> = (0..RAYS).map(|_| rng.normal() as f32).collect();
            out.iter_mut().enumerate().for_each(|(k, v)| *v = once[(k + 2 * RAYS - MARGIN - rays) % RAYS]);
        }
        out
    }

    #[test]
    fn parameters_come_back_as_they_went_in() {
        let (network, weights) = network(&Device::flex());
        assert_eq!(Network::weights(&network), weights);
    }

    /// Turned by whole directions, the same is said of its being a marker, but not of where its box lies.
    #[test]
    fn turning_changes_no_logit() {
        let (network, _) = network(&Device::flex());
        let opinions = network.opinions([view(0), view(20), view(21)].concat());
        assert!((opinions[0].logits[1] - opinions[1].logits[1]).abs() < 1e-4, "{opinions:?}");
        assert!((opinions[0].logits[1] - opinions[2].logits[1]).abs() > 1e-4, "{opinions:?}");
        assert!(opinions[0].bounds.iter().zip(opinions[1].bounds).any(|(a, b)| (a - b).abs() > 1e-3), "{opinions:?}");
    }

    #[test]
    fn logits_move_and_nothing_else() {
        let (network, mut weights) = network(&Device::flex());
        move_logits(&mut weights, -1.5);
        let moved = RefinerNet::new(&weights, &Device::flex()).unwrap();
        let [a, b] = [&network, &moved].map(|network| network.opinions(view(0))[0]);
        assert!(a.logits.iter().zip(b.logits).all(|(a, b)| (a - 1.5 - b).abs() < 1e-5) && a.bounds == b.bounds && a.frame == b.frame);
    }

    /// Every parameter gets a gradient.
    #[test]
    fn all_of_it_learns() {
        let device = Device::flex().autodiff();
        let (network, _) = network(&device);
        let views = [view(0), view(3)].concat();
        let views = Tensor::from_data(TensorData::new(views, [2, 3, RINGS, COLUMNS]), &device);
        let gradients = network.forward(views).powi_scalar(2).sum().backward();
        for (index, block) in network.convolutions.iter().enumerate() {
            let gradient = block.kernel.val().grad(&gradients).map(values);
            assert!(gradient.is_some_and(|g| g.iter().any(|v| *v != 0.0)), "convolution {index}");
        }
    }
}
