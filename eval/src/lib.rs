//! Scores detections: the paper's metrics, curves, tables, report. No network, only files.
pub mod bootstrap;
pub mod config;
pub mod error;
pub mod figures;
pub mod input;
pub mod interval;
pub mod matching;
pub mod paper_tables;
pub mod protocol;
pub mod validate;

pub use config::{Config, Protocol};
pub use error::EvalError;
pub use validate::{ValidationScores, validate};
