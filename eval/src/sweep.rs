//! One-factor datasets: the metrics as curves against the one thing that varies.
//!
//! The images are sorted by the factor and cut into classes of equal count; each class is scored at the configured threshold
//! as a set of its own, so a point of a curve has the same definition and the same intervals as the headline row.
use crate::{
    error::EvalError,
    evaluation::Evaluation,
    min_side::short_side,
    protocol::{
        paper::{Row, Scores},
        pose::{PoseError, Spread},
    },
    truth::Truth,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::{borrow::Cow, collections::BTreeSet, str::FromStr};
use tcross_dataset::{Marker, Record};

/// What a dataset varies alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Factor {
    /// Length of the motion's path in sides of the marker.
    Blur,
    /// Angle between the sheet's normal and the line of sight, degrees.
    Tilt,
    /// Short side of the box, pixels.
    Size,
    /// Covered part of the marker, 0..1.
    Occlusion,
    /// Sensor noise, percent of full scale.
    Noise,
    /// Exposure, stops from nominal.
    Light,
}

impl Factor {
    /// All six.
    pub const ALL: [Self; 6] = [Self::Blur, Self::Tilt, Self::Size, Self::Occlusion, Self::Noise, Self::Light];

    /// As typed and as part of a file's name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Blur => "blur",
            Self::Tilt => "tilt",
            Self::Size => "size",
            Self::Occlusion => "occlusion",
            Self::Noise => "noise",
            Self::Light => "light",
        }
    }

    /// On an axis, with its unit.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            Self::Blur => "motion blur (fraction of the marker's side)",
            Self::Tilt => "tilt (degrees)",
            Self::Size => "short side of the box (px)",
            Self::Occlusion => "covered part of the marker (fraction)",
            Self::Noise => "noise (% of full scale)",
            Self::Light => "exposure (stops)",
        }
    }

    /// True where a dataset spreads it evenly over octaves.
    #[must_use]
    pub fn is_log(self) -> bool {
        matches!(self, Self::Size | Self::Noise)
    }

    /// Its value in an image and for a marker; `None` where the record does not tell.
    #[must_use]
    pub fn value(self, record: &Record, marker: &Marker, extra: f64) -> Option<f64> {
        let effect = |key: &str| record.effects.get(key).and_then(serde_json::Value::as_f64);
        match self {
            Self::Blur => {
                let side = marker.corners.map_or_else(|| short_side(&marker.bounds, extra), |c| c.side_px());
                marker.blur_px.map(|b| b / side.max(1.0))
            }
            Self::Tilt => marker.tilt_deg,
            Self::Size => Some(short_side(&marker.bounds, extra)),
            Self::Occlusion => marker.occlusion.or(marker.visible.map(|v| 1.0 - v)),
            Self::Noise => effect("noise_percent"),
            Self::Light => effect("exposure_stops"),
        }
    }
}

impl FromStr for Factor {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|f| f.name() == s).ok_or_else(|| {
            let all: Vec<&str> = Self::ALL.iter().map(|f| f.name()).collect();
            format!("'{s}' is no factor; expected one of {}", all.join(", "))
        })
    }
}

/// A class of images with similar values of the factor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Point {
    /// Smallest value.
    pub from: f64,
    /// Largest value.
    pub to: f64,
    /// Mean value: where the point stands.
    pub at: f64,
    /// How many images.
    pub images: u64,
    /// How many markers.
    pub markers: u64,
    /// False positives an image.
    pub fp_per_image: f64,
    /// The metrics at the configured threshold.
    #[serde(flatten)]
    pub row: Row,
    /// Where poses were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pose: Option<PointPose>,
}

/// Poses of a class.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PointPose {
    /// Fraction of all markers with a pose.
    pub recovered: f64,
    /// Fraction of the poses whose angle is wrong by more than 45 degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wrong_orientation: Option<f64>,
    /// Error of the centre, percent of the side.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub center_percent: Option<Spread>,
    /// Error of the corners, percent of the side.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub corner_percent: Option<Spread>,
    /// Error of the angle, degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub angle_deg: Option<Spread>,
}

/// Curves over one factor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Sweep {
    /// What varies.
    pub factor: Factor,
    /// The run's name.
    pub run: String,
    /// Score threshold of every point.
    pub threshold: f64,
    /// Images without a marker, which have no value and are in no point.
    pub images_without: u64,
    /// By rising value.
    pub points: Vec<Point>,
}

/// Fewest images of a point, and most points of a curve.
const LEAST: usize = 20;
const MOST: usize = 10;

/// The curves of a run over a factor. An image has the value of its first marker.
///
/// # Errors
/// If a record with a marker does not tell the factor's value.
pub fn sweep(truth: &Truth, evaluation: &Evaluation, factor: Factor) -> Result<Sweep, EvalError> {
    let extra = truth.boxes.extra();
    let mut values: Vec<(f64, usize)> = Vec::new();
    for (k, record) in truth.records.iter().enumerate() {
        let Some(marker) = record.markers.first() else { continue };
        let value = factor.value(record, marker, extra).ok_or_else(|| EvalError::Factor {
            path: truth.path.clone(),
            image: record.image.clone(),
            factor: factor.name(),
        })?;
        values.push((value, k));
    }
    values.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let classes = (values.len() / LEAST).clamp(1, MOST);
    let cut = |k: usize| values.len() * k / classes;
    let points = (0..classes).map(|k| &values[cut(k)..cut(k + 1)]).filter(|c| !c.is_empty()).map(|c| point(evaluation, truth, c)).collect();
    Ok(Sweep {
        factor,
        run: evaluation.name.clone(),
        threshold: evaluation.config.threshold,
        images_without: (truth.records.len() - values.len()) as u64,
        points,
    })
}

