//! Detects markers and recovers their pose.
pub mod pose;
