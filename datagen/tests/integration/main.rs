//! The generator as its users meet it: whole datasets, on any threads, in shards, resumed.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "helpers of tests may panic too")]
mod datasets;
mod photos;
mod presets;
mod truth;
