//! The one definition of a network: a list of Darknet's layers, checked as it grows.
use crate::error::YoloError;

/// One layer. Indices of other layers are absolute, from 0.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Layer {
    /// Convolution, with batch norm or a bias, and an activation.
    Conv(Conv),
    /// Sum of the layer before and layer `from`, which have the same shape; linear.
    Shortcut {
        /// The other summand.
        from: usize,
    },
    /// Channels of all these layers, one behind the other in this order.
    Route {
        /// What is concatenated.
        from: Vec<usize>,
    },
    /// Each pixel repeated 2 x 2.
    Upsample,
    /// Maximum over windows of 2 x 2, padded below and on the right where they stick out; at stride 1 the size stays.
    MaxPool {
        /// 1 or 2.
        stride: usize,
    },
    /// A YOLO head: the layer before gives raw logits for these anchors.
    Head {
        /// Indices into the model's anchors.
        mask: Vec<usize>,
    },
}

/// A convolution's shape.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Conv {
    /// Channels that come in.
    pub in_channels: usize,
    /// Channels that go out.
    pub filters: usize,
    /// Side of the kernel; `kernel / 2` zeros are padded on each side.
    pub kernel: usize,
    /// 1 or 2.
    pub stride: usize,
    /// With batch norm the bias is its beta.
    pub batch_norm: bool,
    /// Leaky ReLU with slope 0.1, or linear.
    pub leaky: bool,
}

impl Conv {
    /// Number of values in the kernel `[filters, in_channels, kernel, kernel]`.
    #[must_use]
    pub fn kernel_len(&self) -> usize {
        self.filters * self.in_channels * self.kernel * self.kernel
    }

    /// Number of stored values: kernel, bias and, with batch norm, scale, mean and variance.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.kernel_len() + self.filters * if self.batch_norm { 4 } else { 1 }
    }
}

/// Channels a convolution may have: more is a slip of the pen, and would not fit into memory.
const MOST_FILTERS: usize = 1 << 16;

/// The shape of a layer's output for one image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LayerShape {
    /// Channels.
    pub channels: usize,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
}

/// Layers in the order in which they run. Each one reads the layer before it, the first one the image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Graph {
    layers: Vec<Layer>,
    channels: Vec<usize>,
    strides: Vec<usize>,
}

impl Default for Graph {
    fn default() -> Self {
        Self::new()
    }
}

impl Graph {
    /// Channels of an image.
    pub const IMAGE_CHANNELS: usize = 3;

    /// No layers yet.
    #[must_use]
    pub fn new() -> Self {
        Self { layers: Vec::new(), channels: Vec::new(), strides: Vec::new() }
    }

    /// Convolutions alone, as they are stored: how they are joined is another module's business. Such a graph serves [`crate::Weights`] and
    /// files, and no walk.
    #[must_use]
    pub fn of_convolutions(convolutions: Vec<Conv>) -> Self {
        let channels = convolutions.iter().map(|conv| conv.filters).collect();
        let strides = vec![1; convolutions.len()];
        Self { layers: convolutions.into_iter().map(Layer::Conv).collect(), channels, strides }
    }

    /// Adds a layer and says its index.
    ///
    /// # Errors
    /// If it refers to a layer that is not there yet, or shapes do not fit.
    pub fn push(&mut self, layer: Layer) -> Result<usize, YoloError> {
        let here = self.layers.len();
        let wrong = |message: String| YoloError::Layer { layer: here, message };
        let (channels_in, stride_in) = self.output_of_last();
        let known =
            |from: usize| if from < here { Ok(from) } else { Err(wrong(format!("refers to layer {from}, which is not before it"))) };
        let (channels, stride) = match &layer {
            Layer::Conv(c) => {
                if c.in_channels != channels_in {
                    return Err(wrong(format!("takes {} channels, but the layer before has {channels_in}", c.in_channels)));
                }
                let fits = (1..=MOST_FILTERS).contains(&c.filters) && (1..=2).contains(&c.stride) && [1, 3, 5, 7].contains(&c.kernel);
                if !fits {
                    return Err(wrong(format!(
                        "filters={}, size={}, stride={}: expected 1 to {MOST_FILTERS} filters, size 1, 3, 5 or 7, stride 1 or 2",
                        c.filters, c.kernel, c.stride
                    )));
                }
                (c.filters, stride_in * c.stride)
            }
            Layer::Shortcut { from } => {
                let from = known(*from)?;
                if (self.channels[from], self.strides[from]) != (channels_in, stride_in) {
                    return Err(wrong(format!(
                        "adds layer {from} ({} channels, stride {}) to {channels_in} channels of stride {stride_in}",
                        self.channels[from], self.strides[from]
                    )));
                }
                (channels_in, stride_in)
            }
            Layer::Route { from } => {
                let first = known(*from.first().ok_or_else(|| wrong("a route of no layers".into()))?)?;
                let mut channels = 0;
                for &layer in from {
                    if self.strides[known(layer)?] != self.strides[first] {
                        return Err(wrong(format!("joins layers {from:?}, which differ in size")));
                    }
                    channels += self.channels[layer];
                }
                (channels, self.strides[first])
            }
            Layer::Upsample if stride_in % 2 == 0 => (channels_in, stride_in / 2),
            Layer::Upsample => return Err(wrong("would become larger than the image".into())),
            Layer::MaxPool { stride: stride @ 1..=2 } => (channels_in, stride_in * stride),
            Layer::MaxPool { stride } => return Err(wrong(format!("max pool of stride {stride}: expected 1 or 2"))),
            Layer::Head { mask } => {
                if mask.is_empty() || channels_in % mask.len() != 0 {
                    return Err(wrong(format!("{} anchors cannot share {channels_in} channels", mask.len())));
                }
                (channels_in, stride_in)
            }
        };
        self.layers.push(layer);
        self.channels.push(channels);
        self.strides.push(stride);
        Ok(here)
    }

