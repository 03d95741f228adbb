//! The `[data]` section: every choice of the generator as a named number, distribution or weighted choice.
use crate::{blend::Blend, dist::Dist, error::DatagenError, hand::video::Moment, media::Medium, shapes::Shape, surface::Surface};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tcross_dataset::{Rng, Split, dataset::BoxConvention};

/// A choice among names, each with a weight; names that are not there, or have weight 0, are never drawn.
pub type Weights<T> = BTreeMap<T, f64>;

/// How markers are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Style {
    /// The paper's artificial images, pixel for pixel: one axis-aligned marker an image, no antialiasing, inclusive boxes.
    Paper,
    /// Markers drawn by a hand with a pen, seen by a camera.
    HandDrawn,
}

/// What a dataset is made of. The default is the hand-drawn style, as varied as the generator draws.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// How markers are drawn: "paper" or "hand-drawn".
    pub style: Style,
    /// Number of images over all splits; image i is in the split of i mod 10 (0-6 train, 7-8 val, 9 test).
    pub images: u64,
    /// Width of an image in pixels.
    pub width: u32,
    /// Height of an image in pixels.
    pub height: u32,
    /// JPEG quality of the stored images, 1..100.
    pub jpeg_quality: Dist,
    /// What stands behind the markers.
    pub background: BackgroundConfig,
    /// The paper's protocol (style "paper").
    pub paper: PaperConfig,
    /// How many markers, which, how large, how seen (style "hand-drawn").
    pub markers: MarkersConfig,
    /// The hand that draws (style "hand-drawn").
    pub hand: HandConfig,
    /// What light, lens and sensor do (style "hand-drawn").
    pub camera: CameraConfig,
    /// What may be taken for a marker and is none (style "hand-drawn").
    pub confusers: ConfusersConfig,
    /// Videos instead of single images (style "hand-drawn").
    pub video: VideoConfig,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            style: Style::HandDrawn,
            images: 3000,
            width: 416,
            height: 416,
            jpeg_quality: Dist::uniform(70.0, 97.0),
            background: BackgroundConfig::default(),
            paper: PaperConfig::default(),
            markers: MarkersConfig::default(),
            hand: HandConfig::default(),
            camera: CameraConfig::default(),
            confusers: ConfusersConfig::default(),
            video: VideoConfig::default(),
        }
    }
}

/// Backgrounds: crops of photos, or embedded scenes where no photos are given.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct BackgroundConfig {
    /// Side of the crop as a fraction of the largest crop of the image's shape that fits the photo; crops smaller than the image are
    /// enlarged to its size first where the photo allows it.
    pub crop: Dist,
    /// Share of photo crops that are mirrored.
    pub mirrored: f64,
    /// Keeps photos that show nearly the same in one split. Every photo is decoded once for it before the first image.
    pub near_duplicates_together: bool,
    /// Whether embedded scenes stand behind the markers even where photos are given.
    pub embedded: bool,
    /// Embedded scenes by kind.
    pub scenes: Weights<SceneKind>,
}

impl Default for BackgroundConfig {
    fn default() -> Self {
        Self {
            crop: Dist::uniform(0.5, 1.0),
            mirrored: 0.5,
            near_duplicates_together: true,
            embedded: false,
            scenes: SceneKind::ALL.into_iter().map(|k| (k, 1.0)).collect(),
        }
    }
}

/// Kinds of embedded scenes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SceneKind {
    /// Floor, walls, furniture, windows and pictures in perspective.
    Room,
    /// Sky, hills, houses and ground.
    Outdoors,
    /// A table from above with papers, books and pens.
    Desk,
    /// Overlapping textured patches of all sizes.
    Leaves,
}

impl SceneKind {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Room, Self::Outdoors, Self::Desk, Self::Leaves];

    /// The word used in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Room => "room",
            Self::Outdoors => "outdoors",
            Self::Desk => "desk",
            Self::Leaves => "leaves",
        }
    }
}

