//! `metrics.csv`: a line an epoch.
use crate::error::TrainError;
use std::path::Path;
use tcross_dataset::files;
use tcross_eval::ValidationScores;
use tcross_yolo::LossTerms;

/// The numbers of one epoch; what was not measured is absent.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Row {
    /// Passes over the training images so far.
    pub epoch: f64,
    /// Steps so far.
    pub step: u64,
    /// Seconds of training so far.
    pub seconds: f64,
    /// Learning rate of the last step.
    pub rate: f64,
    /// Images a second since the last row.
    pub images_per_second: f64,
    /// Means over the steps since the last row.
    pub loss: LossTerms,
    /// Mean norm of the gradients since the last row.
    pub gradient_norm: f64,
    /// Of the validation images.
    pub scores: Scores,
}

/// The validation's part of a row.
pub type Scores = [Option<f64>; 7];

/// Names of the scores, in the order of [`Scores`].
pub const SCORES: [&str; 7] = ["val_ap", "val_ap50", "val_mean_iou", "val_precision", "val_recall", "val_f1", "val_best_f1"];

const NUMBERS: [&str; 12] = [
    "epoch",
    "step",
    "seconds",
    "rate",
    "images_per_second",
    "loss",
    "center",
    "size",
    "objectness",
    "class",
    "keypoints",
    "gradient_norm",
];

/// A validation's numbers in the order of [`SCORES`].
#[must_use]
pub fn scores(s: &ValidationScores) -> Scores {
    [s.ap, s.ap50, s.mean_iou, s.precision, s.recall, s.f1, s.best_f1.map(|(_, f1)| f1)]
}

impl Row {
    /// All columns with their names; the loss terms follow their sum.
    #[must_use]
    pub fn columns(&self) -> Vec<(&'static str, Option<f64>)> {
        let l = &self.loss;
        let numbers = [
            self.epoch,
            self.step as f64,
            self.seconds,
            self.rate,
            self.images_per_second,
            l.total(),
            l.center,
            l.size,
            l.objectness,
            l.class,
            l.keypoints,
            self.gradient_norm,
        ];
        NUMBERS.into_iter().zip(numbers.map(Some)).chain(SCORES.into_iter().zip(self.scores)).collect()
    }

    /// What was measured, by TensorBoard's names: `loss/center`, `validation/ap`, `training/rate`, so that charts stand in groups.
    #[must_use]
    pub fn tags(&self) -> Vec<(String, f64)> {
        let tag = |name: &str| match name {
            "loss" => "loss/sum".to_owned(),
            "center" | "size" | "objectness" | "class" | "keypoints" => format!("loss/{name}"),
            _ => match name.strip_prefix("val_") {
                Some(score) => format!("validation/{score}"),
                None => format!("training/{name}"),
            },
        };
        self.columns().into_iter().filter(|(name, _)| *name != "step").filter_map(|(name, value)| Some((tag(name), value?))).collect()
    }

    fn from_columns(v: &[Option<f64>]) -> Option<Self> {
        Some(Self {
            epoch: v[0]?,
            step: v[1]? as u64,
            seconds: v[2]?,
            rate: v[3]?,
            images_per_second: v[4]?,
            loss: LossTerms { center: v[6]?, size: v[7]?, objectness: v[8]?, class: v[9]?, keypoints: v[10]? },
            gradient_norm: v[11]?,
            scores: v[12..].try_into().ok()?,
        })
    }
}

/// All rows of a run.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct History {
    /// In order of steps.
    pub rows: Vec<Row>,
}

impl History {
    /// The file's text. Numbers are written so that reading gives the same bits.
    #[must_use]
    pub fn to_csv(&self) -> String {
        let mut text = NUMBERS.into_iter().chain(SCORES).collect::<Vec<_>>().join(",");
        for row in &self.rows {
            text.push('\n');
            let cells: Vec<String> = row.columns().iter().map(|(_, v)| v.map_or(String::new(), |v| v.to_string())).collect();
            text.push_str(&cells.join(","));
        }
        text.push('\n');
        text
    }

    /// Reads the rows up to and with `last_step`; none if there is no file.
    ///
    /// # Errors
    /// If the file is not one of ours.
    pub fn read(path: &Path, last_step: u64) -> Result<Self, TrainError> {
        if !path.is_file() {
            return Ok(Self::default());
        }
        let text = files::read_text(path)?;
        let mut rows = Vec::new();
        for (k, line) in text.lines().enumerate().skip(1) {
            let cells: Vec<Option<f64>> = line.split(',').map(|cell| cell.parse().ok()).collect();
            let row = if cells.len() == NUMBERS.len() + SCORES.len() { Row::from_columns(&cells) } else { None };
            rows.push(row.ok_or_else(|| TrainError::state(path, format!("line {}: expected the columns of line 1", k + 1)))?);
        }
        rows.retain(|row| row.step <= last_step);
        Ok(Self { rows })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn survives_the_file() {
        let dir = tempfile::tempdir().unwrap();
        let loss = LossTerms { center: 0.1 + 0.2, size: 1e-17, objectness: 3.0, class: 0.0, keypoints: 0.0 };
        let row = |step| Row {
            epoch: 0.5,
            step,
            rate: 1.0 / 3.0,
            loss,
            scores: [Some(0.7), None, None, None, Some(1.0), None, None],
            ..Row::default()
        };
        let history = History { rows: vec![row(10), row(20), row(30)] };
        let path = dir.path().join("metrics.csv");
        std::fs::write(&path, history.to_csv()).unwrap();
        assert_eq!(History::read(&path, 30).unwrap(), history);
        assert_eq!(History::read(&path, 29).unwrap().rows.len(), 2);
        std::fs::write(&path, "a,b\n1,2\n").unwrap();
        assert!(History::read(&path, 9).unwrap_err().to_string().contains("line 2"));
    }
}
