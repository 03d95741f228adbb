//! A network for inference alone, on the CPU: batch norm folded into the convolutions, no tensors, no allocation once warm.
use crate::{
    config::{ModelConfig, NetSize},
    error::YoloError,
    graph::{Conv, Graph},
    plan::{PlanStep, Step, plan},
    weights::{ConvWeights, Weights, fold::fold},
};
use rayon::prelude::*;
use tcross_kernels::{
    ConvShape, Isa,
    conv::{self, Epilogue},
    pack::{self, Panels},
    resample,
};

/// A convolution ready to run.
#[derive(Debug, Clone)]
struct Folded {
    conv: Conv,
    kernel: Kernel,
    bias: Vec<f32>,
}

#[derive(Debug, Clone)]
enum Kernel {
    /// For the fast kernels.
    Packed(Panels),
    /// `[out, in, kernel, kernel]`, of a shape for which there are none.
    Plain(Vec<f32>),
}

/// A value on its way through the network: one of the arena's buffers, read as `[height, width, channels]`.
#[derive(Debug, Clone, Copy, Default)]
struct Value {
    buffer: usize,
    height: usize,
    width: usize,
    channels: usize,
}

impl Value {
    fn len(&self) -> usize {
        self.height * self.width * self.channels
    }

    fn size(&self) -> [usize; 4] {
        [1, self.height, self.width, self.channels]
    }
}

/// Buffers that steps take and give back. The same frame takes the same ones again, so that after the first nothing is allocated.
#[derive(Debug, Clone, Default)]
struct Arena {
    buffers: Vec<Vec<f32>>,
    free: Vec<usize>,
}

impl Arena {
    /// The smallest free buffer that holds `len` values, or a new one.
    fn take(&mut self, len: usize) -> usize {
        let fit =
            (0..self.free.len()).filter(|&k| self.buffers[self.free[k]].len() >= len).min_by_key(|&k| self.buffers[self.free[k]].len());
        match fit {
            Some(k) => self.free.swap_remove(k),
            None => {
                self.buffers.push(vec![0.0; len]);
                self.buffers.len() - 1
            }
        }
    }

    fn values(&self, value: Value) -> &[f32] {
        &self.buffers[value.buffer][..value.len()]
    }

    /// Takes a buffer for `value` and lets `write` fill it.
    fn fill(&mut self, value: Value, write: impl FnOnce(&Self, &mut [f32])) -> Value {
        let buffer = self.take(value.len());
        let mut out = std::mem::take(&mut self.buffers[buffer]);
        write(self, &mut out[..value.len()]);
        self.buffers[buffer] = out;
        Value { buffer, ..value }
    }
}

/// A YOLO network that only infers. It gives what [`crate::Yolo`] gives without autodiff, up to rounding.
#[derive(Debug, Clone)]
pub struct InferenceNet {
    convolutions: Vec<Folded>,
    steps: Vec<PlanStep>,
    /// Values that a later step reads, by layer.
    kept: Vec<Option<Value>>,
    arena: Arena,
    heads: Vec<Vec<f32>>,
}

impl InferenceNet {
    /// Folds a network's parameters.
    ///
    /// # Errors
    /// If the description is not valid or the parameters do not fit it.
    pub fn new(config: &ModelConfig, weights: &Weights) -> Result<Self, YoloError> {
        config.validate()?;
        Self::from_graph(&config.graph()?, weights, config.epsilon)
    }

    /// A network of these layers with these parameters; `epsilon` stands inside batch norm's root.
    ///
    /// # Errors
    /// If the parameters do not fit the layers.
    pub fn from_graph(graph: &Graph, weights: &Weights, epsilon: f64) -> Result<Self, YoloError> {
        weights.check(graph)?;
        let isa = Isa::detect();
        let layers: Vec<_> = graph.convolutions().zip(&weights.convolutions).collect();
        let convolutions = layers.par_iter().map(|((_, conv), w)| ready(isa, conv, w, epsilon)).collect();
        let heads = graph.heads().map(|_| Vec::new()).collect();
        Ok(Self { convolutions, steps: plan(graph, true), kept: vec![None; graph.layers().len()], arena: Arena::default(), heads })
    }

    /// One image `[3, height, width]`, RGB in 0..1, to each head's raw logits `[anchors * fields, rows, columns]`, coarse first.
    ///
    /// # Panics
    /// If the image's length is not that of `net`.
    pub fn run(&mut self, image: &[f32], net: NetSize) -> &[Vec<f32>] {
        assert_eq!(image.len(), 3 * net.width * net.height, "an image of another size");
        // The whole frame among the workers: a layer that came to them from outside would wait, and now and then take memory.
        rayon::scope(|_| self.walk(image, net));
        &self.heads
    }

