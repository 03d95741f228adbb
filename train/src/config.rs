//! The `[train]` section.
use crate::{error::TrainError, refine::Refine};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tcross_yolo::LossKind;

/// How a network is trained.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Images in a step.
    pub batch: usize,
    /// Parts of a batch that go through the network side by side, each on its share of the threads and with batch norm of its own: faster for
    /// narrow networks, whose layers are too small to be divided. 1 to `batch`.
    pub batch_parts: usize,
    /// Length in passes over the training images.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub epochs: Option<f64>,
    /// Length in steps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<u64>,
    /// Length in minutes of wall time, validation included. Of several lengths, the one that ends first counts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_minutes: Option<f64>,
    /// File that the weights start from: a Darknet file (whole, or cut as `NAME.conv.N`) or safetensors; absent: random.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub init: Option<String>,
    /// Which part of the network stands still: `none`, `backbone`, or `backbone-running` (its batch norm does too).
    pub freeze: Freeze,
    /// `darknet` or `paper`.
    pub loss: LossKind,
    /// A predictor whose box overlaps a truth by more than this IoU is no negative, 0..1.
    pub ignore_iou: f64,
    /// Besides the anchor of best shape, every one whose shape overlaps a truth's by more than this IoU learns it too, 0..=1; 1: the best only.
    pub assign_iou: f64,
    /// Bias of each objectness logit at the start.
    pub objectness_bias: f64,
    /// Bias of each class logit at the start.
    pub class_bias: f64,
    /// Largest norm of a step's gradient; longer ones are scaled down.
    pub clip: f64,
    /// Whether `clip` holds for all parameters together or for each variable alone.
    pub clip_by: ClipBy,
    /// Share of the old running statistics that batch norm keeps at each step, 0..1.
    pub batch_norm_decay: f64,
    /// Decay of the moving average of the weights, which is what is validated and kept; 0 for none.
    pub ema: f64,
    /// The optimiser.
    pub optimizer: Optimizer,
    /// The rate over time.
    pub schedule: Schedule,
    /// What is done to the images.
    pub augment: Augment,
    /// Validation and the choice of the best weights.
    pub validate: Validate,
    /// A second stage, which looks at each claim of the trained detector again.
    pub refine: Refine,
    /// Shapes in the order of their class numbers; empty: every marker is class 0.
    pub classes: Vec<String>,
    /// Share of images without a marker in an epoch, 0..1; absent: as in the dataset.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub empty_ratio: Option<f64>,
    /// Sides of square inputs that are drawn from, in pixels; empty: the model's own input size always.
    pub multi_scale: Vec<usize>,
    /// Steps for which a drawn input size is kept.
    pub multi_scale_steps: u64,
    /// Parts of the images in place of whole ones, for the first part of the training.
    pub windows: Windows,
    /// Memory for decoded images in GB; what does not fit is decoded again each epoch. As much again may hold what a backbone that stands
    /// still (`backbone-running`) says of images that are never changed, so that it is computed once.
    pub cache_gb: f64,
    /// Threads that make batches ahead of the steps.
    pub workers: usize,
    /// Minutes between two saved states within an epoch.
    pub save_minutes: f64,
    /// Batches whose pictures are drawn with their boxes at the start.
    pub drawn_batches: usize,
    /// Whether the processor runs its hand-written kernels; false takes burn's own operations, for comparison.
    pub fused: bool,
}

/// Which part of the network stands still.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Freeze {
    /// Everything learns.
    #[default]
    None,
    /// The backbone's weights stand still; its batch norm runs on batch statistics and updates its averages (the paper).
    Backbone,
    /// The backbone's weights stand still, and its batch norm uses the averages it came with.
    BackboneRunning,
}

/// What a clipped norm is taken over.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ClipBy {
    /// All gradients together.
    #[default]
    Global,
    /// Each variable's gradient alone (the paper).
    Variable,
}

