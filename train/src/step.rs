//! One step of a detector: a batch to gradients, in one part or several side by side, and gradients to new parameters.
pub use crate::learner::StepOutput;
use crate::{
    config::{Config, Freeze},
    data::Batch,
    device::Accelerator,
    error::TrainError,
    features::FeatureCache,
    learner::Learner,
    optimizer::Slot,
    pass::Pass,
};
use tcross_kernels::ops::Path;
use tcross_yolo::{Loss, ModelConfig, Statistics, Weights, Yolo};

/// A network with its optimiser.
pub struct Trainer {
    learner: Learner<Yolo>,
    pass: Pass,
    features: Option<FeatureCache>,
}

impl Trainer {
    /// A network of this description that starts from these weights.
    ///
    /// # Errors
    /// If the weights do not fit the description, or the threads for parts of a batch cannot be started.
    pub fn new(config: &Config, model: &ModelConfig, weights: &Weights, accelerator: &Accelerator) -> Result<Self, TrainError> {
        let device = accelerator.device().autodiff();
        let path = if config.fused { Path::for_device(&device) } else { Path::Composite };
        let copy = || -> Result<Yolo, TrainError> {
            let network = Yolo::new(model, weights, &device)?.with_momentum(1.0 - config.batch_norm_decay).with_path(path);
            let backbone = network.graph().backbone();
            Ok(match config.freeze {
                Freeze::None => network,
                Freeze::Backbone => network.frozen(backbone),
                Freeze::BackboneRunning => network.frozen(backbone).with_statistics(backbone, Statistics::Running),
            })
        };
        let learner = Learner::new(config.batch_parts, &config.optimizer, config.clip, config.clip_by, copy)?;
        let loss = Loss { kind: config.loss, ignore_iou: config.ignore_iou as f32, assign_iou: config.assign_iou as f32 };
        Ok(Self { learner, pass: Pass { model: model.clone(), loss, device, path }, features: FeatureCache::of(config) })
    }

    /// Learns from a batch at this rate. `step` counts from 0.
    ///
    /// # Errors
    /// If a truth is out of range.
    pub fn step(&mut self, batch: Batch, rate: f64, step: u64) -> Result<StepOutput, TrainError> {
        let pass = &self.pass;
        let passed = match self.learner.replicas() {
            [network] => pass.run(network, batch, self.features.as_mut())?,
            replicas => self.learner.pass(batch.parts(replicas.len()), |network, part| pass.run(network, part, None))?,
        };
        Ok(self.learner.learn(passed, rate, step))
    }

    /// Which kernels run.
    #[must_use]
    pub fn path(&self) -> Path {
        self.pass.path
    }

    /// Reads the parameters back.
    #[must_use]
    pub fn weights(&self) -> Weights {
        self.learner.weights()
    }

    /// What the optimiser remembers, one a float of the network in the order in which it is walked.
    #[must_use]
    pub fn slots(&self) -> &[Slot] {
        self.learner.slots()
    }

    /// Puts back what the optimiser remembered.
    pub fn set_slots(&mut self, slots: Vec<Slot>) {
        self.learner.set_slots(slots);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        augment::{Input, View},
        data::Request,
    };
    use tcross_dataset::Rng;
    use tcross_kernels::allocator;
    use tcross_yolo::{Architecture, NetSize, Network, NormBox, Truth};

    /// `batch` images of noise with a box each, the second half of them as the first.
    fn twice(batch: usize) -> Batch {
        let net = NetSize::square(64);
        let mut rng = Rng::for_item(1, "test/step", 0);
        let half: Vec<f32> = (0..batch / 2 * 3 * 64 * 64).map(|_| rng.unit() as f32).collect();
        let mut truth = || {
            let [x, y, w, h] = [0; 4].map(|_| rng.uniform(0.3, 0.6) as f32);
            vec![Truth { bounds: NormBox { x, y, w, h }, class: 0, weight: 1.0, keypoints: Vec::new() }]
        };
        let truths: Vec<Vec<Truth>> = (0..batch / 2).map(|_| truth()).collect();
        let request = Request { step: 0, input: Input { net, view: View::Whole, fraction: 0.0 } };
        Batch { request, sources: vec![vec![0]; batch], images: half.repeat(2), truths: [truths.clone(), truths].concat() }
    }

    /// Halves that are the same have the whole's statistics, loss and gradient: a step in two parts is the step in one.
    #[test]
    fn a_step_in_parts_is_the_step_of_the_whole() {
        let model = ModelConfig { width: 0.125, depth: 0.25, ..ModelConfig::of(Architecture::YoloV3) };
        let weights = Weights::init(&model.graph().unwrap(), &model.fields(), &Default::default(), 1);
        let learned = [1, 2].map(|batch_parts| {
            let config = Config { batch_parts, ..Config::default() };
            let mut trainer = Trainer::new(&config, &model, &weights, &Accelerator::Cpu).unwrap();
            let found = [0, 1].map(|step| trainer.step(twice(4), 1e-3, step).unwrap());
            let copies = trainer.learner.replicas().iter().map(Network::weights).collect::<Vec<_>>();
            assert!(allocator::is_kept(), "a step's buffers serve the next");
            assert!(copies.len() == batch_parts && copies.iter().all(|copy| *copy == copies[0]), "replicas agree");
            (found, trainer.weights())
        });
        let [(whole, whole_weights), (parts, parts_weights)] = &learned;
        for (a, b) in whole.iter().zip(parts) {
            assert!((a.terms.total() - b.terms.total()).abs() < 1e-3 * a.terms.total(), "{a:?}, {b:?}");
            assert!((a.gradient_norm - b.gradient_norm).abs() < 1e-2 * a.gradient_norm, "{a:?}, {b:?}");
        }
        let (a, b) = (whole_weights.convolutions[0].norm.as_ref().unwrap(), parts_weights.convolutions[0].norm.as_ref().unwrap());
        assert!(a.variance.iter().zip(&b.variance).all(|(a, b)| (a - b).abs() < 1e-4 * a), "running averages");
        assert!(*whole_weights != weights);
    }

    #[test]
    fn a_batch_falls_into_parts_of_about_the_same_size() {
        let batch = Batch {
            truths: vec![Vec::new(); 5],
            sources: (0..5).map(|k| vec![k]).collect(),
            images: (0..10).map(|k| k as f32).collect(),
            ..twice(2)
        };
        let parts = batch.parts(3);
        let sizes: Vec<usize> = parts.iter().map(|part| part.truths.len()).collect();
        assert_eq!(sizes, [2, 2, 1]);
        assert_eq!(parts.iter().flat_map(|part| part.images.clone()).collect::<Vec<_>>(), (0..10).map(|k| k as f32).collect::<Vec<_>>());
        assert_eq!(parts[2].sources, [[4]]);
    }
}
