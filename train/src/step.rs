//! One step: a batch to gradients, in one part or several side by side, and gradients to new parameters.
use crate::{
    config::{self, ClipBy, Config, Freeze},
    data::Batch,
    device::Accelerator,
    error::TrainError,
    features::FeatureCache,
    muon,
    optimizer::{Rule, Slot, clip_gains, squared_norm},
    pass::{Pass, Passed, floats, floats_mut},
};
use burn::{
    module::{Module, ModuleMapper, Param},
    tensor::{Tensor, TensorData},
};
use rayon::{ThreadPool, ThreadPoolBuilder, prelude::*};
use tcross_kernels::{
    allocator::{self, Keep},
    ops::Path,
};
use tcross_yolo::{Loss, LossTerms, ModelConfig, Statistics, Weights, Yolo};

/// A network with its optimiser.
pub struct Trainer {
    /// Every step takes and frees the same large buffers. First, so that it is dropped before the others give theirs back for good.
    _kept: Keep,
    /// The network once for each part of a batch, all with the same parameters: burn would let two backward passes of one network wait for
    /// each other.
    replicas: Vec<Yolo>,
    /// Threads for each part; none where there are too few, and parts come one after another.
    pools: Vec<ThreadPool>,
    pass: Pass,
    optimizer: config::Optimizer,
    clip: f64,
    clip_by: ClipBy,
    features: Option<FeatureCache>,
    /// One a float of the network, in the order in which it is walked; those that do not learn stay empty.
    slots: Vec<Slot>,
}

/// What a step has found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepOutput {
    /// The parts of the loss, divided by the batch.
    pub terms: LossTerms,
    /// Norm of all gradients before clipping.
    pub gradient_norm: f64,
}

impl Trainer {
    /// A network of this description that starts from these weights.
    ///
    /// # Errors
    /// If the weights do not fit the description, or the threads for parts of a batch cannot be started.
    pub fn new(config: &Config, model: &ModelConfig, weights: &Weights, accelerator: &Accelerator) -> Result<Self, TrainError> {
        let kept = allocator::keep();
        let device = accelerator.device().autodiff();
        let path = if config.fused { Path::for_device(&device) } else { Path::Composite };
        let replica = || -> Result<Yolo, TrainError> {
            let network = Yolo::new(model, weights, &device)?.with_momentum(1.0 - config.batch_norm_decay).with_path(path);
            let backbone = network.graph().backbone();
            Ok(match config.freeze {
                Freeze::None => network,
                Freeze::Backbone => network.frozen(backbone),
                Freeze::BackboneRunning => network.frozen(backbone).with_statistics(backbone, Statistics::Running),
            })
        };
        let parts = config.batch_parts;
        let threads = rayon::current_num_threads() / parts;
        let pool = |_| {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build();
            pool.map_err(|e| TrainError::Device { device: "cpu".into(), message: e.to_string() })
        };
        let pools = if parts > 1 && threads > 0 { (0..parts).map(pool).collect::<Result<_, _>>()? } else { Vec::new() };
        let loss = Loss { kind: config.loss, ignore_iou: config.ignore_iou as f32, assign_iou: config.assign_iou as f32 };
        Ok(Self {
            _kept: kept,
            replicas: (0..parts).map(|_| replica()).collect::<Result<_, _>>()?,
            pools,
            pass: Pass { model: model.clone(), loss, device, path },
            optimizer: config.optimizer.clone(),
            clip: config.clip,
            clip_by: config.clip_by,
            features: FeatureCache::of(config),
            slots: Vec::new(),
        })
    }

    /// Learns from a batch at this rate. `step` counts from 0.
    ///
    /// # Errors
    /// If a truth is out of range.
    pub fn step(&mut self, batch: Batch, rate: f64, step: u64) -> Result<StepOutput, TrainError> {
        let Passed { terms, gradients, .. } = self.learn_from(batch)?;
        let squared: Vec<f64> = gradients.iter().map(|g| g.as_ref().map_or(0.0, |g| squared_norm(floats(g)))).collect();
        let (gradient_norm, gains) = clip_gains(&squared, self.clip, self.clip_by);
        if gradient_norm.is_finite() {
            self.slots.resize(gradients.len(), Slot::default());
            let rule = Rule::new(&self.optimizer, rate, step);
            let directions = match rule.orthogonal() {
                true => directions(&rule, &gradients, &gains, &mut self.slots),
                false => vec![None; gains.len()],
            };
            let tell = self.replicas.len() > 1;
            let mut update = Update {
                rule,
                gradients: &gradients,
                gains: &gains,
                directions: &directions,
                slots: &mut self.slots,
                tell,
                moved: Vec::new(),
            };
            let mut replicas = std::mem::take(&mut self.replicas).into_iter();
            let first = replicas.next().map(|network| network.map(&mut update));
            let moved = update.moved;
            let others = replicas.map(|network| network.map(&mut Adopt { values: moved.iter() }));
            self.replicas = first.into_iter().chain(others).collect();
        }
        Yolo::share_statistics(&self.replicas);
        Ok(StepOutput { terms, gradient_norm })
    }

