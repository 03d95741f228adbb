//! Everything that can go wrong while generating, told with the key or the file, what was found and what is allowed.
use std::path::{Path, PathBuf};
use tcross_dataset::DatasetError;

/// An error of configuring or making a dataset.
#[derive(Debug, thiserror::Error)]
pub enum DatagenError {
    /// A value of the `[data]` section that cannot be used.
    #[error("data.{key} = {found}: allowed is {allowed}")]
    Config {
        /// The key inside `[data]`, with dots.
        key: String,
        /// The value that was found.
        found: String,
        /// What is allowed there.
        allowed: String,
    },
    /// A folder without a single usable photo, or with too few for three splits.
    #[error("{dir}: {found} usable photos ({skipped} skipped); needed are at least {needed} JPEG, PNG or WebP files")]
    NoPhotos {
        /// The folder that was searched.
        dir: PathBuf,
        /// Photos that could be used.
        found: usize,
        /// Files that looked like photos but could not be read.
        skipped: usize,
        /// The least number.
        needed: usize,
    },
    /// What is already in the output folder was made from something else.
    #[error("{dir}: holds another dataset (other config, seed, backgrounds or part); choose another folder or delete this one")]
    Mismatch {
        /// The output folder.
        dir: PathBuf,
    },
    /// A picture could not be encoded.
    #[error("{path}: {message}")]
    Encode {
        /// The picture.
        path: PathBuf,
        /// The encoder's words.
        message: String,
    },
    /// Generation was stopped from outside; everything finished so far is kept.
    #[error("stopped; what was finished is kept")]
    Stopped,
    /// Reading or writing failed.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
}

impl DatagenError {
    /// A refused value of the configuration.
    pub fn config(key: impl Into<String>, found: impl ToString, allowed: impl Into<String>) -> Self {
        Self::Config { key: key.into(), found: found.to_string(), allowed: allowed.into() }
    }

    /// An I/O error with the path it happened at.
    pub fn io(path: impl AsRef<Path>, source: std::io::Error) -> Self {
        Self::Dataset(DatasetError::io(path, source))
    }
}
