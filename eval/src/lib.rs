//! Scores detections: the paper's metrics, curves, tables, report. No network, only files.
pub mod bootstrap;
pub mod calibration;
pub mod config;
pub mod curves;
pub mod error;
pub mod evaluation;
pub mod failures;
pub mod figures;
pub mod input;
pub mod interval;
pub mod matching;
pub mod metrics;
pub mod paper_tables;
pub mod protocol;
pub mod report;
pub mod slices;
pub mod table;
pub mod truth;
pub mod validate;
pub mod verdict;

pub use config::{Config, Protocol};
pub use error::EvalError;
pub use evaluation::{Evaluation, evaluate};
pub use input::DetectionSource;
pub use report::{Report, Run};
pub use truth::Truth;
pub use validate::{ValidationScores, validate};
