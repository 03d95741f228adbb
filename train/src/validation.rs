//! Validation in memory: the averaged weights detect on the validation images, the eval crate scores.
use crate::{
    augment::{Labels, Plan, planes::Planes},
    config::{Metric, Validate},
    data::Samples,
    device::Accelerator,
    error::TrainError,
    run::draw,
};
use burn::tensor::{Tensor, TensorData};
use image::RgbImage;
use rayon::prelude::*;
use std::time::{Duration, Instant};
use tcross_dataset::{ImageDetections, PixelBox, dataset::BoxConvention, geom::boxes::iou};
use tcross_eval::ValidationScores;
use tcross_kernels::ops::Path;
use tcross_yolo::{DetectOptions, ModelConfig, Weights, Yolo, detect, network::read_logits};

/// What a validation looks at.
pub struct Validator<'a> {
    /// Images with their truth.
    pub samples: &'a Samples,
    /// How the dataset's boxes are counted.
    pub boxes: BoxConvention,
    /// The network.
    pub model: &'a ModelConfig,
    /// Where it runs.
    pub accelerator: Accelerator,
    /// Which kernels run.
    pub path: Path,
    /// Images in a forward pass.
    pub batch: usize,
    /// Settings.
    pub config: &'a Validate,
    /// Shapes in the order of their class numbers.
    pub classes: &'a [String],
}

impl Validator<'_> {
    /// Detects on every image with these weights, and says how long the network alone took.
    ///
    /// # Errors
    /// If the weights do not fit the network.
    pub fn detections(&self, weights: &Weights) -> Result<(Vec<ImageDetections>, Duration), TrainError> {
        let mut spent = Duration::ZERO;
        let device = self.accelerator.device();
        let network = Yolo::new(self.model, weights, &device)?.with_path(self.path);
        let net = self.model.input;
        let geometry = self.model.geometry(net);
        let length = 3 * net.width * net.height;
        let count = self.samples.count();
        let mut all = Vec::with_capacity(count);
        for start in (0..count).step_by(self.batch) {
            let indices: Vec<usize> = (start..(start + self.batch).min(count)).collect();
            let mut images = vec![0.0; indices.len() * length];
            images.par_chunks_exact_mut(length).zip(&indices).for_each(|(out, &index)| {
                Plan::plain(index, net, net).render(self.samples, &mut |i| self.samples.read(i), out);
            });
            let started = Instant::now();
            let images = Tensor::from_data(TensorData::new(images, [indices.len(), 3, net.height, net.width]), &device);
            let heads: Vec<Vec<f32>> = network.forward(images).iter().map(read_logits).collect();
            spent += started.elapsed();
            let image = |(k, &index): (usize, &usize)| {
                let logits: Vec<&[f32]> =
                    heads.iter().enumerate().map(|(h, head)| &head[k * geometry.head_len(h)..][..geometry.head_len(h)]).collect();
                let record = &self.samples.records[index];
                let detections = detect(&geometry, &logits, &self.samples.letterbox(index), self.model.boxes, &DetectOptions::default());
                ImageDetections { image: record.image.clone(), width: record.width, height: record.height, detections, ms: None }
            };
            all.extend(indices.par_iter().enumerate().map(image).collect::<Vec<_>>());
        }
        Ok((all, spent))
    }

    /// Scores detections.
    #[must_use]
    pub fn score(&self, detections: &[ImageDetections]) -> ValidationScores {
        let config = tcross_eval::Config { threshold: self.config.threshold, classes: self.classes.to_vec(), ..Default::default() };
        tcross_eval::validate(&self.samples.records, detections, self.boxes, &config)
    }

    /// The images that went worst, with true and claimed boxes: those with the least IoU of a marker's best claim at the threshold,
    /// then those with the most claims too many.
    #[must_use]
    pub fn worst(&self, detections: &[ImageDetections]) -> RgbImage {
        let kept = |index: usize| detections[index].detections.iter().filter(|d| d.score >= self.config.threshold).map(|d| d.bounds);
        let quality = |index: usize| {
            let markers = &self.samples.records[index].markers;
            let best = |m: &PixelBox| kept(index).map(|b| iou(m, &b)).fold(0.0, f64::max);
            let least = markers.iter().map(|m| best(&m.bounds)).fold(1.0, f64::min);
            least - 0.1 * kept(index).count().saturating_sub(markers.len()) as f64
        };
        let mut order: Vec<(usize, f64)> = (0..detections.len()).map(|index| (index, quality(index))).collect();
        order.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        let picture = |&(index, _): &(usize, f64)| {
            let extra = self.boxes.extra();
            let letterbox = self.samples.letterbox(index);
            let place = |b: PixelBox| letterbox.box_to_net(&b.grown(extra));
            let truths: Vec<PixelBox> = self.samples.labels(index).iter().map(|l| l.bounds).collect();
            let claimed: Vec<PixelBox> = kept(index).map(place).collect();
            let size = self.samples.size();
            let image = self.samples.read(index);
            draw::claims(image.as_deref().unwrap_or(&Planes::grey(size.width, size.height)), &truths, &claimed)
        };
        draw::sheet(&order.iter().take(9).map(picture).collect::<Vec<_>>())
    }
}

/// The number that makes weights the best.
#[must_use]
pub fn metric(scores: &ValidationScores, metric: Metric) -> Option<f64> {
    match metric {
        Metric::Ap => scores.ap,
        Metric::Ap50 => scores.ap50,
        Metric::MeanIou => scores.mean_iou,
        Metric::Precision => scores.precision,
        Metric::Recall => scores.recall,
        Metric::F1 => scores.f1,
        Metric::BestF1 => scores.best_f1.map(|(_, f1)| f1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::toy;
    use tcross_dataset::{Dataset, Split};
    use tcross_yolo::{Architecture, NetSize};

    /// burn's own operations, where they are asked for, give the same boxes but for the last bits.
    #[test]
    fn the_chosen_kernels_run() {
        let dir = tempfile::tempdir().unwrap();
        toy::write(dir.path(), 1, 2, 64).unwrap();
        let dataset = Dataset::open(dir.path()).unwrap();
        let model = ModelConfig { width: 0.0625, input: NetSize::square(64), ..ModelConfig::of(Architecture::YoloV3Tiny) };
        let samples = Samples::open(&dataset, Split::Val, model.input, &[], 0).unwrap();
        let init = tcross_yolo::weights::Init { objectness_bias: 0.0, ..Default::default() };
        let weights = Weights::init(&model.graph().unwrap(), &model.fields(), &init, 3);
        let [fused, composite] = [Path::Fused, Path::Composite].map(|path| {
            let validator = Validator {
                samples: &samples,
                boxes: BoxConvention::Continuous,
                model: &model,
                accelerator: Accelerator::Cpu,
                path,
                batch: 2,
                config: &Validate::default(),
                classes: &[],
            };
            let (found, _) = validator.detections(&weights).unwrap();
            found.iter().flat_map(|image| &image.detections).map(|d| d.score).collect::<Vec<f64>>()
        });
        assert!(!fused.is_empty() && fused != composite);
        assert!(fused.iter().zip(&composite).all(|(a, b)| (a - b).abs() < 1e-4), "{fused:?} {composite:?}");
    }
}
