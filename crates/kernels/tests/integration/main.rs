//! Every kernel against plain loops with f64 sums, on every instruction set of this machine.
mod convolutions;
#[cfg(feature = "burn")]
mod operations;
