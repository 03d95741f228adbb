//! SGD with momentum, AdamW and Muon's strides over plain slices. Parameters change here only: in [`Rule::update`] and, Muon's kernels,
//! in [`Rule::stride`].
use crate::config::{self, ClipBy, OptimizerKind};
use rayon::prelude::*;

/// What the optimiser remembers of one parameter: momentum for SGD and Muon's kernels, both moments for AdamW. Empty until its first step.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Slot {
    /// Running mean (SGD, Muon: running sum) of the gradient.
    pub first: Vec<f32>,
    /// Running mean of its square (AdamW).
    pub second: Vec<f32>,
}

/// One step's numbers, the same for all parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rule {
    /// Which optimiser.
    pub kind: OptimizerKind,
    /// Learning rate of this step.
    pub rate: f32,
    /// Weight decay of the parameters that have one.
    pub decay: f32,
    /// Momentum of SGD and of Muon's kernels; AdamW's first decay rate, also for what Muon leaves to it.
    pub momentum: f32,
    /// AdamW's second decay rate.
    pub second_momentum: f32,
    /// `1 - momentum^t` and `1 - second_momentum^t` of this step, the t-th.
    correction: [f32; 2],
}

/// Added to the root of AdamW's second moment.
const EPSILON: f32 = 1e-8;
/// Values a task works on: fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 1 << 14;

impl Rule {
    /// The rule of `step` (0-based) at this rate.
    #[must_use]
    pub fn new(config: &config::Optimizer, rate: f64, step: u64) -> Self {
        let taken = (step + 1) as f64;
        let correction = [config.momentum, config.second_momentum].map(|m| (1.0 - m.powf(taken)) as f32);
        Self {
            kind: config.kind,
            rate: rate as f32,
            decay: config.decay as f32,
            momentum: config.momentum as f32,
            second_momentum: config.second_momentum as f32,
            correction,
        }
    }

    /// Moves one parameter against its gradient, in place. `gain` scales the gradient (clipping), `decays` says whether the
    /// parameter has weight decay.
    pub fn update(&self, parameter: &mut [f32], gradient: &[f32], gain: f32, decays: bool, slot: &mut Slot) {
        let decay = if decays { self.decay } else { 0.0 };
        slot.first.resize(parameter.len(), 0.0);
        match self.kind {
            OptimizerKind::Sgd => {
                let tasks = parameter.par_chunks_mut(CHUNK).zip(gradient.par_chunks(CHUNK)).zip(slot.first.par_chunks_mut(CHUNK));
                tasks.for_each(|((parameter, gradient), first)| {
                    for ((p, g), m) in parameter.iter_mut().zip(gradient).zip(first) {
                        *m = self.momentum * *m + (gain * g + decay * *p);
                        *p -= self.rate * *m;
                    }
                });
            }
            OptimizerKind::Adamw | OptimizerKind::Muon => {
                slot.second.resize(parameter.len(), 0.0);
                let [first_share, second_share] = self.correction;
                let (keep, rate) = (1.0 - self.rate * decay, self.rate / first_share);
                let root = 1.0 / second_share.sqrt();
                let moments = slot.first.par_chunks_mut(CHUNK).zip(slot.second.par_chunks_mut(CHUNK));
                let tasks = parameter.par_chunks_mut(CHUNK).zip(gradient.par_chunks(CHUNK)).zip(moments);
                tasks.for_each(|((parameter, gradient), (first, second))| {
                    for ((p, g), (m, v)) in parameter.iter_mut().zip(gradient).zip(first.iter_mut().zip(second)) {
                        let g = gain * g;
                        *m = self.momentum * *m + (1.0 - self.momentum) * g;
                        *v = self.second_momentum * *v + (1.0 - self.second_momentum) * g * g;
                        *p = keep * *p - rate * *m / (v.sqrt() * root + EPSILON);
                    }
                });
            }
        }
    }

    /// Whether kernels move along directions of their own, by [`Self::stride`], and only the rest by [`Self::update`].
    #[must_use]
    pub fn orthogonal(&self) -> bool {
        self.kind == OptimizerKind::Muon
    }

