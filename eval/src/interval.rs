//! Uncertainty: Wilson's interval of a rate, percentiles of bootstrap draws.

/// A lower and an upper end, both inside.
pub type Interval = [f64; 2];

/// Two-sided 95 % of the normal distribution.
pub const Z95: f64 = 1.959_963_984_540_054;

/// Wilson's 95 % score interval of `hits` out of `trials`; `None` without a trial.
#[must_use]
pub fn wilson(hits: u64, trials: u64) -> Option<Interval> {
    if trials == 0 {
        return None;
    }
    let (n, p) = (trials as f64, hits as f64 / trials as f64);
    let z2 = Z95 * Z95;
    let center = (p + z2 / (2.0 * n)) / (1.0 + z2 / n);
    let half = Z95 / (1.0 + z2 / n) * (p * (1.0 - p) / n + z2 / (4.0 * n * n)).sqrt();
    // At the ends the formula gives 0 and 1 but for rounding.
    let lo = if hits == 0 { 0.0 } else { (center - half).max(0.0) };
    let hi = if hits == trials { 1.0 } else { (center + half).min(1.0) };
    Some([lo, hi])
}

/// The quantile `q` (0..1) of ascending values, linear between neighbours; `None` without a value.
#[must_use]
pub fn quantile(ascending: &[f64], q: f64) -> Option<f64> {
    let last = ascending.len().checked_sub(1)?;
    let at = q.clamp(0.0, 1.0) * last as f64;
    let (below, part) = (at.floor() as usize, at.fract());
    let above = (below + 1).min(last);
    Some(ascending[below] + (ascending[above] - ascending[below]) * part)
}

/// The middle 95 % of draws; those that are not finite (a rate of nothing) are left out.
#[must_use]
pub fn percentile_interval(draws: impl IntoIterator<Item = f64>) -> Option<Interval> {
    let mut values: Vec<f64> = draws.into_iter().filter(|v| v.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    Some([quantile(&values, 0.025)?, quantile(&values, 0.975)?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn wilson_as_in_the_textbooks() {
        // Newcombe 1998, table I: 81 of 263, 15 of 148, 0 of 20, 1 of 29.
        for (hits, trials, lo, hi) in [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)]
        {
            let [a, b] = wilson(hits, trials).unwrap();
            assert!((a - lo).abs() < 5e-5 && (b - hi).abs() < 5e-5, "{hits}/{trials}: {a} {b}");
        }
        assert_eq!(wilson(0, 0), None);
    }

    proptest! {
        #[test]
        fn wilson_holds_its_rate(trials in 1u64..5000, part in 0.0..=1.0f64) {
            let hits = (trials as f64 * part) as u64;
            let [lo, hi] = wilson(hits, trials).unwrap();
            let p = hits as f64 / trials as f64;
            prop_assert!(0.0 <= lo && lo <= p && p <= hi && hi <= 1.0);
        }
    }

    #[test]
    fn quantiles_are_linear_between_neighbours() {
        assert_eq!(quantile(&[1.0, 2.0, 4.0], 0.75), Some(3.0));
        assert_eq!(quantile(&[5.0], 0.1), Some(5.0));
        assert_eq!(quantile(&[], 0.5), None);
    }
}
