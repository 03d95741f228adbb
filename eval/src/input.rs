//! Problems of the files that are scored, told with file and line.
use std::{fmt, path::PathBuf};

/// What is wrong with a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ProblemKind {
    /// Detections for an image that the truth lacks.
    UnknownImage,
    /// An image of the truth without a line of detections.
    MissingImage,
    /// A score that is not a number from 0 to 1.
    BadScore,
    /// A box with a number that is not finite, or with its sides reversed.
    BadBox,
    /// A second line for one image.
    DuplicateLine,
    /// Another width or height than the truth's.
    OtherSize,
    /// Not JSON of the expected form.
    BadLine,
}

/// One problem and where it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// What is wrong.
    pub kind: ProblemKind,
    /// The file.
    pub path: PathBuf,
    /// 1-based.
    pub line: usize,
    /// What was found and what is expected.
    pub message: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}: {}", self.path.display(), self.line, self.message)
    }
}