/// The paper's artificial images, section 2 of its notes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PaperConfig {
    /// One of the paper's shapes.
    pub shape: Shape,
    /// Thickness of the lines in pixels: 1, 2 or "int 1..2".
    pub thickness: Dist,
    /// Colours: "fixed" green and blue, or "colored" (the paper's coloured variants).
    pub colors: PaperColors,
    /// Width of the marker in pixels, whole numbers; it covers one pixel more.
    pub width: Dist,
    /// Height of the marker in pixels, whole numbers; it covers one pixel more.
    pub height: Dist,
    /// The one side of the @ sign in pixels, whole numbers.
    pub at_sign_side: Dist,
}

impl Default for PaperConfig {
    fn default() -> Self {
        Self {
            shape: Shape::TCross,
            thickness: Dist::constant(2.0),
            colors: PaperColors::Fixed,
            width: Dist::int(5, 60),
            height: Dist::int(6, 50),
            at_sign_side: Dist::int(15, 45),
        }
    }
}

/// Colours of the paper's images.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PaperColors {
    /// (0, 200, 0) and (0, 0, 200).
    Fixed,
    /// Two of three channels at 200..255 for the fill, one for the lines.
    Colored,
}

/// Markers of the hand-drawn style.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MarkersConfig {
    /// Markers an image, whole numbers; 0 is an image without a marker.
    pub per_image: Dist,
    /// Shapes by weight.
    pub shapes: Weights<Shape>,
    /// Side in pixels: the root of the area of the marker's quadrilateral in the image. "log 8..416" is every octave alike.
    pub side_px: Dist,
    /// Angle between the marker's normal and the direction to the camera, in degrees.
    pub tilt_deg: Dist,
    /// Width by height of the drawn rectangle.
    pub aspect: Dist,
    /// Turn about the normal, in degrees.
    pub roll_deg: Dist,
    /// Share of markers that may be cut by the image's border.
    pub cut: f64,
    /// Fraction of a marker's area covered by something in front of it.
    pub occlusion: Dist,
    /// Share of markers on bent paper.
    pub bent: f64,
    /// Curvature of bent sheets: side over radius.
    pub bend: Dist,
    /// Width of the paper's margin around the marker, in sides; each of the four is 0.6 to 1.6 times this.
    pub margin: Dist,
    /// What a marker is drawn on, by weight.
    pub surfaces: Weights<Surface>,
    /// What a fill is drawn with, by weight.
    pub media: Weights<Medium>,
    /// What the lines are drawn with, by weight; a medium that would not show on the fill is drawn again.
    pub line_media: Weights<Medium>,
    /// Hues of the fills in degrees (0 red, 120 green, 240 blue), each alike; videos take them in turn. Where there is none, any hue.
    pub hues: Vec<f64>,
    /// How markers are put into the picture, by weight, so that no kind of seam gives them away.
    pub blend: Weights<Blend>,
}

impl Default for MarkersConfig {
    fn default() -> Self {
        let even = |media: &[Medium]| media.iter().map(|m| (*m, 1.0)).collect::<Weights<_>>();
        Self {
            per_image: "20% 0, 55% 1, 15% 2, 10% int 3..4".parse().unwrap_or_else(|_| Dist::constant(1.0)),
            shapes: [(Shape::TCross, 1.0)].into(),
            side_px: Dist::log(8.0, 416.0),
            tilt_deg: "60% 0..45, 40% 45..75".parse().unwrap_or_else(|_| Dist::constant(0.0)),
            aspect: Dist::log(0.8, 1.25),
            roll_deg: Dist::uniform(0.0, 360.0),
            cut: 0.08,
            occlusion: "85% 0, 15% 0.02..0.6".parse().unwrap_or_else(|_| Dist::constant(0.0)),
            bent: 0.3,
            bend: Dist::uniform(-0.5, 0.5),
            margin: Dist::uniform(0.04, 0.5),
            surfaces: Surface::ALL.into_iter().map(|s| (s, if s == Surface::Photo { 2.0 } else { 1.0 })).collect(),
            media: even(&Medium::ALL),
            line_media: even(&[
                Medium::FeltTip,
                Medium::BallPen,
                Medium::DryErase,
                Medium::Print,
                Medium::Crayon,
                Medium::Highlighter,
                Medium::Paint,
            ]),
            hues: Vec::new(),
            blend: Blend::ALL.into_iter().map(|b| (b, if b == Blend::Matched { 3.0 } else { 1.0 })).collect(),
        }
    }
}

