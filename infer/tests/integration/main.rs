//! Integration tests: the detector against Darknet's own boxes, runs over files, poses on drawn markers.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "helpers of tests may panic too")]
mod detector;
mod pose;
mod run;
#[allow(dead_code)]
mod scene;
