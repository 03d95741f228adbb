//! YOLOv3 and yolov3-tiny: network, weights, loss, decoding.
//!
//! Pixels go in through [`input`], the burn module [`Yolo`] walks a [`Graph`], and [`decode`] with [`nms`] turn its raw heads into boxes.
//! Training asks [`loss`] for the gradient of each logit. Parameters travel as [`Weights`], whatever file they come from.
//!
//! ```
//! use burn::tensor::{Device, Tensor};
//! use tcross_yolo::{Architecture, ModelConfig, NetSize, Weights, Yolo};
//! let config = ModelConfig { width: 0.0625, input: NetSize::square(64), ..ModelConfig::of(Architecture::YoloV3Tiny) };
//! let graph = config.graph()?;
//! let weights = Weights::init(&graph, &config.fields(), &Default::default(), 7);
//! let device = Device::flex();
//! let network = Yolo::new(&config, &weights, &device)?;
//! let heads = network.forward(Tensor::zeros([1, 3, 64, 64], &device));
//! assert_eq!(heads[0].dims(), [1, 3 * (4 + 1 + 1), 2, 2]);
//! # Ok::<(), tcross_yolo::YoloError>(())
//! ```
pub mod anchors;
pub mod blocks;
pub mod config;
pub mod decode;
pub mod detector;
pub mod error;
pub mod fields;
pub mod geometry;
pub mod graph;
pub mod inference;
pub mod input;
pub mod loss;
pub mod model;
pub mod network;
pub mod nms;
pub mod plan;
pub mod refiner;
pub mod targets;
pub mod weights;

pub use blocks::Statistics;
pub use config::{AnchorChoice, Architecture, BoxConvention, ModelConfig, ModelSection, NetSize};
pub use decode::{DetectOptions, NetDetection, detect};
pub use detector::Detector;
pub use error::YoloError;
pub use fields::BoxFields;
pub use geometry::Geometry;
pub use geometry::NormBox;
pub use graph::{Graph, Layer};
pub use inference::InferenceNet;
pub use loss::{Loss, LossKind, LossOutput, LossTerms};
pub use model::{ExportFormat, Model};
pub use network::{Network, Yolo};
pub use refiner::Refiner;
pub use targets::Truth;
pub use weights::Weights;
