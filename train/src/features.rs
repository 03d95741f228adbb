//! What a backbone that stands still says of images that never change: computed once, kept, and read again in every later epoch.
use crate::config::{Config, Freeze};
use burn::tensor::{Device, Tensor, TensorData};
use std::collections::HashMap;
use tcross_yolo::{Yolo, network::Features};

/// A cache of features, one list of values an image.
#[derive(Debug)]
pub struct FeatureCache {
    images: HashMap<usize, Vec<Vec<f32>>>,
    /// The place in the network where they belong, once there is a batch.
    place: Option<Features>,
    bytes: usize,
    budget: usize,
}

impl FeatureCache {
    /// A cache, where it can serve: the backbone and its batch norms stand still, no image is ever shown in another form, and batches go
    /// through the network whole.
    #[must_use]
    pub fn of(config: &Config) -> Option<Self> {
        let still = config.freeze == Freeze::BackboneRunning
            && config.augment.is_still()
            && config.multi_scale.is_empty()
            && config.windows.until == 0.0
            && config.batch_parts == 1;
        let budget = (config.cache_gb * 1e9) as usize;
        (still && budget > 0).then(|| Self { images: HashMap::new(), place: None, bytes: 0, budget })
    }

    /// The features of a batch: those kept, or computed from `images` and kept as long as there is room.
    pub fn of_batch(&mut self, network: &Yolo, sources: &[Vec<usize>], images: Tensor<4>) -> Features {
        let device = images.device();
        match self.kept(sources, &device) {
            Some(features) => features,
            None => {
                let features = network.backbone(images);
                self.keep(sources, &features);
                features
            }
        }
    }

    fn kept(&self, sources: &[Vec<usize>], device: &Device) -> Option<Features> {
        let place = self.place.as_ref()?;
        let images: Vec<&Vec<Vec<f32>>> = sources.iter().map(|s| self.images.get(s.first()?)).collect::<Option<_>>()?;
        let tensors = place.tensors().enumerate().map(|(k, like)| {
            let [_, height, width, channels] = like.dims();
            let values: Vec<f32> = images.iter().flat_map(|image| image[k].iter().copied()).collect();
            Tensor::from_data(TensorData::new(values, [images.len(), height, width, channels]), device)
        });
        place.with_tensors(tensors)
    }

    fn keep(&mut self, sources: &[Vec<usize>], features: &Features) {
        let values = features.values();
        let bytes: usize = values.iter().map(|v| size_of_val(v.as_slice()) / sources.len()).sum();
        for (index, source) in sources.iter().enumerate() {
            let Some(&image) = source.first() else { continue };
            if self.images.contains_key(&image) || self.bytes + bytes > self.budget {
                continue;
            }
            let own = |v: &Vec<f32>| v.chunks_exact(v.len() / sources.len()).nth(index).unwrap_or_default().to_vec();
            self.images.insert(image, values.iter().map(own).collect());
            self.bytes += bytes;
        }
        self.place.get_or_insert_with(|| features.clone());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Augment;
    use tcross_yolo::{Architecture, ModelConfig, NetSize, Weights};

    #[test]
    fn the_second_time_nothing_is_computed() {
        let model = ModelConfig { width: 0.0625, depth: 0.25, input: NetSize::square(64), ..ModelConfig::of(Architecture::YoloV3) };
        let weights = Weights::init(&model.graph().unwrap(), &model.fields(), &Default::default(), 1);
        let device = Device::flex();
        let network = Yolo::new(&model, &weights, &device).unwrap();
        let still = Augment { flip: 0.0, color_probability: 0.0, ..Augment::default() };
        let config = Config { freeze: Freeze::BackboneRunning, augment: still, ..Config::default() };
        assert!(FeatureCache::of(&Config { freeze: Freeze::Backbone, ..config.clone() }).is_none());
        assert!(FeatureCache::of(&Config { augment: Augment::default(), ..config.clone() }).is_none());
        let mut cache = FeatureCache::of(&config).unwrap();
        let noise: Vec<f32> = (0..2 * 3 * 64 * 64).map(|k| (k * 7919 % 101) as f32 / 101.0).collect();
        let images = Tensor::<4>::from_data(TensorData::new(noise, [2, 3, 64, 64]), &device);
        let logits = |f: Features| network.heads(f).into_iter().map(|h| h.into_data()).collect::<Vec<_>>();
        let whole: Vec<TensorData> = network.forward(images.clone()).into_iter().map(|h| h.into_data()).collect();
        assert_eq!(logits(cache.of_batch(&network, &[vec![4], vec![9]], images.clone())), whole);
        // In another order, of pictures that are not looked at.
        let swapped = logits(cache.of_batch(&network, &[vec![9], vec![4]], images.zeros_like()));
        for (a, b) in swapped.iter().zip(&whole) {
            let (a, b) = (a.as_slice::<f32>().unwrap(), b.as_slice::<f32>().unwrap());
            assert_eq!(a[..a.len() / 2], b[b.len() / 2..]);
        }
    }
}
