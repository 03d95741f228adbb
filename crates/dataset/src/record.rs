//! One image and its truth: a line of `train.jsonl`, `val.jsonl` or `test.jsonl`. `FORMAT.md` defines each quantity.
use crate::geom::{boxes::PixelBox, homography::Homography, quad::Quad};
use serde::{Deserialize, Serialize};

/// One image of a dataset. Keys are written in this order; what does not apply is absent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Path relative to the dataset's folder, with `/`.
    pub image: String,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// The background it was drawn on: a photo's path relative to the backgrounds' folder, or `embedded/<kind>`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub background: Option<String>,
    /// Every marker of the image; may be empty.
    pub markers: Vec<Marker>,
    /// What was drawn to be taken for one, and is none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub confusers: Vec<Confuser>,
    /// Camera: `[fx, fy, cx, cy]` in pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub intrinsics: Option<[f64; 4]>,
    /// Radial lens distortion `[k1, k2]`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distortion: Option<[f64; 2]>,
    /// The parameters of every effect applied to the whole image, by name.
    #[serde(default, skip_serializing_if = "serde_json::Map::is_empty")]
    pub effects: serde_json::Map<String, serde_json::Value>,
}

impl Record {
    /// The photo it was drawn on; `None` where that is not known or the background is an embedded scene.
    #[must_use]
    pub fn photo(&self) -> Option<&str> {
        self.background.as_deref().filter(|b| !b.starts_with("embedded/"))
    }
}

/// Something that resembles a marker and is none: what is found there is a false positive.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Confuser {
    /// The shape's name, such as `cross_in_rectangle`.
    pub shape: String,
    /// Extent of what is drawn and visible, counted as a marker's.
    #[serde(rename = "box")]
    pub bounds: PixelBox,
}

/// One marker's truth. `corners` run clockwise as seen and start at the stem's corner.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Marker {
    /// The shape's name, such as `t_cross`.
    pub shape: String,
    /// Extent of what is drawn and visible, in pixels (datasets with `boxes = "inclusive"`: pixel indices, both ends in).
    #[serde(rename = "box")]
    pub bounds: PixelBox,
    /// The four corners, clockwise as seen, the stem's first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corners: Option<Quad>,
    /// Where the lines meet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub center: Option<[f64; 2]>,
    /// Degrees, [0, 360): 0 right, 90 up; of the vector from the centre to the stem's corner.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub angle: Option<f64>,
    /// Index of the stem's corner in `corners`: 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stem: Option<u32>,
    /// Fraction of the marker's area that is inside the image and not covered, 0..1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub visible: Option<f64>,
    /// Unit square to pixels, row-major.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub homography: Option<Homography>,
    /// Length of the motion blur in pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub blur_px: Option<f64>,
    /// Radius of the defocus in pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub defocus_px: Option<f64>,
    /// Angle between the marker's normal and the direction to the camera, in degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tilt_deg: Option<f64>,
    /// What it was drawn with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub medium: Option<String>,
    /// What it was drawn on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub surface: Option<String>,
    /// Colour of the fill, `#rrggbb`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fill: Option<String>,
    /// Colour of the lines, `#rrggbb`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub line: Option<String>,
    /// Thickness of the lines in pixels (paper mode).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub thickness: Option<f64>,
    /// Fraction of the marker's area hidden by an occluder, 0..1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub occlusion: Option<f64>,
    /// How it was put into the picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub blend: Option<String>,
    /// Curvature of its sheet in sides over radius, and the direction in which it bends in the marker's plane, in degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bend: Option<[f64; 2]>,
    /// Reflected light on it: its place `x, y` and its radius in sides from the middle, and its strength.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub glare: Option<[f64; 4]>,
    /// How the hand drew it, by name, such as `aspect` (width over height) and `wobble` (thousandths of the side).
    #[serde(default, skip_serializing_if = "serde_json::Map::is_empty")]
    pub hand: serde_json::Map<String, serde_json::Value>,
    /// What was drawn from the config for it, by name, where the other keys do not tell.
    #[serde(default, skip_serializing_if = "serde_json::Map::is_empty")]
    pub asked: serde_json::Map<String, serde_json::Value>,
    /// Rotation of the marker in the camera's frame, row-major.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation: Option<[f64; 9]>,
    /// Centre of the marker in the camera's frame, in units of the marker's side.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub translation: Option<[f64; 3]>,
    /// Visible pixels as run lengths over rows: `[skip, take, skip, take, ...]` from the image's first pixel.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mask: Option<Vec<u32>>,
    /// The seed of the marker's own random streams.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
}

impl Marker {
    /// A marker of which only shape and box are known.
    #[must_use]
    pub fn from_box(shape: impl Into<String>, bounds: PixelBox) -> Self {
        Self {
            shape: shape.into(),
            bounds,
            corners: None,
            center: None,
            angle: None,
            stem: None,
            visible: None,
            homography: None,
            blur_px: None,
            defocus_px: None,
            tilt_deg: None,
            medium: None,
            surface: None,
            fill: None,
            line: None,
            thickness: None,
            occlusion: None,
            blend: None,
            bend: None,
            glare: None,
            hand: serde_json::Map::new(),
            asked: serde_json::Map::new(),
            rotation: None,
            translation: None,
            mask: None,
            seed: None,
        }
    }
}
