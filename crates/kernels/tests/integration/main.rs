//! Every kernel against plain loops with f64 sums, on every instruction set of this machine.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "helpers of tests may panic too")]
mod convolutions;
#[cfg(feature = "burn")]
mod operations;
