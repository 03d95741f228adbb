//! Everything that can go wrong in a training, told with key or file, what was found and what is allowed.
use std::path::{Path, PathBuf};
use tcross_dataset::DatasetError;
use tcross_yolo::YoloError;

/// An error of configuring, starting, running or resuming a training.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// A value of `[train]` that is not allowed.
    #[error("train.{key} = {found}: expected {allowed}")]
    Value {
        /// Key within the section.
        key: String,
        /// The value, as written.
        found: String,
        /// What it may be.
        allowed: String,
    },
    /// The dataset, or a file of the run.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// The network or its weights.
    #[error(transparent)]
    Yolo(#[from] YoloError),
    /// A label that cannot be learned.
    #[error("{path}:{line}: marker {marker} of {image}: {message}")]
    Label {
        /// The list.
        path: PathBuf,
        /// 1-based.
        line: usize,
        /// The record's image.
        image: String,
        /// 0-based within the record.
        marker: usize,
        /// What was found and what is expected.
        message: String,
    },
    /// A split without any usable image.
    #[error("{path}: no {what}")]
    Empty {
        /// The list.
        path: PathBuf,
        /// What is missing.
        what: String,
    },
    /// A saved state that does not belong to this training.
    #[error("{path}: {message}")]
    State {
        /// The file.
        path: PathBuf,
        /// What was found and what is expected.
        message: String,
    },
    /// The loss or a gradient is no longer a finite number, or has grown beyond all bounds.
    #[error("training diverged at step {step}: {what}; the batch is drawn in {batch}; lower train.optimizer.rate or train.clip")]
    Diverged {
        /// 0-based.
        step: u64,
        /// Which number, and its value.
        what: String,
        /// The pictures of the batch.
        batch: PathBuf,
    },
    /// More memory would be needed than there is.
    #[error("this training needs about {needed} but {available} are free; lower train.batch, model.width, model.input or train.cache_gb")]
    Memory {
        /// Estimate, with its unit.
        needed: String,
        /// With its unit.
        available: String,
    },
    /// A folder that already holds a run.
    #[error("{run}: already holds a run; pass --resume to go on with it, or choose another folder")]
    RunExists {
        /// The folder.
        run: PathBuf,
    },
    /// A device that this build or this machine does not have.
    #[error("device '{device}': {message}")]
    Device {
        /// Its name.
        device: String,
        /// Why it cannot be used.
        message: String,
    },
}

impl TrainError {
    /// A value of `[train]` that is not allowed.
    pub(crate) fn value(key: impl Into<String>, found: impl ToString, allowed: impl Into<String>) -> Self {
        Self::Value { key: key.into(), found: found.to_string(), allowed: allowed.into() }
    }

    /// A saved state that does not fit.
    pub(crate) fn state(path: impl AsRef<Path>, message: impl ToString) -> Self {
        Self::State { path: path.as_ref().to_owned(), message: message.to_string() }
    }
}