    fn walk(&mut self, image: &[f32], net: NetSize) {
        let mut kept = std::mem::take(&mut self.kept);
        kept.fill(None);
        let mut x = Value { buffer: self.arena.take(image.len()), height: net.height, width: net.width, channels: 3 };
        resample::interleave_into(image, 1, image.len() / 3, 3, &mut self.arena.buffers[x.buffer][..image.len()]);
        let steps = std::mem::take(&mut self.steps);
        let mut head = 0;
        for PlanStep { step, layer, kept: keep, dropped } in &steps {
            #[expect(clippy::expect_used, reason = "`plan` marks as kept, until their last reader, the layers that later steps read")]
            let read = |layer: &usize| kept[*layer].expect("the plan keeps what a later step reads");
            let y = match step {
                Step::Conv(index) => self.convolve(*index, x, None),
                Step::Residual { squeeze, expand } => {
                    let inner = self.convolve(*squeeze, x, None);
                    let y = self.convolve(*expand, inner, Some(x));
                    self.arena.free.push(inner.buffer);
                    y
                }
                Step::Add(from) => self.add(x, read(from)),
                Step::Concat(from) => self.concat(from.iter().map(read)),
                Step::Upsample => {
                    let y = Value { height: 2 * x.height, width: 2 * x.width, ..x };
                    self.arena.fill(y, |arena, out| resample::upsample_into(arena.values(x), x.size(), out))
                }
                Step::MaxPool(stride) => {
                    let y = Value { height: x.height.div_ceil(*stride), width: x.width.div_ceil(*stride), ..x };
                    self.arena.fill(y, |arena, out| resample::max_pool_into(arena.values(x), x.size(), *stride, out))
                }
                Step::Head => {
                    self.heads[head].resize(x.len(), 0.0);
                    resample::planes_into(self.arena.values(x), x.channels, &mut self.heads[head]);
                    head += 1;
                    x
                }
            };
            let still_read = |kept: &[Option<Value>], v: Value| kept.iter().flatten().any(|k| k.buffer == v.buffer);
            let before = std::mem::replace(&mut x, y);
            if *keep {
                kept[*layer] = Some(y);
            }
            if before.buffer != y.buffer && !still_read(&kept, before) {
                self.arena.free.push(before.buffer);
            }
            for &layer in dropped {
                if let Some(value) = kept[layer].take()
                    && value.buffer != x.buffer
                    && value.buffer != before.buffer
                    && !still_read(&kept, value)
                {
                    self.arena.free.push(value.buffer);
                }
            }
        }
        self.arena.free.clear();
        self.arena.free.extend(0..self.arena.buffers.len());
        self.steps = steps;
        self.kept = kept;
    }

    fn convolve(&mut self, index: usize, x: Value, residual: Option<Value>) -> Value {
        let Folded { conv, kernel, bias } = &self.convolutions[index];
        let shape = shape_of(conv, x.height, x.width);
        let slope = if conv.leaky { crate::blocks::LEAKY_SLOPE as f32 } else { 1.0 };
        let y = Value { buffer: 0, height: shape.out_height(), width: shape.out_width(), channels: shape.out_channels };
        self.arena.fill(y, |arena, out| {
            let epilogue = Epilogue { bias, slope, residual: residual.map(|r| arena.values(r)) };
            match kernel {
                Kernel::Packed(panels) => conv::forward_activated(&shape, arena.values(x), panels, epilogue, out),
                Kernel::Plain(weight) => conv::forward_plain(&shape, arena.values(x), weight, epilogue, out),
            }
        })
    }

    fn add(&mut self, x: Value, other: Value) -> Value {
        self.arena.fill(x, |arena, out| resample::add_into(arena.values(x), arena.values(other), out))
    }

    fn concat(&mut self, parts: impl Iterator<Item = Value> + Clone) -> Value {
        let all = parts.clone().map(|p| p.channels).sum();
        let size = parts.clone().next().unwrap_or_default();
        self.arena.fill(Value { channels: all, ..size }, |arena, out| {
            let mut first = 0;
            for part in parts {
                resample::concat_into(arena.values(part), part.channels, first, all, out);
                first += part.channels;
            }
        })
    }
}

