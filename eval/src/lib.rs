//! Scores detections: the paper's metrics, curves, tables, report. No network, only files.
pub mod figures;
