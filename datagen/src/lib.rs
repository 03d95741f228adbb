//! Draws fiducial markers like a hand onto backgrounds, with exact truth.
//!
//! ```no_run
//! use std::sync::atomic::AtomicBool;
//! use tcross_datagen::{Backgrounds, Config, GenerateOptions, generate};
//! let options = GenerateOptions { out: "data".into(), seed: 7, ..Default::default() };
//! let made = generate(&Config::default(), &Backgrounds::embedded(), &options, &AtomicBool::new(false), &mut |_| {})?;
//! println!("{} markers", made.manifest.markers);
//! # Ok::<(), tcross_datagen::DatagenError>(())
//! ```
pub mod audit;
pub mod background;
pub mod blend;
pub mod canvas;
pub mod card;
pub mod color;
pub mod config;
pub mod dist;
pub mod effects;
pub mod error;
pub mod hand;
pub mod jpeg;
pub mod manifest;
pub mod media;
pub mod noise;
pub mod paper;
pub mod print;
pub mod sample;
pub mod shapes;
pub mod stickers;
pub mod surface;
pub mod writer;

pub use background::Backgrounds;
pub use blend::Blend;
pub use config::{Config, Style};
pub use dist::Dist;
pub use error::DatagenError;
pub use manifest::Manifest;
pub use media::Medium;
pub use print::MarkerSheet;
pub use sample::{Sample, sample};
pub use shapes::Shape;
pub use surface::Surface;
pub use writer::{GenerateOptions, Progress, Summary, generate};