/// The hand: 1 is an ordinary one, 0 a ruler.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct HandConfig {
    /// How much strokes wander, in thousandths of the side (deviation of the middle of a stroke of one side).
    pub wobble: Dist,
    /// How far the four corners stand from a rectangle's, as a fraction of the side; the truth follows.
    pub corner_error: Dist,
    /// How far lines start and end from where they should, as a fraction of the side.
    pub end_error: Dist,
    /// Width of the lines as a fraction of the side.
    pub line_width: Dist,
    /// Share of fills that are hatched; others are flat.
    pub hatched: f64,
    /// Distance of hatching strokes in nib widths.
    pub hatch_spacing: Dist,
    /// Angle of the hatching to the marker's first side, in degrees.
    pub hatch_deg: Dist,
    /// Share of markers with an outline drawn around the fill.
    pub outlined: f64,
    /// Share of lines that are drawn twice.
    pub retraced: f64,
    /// Share of strokes with a gap.
    pub gaps: f64,
}

impl Default for HandConfig {
    fn default() -> Self {
        Self {
            wobble: Dist::log(3.0, 25.0),
            corner_error: Dist::uniform(0.0, 0.04),
            end_error: Dist::uniform(0.0, 0.03),
            line_width: Dist::log(0.04, 0.14),
            hatched: 0.75,
            hatch_spacing: Dist::uniform(0.55, 1.1),
            hatch_deg: Dist::uniform(0.0, 180.0),
            outlined: 0.5,
            retraced: 0.15,
            gaps: 0.06,
        }
    }
}

/// Light, lens and sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CameraConfig {
    /// Horizontal field of view in degrees.
    pub field_of_view_deg: Dist,
    /// Radial distortion k1 of the lens (r in focal lengths).
    pub distortion: Dist,
    /// Length of the motion blur as a fraction of the marker's side.
    pub motion_blur: Dist,
    /// The longest motion blur in pixels.
    pub motion_blur_max_px: f64,
    /// Direction of the motion in degrees.
    pub motion_deg: Dist,
    /// Bend of the motion's path: sagitta over length.
    pub motion_curve: Dist,
    /// Share of blurred images in which the camera moves; in the others the marker alone does.
    pub camera_moves: f64,
    /// Radius of the defocus in pixels.
    pub defocus_px: Dist,
    /// Least blur of the marker alone: deviation in pixels. Where the photo's own edges are softer, it is as soft as they are.
    pub softness_px: Dist,
    /// Exposure in stops.
    pub exposure_stops: Dist,
    /// Gain of red and loss of blue of the white balance, in stops.
    pub white_balance_stops: Dist,
    /// Noise of the sensor: deviation at full light, in hundredths of it (shot noise), a tenth of it in the dark.
    pub noise_percent: Dist,
    /// Share of images with a cast shadow.
    pub shadows: f64,
    /// Share of markers with glare.
    pub glare: f64,
}

impl Default for CameraConfig {
    fn default() -> Self {
        let dist = |text: &str| text.parse().unwrap_or_else(|_| Dist::constant(0.0));
        Self {
            field_of_view_deg: Dist::uniform(45.0, 80.0),
            distortion: Dist::uniform(-0.08, 0.04),
            motion_blur: dist("45% 0, 45% 0.02..0.15, 10% 0.15..0.4"),
            motion_blur_max_px: 64.0,
            motion_deg: Dist::uniform(0.0, 180.0),
            motion_curve: dist("70% 0, 30% -0.2..0.2"),
            camera_moves: 0.7,
            defocus_px: dist("65% 0, 35% log 0.4..3"),
            softness_px: Dist::uniform(0.3, 0.9),
            exposure_stops: Dist::uniform(-0.7, 0.5),
            white_balance_stops: Dist::uniform(-0.2, 0.2),
            noise_percent: dist("30% 0, 70% log 0.3..5"),
            shadows: 0.25,
            glare: 0.08,
        }
    }
}