fn point(evaluation: &Evaluation, truth: &Truth, class: &[(f64, usize)]) -> Point {
    let config = &evaluation.config;
    let image = |k: usize| Cow::Borrowed(&evaluation.images[class[k].1]);
    let scores = Scores::from_fn(class.len(), image, &[config.threshold], config.bootstrap_draws, config.seed);
    let row = scores.row(0);
    Point {
        from: class[0].0,
        to: class[class.len() - 1].0,
        at: class.iter().map(|c| c.0).sum::<f64>() / class.len() as f64,
        images: class.len() as u64,
        markers: scores.markers(),
        fp_per_image: row.fp as f64 / class.len() as f64,
        row,
        pose: evaluation.pose.as_ref().map(|p| poses(&p.errors, truth, class)),
    }
}

fn poses(errors: &[PoseError], truth: &Truth, class: &[(f64, usize)]) -> PointPose {
    let images: BTreeSet<usize> = class.iter().map(|c| c.1).collect();
    let markers = images.iter().flat_map(|&k| &truth.records[k].markers).filter(|m| m.corners.is_some()).count();
    let errors: Vec<&PoseError> = errors.iter().filter(|e| images.contains(&e.image)).collect();
    let spread = |f: &dyn Fn(&PoseError) -> f64| Spread::of(errors.iter().map(|e| f(e)));
    let turned = errors.iter().filter(|e| e.angle_deg.abs() > 45.0).count();
    PointPose {
        recovered: errors.len() as f64 / markers.max(1) as f64,
        wrong_orientation: (!errors.is_empty()).then(|| turned as f64 / errors.len() as f64),
        center_percent: spread(&PoseError::center_percent),
        corner_percent: spread(&PoseError::corner_percent),
        angle_deg: spread(&|e| e.angle_deg.abs()),
    }
}

impl Sweep {
    /// The longest stretch of neighbouring classes in which recall is at least `recall`: its smallest and largest value.
    #[must_use]
    pub fn holds(&self, recall: f64) -> Option<[f64; 2]> {
        let good = |p: &Point| p.row.recall.is_some_and(|r| r >= recall);
        let stretches = self.points.chunk_by(|a, b| good(a) == good(b)).filter(|s| good(&s[0]));
        let longest =
            stretches.fold(None, |best: Option<&[Point]>, s| if best.is_none_or(|b| s.len() > b.len()) { Some(s) } else { best })?;
        Some([longest[0].from, longest[longest.len() - 1].to])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Config, evaluate};
    use tcross_dataset::{ImageDetections, dataset::BoxConvention};

    /// 100 images of rising tilt, found below 50 degrees; a false positive on the last ten; every eleventh has no marker.
    fn tilted(with_tilt: bool) -> (Truth, Evaluation) {
        let mut records = Vec::new();
        let mut rows: Vec<ImageDetections> = Vec::new();
        for k in 0..110 {
            let tilt = f64::from(k) * 80.0 / 110.0;
            let mut marker = serde_json::json!({"shape": "t_cross", "box": [10, 10, 40, 40]});
            if with_tilt {
                marker["tilt_deg"] = tilt.into();
            }
            let markers = if k % 11 == 10 { vec![] } else { vec![marker] };
            let json = serde_json::json!({"image": k.to_string(), "width": 100, "height": 100, "markers": markers});
            records.push(serde_json::from_value(json).unwrap());
            let mut claims = Vec::new();
            if tilt < 50.0 && k % 11 != 10 {
                claims.push(serde_json::json!({"score": 0.9, "class": 0, "box": [10, 10, 40, 40]}));
            }
            if k >= 100 {
                claims.push(serde_json::json!({"score": 0.9, "class": 0, "box": [60, 60, 90, 90]}));
            }
            let row = serde_json::json!({"image": k.to_string(), "width": 100, "height": 100, "detections": claims});
            rows.push(serde_json::from_value(row).unwrap());
        }
        // Not in order of the factor.
        records.reverse();
        let truth = Truth::new(records, BoxConvention::Continuous, None);
        let evaluation = evaluate(&truth, "tilted", rows.into(), &Config { bootstrap_draws: 50, ..Config::default() }, false).unwrap();
        (truth, evaluation)
    }

    #[test]
    fn points_are_the_metrics_of_their_images() {
        let (truth, evaluation) = tilted(true);
        let sweep = sweep(&truth, &evaluation, Factor::Tilt).unwrap();
        assert_eq!((sweep.points.len(), sweep.images_without), (5, 10));
        assert!(sweep.points.windows(2).all(|w| w[0].to <= w[1].from));
        assert_eq!(sweep.points.iter().map(|p| p.images).sum::<u64>(), 100);
        assert_eq!(sweep.points[0].row.recall, Some(1.0));
        let last = &sweep.points[4];
        assert_eq!((last.row.recall, last.row.fp, last.markers), (Some(0.0), 9, 20));
        assert!((last.fp_per_image - 0.45).abs() < 1e-12 && last.row.recall_ci.is_some());
        let [from, to] = sweep.holds(0.9).unwrap();
        assert!(from == 0.0 && to > 40.0 && to < 50.0, "{from} {to}");
        assert_eq!(sweep.holds(1.1), None);
    }

    #[test]
    fn a_record_without_the_factor_is_named() {
        let (truth, evaluation) = tilted(false);
        let message = sweep(&truth, &evaluation, Factor::Tilt).unwrap_err().to_string();
        assert!(message.contains("tilt") && message.contains("'108'"), "{message}");
        assert!("tiltt".parse::<Factor>().unwrap_err().contains("occlusion"));
    }
}
