//! `detections.jsonl`: what a detector claims, one line an image, also when it claims nothing.
use crate::{
    error::DatasetError,
    files,
    geom::{boxes::PixelBox, homography::Homography, quad::Quad},
};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// All claims about one image, by falling score.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ImageDetections {
    /// As in the dataset's record.
    pub image: String,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// By falling score; may be empty.
    pub detections: Vec<Detection>,
    /// Milliseconds a stage.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ms: Option<StageTimes>,
}

/// One claimed marker.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Detection {
    /// Objectness times class probability, 0..1.
    pub score: f64,
    /// Index of the class.
    pub class: u32,
    /// In pixels of the source image.
    #[serde(rename = "box")]
    pub bounds: PixelBox,
    /// The recovered pose, or why there is none; absent where it was not asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pose: Option<PoseOutcome>,
}

/// A pose, or a refusal: an answer, not a failure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum PoseOutcome {
    /// `{"refused": "reason"}`.
    Refused {
        /// Why no pose is claimed.
        refused: String,
    },
    /// A recovered pose.
    Found(Box<Pose>),
}

/// Where a marker lies in the image and, with a known camera, in space.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Where the lines meet, in pixels.
    pub center: [f64; 2],
    /// Clockwise as seen, the stem's first.
    pub corners: Quad,
    /// Degrees, [0, 360): 0 right, 90 up.
    pub angle: f64,
    /// Unit square to pixels, row-major.
    pub homography: Homography,
    /// Covariance of the centre in px squared: `[xx, xy, yy]`.
    pub covariance: [f64; 3],
    /// 0..1.
    pub quality: f64,
    /// Rotation of the marker in the camera's frame, row-major.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation: Option<[f64; 9]>,
    /// Centre of the marker in the camera's frame, in the unit of the given side.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub translation: Option<[f64; 3]>,
    /// Root mean square over the corners, in pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reprojection_px: Option<f64>,
    /// The other solution of the plane, where there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rival: Option<RivalPose>,
}

/// The second solution of a planar pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RivalPose {
    /// Rotation, row-major.
    pub rotation: [f64; 9],
    /// Translation, in the unit of the given side.
    pub translation: [f64; 3],
    /// Root mean square over the corners, in pixels.
    pub reprojection_px: f64,
}

/// Milliseconds spent on one image.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct StageTimes {
    /// Reading and decoding.
    pub decode: f64,
    /// Letterbox, network, boxes.
    pub network: f64,
    /// All poses of the image.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pose: Option<f64>,
}

/// Reads a whole detections file.
///
/// # Errors
/// If the file cannot be read, or a line is no JSON of this form (with the line's number).
pub fn read(path: impl AsRef<Path>) -> Result<Vec<ImageDetections>, DatasetError> {
    files::read_jsonl(path)
}

/// Writes a detections file, first under a temporary name.
///
/// # Errors
/// If the folder cannot be written.
pub fn write<'a>(path: impl AsRef<Path>, rows: impl IntoIterator<Item = &'a ImageDetections>) -> Result<(), DatasetError> {
    files::write_jsonl(path, rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusals_and_poses_are_told_apart() {
        let line = r#"{"image":"a.jpg","width":4,"height":4,"detections":[{"score":0.5,"class":0,"box":[0.0,0.0,2.0,2.0],"pose":{"refused":"cut by the border"}}]}"#;
        let row: ImageDetections = serde_json::from_str(line).unwrap();
        assert!(matches!(row.detections[0].pose, Some(PoseOutcome::Refused { .. })));
        assert_eq!(serde_json::to_string(&row).unwrap(), line);
    }
}