/// What is not a marker.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ConfusersConfig {
    /// Near misses an image, whole numbers: drawn like markers, not annotated.
    pub near_misses: Dist,
    /// Shapes of near misses by weight.
    pub shapes: Weights<Shape>,
    /// Stickers, stripes, signs and words an image, whole numbers.
    pub stickers: Dist,
}

impl Default for ConfusersConfig {
    fn default() -> Self {
        let dist = |text: &str| text.parse().unwrap_or_else(|_| Dist::constant(0.0));
        Self {
            near_misses: dist("65% 0, 25% 1, 10% int 2..3"),
            shapes: Shape::ALL.into_iter().filter(|s| *s != Shape::TCross).map(|s| (s, 1.0)).collect(),
            stickers: dist("50% 0, 50% int 1..5"),
        }
    }
}

/// Short videos of one marker each by a hand-held camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct VideoConfig {
    /// Number of videos over all images, each of one marker; 0 makes single images. Images are dealt to them evenly and in order.
    pub sequences: u64,
    /// Frames a second.
    pub fps: f64,
    /// Every N-th frame becomes an image.
    pub every: u64,
    /// How far the camera wanders, as a fraction of its distance from the marker.
    pub wander: Dist,
    /// How fast it wanders: turns a second of its slowest motion.
    pub pace_hz: Dist,
    /// How much the hand trembles, in degrees.
    pub tremor_deg: Dist,
    /// How long the shutter is open, in milliseconds; what moves meanwhile is blurred.
    pub exposure_ms: Dist,
    /// True: all frames of a video stand in one split. False: image i is in the split of i mod 10 as in the paper, so that nearly the same
    /// picture may be learnt from and tested on.
    pub whole_sequences: bool,
}

impl Default for VideoConfig {
    fn default() -> Self {
        Self {
            sequences: 0,
            fps: 30.0,
            every: 10,
            wander: Dist::uniform(0.15, 0.5),
            pace_hz: Dist::log(0.05, 0.25),
            tremor_deg: Dist::uniform(0.02, 0.2),
            exposure_ms: Dist::log(4.0, 33.0),
            whole_sequences: true,
        }
    }
}

/// One of the names, by weight.
pub fn choose<T: Copy>(weights: &Weights<T>, rng: &mut Rng) -> Option<T> {
    if weights.is_empty() {
        return None;
    }
    let index = rng.weighted(&weights.values().copied().collect::<Vec<_>>());
    weights.keys().nth(index).copied()
}

impl Config {
    /// How the boxes of a dataset made from this are to be read.
    #[must_use]
    pub fn boxes(&self) -> BoxConvention {
        match self.style {
            Style::Paper => BoxConvention::Inclusive,
            Style::HandDrawn => BoxConvention::Continuous,
        }
    }

    /// The split of image `index`: by `index mod 10`, or the split of its video.
    #[must_use]
    pub fn split_of(&self, index: u64) -> Split {
        match Moment::of(&self.video, self.images, index).filter(|_| self.video.whole_sequences) {
            // Videos are dealt like ten groups of images, in order.
            Some(moment) => Split::of(((2 * moment.sequence + 1) * 5 / self.video.sequences) as usize),
            None => Split::of(index as usize),
        }
    }