/// The optimiser and its numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Optimizer {
    /// `adamw`, `sgd` or `muon`.
    pub kind: OptimizerKind,
    /// Highest learning rate.
    pub rate: f64,
    /// Weight decay of convolution kernels; biases and batch norm have none. Decoupled for AdamW and Muon, added to the gradient for SGD.
    pub decay: f64,
    /// Momentum of SGD and of Muon's kernels; AdamW's first decay rate, also for what Muon leaves to it.
    pub momentum: f64,
    /// AdamW's second decay rate, also for what Muon leaves to it.
    pub second_momentum: f64,
}

/// Which optimiser.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum OptimizerKind {
    /// Adam with decoupled weight decay.
    #[default]
    Adamw,
    /// Gradient descent with momentum.
    Sgd,
    /// Momentum made orthogonal for convolution kernels, AdamW for everything else.
    Muon,
}

/// The rate over time, as a factor on the highest rate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Schedule {
    /// `cosine`, `constant` or `steps`.
    pub kind: ScheduleKind,
    /// Share of the training, 0..1, over which the rate rises from 0.
    pub warmup: f64,
    /// Length of the rise in epochs; where given, it replaces `warmup`, and `at_epochs` count from its end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub warmup_epochs: Option<f64>,
    /// Exponent of the rise: 1 linear, 4 as Darknet's burn-in.
    pub warmup_power: f64,
    /// Factor that the cosine ends at, 0..1.
    pub end: f64,
    /// `steps`: shares of the training, rising, 0..1, at which the factor changes.
    pub at: Vec<f64>,
    /// `steps`: epochs, rising, at which the factor changes; where given, they replace `at`.
    pub at_epochs: Vec<f64>,
    /// `steps`: the factor from each of those on.
    pub factors: Vec<f64>,
}

/// The form of the rate.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ScheduleKind {
    /// Half a cosine, down to `end`.
    #[default]
    Cosine,
    /// 1 throughout.
    Constant,
    /// Piecewise constant.
    Steps,
}

/// What is done to the images. Probabilities are 0..1; pixels and labels always move together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Augment {
    /// Probability of a mirror image (a marker's stem is mirrored with it).
    pub flip: f64,
    /// How colours change: `linear` (one matrix an image) or `hsv` (hue, saturation and value, as the paper does).
    pub color: ColorSpace,
    /// Probability of each change of colour.
    pub color_probability: f64,
    /// Contrast (`hsv`: value) is multiplied by a factor of 1 +- this.
    pub gain: f64,
    /// Brightness is shifted by +- this, of the range 0..1.
    pub shift: f64,
    /// Saturation is multiplied by a factor of 1 +- this.
    pub saturation: f64,
    /// Hue is turned by +- this, in degrees.
    pub hue_deg: f64,
    /// Size is multiplied by a factor from 1 / (1 + this) to 1 + this.
    pub scale: f64,
    /// The image is moved by up to this, of the input's size, along each axis.
    pub translate: f64,
    /// Width over height is multiplied by a factor from 1 / (1 + this) to 1 + this.
    pub aspect: f64,
    /// Probability that four images make one.
    pub mosaic: f64,
    /// Share of the training, 0..1, after which no mosaic is made.
    pub mosaic_until: f64,
    /// Probability that two images are mixed, with a weight from Beta(1.5, 1.5).
    pub mixup: f64,
    /// Probability that the image is laid on a larger grey canvas.
    pub expand: f64,
    /// Largest side of that canvas, in sides of the image.
    pub expand_most: f64,
    /// Probability of a crop that keeps a marker to a drawn IoU.
    pub crop: f64,
    /// How pixels are sampled where the size changes: `smooth`, `bilinear`, `nearest`, or `random` among the three.
    pub sampling: Sampling,
}

/// Where colours are changed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ColorSpace {
    /// One affine map of red, green and blue.
    #[default]
    Linear,
    /// Hue, saturation and value of each pixel.
    Hsv,
}

