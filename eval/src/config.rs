//! The `[eval]` section.
use crate::{error::EvalError, sweep::Factor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A way of scoring.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Protocol {
    /// The paper's six metrics over the threshold.
    Paper,
    /// COCO's average precision and recall.
    Coco,
    /// Errors of centre, angle and corners.
    Pose,
}

/// How the overlap of two boxes is measured in the paper's protocol.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum IouKind {
    /// The paper's: every side counts as `max - min + 1`.
    #[default]
    Inclusive,
    /// Continuous pixels.
    Continuous,
}

/// A published row that the result is put beside.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PaperRef {
    /// Number of the paper's table: 2 to 7.
    pub table: u8,
    /// The row's words, such as `T cross of random thickness`; in table 6 the threshold.
    pub row: String,
}

/// How detections are scored and reported.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Which protocols are computed: `paper`, `coco`, `pose`.
    pub protocols: Vec<Protocol>,
    /// Scores at which the paper's metrics are given, rising, each in 0..1; a detection is kept where its score >= threshold.
    pub thresholds: Vec<f64>,
    /// The threshold of the headline row, 0..1.
    pub threshold: f64,
    /// A detection that overlaps no marker by at least this IoU is a false positive, 0..1.
    pub min_iou: f64,
    /// How the paper's protocol measures overlap: `inclusive` or `continuous`.
    pub iou: IouKind,
    /// Names of the classes in the order of the detections' numbers; empty: all shapes are one class.
    pub classes: Vec<String>,
    /// Ends of the size classes, in pixels of the box's short side, rising.
    pub size_edges_px: Vec<f64>,
    /// Least short sides, in pixels, rising: for each the paper's metrics are also given for markers whose box is at least so
    /// large; smaller markers, what is matched to them, and unmatched detections smaller than that are ignored.
    pub min_side_px: Vec<f64>,
    /// Bootstrap draws for intervals and bands; 0 for none.
    pub bootstrap_draws: usize,
    /// Seed of the bootstrap and of the choice of samples.
    pub seed: u64,
    /// Pictures in each gallery of the report.
    pub gallery: usize,
    /// What this dataset varies alone: `blur`, `tilt`, `size`, `occlusion`, `noise` or `light`. The report then shows the
    /// metrics as curves against it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sweep: Option<Factor>,
    /// The published row that the result is put beside.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub paper: Option<PaperRef>,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            protocols: vec![Protocol::Paper, Protocol::Coco],
            thresholds: (1..=14).map(|k| f64::from(k * 5) / 100.0).collect(),
            threshold: 0.3,
            min_iou: 0.2,
            iou: IouKind::Inclusive,
            classes: Vec::new(),
            size_edges_px: vec![8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0, 96.0],
            min_side_px: vec![12.0, 16.0, 24.0, 32.0],
            bootstrap_draws: 1000,
            seed: 0,
            gallery: 12,
            sweep: None,
            paper: None,
        }
    }
}

impl Config {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the first key whose value is not allowed.
    pub fn validate(&self) -> Result<(), EvalError> {
        let rising = |v: &[f64]| v.windows(2).all(|w| w[0] < w[1]);
        let unit = |v: f64| (0.0..=1.0).contains(&v);
        let error = |key, found: String, allowed| Err(EvalError::Config { key, found, allowed });
        if self.protocols.is_empty() {
            return error("protocols", "[]".into(), "one or more of paper, coco, pose");
        }
        if self.thresholds.is_empty() || !rising(&self.thresholds) || !self.thresholds.iter().all(|t| unit(*t)) {
            return error("thresholds", format!("{:?}", self.thresholds), "one or more rising numbers from 0 to 1");
        }
        if !unit(self.threshold) {
            return error("threshold", self.threshold.to_string(), "a number from 0 to 1");
        }
        if !(self.min_iou > 0.0 && self.min_iou <= 1.0) {
            return error("min_iou", self.min_iou.to_string(), "a number above 0, at most 1");
        }
        for (key, sides) in [("size_edges_px", &self.size_edges_px), ("min_side_px", &self.min_side_px)] {
            if !rising(sides) || !sides.iter().all(|v| v.is_finite() && *v > 0.0) {
                return error(key, format!("{sides:?}"), "rising numbers above 0");
            }
        }
        if self.bootstrap_draws > 1_000_000 {
            return error("bootstrap_draws", self.bootstrap_draws.to_string(), "0 to 1000000");
        }
        if let Some(paper) = &self.paper {
            crate::paper_tables::find(paper)?;
        }
        Ok(())
    }

    /// The same scoring for the choice of a threshold: no intervals and no pictures, which only cost time.
    #[must_use]
    pub fn for_a_threshold(&self) -> Self {
        Self { protocols: vec![Protocol::Paper], bootstrap_draws: 0, gallery: 0, min_side_px: Vec::new(), ..self.clone() }
    }

    /// True where a protocol is asked for.
    #[must_use]
    pub fn wants(&self, protocol: Protocol) -> bool {
        self.protocols.contains(&protocol)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_the_papers() {
        let config = Config::default();
        config.validate().unwrap();
        assert_eq!((config.thresholds[0], config.thresholds[13], config.thresholds.len()), (0.05, 0.7, 14));
    }

    #[test]
    fn a_wrong_value_is_named() {
        let config = Config { thresholds: vec![0.5, 0.3], ..Config::default() };
        let message = config.validate().unwrap_err().to_string();
        assert!(message.contains("thresholds") && message.contains("[0.5, 0.3]") && message.contains("rising"), "{message}");
        let config = Config { min_side_px: vec![0.0], ..Config::default() };
        assert!(config.validate().unwrap_err().to_string().contains("min_side_px"));
        assert!(toml::from_str::<Config>("treshold = 0.3").unwrap_err().to_string().contains("treshold"));
    }
}
