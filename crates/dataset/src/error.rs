//! Everything that can be wrong with files of this crate, told with file, line, what was found and what is allowed.
use std::path::{Path, PathBuf};

/// An error of reading, checking or writing a dataset or a detections file.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// The operating system refused.
    #[error("{path}: {source}")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A line of a JSONL file, or a TOML file, is not what it should be.
    #[error("{path}:{line}: {message}")]
    Line {
        /// The file.
        path: PathBuf,
        /// 1-based.
        line: usize,
        /// What was found and what is expected.
        message: String,
    },
    /// A split that the dataset does not have.
    #[error("{dir}: no split '{split}' (found: {found}); expected the file {split}.jsonl")]
    MissingSplit {
        /// The dataset's folder.
        dir: PathBuf,
        /// The wanted split.
        split: String,
        /// The splits that are there, or `none`.
        found: String,
    },
    /// Something is there that should not be, or cannot be used for what was asked.
    #[error("{path}: found {found}; expected {expected}")]
    Unfit {
        /// The file or folder.
        path: PathBuf,
        /// What is there.
        found: String,
        /// What is allowed.
        expected: String,
    },
    /// A picture that cannot be read.
    #[error("{path}: unreadable image: {message}")]
    Image {
        /// The picture.
        path: PathBuf,
        /// The decoder's words.
        message: String,
    },
}

impl DatasetError {
    /// Wraps an I/O error with the path it happened at.
    pub fn io(path: impl AsRef<Path>, source: std::io::Error) -> Self {
        Self::Io { path: path.as_ref().to_owned(), source }
    }

    /// Something of another kind than what is needed.
    pub fn unfit(path: impl AsRef<Path>, found: impl ToString, expected: impl ToString) -> Self {
        Self::Unfit { path: path.as_ref().to_owned(), found: found.to_string(), expected: expected.to_string() }
    }

    /// An error at a line (1-based) of a text file.
    pub fn line(path: impl AsRef<Path>, line: usize, message: impl ToString) -> Self {
        Self::Line { path: path.as_ref().to_owned(), line, message: message.to_string() }
    }
}
