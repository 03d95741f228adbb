//! Detects markers and recovers their pose.
//!
//! ```no_run
//! use tcross_infer::{Detector, pose};
//! let image = image::open("photo.jpg")?.into_rgb8();
//! for found in Detector::load("runs/quickstart/run")?.detect(&image) {
//!     println!("{:.2} {:?}", found.score, pose::recover(&image, &found.bounds, &pose::Config::default()));
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
pub mod camera;
pub mod config;
pub mod error;
pub mod lettering;
pub mod overlay;
pub mod pose;
pub mod run;
pub mod source;
pub mod video;

pub use camera::{Camera, Lens};
pub use config::Config;
pub use error::InferError;
pub use run::{Boxes, Progress, RunOptions, RunReport, run};
pub use source::{Source, read_image};
pub use tcross_yolo::Detector;
pub use video::VideoReport;