    /// Takes the parts of a batch through the replicas, side by side where there are threads for each, and adds up what they find.
    fn learn_from(&mut self, batch: Batch) -> Result<Passed, TrainError> {
        let (pass, replicas) = (&self.pass, &self.replicas);
        if let [network] = replicas.as_slice() {
            return pass.run(network, batch, self.features.as_mut());
        }
        let parts = batch.parts(replicas.len());
        let work = parts.into_iter().zip(replicas);
        let passed: Vec<Result<Passed, TrainError>> = if self.pools.is_empty() {
            work.map(|(part, network)| pass.run(network, part, None)).collect()
        } else {
            std::thread::scope(|scope| {
                let begun =
                    work.zip(&self.pools).map(|((part, network), pool)| scope.spawn(|| pool.install(|| pass.run(network, part, None))));
                let begun: Vec<_> = begun.collect();
                begun.into_iter().map(|part| part.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))).collect()
            })
        };
        Ok(Passed::sum(passed.into_iter().collect::<Result<_, _>>()?))
    }

    /// Which kernels run.
    #[must_use]
    pub fn path(&self) -> Path {
        self.pass.path
    }

    /// Reads the parameters back.
    #[must_use]
    pub fn weights(&self) -> Weights {
        self.replicas.first().map(Yolo::weights).unwrap_or_default()
    }

    /// What the optimiser remembers, one a float of the network in the order in which it is walked.
    #[must_use]
    pub fn slots(&self) -> &[Slot] {
        &self.slots
    }

    /// Puts back what the optimiser remembered.
    pub fn set_slots(&mut self, slots: Vec<Slot>) {
        self.slots = slots;
    }
}

/// The direction in which each kernel moves; none for other parameters. Kernels are independent of each other, so threads change nothing.
fn directions(rule: &Rule, gradients: &[Option<TensorData>], gains: &[f32], slots: &mut [Slot]) -> Vec<Option<Vec<f32>>> {
    let one = |((gradient, gain), slot): ((&Option<TensorData>, &f32), &mut Slot)| {
        let gradient = gradient.as_ref().filter(|g| g.shape().len() == 4)?;
        Some(muon::direction(floats(gradient), *gain, gradient.shape()[0], rule.momentum, slot))
    };
    gradients.par_iter().zip(gains).zip(slots).map(one).collect()
}

/// Moves each parameter.
struct Update<'a> {
    rule: Rule,
    gradients: &'a [Option<TensorData>],
    gains: &'a [f32],
    directions: &'a [Option<Vec<f32>>],
    slots: &'a mut [Slot],
    /// Whether `moved` is to hold where each parameter has moved to.
    tell: bool,
    /// One a parameter so far; none for what does not learn, or where nobody asks.
    moved: Vec<Option<TensorData>>,
}

impl ModuleMapper for Update<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let at = self.moved.len();
        let Some(gradient) = &self.gradients[at] else {
            self.moved.push(None);
            return param;
        };
        let (id, tensor, mapper) = param.consume();
        let device = tensor.device();
        let mut data = tensor.inner().into_data();
        match &self.directions[at] {
            Some(direction) => self.rule.stride(floats_mut(&mut data), direction),
            // Kernels have four dimensions; biases and batch norm's numbers have one and no decay.
            None => self.rule.update(floats_mut(&mut data), floats(gradient), self.gains[at], D == 4, &mut self.slots[at]),
        }
        self.moved.push(self.tell.then(|| data.clone()));
        Param::from_mapped_value(id, Tensor::from_data(data, &device).require_grad(), mapper)
    }
}

/// Puts each parameter where that of another replica has moved to.
struct Adopt<'a> {
    values: std::slice::Iter<'a, Option<TensorData>>,
}

impl ModuleMapper for Adopt<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let Some(Some(values)) = self.values.next() else { return param };
        let (id, tensor, mapper) = param.consume();
        Param::from_mapped_value(id, Tensor::from_data(values.clone(), &tensor.device()).require_grad(), mapper)
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
    use tcross_yolo::{Architecture, NetSize, NormBox, Truth};

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
            let copies = trainer.replicas.iter().map(Yolo::weights).collect::<Vec<_>>();
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
