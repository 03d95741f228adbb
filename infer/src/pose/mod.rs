//! From a detection's box to the marker's pose, or to the reason why none is claimed.
pub mod arms;
pub mod colour;
pub mod crop;
pub mod edges;
pub mod evidence;
pub mod fit;
pub mod model;
pub mod paper;
pub mod plane;
pub mod quad;
mod refusal;
pub mod search;
pub mod square;
pub mod stroke;

pub use refusal::Refusal;

use crop::Picture;
use image::RgbImage;
use serde::{Deserialize, Serialize};
use tcross_dataset::{PixelBox, Pose, PoseOutcome};

/// Which method recovers poses.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// The T cross fitted as a whole (ours).
    #[default]
    Model,
    /// The paper's chain: hue filter, Canny, Hough, four clusters.
    Paper,
}

/// How poses are recovered.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Method: `model` (ours) or `paper`.
    pub method: Method,
    /// Surroundings looked at beside the box, as a share of its longer side, 0..1.
    pub padding: f64,
    /// Boxes with a shorter side below this many pixels are refused.
    pub min_side_px: f64,
    /// Poses of a lower quality are refused, 0..1.
    pub min_quality: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self { method: Method::Model, padding: 0.22, min_side_px: 8.0, min_quality: 0.03 }
    }
}

/// The pose of the marker in `bounds`, in pixels of `image`, or a refusal with its reason. Never panics: any image and any
/// numbers in the box are answered.
#[must_use]
pub fn recover(image: &RgbImage, bounds: &PixelBox, config: &Config) -> PoseOutcome {
    match try_recover(image, bounds, config) {
        Ok(pose) => PoseOutcome::Found(Box::new(pose)),
        Err(refusal) => PoseOutcome::Refused { refused: refusal.to_string() },
    }
}

/// As [`recover`], with the refusal as a type.
///
/// # Errors
/// The reason for which no pose is claimed.
pub fn try_recover(image: &RgbImage, bounds: &PixelBox, config: &Config) -> Result<Pose, Refusal> {
    match config.method {
        Method::Model => model::recover(image, bounds, config),
        Method::Paper => paper::recover(image, bounds, config, None),
    }
}

/// The picture and the part of the box inside it, if they can hold a marker at all.
fn checked<'a>(image: &'a RgbImage, bounds: &PixelBox, config: &Config) -> Result<(Picture<'a>, PixelBox), Refusal> {
    if !bounds.is_valid() {
        return Err(Refusal::NoBox);
    }
    if bounds.area() <= 0.0 {
        return Err(Refusal::NoArea);
    }
    let picture = Picture::new(image).ok_or(Refusal::Outside)?;
    let inside = bounds.clipped(picture.width as f64, picture.height as f64);
    if inside.area() <= 0.0 {
        return Err(Refusal::Outside);
    }
    if inside.short_side() < config.min_side_px {
        return Err(Refusal::TooSmall);
    }
    Ok((picture, inside))
}

/// The box with its surroundings, inside the picture.
fn padded(picture: &Picture, b: &PixelBox, share: f64) -> PixelBox {
    let pad = share * b.width().max(b.height()) + 3.0;
    PixelBox { x_min: b.x_min - pad, y_min: b.y_min - pad, x_max: b.x_max + pad, y_max: b.y_max + pad }
        .clipped(picture.width as f64, picture.height as f64)
}