/// Windows: square parts of the images at their own scale, most of them around a marker. A window holds as much to learn from as the whole
/// image, at a fraction of its price; the rest of the training then shows the network whole images, with as much background as it will meet.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Windows {
    /// Share of the training, 0..1, of its steps or of its time, whichever is further ahead, after which images are whole; 0: always whole.
    pub until: f64,
    /// Side of a window in pixels of the model's input, a multiple of 32.
    pub side: usize,
    /// Probability that a window is laid around a marker of its image, which is scaled down where it would not fit.
    pub focus: f64,
}

/// How pixels are sampled.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Sampling {
    /// Bilinear, over all pixels that a smaller one covers.
    #[default]
    Smooth,
    /// Bilinear between the four nearest pixels.
    Bilinear,
    /// The nearest pixel.
    Nearest,
    /// One of the three, drawn for each image.
    Random,
}

/// Validation and the choice of the best weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Validate {
    /// Epochs between two validations.
    pub every: u64,
    /// Validation images used at most, evenly spread over the split; 0 for all.
    pub images: usize,
    /// What makes weights the best: `ap`, `ap50`, `mean_iou`, `precision`, `recall`, `f1` or `best_f1`.
    pub metric: Metric,
    /// Score of the reported precision and recall, 0..1.
    pub threshold: f64,
    /// Validations without a new best after which training ends; 0 for never.
    pub patience: u64,
    /// Validations between two pictures of the worst images; 0 for none.
    pub worst_every: u64,
}

/// A number of a validation.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Metric {
    /// COCO's average precision, mean over IoU 0.50 to 0.95.
    #[default]
    Ap,
    /// COCO's average precision at IoU 0.5.
    Ap50,
    /// The paper's mean IoU at the threshold.
    MeanIou,
    /// At the threshold.
    Precision,
    /// At the threshold.
    Recall,
    /// At the threshold.
    F1,
    /// Highest F1 over all thresholds.
    BestF1,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            batch: 8,
            batch_parts: 1,
            epochs: Some(5.0),
            steps: None,
            max_minutes: None,
            init: None,
            freeze: Freeze::None,
            loss: LossKind::Darknet,
            ignore_iou: 0.6,
            assign_iou: 1.0,
            objectness_bias: -7.0,
            class_bias: 3.0,
            clip: 100.0,
            clip_by: ClipBy::Global,
            batch_norm_decay: 0.97,
            ema: 0.998,
            optimizer: Optimizer::default(),
            schedule: Schedule::default(),
            augment: Augment::default(),
            validate: Validate::default(),
            refine: Refine::default(),
            classes: Vec::new(),
            empty_ratio: None,
            multi_scale: Vec::new(),
            multi_scale_steps: 10,
            windows: Windows::default(),
            cache_gb: 4.0,
            workers: 1,
            save_minutes: 10.0,
            drawn_batches: 2,
            fused: true,
        }
    }
}

impl Default for Optimizer {
    fn default() -> Self {
        Self { kind: OptimizerKind::Adamw, rate: 2e-3, decay: 0.01, momentum: 0.9, second_momentum: 0.999 }
    }
}

impl Default for Schedule {
    fn default() -> Self {
        Self {
            kind: ScheduleKind::Cosine,
            warmup: 0.04,
            warmup_epochs: None,
            warmup_power: 1.0,
            end: 0.01,
            at: vec![0.8, 0.9],
            at_epochs: Vec::new(),
            factors: vec![0.1, 0.01],
        }
    }
}

impl Default for Augment {
    fn default() -> Self {
        Self {
            flip: 0.5,
            color: ColorSpace::Linear,
            color_probability: 1.0,
            gain: 0.3,
            shift: 0.1,
            saturation: 0.0,
            hue_deg: 0.0,
            scale: 0.0,
            translate: 0.0,
            aspect: 0.0,
            mosaic: 0.0,
            mosaic_until: 0.8,
            mixup: 0.0,
            expand: 0.0,
            expand_most: 4.0,
            crop: 0.0,
            sampling: Sampling::Smooth,
        }
    }
}