    fn output_of_last(&self) -> (usize, usize) {
        match (self.channels.last(), self.strides.last()) {
            (Some(&channels), Some(&stride)) => (channels, stride),
            _ => (Self::IMAGE_CHANNELS, 1),
        }
    }

    /// Channels that the next layer would take.
    #[must_use]
    pub fn next_channels(&self) -> usize {
        self.output_of_last().0
    }

    /// All layers.
    #[must_use]
    pub fn layers(&self) -> &[Layer] {
        &self.layers
    }

    /// Every convolution with its layer's index, in the order in which weights are stored.
    pub fn convolutions(&self) -> impl Iterator<Item = (usize, &Conv)> {
        self.layers.iter().enumerate().filter_map(|(index, layer)| match layer {
            Layer::Conv(conv) => Some((index, conv)),
            _ => None,
        })
    }

    /// Every head: its layer's index, its anchors, and how many net-input pixels one of its cells covers; coarse first.
    pub fn heads(&self) -> impl Iterator<Item = (usize, &[usize], usize)> {
        self.layers.iter().enumerate().filter_map(|(index, layer)| match layer {
            Layer::Head { mask } => Some((index, mask.as_slice(), self.strides[index])),
            _ => None,
        })
    }

    /// True for a convolution whose output is a head's logits.
    #[must_use]
    pub fn is_head(&self, layer: usize) -> bool {
        matches!(self.layers.get(layer + 1), Some(Layer::Head { .. }))
    }

    /// Channels of each layer's output.
    #[must_use]
    pub fn channels(&self, layer: usize) -> usize {
        self.channels[layer]
    }

    /// The largest stride: an input's sides must be multiples of it.
    #[must_use]
    pub fn max_stride(&self) -> usize {
        self.strides.iter().copied().max().unwrap_or(1)
    }

    /// Shapes of all layers for an input of this size.
    #[must_use]
    pub fn shapes(&self, net: crate::NetSize) -> Vec<LayerShape> {
        let shape = |(&channels, &stride)| LayerShape { channels, height: net.height / stride, width: net.width / stride };
        self.channels.iter().zip(&self.strides).map(shape).collect()
    }

    /// The same layers with a plain bias in place of each batch norm, for folded parameters.
    #[must_use]
    pub fn without_batch_norm(&self) -> Self {
        let mut graph = self.clone();
        for layer in &mut graph.layers {
            if let Layer::Conv(conv) = layer {
                conv.batch_norm = false;
            }
        }
        graph
    }

    /// Number of stored values of all convolutions.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.convolutions().map(|(_, c)| c.parameters()).sum()
    }

    /// Floating-point operations of the convolutions of a forward pass of one image, multiply and add counted apart.
    #[must_use]
    pub fn flops(&self, net: crate::NetSize) -> u64 {
        let shapes = self.shapes(net);
        self.convolutions().map(|(layer, c)| 2 * (c.kernel_len() * shapes[layer].height * shapes[layer].width) as u64).sum()
    }

    /// Number of leading layers that form the backbone: up to the last shortcut (Darknet-53, `darknet53.conv.74`) or, without
    /// shortcuts, up to the first head's convolution (`yolov3-tiny.conv.15`).
    #[must_use]
    pub fn backbone(&self) -> usize {
        let last_shortcut = self.layers.iter().rposition(|l| matches!(l, Layer::Shortcut { .. })).map(|at| at + 1);
        let first_head = self.layers.iter().position(|l| matches!(l, Layer::Head { .. })).map(|at| at.saturating_sub(1));
        last_shortcut.or(first_head).unwrap_or(self.layers.len())
    }
}
