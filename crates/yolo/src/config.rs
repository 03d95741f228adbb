//! `[model]` of a config, and `model.toml` beside the weights.
use crate::{
    error::YoloError,
    fields::BoxFields,
    geometry::Geometry,
    graph::{Conv, Graph, Layer},
};
use serde::{Deserialize, Serialize};
pub use tcross_dataset::dataset::BoxConvention;

/// Epsilon inside the root of batch norm: what Darknet's GPU code, which trained the published weights, and PyTorch use.
pub const BATCH_NORM_EPSILON: f64 = 1e-5;

/// Classes a network may have.
pub const MOST_CLASSES: usize = 10_000;

/// Width and height of a network's input in pixels, both multiples of 32; `[width, height]` in files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(from = "[usize; 2]", into = "[usize; 2]")]
pub struct NetSize {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl NetSize {
    /// As wide as high.
    #[must_use]
    pub fn square(side: usize) -> Self {
        Self { width: side, height: side }
    }
}

impl From<[usize; 2]> for NetSize {
    fn from([width, height]: [usize; 2]) -> Self {
        Self { width, height }
    }
}

impl From<NetSize> for [usize; 2] {
    fn from(net: NetSize) -> Self {
        [net.width, net.height]
    }
}

impl std::fmt::Display for NetSize {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

/// Which layers a network has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Architecture {
    /// 107 layers, Darknet-53 below, heads of stride 32, 16, 8.
    #[serde(rename = "yolov3")]
    YoloV3,
    /// 24 layers, heads of stride 32, 16.
    #[serde(rename = "yolov3-tiny")]
    YoloV3Tiny,
    /// Layers of a Darknet cfg file, kept as text in `layers`.
    DarknetCfg,
}

impl Architecture {
    /// Strides of the published network's heads, coarse first.
    #[must_use]
    pub fn strides(self) -> Vec<usize> {
        match self {
            Self::YoloV3 => vec![32, 16, 8],
            Self::YoloV3Tiny => vec![32, 16],
            Self::DarknetCfg => Vec::new(),
        }
    }

    /// The anchors published for COCO, in net-input pixels at 416, small ones first.
    #[must_use]
    pub fn coco_anchors(self) -> Vec<[f32; 2]> {
        match self {
            Self::YoloV3 => vec![
                [10.0, 13.0],
                [16.0, 30.0],
                [33.0, 23.0],
                [30.0, 61.0],
                [62.0, 45.0],
                [59.0, 119.0],
                [116.0, 90.0],
                [156.0, 198.0],
                [373.0, 326.0],
            ],
            Self::YoloV3Tiny => vec![[10.0, 14.0], [23.0, 27.0], [37.0, 58.0], [81.0, 82.0], [135.0, 169.0], [344.0, 319.0]],
            Self::DarknetCfg => Vec::new(),
        }
    }
}

impl std::fmt::Display for Architecture {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str(match self {
            Self::YoloV3 => "yolov3",
            Self::YoloV3Tiny => "yolov3-tiny",
            Self::DarknetCfg => "darknet-cfg",
        })
    }
}

/// Anchors of each head.
const ANCHORS_A_HEAD: usize = 3;

/// Which anchors (small ones first) belong to which of so many heads (coarse first).
fn masks(heads: usize) -> Vec<Vec<usize>> {
    (0..heads).rev().map(|head| (ANCHORS_A_HEAD * head..ANCHORS_A_HEAD * (head + 1)).collect()).collect()
}

/// Where a model's anchors come from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(untagged)]
pub enum AnchorChoice {
    /// A word: `"kmeans"` over the training boxes, or `"coco"`.
    Named(AnchorSource),
    /// `[[width, height], ...]` in net-input pixels, small ones first.
    List(Vec<[f32; 2]>),
}

/// A way to find anchors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum AnchorSource {
    /// k-means over the letterboxed training boxes, with 1 - IoU as distance and medians as centres.
    Kmeans,
    /// The published ones.
    Coco,
}

