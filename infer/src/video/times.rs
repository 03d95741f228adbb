//! Durations gathered in bounded memory: a histogram of logarithmic bins, fine enough for a median and a high percentile.

/// Bins a factor of ten.
const DECADE: usize = 100;
/// The first bin ends here, ms; the last begins ten million times later.
const LEAST_MS: f64 = 1e-3;
const BINS: usize = 7 * DECADE;

/// Durations of one stage in milliseconds; quantiles are exact to 2.3 %.
#[derive(Debug, Clone)]
pub struct Times {
    counts: Vec<u64>,
    total: u64,
}

impl Default for Times {
    fn default() -> Self {
        Self { counts: vec![0; BINS], total: 0 }
    }
}

impl Times {
    /// Adds one duration.
    pub fn add(&mut self, ms: f64) {
        let bin = (ms.max(LEAST_MS) / LEAST_MS).log10() * DECADE as f64;
        self.counts[(bin as usize).min(BINS - 1)] += 1;
        self.total += 1;
    }

    /// How many.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.total
    }

    /// The duration below which this share of them lies (the middle of its bin); `None` without any.
    #[must_use]
    pub fn quantile(&self, share: f64) -> Option<f64> {
        let rank = ((share * self.total as f64).ceil() as u64).clamp(1, self.total.max(1));
        let mut seen = 0;
        let bin = self.counts.iter().position(|n| {
            seen += n;
            seen >= rank && self.total > 0
        })?;
        Some(LEAST_MS * 10f64.powf((bin as f64 + 0.5) / DECADE as f64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_near_enough() {
        let mut times = Times::default();
        assert_eq!(times.quantile(0.5), None);
        (1..=1000).for_each(|k| times.add(f64::from(k) * 0.05));
        for (share, want) in [(0.5, 25.0), (0.95, 47.5), (0.0, 0.05), (1.0, 50.0)] {
            let got = times.quantile(share).unwrap();
            assert!((got / want - 1.0).abs() < 0.024, "{share}: {got} {want}");
        }
        times.add(f64::MAX);
        times.add(-1.0);
        assert_eq!(times.count(), 1002);
    }
}
