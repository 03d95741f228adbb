//! From a picture to boxes: letterbox, network, decoding, suppression, the letterbox undone, and a second look where the model has one.
use crate::{
    Geometry, InferenceNet, Model, ModelConfig, Refiner,
    decode::{self, DetectOptions},
    error::YoloError,
    input,
    refiner::{LEAST_SCORE, REFINER},
};
use image::RgbImage;
use std::path::Path;
use tcross_dataset::Detection;

/// A loaded model, ready to look at pictures.
#[derive(Debug, Clone)]
pub struct Detector {
    model: ModelConfig,
    geometry: Geometry,
    network: InferenceNet,
    planes: Vec<f32>,
    /// The second stage, where there is one.
    pub refiner: Option<Refiner>,
    /// Which claims are kept.
    pub options: DetectOptions,
}

impl Detector {
    /// Loads a model: a run's folder (its best weights, and its second stage), a `.safetensors` file with `model.toml` beside it, or a
    /// Darknet `.cfg` or `.weights` with its partner beside it.
    ///
    /// # Errors
    /// If a file is missing, broken, or does not fit its description.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, YoloError> {
        let path = path.as_ref();
        let mut detector = Self::from_model(&Model::load(path)?)?;
        let refiner = path.join(REFINER);
        if refiner.is_file() {
            detector.refiner = Some(Refiner::read(refiner, detector.model.boxes)?);
        }
        Ok(detector)
    }

    /// A detector of a model in memory, such as one just trained, without a second stage.
    ///
    /// # Errors
    /// If the weights do not fit the description.
    pub fn from_model(model: &Model) -> Result<Self, YoloError> {
        let net = model.config.input;
        Ok(Self {
            geometry: model.config.geometry(net),
            network: InferenceNet::new(&model.config, &model.weights)?,
            model: model.config.clone(),
            planes: vec![0.0; 3 * net.width * net.height],
            refiner: None,
            options: DetectOptions::default(),
        })
    }

    /// What the model is.
    #[must_use]
    pub fn model(&self) -> &ModelConfig {
        &self.model
    }

    /// Every marker the model claims in a picture, by falling score; boxes in pixels of the picture, counted as the model's
    /// training set counts them.
    pub fn detect(&mut self, image: &RgbImage) -> Vec<Detection> {
        let options = self.options;
        if self.refiner.is_none() {
            return self.claims(image, &options);
        }
        let claims = self.claims(image, &DetectOptions { score: LEAST_SCORE.min(options.score), ..options });
        self.refiner.as_ref().map_or(Vec::new(), |refiner| refiner.refine(image, &claims, &options))
    }

    /// What the first stage alone claims.
    pub fn claims(&mut self, image: &RgbImage, options: &DetectOptions) -> Vec<Detection> {
        if image.width() == 0 || image.height() == 0 {
            return Vec::new();
        }
        let letterbox = input::prepare(image, self.model.input, &mut self.planes);
        let heads = self.network.run(&self.planes, self.model.input);
        let heads: Vec<&[f32]> = heads.iter().map(Vec::as_slice).collect();
        decode::detect(&self.geometry, &heads, &letterbox, self.model.boxes, options)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Architecture, NetSize, Weights, refiner::net, weights::safetensors};

    /// A folder with a second stage is read with it, and its claims have other scores and boxes than the first stage's.
    #[test]
    fn a_second_stage_beside_the_weights_is_used() {
        let dir = tempfile::tempdir().unwrap();
        let config = ModelConfig { width: 0.0625, input: NetSize::square(64), ..ModelConfig::of(Architecture::YoloV3Tiny) };
        let init = crate::weights::Init { objectness_bias: 0.0, ..Default::default() };
        let weights = Weights::init(&config.graph().unwrap(), &config.fields(), &init, 3);
        Model { config, weights }.save(dir.path().join("best.safetensors")).unwrap();
        let image = RgbImage::from_fn(90, 60, |x, y| image::Rgb([(x * 7) as u8, (y * 11) as u8, (x * y) as u8]));
        let mut plain = Detector::load(dir.path()).unwrap();
        assert!(plain.refiner.is_none());
        let first = plain.detect(&image);

        let mut says = Weights::zeros(&net::layers());
        let at = says.convolutions.len() - 2;
        says.convolutions[at].bias = vec![0.0, 2.0];
        safetensors::write(dir.path().join(REFINER), &net::layers(), &says).unwrap();
        let mut refined = Detector::load(dir.path()).unwrap();
        let second = refined.detect(&image);
        assert!(!first.is_empty() && second[0].score > first[0].score);
        refined.refiner = None;
        assert_eq!(refined.detect(&image), first);
        std::fs::write(dir.path().join(REFINER), "x").unwrap();
        assert!(Detector::load(dir.path()).unwrap_err().to_string().contains(REFINER));
    }
}
