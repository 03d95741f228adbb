//! Trains a detector: batches, augmentation, steps, checkpoints, curves.
//!
//! ```no_run
//! use std::sync::atomic::AtomicBool;
//! use tcross_dataset::Dataset;
//! use tcross_train::{Config, Progress, RunOptions, fit};
//! let stop = AtomicBool::new(false); // set it to true to stop and save
//! let options = RunOptions::new("runs/mine", 7, &stop);
//! let config = Config { max_minutes: Some(10.0), ..Config::default() };
//! let summary = fit(&config, &Default::default(), &Dataset::open("data")?, &options, &mut |news| {
//!     if let Progress::Epoch { row, .. } = news {
//!         eprintln!("epoch {:.1}: loss {:.2}", row.epoch, row.loss.total());
//!     }
//! })?;
//! println!("best after step {:?}", summary.best);
//! # Ok::<(), tcross_train::TrainError>(())
//! ```
//!
//! The same config, seed, data and number of threads give the same weights, bit by bit, whether a run is stopped and resumed or not;
//! only where a length is given in minutes does the clock decide when the rate falls.
pub mod augment;
pub mod config;
pub mod data;
pub mod device;
mod divergence;
pub mod ema;
pub mod error;
mod features;
pub mod fit;
mod learner;
pub mod memory;
mod muon;
pub mod optimizer;
mod pass;
pub mod progress;
mod refine;
pub mod repeat;
pub mod run;
pub mod schedule;
mod start;
pub mod step;
#[cfg(test)]
mod toy;
pub mod validation;

pub use config::Config;
pub use device::Accelerator;
pub use error::TrainError;
pub use fit::{End, RunOptions, RunSummary, fit};
pub use progress::{Progress, StepReport};
pub use refine::{Refine, refine};
pub use repeat::Repeats;