/// The network to train.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ModelSection {
    /// `yolov3` or `yolov3-tiny`.
    pub architecture: Architecture,
    /// Multiplies the channels of every layer but the heads.
    pub width: f64,
    /// Multiplies the number of residual units of each stage (yolov3 only), at least one stays.
    pub depth: f64,
    /// Channels are rounded to a multiple of this, and are at least this many. 1 divides exactly.
    pub channel_multiple: usize,
    /// Strides of the heads in pixels, coarse first, each half of the one before. Empty: the published ones (`yolov3`: 32, 16, 8;
    /// `yolov3-tiny`: 32, 16). `yolov3` may have any run of 32, 16, 8, 4; stages that no head needs are left out.
    pub heads: Vec<usize>,
    /// Number of classes.
    pub classes: usize,
    /// Points a box carries besides itself (0: plain YOLOv3). They are learned with the boxes; `infer` does not write them.
    pub keypoints: usize,
    /// Input size `[width, height]` in pixels, both multiples of 32.
    pub input: NetSize,
    /// `"kmeans"` (over the training boxes), `"coco"` (the published ones), or a list of `[width, height]` in net-input pixels.
    pub anchors: AnchorChoice,
    /// Length, in cells, of the interval in which a cell's boxes have their centres, 1..=3: 1 in YOLOv3; above, the cells beside the one
    /// that holds a centre learn its box too where they reach it (Darknet's `scale_x_y`).
    pub scale_xy: f32,
    /// Added to the variance inside the root of batch norm.
    pub epsilon: f64,
}

impl Default for ModelSection {
    fn default() -> Self {
        Self {
            architecture: Architecture::YoloV3,
            width: 0.125,
            depth: 1.0,
            channel_multiple: 8,
            heads: Vec::new(),
            classes: 1,
            keypoints: 0,
            input: NetSize::square(416),
            anchors: AnchorChoice::Named(AnchorSource::Kmeans),
            scale_xy: 1.0,
            epsilon: BATCH_NORM_EPSILON,
        }
    }
}

impl ModelSection {
    /// Checks every value.
    ///
    /// # Errors
    /// The first value that is not allowed, with its key and what is.
    pub fn validate(&self) -> Result<(), YoloError> {
        let anchors = match &self.anchors {
            AnchorChoice::List(list) => list.clone(),
            AnchorChoice::Named(AnchorSource::Coco) => self.architecture.coco_anchors(),
            AnchorChoice::Named(AnchorSource::Kmeans) => vec![[1.0; 2]; self.anchor_count()],
        };
        if self.architecture == Architecture::DarknetCfg {
            return Err(YoloError::value(
                "model.architecture",
                "darknet-cfg",
                "'yolov3' or 'yolov3-tiny' (others can be imported, not configured)",
            ));
        }
        self.resolve(anchors, BoxConvention::Continuous).validate()
    }

    /// How many anchors the heads share.
    #[must_use]
    pub fn anchor_count(&self) -> usize {
        ANCHORS_A_HEAD * self.strides().len()
    }

    fn strides(&self) -> Vec<usize> {
        if self.heads.is_empty() { self.architecture.strides() } else { self.heads.clone() }
    }

    /// The complete description of a network, with these anchors (net-input pixels, small ones first).
    #[must_use]
    pub fn resolve(&self, anchors: Vec<[f32; 2]>, boxes: BoxConvention) -> ModelConfig {
        ModelConfig {
            format: MODEL_FORMAT,
            architecture: self.architecture,
            width: self.width,
            depth: self.depth,
            channel_multiple: self.channel_multiple,
            classes: self.classes,
            keypoints: self.keypoints,
            names: Vec::new(),
            input: self.input,
            anchors,
            heads: self.strides(),
            masks: masks(self.strides().len()),
            scale_xy: self.scale_xy,
            boxes,
            epsilon: self.epsilon,
            layers: None,
        }
    }
}

/// The newest `model.toml` this program reads.
pub const MODEL_FORMAT: u32 = 1;

/// `model.toml`: everything about a network but its parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelConfig {
    /// Version of this file's form.
    pub format: u32,
    /// Which layers.
    pub architecture: Architecture,
    /// Multiplier of channels.
    #[serde(default = "one")]
    pub width: f64,
    /// Multiplier of residual units.
    #[serde(default = "one")]
    pub depth: f64,
    /// Channels are rounded to a multiple of this.
    #[serde(default = "eight")]
    pub channel_multiple: usize,
    /// Number of classes.
    pub classes: usize,
    /// Points a box carries besides itself.
    #[serde(default)]
    pub keypoints: usize,
    /// Names of the classes; may be empty.
    #[serde(default)]
    pub names: Vec<String>,
    /// `[width, height]` in pixels.
    pub input: NetSize,
    /// `[width, height]` in net-input pixels, small ones first.
    pub anchors: Vec<[f32; 2]>,
    /// Strides of the heads in pixels, coarse first.
    #[serde(default)]
    pub heads: Vec<usize>,
    /// Indices of the anchors of each head, coarse first.
    pub masks: Vec<Vec<usize>>,
    /// Length, in cells, of the interval in which a cell's boxes have their centres.
    #[serde(default = "unit", skip_serializing_if = "is_unit")]
    pub scale_xy: f32,
    /// How the training boxes counted pixels; detections count alike.
    #[serde(default)]
    pub boxes: BoxConvention,
    /// Epsilon of batch norm, inside the root.
    pub epsilon: f64,
    /// Layer sections of a Darknet cfg, where the architecture is `darknet-cfg`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub layers: Option<String>,
}

