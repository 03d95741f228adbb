//! What can be wrong with a configuration or with the files that are scored.
use crate::input::Problem;
use tcross_dataset::DatasetError;

/// An error of scoring or of writing the results.
#[derive(Debug, thiserror::Error)]
pub enum EvalError {
    /// A file could not be read or written.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// A key of `[eval]` holds what it must not.
    #[error("[eval] {key} = {found}: allowed is {allowed}")]
    Config {
        /// The key.
        key: &'static str,
        /// Its value.
        found: String,
        /// What it may hold.
        allowed: &'static str,
    },
    /// A truth is not what it should be; the first problem and how many there are.
    #[error("{first}{}; correct the file", more(*.count))]
    Truth {
        /// The first of them, in order of the file.
        first: Problem,
        /// All of them.
        count: usize,
    },
    /// Detections are not what they should be; the first problem and how many there are.
    #[error("{first}{}; correct the file, or count such faults with --lenient", more(*.count))]
    Input {
        /// The first of them, in order of the files.
        first: Problem,
        /// All of them.
        count: usize,
    },
    /// An image of the truth with more markers than one index can tell apart.
    #[error("{path}: '{image}' has {markers} markers: allowed are at most {most} an image")]
    Markers {
        /// The truth.
        path: std::path::PathBuf,
        /// The image.
        image: String,
        /// Its markers.
        markers: usize,
        /// What is allowed.
        most: usize,
    },
    /// A record that does not tell the value of the factor over which the set is swept.
    #[error("{path}: '{image}' has a marker but does not tell its {factor}; sweep over what the dataset was generated for")]
    Factor {
        /// The truth.
        path: std::path::PathBuf,
        /// The image.
        image: String,
        /// The factor.
        factor: &'static str,
    },
    /// A COCO file that does not hold what the format asks for.
    #[error("{path}: {message}")]
    Coco {
        /// The file.
        path: std::path::PathBuf,
        /// What was found and what is expected.
        message: String,
    },
    /// A row of the paper that does not exist.
    #[error("[eval] paper.table = {table}, paper.row = '{row}': no such row; the rows of that table are {known}")]
    PaperRow {
        /// The asked table.
        table: u8,
        /// The asked row.
        row: String,
        /// What there is.
        known: String,
    },
}

fn more(count: usize) -> String {
    match count {
        0 | 1 => String::new(),
        n => format!(" (and {} more problems)", n - 1),
    }
}
