//! Everything that can go wrong between a model, pictures and detections.
use std::path::{Path, PathBuf};
use tcross_dataset::DatasetError;
use tcross_yolo::YoloError;

/// An error of loading a model or of reading and writing what inference needs.
#[derive(Debug, thiserror::Error)]
pub enum InferError {
    /// The model cannot be used.
    #[error(transparent)]
    Model(#[from] YoloError),
    /// A dataset or detections file cannot be read or written.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// The operating system refused.
    #[error("{path}: {source}")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A value of the configuration that is not allowed.
    #[error("{key} = {found}: expected {allowed}")]
    Value {
        /// The key, with its section.
        key: &'static str,
        /// What stands there.
        found: String,
        /// What may stand there.
        allowed: &'static str,
    },
    /// An input that is neither a picture, nor a folder of pictures, nor a dataset.
    #[error("{path}: {found}; expected an image (jpg, png, webp), a folder with images, or a dataset")]
    Input {
        /// The input.
        path: PathBuf,
        /// What it is instead.
        found: &'static str,
    },
    /// Every picture was unreadable.
    #[error("none of {count} images could be read; the first: {first}")]
    NoneReadable {
        /// How many were tried.
        count: usize,
        /// What was wrong with the first.
        first: String,
    },
    /// A picture that was asked for by name cannot be read.
    #[error("{path}: unreadable image: {message}")]
    Picture {
        /// The picture.
        path: PathBuf,
        /// The decoder's words.
        message: String,
    },
    /// An image for which no boxes were given.
    #[error("{boxes}: no line for the image '{image}' (found {lines} lines)")]
    NoBoxes {
        /// The file of boxes.
        boxes: PathBuf,
        /// The image without a line.
        image: String,
        /// Lines in the file.
        lines: usize,
    },
    /// The external program for videos is missing or failed.
    #[error("{0}")]
    Video(String),
}

impl InferError {
    /// Wraps an I/O error with the path it happened at.
    pub fn io(path: impl AsRef<Path>, source: std::io::Error) -> Self {
        Self::Io { path: path.as_ref().to_owned(), source }
    }
}
