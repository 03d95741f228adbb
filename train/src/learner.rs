//! Networks with an optimiser: parts of a batch side by side to gradients, gradients to new parameters, whatever the network and its loss.
use crate::{
    config::{self, ClipBy},
    error::TrainError,
    muon,
    optimizer::{Rule, Slot, clip_gains, squared_norm},
    pass::{Passed, floats, floats_mut},
};
use burn::{
    module::{ModuleMapper, Param},
    tensor::{Tensor, TensorData},
};
use rayon::{ThreadPool, ThreadPoolBuilder, prelude::*};
use tcross_kernels::allocator::{self, Keep};
use tcross_yolo::{LossTerms, Network, Weights};

/// A network with its optimiser.
pub struct Learner<N> {
    /// Every step takes and frees the same large buffers. First, so that it is dropped before the others give theirs back for good.
    _kept: Keep,
    /// The network once for each part of a batch, all with the same parameters: burn would let two backward passes of one network wait for
    /// each other.
    replicas: Vec<N>,
    /// Threads for each part; none where there are too few, and parts come one after another.
    pools: Vec<ThreadPool>,
    optimizer: config::Optimizer,
    clip: f64,
    clip_by: ClipBy,
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

impl<N: Network + Sync> Learner<N> {
    /// Makes as many copies of a network as a batch has parts.
    ///
    /// # Errors
    /// If a copy cannot be made, or the threads for parts of a batch cannot be started.
    pub fn new(
        parts: usize,
        optimizer: &config::Optimizer,
        clip: f64,
        clip_by: ClipBy,
        copy: impl Fn() -> Result<N, TrainError>,
    ) -> Result<Self, TrainError> {
        let kept = allocator::keep();
        let threads = rayon::current_num_threads() / parts;
        let pool = |_| {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build();
            pool.map_err(|e| TrainError::Device { device: "cpu".into(), message: e.to_string() })
        };
        let pools = if parts > 1 && threads > 0 { (0..parts).map(pool).collect::<Result<_, _>>()? } else { Vec::new() };
        Ok(Self {
            _kept: kept,
            replicas: (0..parts).map(|_| copy()).collect::<Result<_, _>>()?,
            pools,
            optimizer: optimizer.clone(),
            clip,
            clip_by,
            slots: Vec::new(),
        })
    }

    /// Takes the parts of a batch through the copies, side by side where there are threads for each, and adds up what they find.
    ///
    /// # Errors
    /// The first that a part meets.
    pub fn pass<P: Send>(&self, parts: Vec<P>, run: impl Fn(&N, P) -> Result<Passed, TrainError> + Sync) -> Result<Passed, TrainError> {
        let work = parts.into_iter().zip(&self.replicas);
        let passed: Vec<Result<Passed, TrainError>> = if self.pools.is_empty() {
            work.map(|(part, network)| run(network, part)).collect()
        } else {
            let run = &run;
            std::thread::scope(|scope| {
                let begun = work.zip(&self.pools).map(|((part, network), pool)| scope.spawn(move || pool.install(|| run(network, part))));
                let begun: Vec<_> = begun.collect();
                begun.into_iter().map(|part| part.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))).collect()
            })
        };
        Ok(Passed::sum(passed.into_iter().collect::<Result<_, _>>()?))
    }

    /// Moves all parameters by what a batch has found, at this rate. `step` counts from 0.
    pub fn learn(&mut self, passed: Passed, rate: f64, step: u64) -> StepOutput {
        let Passed { terms, gradients, .. } = passed;
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
        N::share_statistics(&self.replicas);
        StepOutput { terms, gradient_norm }
    }

    /// The copies, which agree.
    #[must_use]
    pub fn replicas(&self) -> &[N] {
        &self.replicas
    }

    /// Reads the parameters back.
    #[must_use]
    pub fn weights(&self) -> Weights {
        self.replicas.first().map(N::weights).unwrap_or_default()
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
