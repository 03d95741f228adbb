//! Losses over raw logits, in plain Rust: the terms to log, and the gradient of each logit.
//!
//! Training reads the heads back, asks for the gradient, and calls `(logits * gradient).sum().backward()`: the same code on every device.
use crate::{error::YoloError, geometry::Geometry};
use tcross_dataset::PixelBox;

/// A box to learn, in fractions of the network's input.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// Centre, 0..1.
    pub x: f32,
    /// Centre, 0..1.
    pub y: f32,
    /// Width, above 0.
    pub w: f32,
    /// Height, above 0.
    pub h: f32,
    /// Index of the class.
    pub class: u32,
    /// Share of the picture it comes from (mix-up), 0..1; 1 for a plain picture.
    pub weight: f32,
}

impl Truth {
    /// From a continuous box in net-input pixels.
    #[must_use]
    pub fn from_net_box(bounds: &PixelBox, class: u32, net: crate::NetSize) -> Self {
        let (w, h) = (net.width as f64, net.height as f64);
        let [cx, cy] = bounds.center();
        let (x, y) = ((cx / w) as f32, (cy / h) as f32);
        Self { x, y, w: (bounds.width() / w) as f32, h: (bounds.height() / h) as f32, class, weight: 1.0 }
    }
}

/// Which loss.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum LossKind {
    /// Darknet's: cross-entropy on x, y, objectness and classes, squared error on w, h.
    #[default]
    Darknet,
    /// The paper's: squared errors on the box, focal objectness, mix-up weights.
    Paper,
}

/// A loss with its settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Loss {
    /// Which formula.
    pub kind: LossKind,
    /// A predictor whose box overlaps a truth by more than this is no negative.
    pub ignore_iou: f32,
}

/// The parts of a loss, each summed over cells and heads and divided by the batch.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct LossTerms {
    /// Of x and y.
    pub center: f64,
    /// Of w and h.
    pub size: f64,
    /// Of the objectness.
    pub objectness: f64,
    /// Of the classes.
    pub class: f64,
    /// Of keypoints; 0 where there are none.
    pub keypoints: f64,
}

impl LossTerms {
    /// The sum that training makes small.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.center + self.size + self.objectness + self.class + self.keypoints
    }
}

/// What a loss says about a batch.
#[derive(Debug, Clone, PartialEq)]
pub struct LossOutput {
    /// The parts.
    pub terms: LossTerms,
    /// The gradient of the total for each head's logits, laid out as they are.
    pub gradients: Vec<Vec<f32>>,
}

impl Loss {
    /// Terms and gradients of a batch: each head's logits `[batch, anchor, field, row, column]`, and the truths of each image.
    ///
    /// # Errors
    /// If a truth is out of range, or the lengths do not fit.
    pub fn evaluate(&self, geometry: &Geometry, logits: &[Vec<f32>], truths: &[Vec<Truth>]) -> Result<LossOutput, YoloError> {
        let _ = (geometry, logits, truths);
        todo!("next step")
    }
}