fn shape_of(conv: &Conv, height: usize, width: usize) -> ConvShape {
    let Conv { in_channels, filters: out_channels, kernel, stride, .. } = *conv;
    ConvShape { batch: 1, height, width, in_channels, out_channels, kernel, stride }
}

/// A convolution with its batch norm folded in, in the form that its kernels read.
fn ready(isa: Isa, conv: &Conv, weights: &ConvWeights, epsilon: f64) -> Folded {
    let ConvWeights { kernel, bias, .. } = fold(weights, epsilon);
    let kernel = match tcross_kernels::covers(conv.kernel, conv.stride) {
        true => Kernel::Packed(pack::pack_once(isa, &shape_of(conv, 1, 1), &kernel)),
        false => Kernel::Plain(kernel),
    };
    Folded { conv: conv.clone(), kernel, bias }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Architecture, Yolo, network::read_logits};
    use burn::tensor::{Device, Tensor, TensorData};

    /// A cfg may have kernels for which there is no fast path, here 5x5 and a 1x1 of stride 2.
    #[test]
    fn other_kernels_equal_the_burn_module() {
        let conv = |size, stride, filters, activation| {
            format!("[convolutional]\nfilters={filters}\nsize={size}\nstride={stride}\npad=1\nactivation={activation}\n")
        };
        let head = "[yolo]\nmask=0\nanchors=10,14\nclasses=1\nnum=1\n";
        let body = conv(5, 1, 8, "leaky") + &conv(1, 2, 8, "leaky") + &conv(7, 2, 6, "linear") + head;
        let config = crate::weights::cfg::parse("odd.cfg", &format!("[net]\nwidth=64\nheight=32\n{body}")).unwrap();
        let weights = Weights::init(&config.graph().unwrap(), &config.fields(), &Default::default(), 3);
        let image: Vec<f32> = (0..3 * 64 * 32).map(|k| (k % 13) as f32 / 13.0).collect();
        let device = Device::flex();
        let network = Yolo::new(&config, &weights, &device).unwrap();
        let want = read_logits(&network.forward(Tensor::from_data(TensorData::new(image.clone(), [1, 3, 32, 64]), &device))[0]);
        let mut net = InferenceNet::new(&config, &weights).unwrap();
        let got = &net.run(&image, config.input)[0];
        assert!(got.len() == want.len() && got.iter().zip(&want).all(|(a, b)| (a - b).abs() < 1e-4 * (1.0 + b.abs())));
    }

    #[test]
    fn equals_the_burn_module() {
        for architecture in [Architecture::YoloV3, Architecture::YoloV3Tiny] {
            let net = NetSize { width: 96, height: 64 };
            let config = ModelConfig { width: 0.0625, input: net, classes: 2, ..ModelConfig::of(architecture) };
            let graph = config.graph().unwrap();
            let mut weights = Weights::init(&graph, &config.fields(), &Default::default(), 3);
            let mut rng = tcross_dataset::Rng::for_item(1, "test/inference", 0);
            for conv in &mut weights.convolutions {
                if let Some(norm) = &mut conv.norm {
                    norm.mean.iter_mut().for_each(|m| *m = 0.1 * rng.normal() as f32);
                    norm.variance.iter_mut().for_each(|v| *v = rng.uniform(0.5, 1.5) as f32);
                }
            }
            let mut fast = InferenceNet::new(&config, &weights).unwrap();
            let device = Device::flex();
            let network = Yolo::new(&config, &weights, &device).unwrap();
            for frame in 0..3 {
                let mut rng = tcross_dataset::Rng::for_item(frame, "test/inference/image", 0);
                let image: Vec<f32> = (0..3 * 96 * 64).map(|_| rng.unit() as f32).collect();
                let want = network.forward(Tensor::from_data(TensorData::new(image.clone(), [1, 3, 64, 96]), &device));
                let got = fast.run(&image, net);
                assert_eq!(got.len(), want.len());
                for (got, want) in got.iter().zip(&want) {
                    let want = read_logits(want);
                    assert_eq!(got.len(), want.len());
                    let largest = want.iter().fold(1f32, |m, v| m.max(v.abs()));
                    let worst = got.iter().zip(&want).fold(0f32, |m, (a, b)| m.max((a - b).abs()));
                    assert!(worst < 1e-4 * largest, "{architecture:?}: {worst} of {largest}");
                }
                let buffers = fast.arena.buffers.len();
                fast.run(&image, net);
                assert_eq!(fast.arena.buffers.len(), buffers, "a warm network takes no new buffer");
            }
        }
    }
}
