//! The generator as its users meet it: whole datasets, on any threads, in shards, resumed.
#![allow(clippy::unwrap_used)]
mod datasets;
mod photos;
mod presets;
mod truth;