fn one() -> f64 {
    1.0
}

fn unit() -> f32 {
    1.0
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde hands it over so")]
fn is_unit(value: &f32) -> bool {
    *value == 1.0
}

fn eight() -> usize {
    8
}

impl ModelConfig {
    /// The published network of this architecture: full width, one class, COCO anchors, 416 x 416.
    #[must_use]
    pub fn of(architecture: Architecture) -> Self {
        ModelSection { architecture, width: 1.0, ..Default::default() }.resolve(architecture.coco_anchors(), BoxConvention::Continuous)
    }

    /// In a few words, such as `yolov3 x 0.125 with 1 class(es)`. Whatever differs from the published network besides its width is told as a
    /// variant: `yolov3 x 0.125, variant with heads of stride 16, 8, 4, with 1 class(es)`.
    #[must_use]
    pub fn summary(&self) -> String {
        let mut variant = Vec::new();
        if self.architecture != Architecture::DarknetCfg && self.heads != self.architecture.strides() {
            let strides: Vec<String> = self.heads.iter().map(ToString::to_string).collect();
            variant.push(format!("heads of stride {}", strides.join(", ")));
        }
        if self.depth != 1.0 {
            variant.push(format!("depth x {}", self.depth));
        }
        if self.scale_xy != 1.0 {
            variant.push(format!("centres within {} cells", self.scale_xy));
        }
        if self.keypoints > 0 {
            variant.push(format!("{} keypoint(s) a box", self.keypoints));
        }
        let variant = if variant.is_empty() { String::new() } else { format!(", variant with {},", variant.join(" and ")) };
        let width = if self.architecture == Architecture::DarknetCfg { String::new() } else { format!(" x {}", self.width) };
        format!("{}{width}{variant} with {} class(es)", self.architecture, self.classes)
    }

    /// What a box of this model carries.
    #[must_use]
    pub fn fields(&self) -> BoxFields {
        BoxFields { classes: self.classes, keypoints: self.keypoints }
    }

    /// Checks every value and that the layers fit together.
    ///
    /// # Errors
    /// The first value that is not allowed, with its key and what is.
    pub fn validate(&self) -> Result<(), YoloError> {
        let positive = |key: &str, value: f64, most: f64| {
            let message = format!("a number above 0, at most {most}");
            if value > 0.0 && value <= most { Ok(()) } else { Err(YoloError::value(key, value, message)) }
        };
        positive("model.width", self.width, 4.0)?;
        positive("model.depth", self.depth, 4.0)?;
        positive("model.epsilon", self.epsilon, 0.1)?;
        if !(1.0..=3.0).contains(&self.scale_xy) {
            return Err(YoloError::value("model.scale_xy", self.scale_xy, "1 to 3"));
        }
        for (key, value, most) in [
            ("classes", self.classes, MOST_CLASSES),
            ("channel_multiple", self.channel_multiple, 1024),
            ("keypoints", self.keypoints + 1, 1000),
        ] {
            if value == 0 || value > most {
                return Err(YoloError::value(format!("model.{key}"), value, format!("1 to {most}")));
            }
        }
        if !self.names.is_empty() && self.names.len() != self.classes {
            return Err(YoloError::value(
                "model.names",
                format!("{} names", self.names.len()),
                format!("{} (one a class) or none", self.classes),
            ));
        }
        self.validate_heads()?;
        self.validate_anchors()?;
        let graph = self.graph()?;
        self.validate_layers(&graph)?;
        let multiple = graph.max_stride();
        for (key, side) in [("width", self.input.width), ("height", self.input.height)] {
            if side == 0 || side % multiple != 0 || side > 8192 {
                return Err(YoloError::value(format!("model.input ({key})"), side, format!("a multiple of {multiple}, at most 8192")));
            }
        }
        Ok(())
    }

    fn validate_heads(&self) -> Result<(), YoloError> {
        let wrong = |allowed: &str| Err(YoloError::value("model.heads", format!("{:?}", self.heads), allowed));
        let halves = self.heads.windows(2).all(|pair| pair[0] == 2 * pair[1]);
        match self.architecture {
            Architecture::YoloV3 if self.heads.is_empty() || !halves || !self.heads.iter().all(|s| [4, 8, 16, 32].contains(s)) => {
                wrong("a run of 32, 16, 8, 4")
            }
            Architecture::YoloV3Tiny if self.heads != self.architecture.strides() => wrong("[32, 16] for yolov3-tiny"),
            _ if self.heads.is_empty() => wrong("at least one"),
            _ if self.heads.len() != self.masks.len() => wrong(&format!("as many as masks ({})", self.masks.len())),
            _ => Ok(()),
        }
    }

    /// What is said of the heads is what the layers have, which a cfg's text says too.
    fn validate_layers(&self, graph: &Graph) -> Result<(), YoloError> {
        let heads: Vec<usize> = graph.heads().map(|(_, _, stride)| stride).collect();
        if heads != self.heads {
            return Err(YoloError::value("model.heads", format!("{:?}", self.heads), format!("{heads:?}, which the layers have")));
        }
        let masks: Vec<&[usize]> = graph.heads().map(|(_, mask, _)| mask).collect();
        if masks != self.masks {
            return Err(YoloError::value("model.masks", format!("{:?}", self.masks), format!("{masks:?}, which the layers have")));
        }
        let fields = self.fields().len();
        match graph.heads().find(|(layer, mask, _)| graph.channels(*layer) != mask.len() * fields) {
            Some((layer, mask, _)) => {
                let (channels, wanted) = (graph.channels(layer), mask.len() * fields);
                let allowed = format!("a number that fits the {channels} channels of layer {layer}, not {wanted}");
                Err(YoloError::value("model.classes", self.classes, allowed))
            }
            None => Ok(()),
        }
    }

    fn validate_anchors(&self) -> Result<(), YoloError> {
        let wanted = self.masks.iter().flatten().max().map_or(0, |most| most + 1);
        if self.anchors.len() != wanted {
            let heads: Vec<usize> = self.masks.iter().map(Vec::len).collect();
            return Err(YoloError::value(
                "model.anchors",
                format!("{} anchors", self.anchors.len()),
                format!("{wanted}, for heads of {heads:?} anchors"),
            ));
        }
        match self.anchors.iter().find(|a| a.iter().any(|side| !side.is_finite() || *side <= 0.0)) {
            Some(bad) => Err(YoloError::value("model.anchors", format!("{bad:?}"), "positive widths and heights in net-input pixels")),
            None => Ok(()),
        }
    }

    /// The network's layers.
    ///
    /// # Errors
    /// If `layers` is no readable cfg, or the layers do not fit together.
    pub fn graph(&self) -> Result<Graph, YoloError> {
        match self.architecture {
            Architecture::YoloV3 => self.yolov3(),
            Architecture::YoloV3Tiny => self.yolov3_tiny(),
            Architecture::DarknetCfg => crate::weights::cfg::layers("model.toml", self.layers.as_deref().unwrap_or_default()),
        }
    }

    /// Grids and anchors of the heads for an input of this size.
    #[must_use]
    pub fn geometry(&self, net: NetSize) -> Geometry {
        let heads = self.masks.iter().cloned().zip(self.heads.iter().copied());
        Geometry { scale_xy: self.scale_xy, ..Geometry::new(net, self.fields(), self.anchors.clone(), heads) }
    }

    /// Channels of a layer that has `published` ones at width 1.
    #[must_use]
    pub fn scaled(&self, published: usize) -> usize {
        let multiple = self.channel_multiple as f64;
        ((published as f64 * self.width / multiple).round() * multiple).max(multiple) as usize
    }

    /// Filters of the convolution before a head with this many anchors.
    fn head_filters(&self, anchors: usize) -> usize {
        anchors * self.fields().len()
    }

    fn yolov3(&self) -> Result<Graph, YoloError> {
        let mut b = Builder { config: self, graph: Graph::new() };
        let units = |published: usize| ((published as f64 * self.depth).round() as usize).max(1);
        b.conv(32, 3, 1)?;
        let coarsest = self.heads.first().copied().unwrap_or_default();
        let mut stages = Vec::new();
        for (stride, filters, repeats) in [(2, 64, 1), (4, 128, 2), (8, 256, 8), (16, 512, 8), (32, 1024, 4)] {
            if stride > coarsest {
                break;
            }
            let mut last = b.conv(filters, 3, 2)?;
            for _ in 0..units(repeats) {
                b.conv(filters / 2, 1, 1)?;
                b.conv(filters, 3, 1)?;
                last = b.graph.push(Layer::Shortcut { from: last })?;
            }
            stages.push((stride, last));
        }
        for (head, stride) in self.heads.iter().enumerate() {
            let filters = 16 * stride;
            for _ in 0..2 {
                b.conv(filters, 1, 1)?;
                b.conv(2 * filters, 3, 1)?;
            }
            let neck = b.conv(filters, 1, 1)?;
            b.conv(2 * filters, 3, 1)?;
            b.head(head)?;
            let finer = stages.iter().find(|(s, _)| self.heads.get(head + 1) == Some(s));
            if let Some((_, stage)) = finer {
                b.graph.push(Layer::Route { from: vec![neck] })?;
                b.conv(filters / 2, 1, 1)?;
                let up = b.graph.push(Layer::Upsample)?;
                b.graph.push(Layer::Route { from: vec![up, *stage] })?;
            }
        }
        Ok(b.graph)
    }

    fn yolov3_tiny(&self) -> Result<Graph, YoloError> {
        let mut b = Builder { config: self, graph: Graph::new() };
        let mut skip = 0;
        for (filters, stride) in [(16, 2), (32, 2), (64, 2), (128, 2), (256, 2), (512, 1)] {
            let conv = b.conv(filters, 3, 1)?;
            skip = if filters == 256 { conv } else { skip };
            b.graph.push(Layer::MaxPool { stride })?;
        }
        b.conv(1024, 3, 1)?;
        let neck = b.conv(256, 1, 1)?;
        b.conv(512, 3, 1)?;
        b.head(0)?;
        b.graph.push(Layer::Route { from: vec![neck] })?;
        b.conv(128, 1, 1)?;
        let up = b.graph.push(Layer::Upsample)?;
        b.graph.push(Layer::Route { from: vec![up, skip] })?;
        b.conv(256, 3, 1)?;
        b.head(1)?;
        Ok(b.graph)
    }
}

/// Adds Darknet's usual layers to a graph.
struct Builder<'a> {
    config: &'a ModelConfig,
    graph: Graph,
}

