//! The crate from outside: published rows from made-up detections, files in and files out.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "helpers of tests may panic too")]
mod paper_rows;
mod report;