impl Default for Windows {
    fn default() -> Self {
        Self { until: 0.0, side: 224, focus: 0.8 }
    }
}

impl Default for Validate {
    fn default() -> Self {
        Self { every: 1, images: 500, metric: Metric::Ap, threshold: 0.3, patience: 0, worst_every: 5 }
    }
}

impl Config {
    /// Checks every value.
    ///
    /// # Errors
    /// The first value that is not allowed, with its key and what is.
    pub fn validate(&self) -> Result<(), TrainError> {
        within("batch", self.batch as f64, 1.0, 4096.0)?;
        if !(1..=self.batch).contains(&self.batch_parts) {
            return Err(TrainError::value("batch_parts", self.batch_parts, format!("1 to {} (train.batch)", self.batch)));
        }
        if self.epochs.is_none() && self.steps.is_none() && self.max_minutes.is_none() {
            return Err(TrainError::value("epochs", "absent", "a length: epochs, steps or max_minutes"));
        }
        for (key, length) in [("epochs", self.epochs), ("steps", self.steps.map(|s| s as f64)), ("max_minutes", self.max_minutes)] {
            if let Some(length) = length
                && !(length > 0.0 && length < 1e9)
            {
                return Err(TrainError::value(key, length, "a number above 0"));
            }
        }
        within("ignore_iou", self.ignore_iou, 0.0, 1.0)?;
        within("assign_iou", self.assign_iou, 0.0, 1.0)?;
        within("objectness_bias", self.objectness_bias, -30.0, 30.0)?;
        within("class_bias", self.class_bias, -30.0, 30.0)?;
        within("clip", self.clip, 1e-6, 1e9)?;
        within("batch_norm_decay", self.batch_norm_decay, 0.0, 0.99999)?;
        within("ema", self.ema, 0.0, 0.999_999)?;
        if let Some(ratio) = self.empty_ratio {
            within("empty_ratio", ratio, 0.0, 0.99)?;
        }
        if let Some(side) = self.multi_scale.iter().find(|side| **side == 0 || **side % 32 != 0 || **side > 8192) {
            return Err(TrainError::value("multi_scale", side, "multiples of 32, at most 8192"));
        }
        within("windows.until", self.windows.until, 0.0, 1.0)?;
        within("windows.focus", self.windows.focus, 0.0, 1.0)?;
        if self.windows.side == 0 || !self.windows.side.is_multiple_of(32) || self.windows.side > 8192 {
            return Err(TrainError::value("windows.side", self.windows.side, "a multiple of 32, at most 8192"));
        }
        within("multi_scale_steps", self.multi_scale_steps as f64, 1.0, 1e9)?;
        within("cache_gb", self.cache_gb, 0.0, 1e6)?;
        within("workers", self.workers as f64, 1.0, 256.0)?;
        within("save_minutes", self.save_minutes, 0.0, 1e6)?;
        within("validate.every", self.validate.every as f64, 1.0, 1e9)?;
        within("validate.threshold", self.validate.threshold, 0.0, 1.0)?;
        self.optimizer.validate("optimizer")?;
        self.refine.validate()?;
        self.schedule.validate()?;
        self.augment.validate()
    }
}

impl Optimizer {
    pub(crate) fn validate(&self, key: &str) -> Result<(), TrainError> {
        within(&format!("{key}.rate"), self.rate, 1e-12, 100.0)?;
        within(&format!("{key}.decay"), self.decay, 0.0, 10.0)?;
        within(&format!("{key}.momentum"), self.momentum, 0.0, 0.99999)?;
        within(&format!("{key}.second_momentum"), self.second_momentum, 0.0, 0.999_999)
    }
}

