//! Detects markers and recovers their pose.