    /// Checks every value against what is possible.
    ///
    /// # Errors
    /// Names the first key that cannot be, what was found, and what is allowed.
    pub fn validate(&self) -> Result<(), DatagenError> {
        check(self.images > 0, "images", self.images, "at least 1")?;
        for (key, value) in [("width", self.width), ("height", self.height)] {
            check((32..=8192).contains(&value), key, value, "32 to 8192")?;
        }
        within("jpeg_quality", &self.jpeg_quality, 1.0, 100.0)?;
        within("background.crop", &self.background.crop, 0.01, 1.0)?;
        share("background.mirrored", self.background.mirrored)?;
        weights("background.scenes", &self.background.scenes)?;
        let videos = self.video.sequences > 0 && self.style == Style::Paper;
        check(!videos, "video.sequences", self.video.sequences, "0 in style \"paper\"")?;
        match self.style {
            Style::Paper => self.validate_paper(),
            Style::HandDrawn => self.validate_hand_drawn(),
        }
    }

    fn validate_paper(&self) -> Result<(), DatagenError> {
        let p = &self.paper;
        within("paper.thickness", &p.thickness, 1.0, 2.0)?;
        within("paper.width", &p.width, 1.0, f64::from(self.width) - 3.0)?;
        within("paper.height", &p.height, 1.0, f64::from(self.height) - 3.0)?;
        within("paper.at_sign_side", &p.at_sign_side, 4.0, f64::from(self.width.min(self.height)) - 3.0)
    }

    fn validate_hand_drawn(&self) -> Result<(), DatagenError> {
        let (m, h, c) = (&self.markers, &self.hand, &self.camera);
        within("markers.per_image", &m.per_image, 0.0, 32.0)?;
        within("markers.side_px", &m.side_px, 2.0, 4.0 * f64::from(self.width.max(self.height)))?;
        within("markers.tilt_deg", &m.tilt_deg, 0.0, 85.0)?;
        within("markers.aspect", &m.aspect, 0.2, 5.0)?;
        within("markers.roll_deg", &m.roll_deg, -360.0, 360.0)?;
        within("markers.occlusion", &m.occlusion, 0.0, 0.95)?;
        within("markers.bend", &m.bend, -1.0, 1.0)?;
        within("markers.margin", &m.margin, 0.0, 3.0)?;
        weights("markers.shapes", &m.shapes)?;
        weights("markers.surfaces", &m.surfaces)?;
        weights("markers.media", &m.media)?;
        weights("markers.line_media", &m.line_media)?;
        weights("markers.blend", &m.blend)?;
        within("hand.wobble", &h.wobble, 0.0, 200.0)?;
        within("hand.corner_error", &h.corner_error, 0.0, 0.3)?;
        within("hand.end_error", &h.end_error, 0.0, 0.3)?;
        within("hand.line_width", &h.line_width, 0.005, 0.5)?;
        within("hand.hatch_spacing", &h.hatch_spacing, 0.2, 5.0)?;
        within("camera.field_of_view_deg", &c.field_of_view_deg, 5.0, 150.0)?;
        within("camera.distortion", &c.distortion, -0.25, 0.5)?;
        within("camera.motion_blur", &c.motion_blur, 0.0, 2.0)?;
        within("camera.motion_curve", &c.motion_curve, -0.5, 0.5)?;
        check((0.0..=256.0).contains(&c.motion_blur_max_px), "camera.motion_blur_max_px", c.motion_blur_max_px, "0 to 256")?;
        within("camera.defocus_px", &c.defocus_px, 0.0, 32.0)?;
        within("camera.softness_px", &c.softness_px, 0.0, 8.0)?;
        within("camera.exposure_stops", &c.exposure_stops, -6.0, 6.0)?;
        within("camera.white_balance_stops", &c.white_balance_stops, -2.0, 2.0)?;
        within("camera.noise_percent", &c.noise_percent, 0.0, 50.0)?;
        within("confusers.near_misses", &self.confusers.near_misses, 0.0, 31.0)?;
        within("confusers.stickers", &self.confusers.stickers, 0.0, 50.0)?;
        weights("confusers.shapes", &self.confusers.shapes)?;
        let both = self.confusers.shapes.iter().find(|(shape, w)| **w > 0.0 && m.shapes.get(shape).is_some_and(|w| *w > 0.0));
        let never = self.confusers.near_misses.bounds().1 < 1.0;
        if let Some((shape, _)) = both.filter(|_| !never) {
            return Err(DatagenError::config(
                "confusers.shapes",
                shape.name(),
                "shapes that are no markers (markers.shapes has this one too)",
            ));
        }
        for (key, value) in [
            ("markers.cut", m.cut),
            ("markers.bent", m.bent),
            ("hand.hatched", h.hatched),
            ("hand.outlined", h.outlined),
            ("hand.retraced", h.retraced),
            ("hand.gaps", h.gaps),
            ("camera.camera_moves", c.camera_moves),
            ("camera.shadows", c.shadows),
            ("camera.glare", c.glare),
        ] {
            share(key, value)?;
        }
        check(m.hues.iter().all(|h| (0.0..=360.0).contains(h)), "markers.hues", format!("{:?}", m.hues), "0 to 360")?;
        if self.video.sequences > 0 { self.validate_video() } else { Ok(()) }
    }

