//! Chance, keyed by (seed, purpose, index), so that item 17 is the same alone, in any order, on any threads.
//!
//! The generator is ChaCha8; everything drawn from it (ranges, normals, shuffles) is written here, because the
//! distributions of `rand` may change their output between releases and would move the bytes of every dataset.
use rand::{Rng as _, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A stream of random numbers for one purpose and one item.
#[derive(Debug, Clone)]
pub struct Rng(ChaCha8Rng);

impl Rng {
    /// The stream of `(seed, purpose, index)`. A purpose is a path-like word such as `datagen/blur`: a new purpose never
    /// shifts the draws of another.
    #[must_use]
    pub fn for_item(seed: u64, purpose: &str, index: u64) -> Self {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&seed.to_le_bytes()).update(&index.to_le_bytes()).update(purpose.as_bytes());
        Self(ChaCha8Rng::from_seed(*hasher.finalize().as_bytes()))
    }

    /// 64 uniform bits.
    pub fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// Uniform in [0, 1), 53 bits.
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Uniform in [lo, hi); `lo` where the range is empty.
    pub fn uniform(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * self.unit()
    }

    /// Log-uniform in [lo, hi), both positive: each octave is as likely as the next.
    pub fn log_uniform(&mut self, lo: f64, hi: f64) -> f64 {
        libm::exp(self.uniform(libm::log(lo), libm::log(hi)))
    }

    /// Uniform integer in lo..=hi. Unbiased (rejection on the multiply-shift method).
    ///
    /// # Panics
    /// If `hi < lo`.
    pub fn int(&mut self, lo: i64, hi: i64) -> i64 {
        assert!(lo <= hi, "empty range {lo}..={hi}");
        let span = (hi as i128 - lo as i128 + 1) as u128;
        if span > u64::MAX as u128 {
            return self.bits() as i64;
        }
        let span = span as u64;
        let threshold = span.wrapping_neg() % span;
        loop {
            let product = u128::from(self.bits()) * u128::from(span);
            if product as u64 >= threshold {
                return (lo as i128 + (product >> 64) as i128) as i64;
            }
        }
    }

    /// Uniform index below `n`.
    ///
    /// # Panics
    /// If `n` is 0.
    pub fn index(&mut self, n: usize) -> usize {
        self.int(0, n as i64 - 1) as usize
    }

    /// True with probability `p`.
    pub fn chance(&mut self, p: f64) -> bool {
        self.unit() < p
    }

    /// Normal with mean 0 and deviation 1 (Box-Muller, cosine branch; always two draws).
    pub fn normal(&mut self) -> f64 {
        let radius = libm::sqrt(-2.0 * libm::log(1.0 - self.unit()));
        radius * libm::cos(std::f64::consts::TAU * self.unit())
    }

    /// One of `items`.
    ///
    /// # Panics
    /// If `items` is empty.
    pub fn choose<'a, T>(&mut self, items: &'a [T]) -> &'a T {
        &items[self.index(items.len())]
    }

    /// An index with probability proportional to its weight; weights are not negative and not all zero.
    pub fn weighted(&mut self, weights: &[f64]) -> usize {
        let mut at = self.unit() * weights.iter().sum::<f64>();
        for (i, w) in weights.iter().enumerate() {
            if at < *w {
                return i;
            }
            at -= w;
        }
        weights.iter().rposition(|w| *w > 0.0).unwrap_or(0)
    }

    /// Fisher-Yates, from the last item down.
    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for i in (1..items.len()).rev() {
            items.swap(i, self.index(i + 1));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_draws_are_pinned() {
        let mut rng = Rng::for_item(7, "test", 17);
        let drawn: Vec<i64> = (0..4).map(|_| rng.int(0, 999)).collect();
        let mut again = Rng::for_item(7, "test", 17);
        assert_eq!(drawn, (0..4).map(|_| again.int(0, 999)).collect::<Vec<_>>());
        assert_eq!(drawn, PINNED);
        assert_ne!(Rng::for_item(7, "test", 18).bits(), Rng::for_item(7, "test", 17).bits());
        assert_ne!(Rng::for_item(7, "text", 17).bits(), Rng::for_item(7, "test", 17).bits());
    }
    const PINNED: [i64; 4] = [290, 685, 948, 716];

    #[test]
    fn integers_are_uniform_and_inclusive() {
        let mut rng = Rng::for_item(1, "test/int", 0);
        let mut counts = [0usize; 6];
        for _ in 0..60_000 {
            counts[(rng.int(5, 10) - 5) as usize] += 1;
        }
        assert!(counts.iter().all(|&c| (9_500..10_500).contains(&c)), "{counts:?}");
    }

    #[test]
    fn normals_have_unit_variance() {
        let mut rng = Rng::for_item(1, "test/normal", 0);
        let draws: Vec<f64> = (0..40_000).map(|_| rng.normal()).collect();
        let mean = draws.iter().sum::<f64>() / 40_000.0;
        let var = draws.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 40_000.0;
        assert!(mean.abs() < 0.02 && (var - 1.0).abs() < 0.03, "{mean} {var}");
    }

    #[test]
    fn weights_are_obeyed() {
        let mut rng = Rng::for_item(1, "test/weighted", 0);
        let ones = (0..10_000).filter(|_| rng.weighted(&[3.0, 1.0, 0.0]) == 1).count();
        assert!((2_300..2_700).contains(&ones), "{ones}");
    }
}
