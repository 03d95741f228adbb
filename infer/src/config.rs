//! The `[infer]` section.
use crate::{error::InferError, pose, video::smooth};
use serde::{Deserialize, Serialize};
use tcross_yolo::{DetectOptions, Detector};

/// How detections are made from images.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Detections are kept whose score (objectness x class probability) is at least this, 0..1.
    pub score: f64,
    /// Of two detections of one class that overlap by more than this IoU, the one of lower score goes, 0..1.
    pub nms: f64,
    /// At most this many detections an image.
    pub most: usize,
    /// Whether a model's second stage, where it has one, looks at each claim again.
    pub refine: bool,
    /// Whether poses are recovered.
    pub pose: bool,
    /// Detections whose pose is refused are dropped: the pose as a filter of false detections.
    pub pose_filter: bool,
    /// Score from which overlays show a detection, 0..1.
    pub overlay_score: f64,
    /// How poses are recovered.
    pub recovery: pose::Config,
    /// How poses of videos and cameras are smoothed over time.
    pub smoothing: smooth::Config,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            score: 0.05,
            nms: 0.45,
            most: 200,
            refine: true,
            pose: false,
            pose_filter: false,
            overlay_score: 0.3,
            recovery: pose::Config::default(),
            smoothing: smooth::Config::default(),
        }
    }
}

impl Config {
    /// Checks every value.
    ///
    /// # Errors
    /// The first value that is not allowed, with its key and what is.
    pub fn validate(&self) -> Result<(), InferError> {
        let share = |key: &'static str, value: f64| {
            if (0.0..=1.0).contains(&value) {
                Ok(())
            } else {
                Err(InferError::Value { key, found: value.to_string(), allowed: "a number from 0 to 1" })
            }
        };
        share("infer.score", self.score)?;
        share("infer.nms", self.nms)?;
        share("infer.overlay_score", self.overlay_score)?;
        share("infer.recovery.padding", self.recovery.padding)?;
        share("infer.recovery.min_quality", self.recovery.min_quality)?;
        self.smoothing.validate()?;
        if self.most == 0 {
            return Err(InferError::Value { key: "infer.most", found: "0".into(), allowed: "1 or more" });
        }
        if !(self.recovery.min_side_px >= 1.0 && self.recovery.min_side_px.is_finite()) {
            let found = self.recovery.min_side_px.to_string();
            return Err(InferError::Value { key: "infer.recovery.min_side_px", found, allowed: "a number of pixels, 1 or more" });
        }
        Ok(())
    }

    /// A detector that looks as this configuration says and keeps what it asks for.
    #[must_use]
    pub fn configure(&self, mut detector: Detector) -> Detector {
        detector.options = DetectOptions { score: self.score as f32, nms_iou: self.nms, most: self.most, ..detector.options };
        detector.refiner = detector.refiner.filter(|_| self.refine);
        detector
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_values_are_named() {
        assert!(Config::default().validate().is_ok());
        for (config, key) in [
            (Config { score: 1.5, ..Config::default() }, "infer.score"),
            (Config { nms: f64::NAN, ..Config::default() }, "infer.nms"),
            (Config { most: 0, ..Config::default() }, "infer.most"),
        ] {
            assert!(config.validate().unwrap_err().to_string().starts_with(key));
        }
    }
}
