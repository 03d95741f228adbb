//! What lies on disk and is shared by all stages: records, detections, geometry, chance.
//!
//! `FORMAT.md` beside this crate defines every quantity. A dataset is opened and walked like this:
//!
//! ```no_run
//! use tcross_dataset::{Dataset, Split};
//! let dataset = Dataset::open("runs/quickstart/data")?;
//! for record in dataset.records(Split::Test)? {
//!     println!("{} has {} markers", record.image, record.markers.len());
//! }
//! # Ok::<(), tcross_dataset::DatasetError>(())
//! ```
pub mod check;
pub mod dataset;
pub mod detections;
pub mod digest;
pub mod draw;
pub mod error;
pub mod files;
pub mod formats;
pub mod geom;
pub mod merge;
pub mod picture;
pub mod preview;
pub mod record;
pub mod resplit;
pub mod rng;
pub mod similar;
pub mod split;
pub mod stats;

pub use dataset::Dataset;
pub use detections::{Detection, ImageDetections, Pose, PoseOutcome};
pub use error::DatasetError;
pub use geom::{boxes::PixelBox, homography::Homography, letterbox::Letterbox, quad::Quad};
pub use record::{Confuser, Marker, Record};
pub use rng::Rng;
pub use split::Split;
