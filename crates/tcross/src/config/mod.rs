//! Configs: one TOML whose sections are the configs of the stages' crates.
//!
//! What counts is, from the weakest: the defaults of each section, the files named by `extends`, the file itself,
//! `--set section.key=value`. Each layer is read strictly on its own, so that an error has a file and a line.
mod layers;
mod print;
mod schema;

pub use layers::{digest_of, load, with};
pub use print::commented;

use crate::exit::Outcome;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, path::PathBuf};

/// A whole experiment.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Configs that this one changes, relative to this file: one, or a list of which later ones count more.
    #[serde(skip_serializing_if = "Extends::is_empty")]
    pub extends: Extends,
    /// Every random choice of every stage is drawn from it.
    pub seed: u64,
    /// Photos to draw on, any tree of JPEG, PNG or WebP; absent: embedded scenes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub backgrounds: Option<PathBuf>,
    /// What the dataset is made of.
    pub data: tcross_datagen::Config,
    /// The network.
    pub model: tcross_yolo::ModelSection,
    /// How it is trained.
    pub train: tcross_train::Config,
    /// How it is used.
    pub infer: tcross_infer::Config,
    /// How its detections are scored.
    pub eval: tcross_eval::Config,
    /// Rows of one table: the same experiment with changes. Without any there is one row, the config itself.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub run: Vec<Run>,
    /// Results that are expected; `reproduce` prints a verdict for each.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub expect: Vec<Expect>,
}

/// No, one or several files.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Extends {
    /// One.
    One(PathBuf),
    /// Several, the later the stronger.
    Many(Vec<PathBuf>),
}

impl Default for Extends {
    fn default() -> Self {
        Self::Many(Vec::new())
    }
}

impl Extends {
    fn files(&self) -> &[PathBuf] {
        match self {
            Self::One(file) => std::slice::from_ref(file),
            Self::Many(files) => files,
        }
    }

    fn is_empty(&self) -> bool {
        self.files().is_empty()
    }
}

/// One row of a table: a change of the config, with a folder of its own.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Run {
    /// What the row is called in the table; its folder is the same word with `-` between letters.
    pub name: String,
    /// Configs laid over this one for the row, relative to this file, before `set`: one, or a list.
    #[serde(default, skip_serializing_if = "Extends::is_empty")]
    pub extends: Extends,
    /// What differs, as in a config: `set.data.images = 300`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub set: BTreeMap<String, serde_json::Value>,
    /// The name of an earlier run whose network is used instead of training one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub network_of: Option<String>,
}

/// A result that is expected. It never changes a run.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Expect {
    /// The run's name; absent: every run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub run: Option<String>,
    /// A number of `metrics.json`: `mean_iou`, `precision`, `recall` ... at the headline threshold, or a path such as `coco.ap50`.
    pub metric: String,
    /// Of markers whose box has a short side of at least so many pixels: one of `eval.min_side_px`; absent: of all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min_side_px: Option<f64>,
    /// What it should be.
    pub value: f64,
    /// How much worse it may be.
    #[serde(default)]
    pub tolerance: f64,
    /// Where the value comes from.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub source: String,
}

impl Config {
    /// Checks every value of every section.
    ///
    /// # Errors
    /// Names the first key that cannot be, what was found, and what is allowed.
    pub fn validate(&self) -> Outcome {
        self.data.validate()?;
        self.model.validate()?;
        self.train.validate()?;
        self.infer.validate()?;
        Ok(self.eval.validate()?)
    }
}
