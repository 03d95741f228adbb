//! From a picture to boxes: letterbox, network, decoding, suppression, the letterbox undone.
use crate::{config::Config, error::InferError};
use image::RgbImage;
use std::path::Path;
use tcross_dataset::Detection;
use tcross_yolo::{DetectOptions, Geometry, InferenceNet, Model, ModelConfig, decode, input};

/// A loaded model, ready to look at pictures.
pub struct Detector {
    model: ModelConfig,
    geometry: Geometry,
    network: InferenceNet,
    planes: Vec<f32>,
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
        let net = model.config.input;
        Ok(Self {
            geometry: model.config.geometry(net),
            network: InferenceNet::new(&model.config, &model.weights)?,
            model: model.config.clone(),
            planes: vec![0.0; 3 * net.width * net.height],
            options: DetectOptions::default(),
        })
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
        let heads = self.network.run(&self.planes, self.model.input);
        let heads: Vec<&[f32]> = heads.iter().map(Vec::as_slice).collect();
        decode::detect(&self.geometry, &heads, &letterbox, self.model.boxes, &self.options)
    }
}