    fn validate_video(&self) -> Result<(), DatagenError> {
        let v = &self.video;
        check(v.sequences <= self.images, "video.sequences", v.sequences, "at most one an image")?;
        check((1.0..=1000.0).contains(&v.fps), "video.fps", v.fps, "1 to 1000")?;
        check((1..=10_000).contains(&v.every), "video.every", v.every, "1 to 10000")?;
        within("video.wander", &v.wander, 0.0, 0.8)?;
        within("video.pace_hz", &v.pace_hz, 0.0, 5.0)?;
        within("video.tremor_deg", &v.tremor_deg, 0.0, 5.0)?;
        within("video.exposure_ms", &v.exposure_ms, 0.0, 500.0)?;
        let (one, none) = (self.markers.per_image.bounds(), self.confusers.near_misses.bounds());
        check(one == (1.0, 1.0), "markers.per_image", format!("\"{}\"", self.markers.per_image), "1 where there are videos")?;
        check(none == (0.0, 0.0), "confusers.near_misses", format!("\"{}\"", self.confusers.near_misses), "0 where there are videos")
    }
}

fn check(allowed: bool, key: &str, found: impl ToString, what: &str) -> Result<(), DatagenError> {
    if allowed { Ok(()) } else { Err(DatagenError::config(key, found, what)) }
}

fn within(key: &str, dist: &Dist, lo: f64, hi: f64) -> Result<(), DatagenError> {
    let (min, max) = dist.bounds();
    check(min >= lo && max <= hi, key, format!("\"{dist}\""), &format!("{lo} to {hi}"))
}

fn share(key: &str, value: f64) -> Result<(), DatagenError> {
    check((0.0..=1.0).contains(&value), key, value, "0 to 1")
}

fn weights<T: Serialize>(key: &str, weights: &Weights<T>) -> Result<(), DatagenError> {
    let sum: f64 = weights.values().sum();
    let sound = weights.values().all(|w| w.is_finite() && *w >= 0.0) && sum > 0.0;
    check(sound, key, serde_json::to_string(weights).unwrap_or_default(), "weights of at least 0, one of them above 0")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_valid_and_survives_toml() {
        let config = Config::default();
        config.validate().unwrap();
        let text = toml::to_string(&config).unwrap();
        assert_eq!(toml::from_str::<Config>(&text).unwrap(), config);
    }

    #[test]
    fn refusals_name_the_key_and_what_is_allowed() {
        let config: Config = toml::from_str("[markers]\ntilt_deg = \"0..89\"").unwrap();
        assert_eq!(config.validate().unwrap_err().to_string(), "data.markers.tilt_deg = \"0..89\": allowed is 0 to 85");
        assert!(toml::from_str::<Config>("[markers]\ntilt = 3").unwrap_err().to_string().contains("unknown field `tilt`"));
        assert!(toml::from_str::<Config>("[markers]\nmedia = { crayons = 1 }").unwrap_err().to_string().contains("crayons"));
    }
}