impl Schedule {
    fn validate(&self) -> Result<(), TrainError> {
        within("schedule.warmup", self.warmup, 0.0, 1.0)?;
        within("schedule.warmup_epochs", self.warmup_epochs.unwrap_or(0.0), 0.0, 1e6)?;
        within("schedule.warmup_power", self.warmup_power, 0.0, 10.0)?;
        within("schedule.end", self.end, 0.0, 1.0)?;
        let (key, at) = if self.at_epochs.is_empty() { ("schedule.at", &self.at) } else { ("schedule.at_epochs", &self.at_epochs) };
        if at.windows(2).any(|w| w[0] >= w[1]) || at.iter().any(|v| !v.is_finite() || *v < 0.0) {
            return Err(TrainError::value(key, format!("{at:?}"), "rising numbers, not negative"));
        }
        if self.kind == ScheduleKind::Steps && at.len() != self.factors.len() {
            let found = format!("{} factors", self.factors.len());
            return Err(TrainError::value("schedule.factors", found, format!("{}, one for each of {key}", at.len())));
        }
        self.factors.iter().try_for_each(|factor| within("schedule.factors", *factor, 0.0, 100.0))
    }
}

impl Augment {
    /// Whether an image is always shown as it is, bit by bit.
    #[must_use]
    pub fn is_still(&self) -> bool {
        let colors = self.color_probability * (self.gain + self.shift + self.saturation + self.hue_deg);
        let places = self.flip + self.scale + self.translate + self.aspect + self.mosaic + self.mixup + self.expand + self.crop;
        colors == 0.0 && places == 0.0 && self.sampling != Sampling::Random
    }

    fn validate(&self) -> Result<(), TrainError> {
        let probabilities = [
            ("flip", self.flip),
            ("color_probability", self.color_probability),
            ("mosaic", self.mosaic),
            ("mosaic_until", self.mosaic_until),
            ("mixup", self.mixup),
            ("expand", self.expand),
            ("crop", self.crop),
            ("gain", self.gain),
            ("shift", self.shift),
            ("saturation", self.saturation),
            ("translate", self.translate),
        ];
        probabilities.into_iter().try_for_each(|(key, value)| within(&format!("augment.{key}"), value, 0.0, 1.0))?;
        within("augment.hue_deg", self.hue_deg, 0.0, 180.0)?;
        within("augment.scale", self.scale, 0.0, 10.0)?;
        within("augment.aspect", self.aspect, 0.0, 10.0)?;
        within("augment.expand_most", self.expand_most, 1.0, 16.0)
    }
}

pub(crate) fn within(key: &str, value: f64, least: f64, most: f64) -> Result<(), TrainError> {
    if (least..=most).contains(&value) { Ok(()) } else { Err(TrainError::value(key, value, format!("{least} to {most}"))) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_valid_and_survive_toml() {
        let config = Config::default();
        config.validate().unwrap();
        assert_eq!(toml::from_str::<Config>(&toml::to_string(&config).unwrap()).unwrap(), config);
    }

    #[test]
    fn wrong_values_name_key_found_and_allowed() {
        for (text, words) in [
            ("batch = 0", ["train.batch", "0", "1 to 4096"]),
            ("batch_parts = 9", ["train.batch_parts", "9", "1 to 8"]),
            ("multi_scale = [320, 333]", ["train.multi_scale", "333", "multiples of 32"]),
            ("[refine]\nbatch_parts = 200", ["train.refine.batch_parts", "200", "1 to 128"]),
            ("[optimizer]\nrate = -1.0", ["train.optimizer.rate", "-1", "to 100"]),
            ("[augment]\nflip = 1.5", ["train.augment.flip", "1.5", "0 to 1"]),
            ("[schedule]\nkind = 'steps'\nat = [0.5]", ["train.schedule.factors", "2 factors", "1, one for each"]),
        ] {
            let message = toml::from_str::<Config>(text).unwrap().validate().unwrap_err().to_string();
            assert!(words.iter().all(|w| message.contains(w)), "{message}");
        }
        assert!(toml::from_str::<Config>("batchsize = 8").is_err());
    }
}
