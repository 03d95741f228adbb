//! From a picture to boxes: letterbox, network, decoding, suppression, the letterbox undone.
use crate::{config::Config, error::InferError};
use burn::tensor::{Device, Tensor, TensorData};
use image::RgbImage;
use std::path::Path;
use tcross_dataset::Detection;
use tcross_yolo::{DetectOptions, Geometry, Model, ModelConfig, Yolo, decode, input, network::read_logits};

/// The seam between detection and whatever computes the network: one picture in, raw heads out.
pub trait Network: Send {
    /// Takes one input, three planes (R, G, B) of the network's size in 0..1, and fills each head's logits
    /// `[anchors * fields, rows, columns]`, coarse first.
    fn logits(&mut self, planes: &[f32], heads: &mut Vec<Vec<f32>>);
}

/// The network walked by burn.
struct Walked {
    network: Yolo,
    shape: [usize; 4],
    device: Device,
}

impl Network for Walked {
    fn logits(&mut self, planes: &[f32], heads: &mut Vec<Vec<f32>>) {
        let images = Tensor::<4>::from_data(TensorData::new(planes.to_vec(), self.shape), &self.device);
        heads.clear();
        heads.extend(self.network.forward(images).iter().map(read_logits));
    }
}

/// A loaded model, ready to look at pictures.
pub struct Detector {
    model: ModelConfig,
    geometry: Geometry,
    network: Box<dyn Network>,
    planes: Vec<f32>,
    heads: Vec<Vec<f32>>,
    /// Which claims are kept.
    pub options: DetectOptions,
}

impl Detector {
    /// Loads a model: a run's folder (its best weights), a `.safetensors` file with `model.toml` beside it, or a Darknet
    /// `.cfg` or `.weights` with its partner beside it.
    ///
    /// # Errors
    /// If a file is missing, broken, or does not fit its description.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, InferError> {
        Self::from_model(&Model::load(path)?)
    }

    /// A detector of a model in memory, such as one just trained.
    ///
    /// # Errors
    /// If the weights do not fit the description.
    pub fn from_model(model: &Model) -> Result<Self, InferError> {
        let device = Device::flex();
        let network = Yolo::new(&model.config, &model.weights, &device)?;
        let net = model.config.input;
        Ok(Self::with_network(&model.config, Box::new(Walked { network, shape: [1, 3, net.height, net.width], device })))
    }

    /// A detector on another engine.
    #[must_use]
    pub fn with_network(model: &ModelConfig, network: Box<dyn Network>) -> Self {
        let net = model.input;
        Self {
            geometry: model.geometry(net),
            model: model.clone(),
            network,
            planes: vec![0.0; 3 * net.width * net.height],
            heads: Vec::new(),
            options: DetectOptions::default(),
        }
    }

    /// The same detector keeping what this configuration says.
    #[must_use]
    pub fn configured(mut self, config: &Config) -> Self {
        self.options = DetectOptions { score: config.score as f32, nms_iou: config.nms, most: config.most, ..self.options };
        self
    }

    /// What the model is.
    #[must_use]
    pub fn model(&self) -> &ModelConfig {
        &self.model
    }

    /// Every marker the model claims in a picture, by falling score; boxes in pixels of the picture, counted as the model's
    /// training set counts them.
    pub fn detect(&mut self, image: &RgbImage) -> Vec<Detection> {
        if image.width() == 0 || image.height() == 0 {
            return Vec::new();
        }
        let letterbox = input::prepare(image, self.model.input, &mut self.planes);
        self.network.logits(&self.planes, &mut self.heads);
        let heads: Vec<&[f32]> = self.heads.iter().map(Vec::as_slice).collect();
        decode::detect(&self.geometry, &heads, &letterbox, self.model.boxes, &self.options)
    }
}
