//! What is remembered of each claim from one look to the next: where the marker's frame was seen, and how wrong the score was. Claims that
//! were judged rightly are looked at more rarely, and then stand for as many as were left out. (Importance sampling by the gradient's size:
//! P. Zhao and T. Zhang, Stochastic Optimization with Importance Sampling for Regularized Loss Minimization, 2015.)
use tcross_dataset::Rng;
use tcross_yolo::refiner::Frame;

/// From this error of the score on, a claim is looked at in each pass; below, as much more rarely.
const WRONG: f32 = 0.25;
/// Share of the passes in which a claim is looked at, at least.
const LEAST_SHARE: f32 = 0.25;
/// Numbers that are kept of a claim: the error, and the frame's centre, stretch along x and y, and slant.
const NUMBERS: usize = 6;
/// The error of a claim that was not looked at.
const UNSEEN: f32 = -1.0;

/// What the last look at a claim said.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// The frame, in the claim's units.
    pub frame: Frame,
    /// How far the score was from 0 or 1, as it should have been.
    pub error: f32,
}

/// The last look at each claim, and how far the passes over them have come.
#[derive(Debug, Clone, PartialEq)]
pub struct Memory {
    seed: u64,
    seen: Vec<Option<Seen>>,
    /// Places of all passes that are behind, whether they were looked at or not.
    at: u64,
    epoch: u64,
    order: Vec<usize>,
}

impl Memory {
    /// Of claims that were not looked at.
    pub fn new(seed: u64, claims: usize) -> Self {
        Self { seed, seen: vec![None; claims], at: 0, epoch: u64::MAX, order: Vec::new() }
    }

    /// As it was when [`Memory::numbers`] were taken, after `at` places; none if they are of other claims.
    pub fn again(seed: u64, claims: usize, at: u64, numbers: &[f32]) -> Option<Self> {
        let seen = |n: &[f32; NUMBERS]| {
            let [error, x, y, xx, yy, xy] = *n;
            (error != UNSEEN).then_some(Seen { frame: Frame { center: [x, y], axes: [[xx, xy], [xy, yy]] }, error })
        };
        let (chunks, rest) = numbers.as_chunks::<NUMBERS>();
        let whole = chunks.len() == claims && rest.is_empty();
        whole.then(|| Self { at, seen: chunks.iter().map(seen).collect(), ..Self::new(seed, claims) })
    }

    /// All that is remembered, to be written to a file.
    pub fn numbers(&self) -> Vec<f32> {
        let numbers = |seen: &Option<Seen>| match seen {
            Some(Seen { frame: Frame { center: [x, y], axes: [[xx, xy], [_, yy]] }, error }) => [*error, *x, *y, *xx, *yy, *xy],
            None => [UNSEEN; NUMBERS],
        };
        self.seen.iter().flat_map(numbers).collect()
    }

    /// Places of all passes that are behind.
    pub fn at(&self) -> u64 {
        self.at
    }

    /// What the last look at a claim said.
    pub fn seen(&self, claim: usize) -> Option<Seen> {
        self.seen[claim]
    }

    /// Remembers a look.
    pub fn note(&mut self, claim: usize, seen: Seen) {
        self.seen[claim] = Some(seen);
    }

    /// The claim to look at next, and how many looks this one stands for.
    pub fn next(&mut self) -> (usize, f32) {
        loop {
            let count = self.seen.len() as u64;
            if self.at / count != self.epoch {
                self.epoch = self.at / count;
                self.order = (0..self.seen.len()).collect();
                Rng::for_item(self.seed, "refine/order", self.epoch).shuffle(&mut self.order);
            }
            let claim = self.order[(self.at % count) as usize];
            let share = self.seen[claim].map_or(1.0, |seen| (seen.error / WRONG).clamp(LEAST_SHARE, 1.0));
            self.at += 1;
            if Rng::for_item(self.seed, "refine/skip", self.at).chance(f64::from(share)) {
                return (claim, 1.0 / share);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(error: f32) -> Seen {
        Seen { frame: Frame { center: [0.1, -0.2], axes: [[0.9, 0.3], [0.3, 0.7]] }, error }
    }

    #[test]
    fn each_pass_comes_by_every_claim_once() {
        let mut memory = Memory::new(1, 10);
        let mut pass = || (0..10).map(|_| memory.next()).collect::<Vec<_>>();
        let (one, two) = (pass(), pass());
        assert_ne!(one, two);
        for mut order in [one, two] {
            order.sort_by_key(|(claim, _)| *claim);
            assert_eq!(order, (0..10).map(|k| (k, 1.0)).collect::<Vec<_>>());
        }
    }

    /// Claims that are known well come rarely, and count as often as the others all the same.
    #[test]
    fn what_is_judged_rightly_comes_rarely_and_weighs_more() {
        let mut memory = Memory::new(2, 4);
        for (claim, error) in [(0, 0.9), (1, WRONG / 2.0), (2, 0.001)] {
            memory.note(claim, seen(error));
        }
        let (mut looks, mut weights) = ([0; 4], [0.0; 4]);
        while memory.at() < 4 * 4000 {
            let (claim, weight) = memory.next();
            looks[claim] += 1;
            weights[claim] += weight;
        }
        assert_eq!((looks[0], looks[3]), (4000, 4000), "wrong ones and those never seen in every pass");
        assert!((1850..2150).contains(&looks[1]) && (900..1100).contains(&looks[2]), "{looks:?}");
        assert!(weights.iter().all(|w| (w - 4000.0f32).abs() < 400.0), "{weights:?}");
    }

    #[test]
    fn it_goes_on_where_it_was() {
        let mut memory = Memory::new(3, 7);
        for k in 0..20 {
            let (claim, _) = memory.next();
            memory.note(claim, seen(0.05 * k as f32));
        }
        let mut again = Memory::again(3, 7, memory.at(), &memory.numbers()).unwrap();
        assert!((0..7).all(|k| again.seen(k) == memory.seen(k)) && again.seen(0).is_some());
        assert!((0..30).all(|_| again.next() == memory.next()));
        assert_eq!(Memory::again(3, 6, 0, &memory.numbers()), None);
        assert_eq!(Memory::again(3, 2, 0, &[UNSEEN; 12]), Some(Memory::new(3, 2)));
    }
}
