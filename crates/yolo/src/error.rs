//! Everything that can be wrong with a model, its files or its configuration: where, what was found, what is expected.
use std::path::{Path, PathBuf};

/// An error of building, reading or writing a network.
#[derive(Debug, thiserror::Error)]
pub enum YoloError {
    /// The operating system refused.
    #[error("{path}: {source}")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A value that is not allowed.
    #[error("{key} = {found}: expected {allowed}")]
    Value {
        /// The key, such as `model.width`.
        key: String,
        /// What stands there.
        found: String,
        /// What may stand there.
        allowed: String,
    },
    /// A line of a text file (`.cfg`, `model.toml`) is not what it should be.
    #[error("{path}:{line}: {message}")]
    Line {
        /// The file.
        path: PathBuf,
        /// 1-based.
        line: usize,
        /// What was found and what is expected.
        message: String,
    },
    /// Layers that do not fit together.
    #[error("layer {layer}: {message}")]
    Layer {
        /// Index of the layer, from 0.
        layer: usize,
        /// What does not fit.
        message: String,
    },
    /// A weights file of the wrong length.
    #[error("{path}: {part}: expected {expected} bytes at offset {offset}, found {found}")]
    Length {
        /// The file.
        path: PathBuf,
        /// What should stand there, such as `layer 12, kernel`, or `end of file`.
        part: String,
        /// Bytes from the start of the file.
        offset: u64,
        /// Bytes that should follow there.
        expected: u64,
        /// Bytes that do.
        found: u64,
    },
    /// A weights file of the same network with another number of classes.
    #[error("{path} holds a network of {found} class(es): expected {expected}")]
    Classes {
        /// The file.
        path: PathBuf,
        /// Classes of the description.
        expected: usize,
        /// Classes of the file.
        found: usize,
    },
    /// A weights file of another published network.
    #[error("{path} holds {found}: expected {expected} ({source})")]
    Architecture {
        /// The file.
        path: PathBuf,
        /// What it is, by its length.
        found: String,
        /// What the description asks for.
        expected: String,
        /// Where reading failed.
        source: Box<YoloError>,
    },
    /// A tensor of a safetensors file, or a convolution's parameters, of the wrong shape or kind, missing, or not known.
    #[error("{path}: tensor '{name}': expected {expected}, found {found}")]
    Tensor {
        /// The file; empty for parameters in memory.
        path: PathBuf,
        /// The tensor's name.
        name: String,
        /// What it should be.
        expected: String,
        /// What it is.
        found: String,
    },
    /// A file written by a newer program, or of another kind.
    #[error("{path}: format {found}, but this program reads up to {known}; update it or export the model again")]
    Format {
        /// The file.
        path: PathBuf,
        /// Its format.
        found: String,
        /// The newest known here.
        known: u32,
    },
    /// A file that is broken in a way its own reader explains.
    #[error("{path}: {message}")]
    Broken {
        /// The file.
        path: PathBuf,
        /// The reader's words.
        message: String,
    },
    /// A label that the network cannot learn.
    #[error("image {image}, box {index}: {message}")]
    Label {
        /// Position of the image in the batch.
        image: usize,
        /// Position of the box in the image's list.
        index: usize,
        /// What was found and what is expected.
        message: String,
    },
}

impl YoloError {
    /// Wraps an I/O error with the path it happened at.
    pub fn io(path: impl AsRef<Path>, source: std::io::Error) -> Self {
        Self::Io { path: path.as_ref().to_owned(), source }
    }

    /// An error at a line (1-based) of a text file.
    pub fn line(path: impl AsRef<Path>, line: usize, message: impl ToString) -> Self {
        Self::Line { path: path.as_ref().to_owned(), line, message: message.to_string() }
    }

    /// A value that is not allowed.
    pub fn value(key: impl ToString, found: impl ToString, allowed: impl ToString) -> Self {
        Self::Value { key: key.to_string(), found: found.to_string(), allowed: allowed.to_string() }
    }

    pub(crate) fn broken(path: impl AsRef<Path>, message: impl ToString) -> Self {
        Self::Broken { path: path.as_ref().to_owned(), message: message.to_string() }
    }
}
