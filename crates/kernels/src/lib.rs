//! Fused convolution kernels for the CPU and their burn operations.
//!
//! The only crate that is allowed `unsafe`: every block argues its safety.
#![allow(unsafe_code)]
pub mod allocator;
mod buffer;
pub mod circle;
pub mod conv;
mod gather;
pub mod matrix;
pub mod norm;
#[cfg(feature = "burn")]
pub mod ops;
pub mod pack;
pub mod reference;
pub mod resample;
mod shape;
pub mod simd;
pub mod weight_gradient;
mod winograd;

pub use gather::Activation;
pub use shape::{ConvShape, covers};
pub use simd::Isa;