    /// Moves a kernel along a direction, in place.
    pub fn stride(&self, kernel: &mut [f32], direction: &[f32]) {
        let keep = 1.0 - self.rate * self.decay;
        kernel.iter_mut().zip(direction).for_each(|(p, d)| *p = keep * *p - self.rate * d);
    }
}

/// Sum of squares, in f64 over fixed chunks.
#[must_use]
pub fn squared_norm(values: &[f32]) -> f64 {
    let chunks: Vec<f64> = values.par_chunks(CHUNK).map(|c| c.iter().map(|v| f64::from(*v) * f64::from(*v)).sum()).collect();
    chunks.iter().sum()
}

/// The norm of all gradients, and by how much each is to be scaled so that no norm exceeds `clip`.
#[must_use]
pub fn clip_gains(squared: &[f64], clip: f64, by: ClipBy) -> (f64, Vec<f32>) {
    let norm = squared.iter().sum::<f64>().sqrt();
    let gain = |norm: f64| if norm > clip { (clip / norm) as f32 } else { 1.0 };
    let gains = match by {
        ClipBy::Global => vec![gain(norm); squared.len()],
        ClipBy::Variable => squared.iter().map(|s| gain(s.sqrt())).collect(),
    };
    (norm, gains)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rule(kind: OptimizerKind, step: u64) -> Rule {
        let config = config::Optimizer { kind, decay: 0.1, momentum: 0.9, second_momentum: 0.99, ..Default::default() };
        Rule::new(&config, 0.5, step)
    }

    #[test]
    fn sgd_by_hand() {
        let (mut p, mut slot) = ([2.0], Slot::default());
        rule(OptimizerKind::Sgd, 0).update(&mut p, &[1.0], 1.0, true, &mut slot);
        assert!((p[0] - (2.0 - 0.5 * 1.2)).abs() < 1e-6); // velocity 1 + 0.1 * 2
        rule(OptimizerKind::Sgd, 1).update(&mut p, &[4.0], 0.25, false, &mut slot);
        assert!((p[0] - (1.4 - 0.5 * (0.9 * 1.2 + 1.0))).abs() < 1e-6);
    }

    #[test]
    fn adamw_by_hand() {
        let (mut p, mut slot) = ([2.0], Slot::default());
        rule(OptimizerKind::Adamw, 0).update(&mut p, &[3.0], 1.0, true, &mut slot);
        assert!((p[0] - (2.0 * 0.95 - 0.5)).abs() < 1e-5); // the first step has size 1 whatever the gradient
        rule(OptimizerKind::Adamw, 1).update(&mut p, &[-1.0], 1.0, false, &mut slot);
        let m = (0.9 * 0.3 - 0.1) / (1.0 - 0.81);
        let v: f64 = (0.99 * 0.09 + 0.01) / (1.0 - 0.9801);
        assert!((f64::from(p[0]) - (1.4 - 0.5 * m / v.sqrt())).abs() < 1e-5, "{}", p[0]);
    }

    #[test]
    fn threads_do_not_change_a_bit() {
        let gradient: Vec<f32> = (0..50_000).map(|k| ((k * 7919) % 1000) as f32 / 500.0 - 1.0).collect();
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let (mut p, mut slot) = (vec![1.0; 50_000], Slot::default());
                (0..3).for_each(|step| rule(OptimizerKind::Adamw, step).update(&mut p, &gradient, 0.3, true, &mut slot));
                (p, slot, squared_norm(&gradient))
            })
        };
        assert_eq!(run(1), run(4));
    }

    #[test]
    fn clipping_by_all_and_by_each() {
        let (norm, gains) = clip_gains(&[9.0, 16.0], 2.5, ClipBy::Global);
        assert_eq!((norm, gains), (5.0, vec![0.5, 0.5]));
        assert_eq!(clip_gains(&[9.0, 16.0], 3.5, ClipBy::Variable).1, vec![1.0, 0.875]);
    }
}