impl Builder<'_> {
    fn conv(&mut self, published: usize, kernel: usize, stride: usize) -> Result<usize, YoloError> {
        let (in_channels, filters) = (self.graph.next_channels(), self.config.scaled(published));
        self.graph.push(Layer::Conv(Conv { in_channels, filters, kernel, stride, batch_norm: true, leaky: true }))
    }

    fn head(&mut self, head: usize) -> Result<usize, YoloError> {
        let mask = self.config.masks.get(head).cloned().unwrap_or_default();
        let (in_channels, filters) = (self.graph.next_channels(), self.config.head_filters(mask.len()));
        self.graph.push(Layer::Conv(Conv { in_channels, filters, kernel: 1, stride: 1, batch_norm: false, leaky: false }))?;
        self.graph.push(Layer::Head { mask })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_sizes() {
        let coco = ModelConfig { classes: 80, ..ModelConfig::of(Architecture::YoloV3) };
        let graph = coco.graph().unwrap();
        assert_eq!(graph.layers().len(), 107);
        assert_eq!(graph.parameters(), 62_001_757); // with the batch norms' means and variances, as darknet53.weights
        assert_eq!(graph.backbone(), 75);
        assert!((graph.flops(coco.input) as f64 / 65.86e9 - 1.0).abs() < 1e-3, "{}", graph.flops(coco.input));
        assert_eq!(graph.heads().map(|(layer, _, stride)| (layer, stride)).collect::<Vec<_>>(), [(82, 32), (94, 16), (106, 8)]);

        let tiny = ModelConfig { classes: 80, ..ModelConfig::of(Architecture::YoloV3Tiny) };
        let graph = tiny.graph().unwrap();
        assert_eq!((graph.layers().len(), graph.parameters(), graph.backbone()), (24, 8_858_734, 15));
        assert!((graph.flops(tiny.input) as f64 / 5.565e9 - 1.0).abs() < 1e-3);
    }

    #[test]
    fn heads_choose_their_stages() {
        let with = |heads: &[usize]| {
            let section = ModelSection { heads: heads.to_vec(), width: 1.0, ..Default::default() };
            let anchors = vec![[1.0; 2]; section.anchor_count()];
            let config = section.resolve(anchors, BoxConvention::Continuous);
            config.validate().unwrap();
            config.graph().unwrap()
        };
        assert_eq!(with(&[32, 16, 8]), ModelConfig::of(Architecture::YoloV3).graph().unwrap());
        let fine = with(&[16, 8, 4]);
        assert_eq!(fine.heads().map(|h| h.2).collect::<Vec<_>>(), [16, 8, 4]);
        assert_eq!((fine.max_stride(), fine.backbone()), (16, 62)); // layer 62 would open the coarsest stage
        assert_eq!(with(&[32, 16, 8, 4]).heads().count(), 4);
        for bad in [&[32, 8][..], &[8, 16], &[64, 32]] {
            let section = ModelSection { heads: bad.to_vec(), ..Default::default() };
            assert!(section.validate().unwrap_err().to_string().contains("model.heads"));
        }
    }

    #[test]
    fn variants_are_named_so() {
        assert_eq!(ModelConfig::of(Architecture::YoloV3Tiny).summary(), "yolov3-tiny x 1 with 1 class(es)");
        let section = ModelSection { heads: vec![16, 8, 4], keypoints: 5, ..Default::default() };
        let fine = section.resolve(vec![[1.0; 2]; 9], BoxConvention::Continuous).summary();
        assert_eq!(fine, "yolov3 x 0.125, variant with heads of stride 16, 8, 4 and 5 keypoint(s) a box, with 1 class(es)");
    }

    #[test]
    fn width_rounds_to_multiples() {
        let config = ModelConfig { width: 0.125, ..ModelConfig::of(Architecture::YoloV3) };
        assert_eq!((config.scaled(32), config.scaled(64), config.scaled(1024)), (8, 8, 128));
        let exact = ModelConfig { width: 0.0625, channel_multiple: 1, ..config };
        assert_eq!((exact.scaled(32), exact.scaled(1024)), (2, 64));
    }

    #[test]
    fn model_toml_round_trips_and_refuses_unknown_keys() {
        let config = ModelConfig::of(Architecture::YoloV3Tiny);
        let text = toml::to_string(&config).unwrap();
        assert_eq!(toml::from_str::<ModelConfig>(&text).unwrap(), config);
        assert!(toml::from_str::<ModelConfig>(&format!("widht = 1.0\n{text}")).is_err());
    }

    #[test]
    fn wrong_values_name_key_found_and_allowed() {
        let good = ModelSection::default();
        assert!(good.validate().is_ok());
        for (section, words) in [
            (ModelSection { width: 0.0, ..good.clone() }, ["model.width", "0", "above 0"]),
            (ModelSection { input: NetSize::square(400), ..good.clone() }, ["model.input", "400", "multiple of 32"]),
            (ModelSection { anchors: AnchorChoice::List(vec![[1.0, 2.0]; 6]), ..good.clone() }, ["model.anchors", "6 anchors", "9"]),
            (ModelSection { classes: 0, ..good.clone() }, ["model.classes", "0", "1 to"]),
        ] {
            let message = section.validate().unwrap_err().to_string();
            assert!(words.iter().all(|w| message.contains(w)), "{message}");
        }
    }

    /// An edited `model.toml` whose layers are a cfg's text.
    #[test]
    fn what_differs_from_the_layers_is_named() {
        let tiny = ModelConfig::of(Architecture::YoloV3Tiny);
        let good = crate::weights::cfg::with_layers(tiny.clone(), &tiny.graph().unwrap());
        good.validate().unwrap();
        for (config, words) in [
            (ModelConfig { heads: vec![32, 8], ..good.clone() }, "model.heads = [32, 8]: expected [32, 16]"),
            (ModelConfig { masks: vec![vec![0, 1, 2], vec![3, 4, 5]], ..good.clone() }, "expected [[3, 4, 5], [0, 1, 2]]"),
            (ModelConfig { classes: 2, ..good.clone() }, "model.classes = 2: expected a number that fits the 18 channels of layer 16"),
            (ModelConfig { keypoints: 1, ..good.clone() }, "fits the 18 channels"),
        ] {
            let message = config.validate().unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        }
    }

    #[test]
    fn a_network_has_a_head() {
        let layers = Some("[convolutional]\nfilters=8\nsize=3\nstride=1\npad=1\nactivation=leaky\n".to_owned());
        let architecture = Architecture::DarknetCfg;
        let config =
            ModelConfig { architecture, layers, heads: Vec::new(), masks: Vec::new(), ..ModelConfig::of(Architecture::YoloV3Tiny) };
        assert!(config.validate().unwrap_err().to_string().contains("at least one"));
    }
}
