//! From a dataset's folder to batches: samples, the order they come in, and the threads that make batches ahead of the steps.
pub mod batch;
pub mod order;
pub mod samples;

pub use batch::{Batch, BatchMaker, Loader, Request};
pub use order::Order;
pub use samples::{Samples, evenly};
