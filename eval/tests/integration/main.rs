//! The crate from outside: published rows from made-up detections, files in and files out.
mod paper_rows;
mod report;
