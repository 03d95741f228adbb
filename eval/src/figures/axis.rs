//! Axes: which values they span, where their ticks stand, and what the ticks say.

/// How values are laid along an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// Equal steps for equal differences.
    Linear,
    /// Equal steps for equal ratios; values that are not positive are left out.
    Log,
}

/// An axis of a plot.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// What it measures, with its unit.
    pub label: String,
    /// How values are laid along it.
    pub scale: Scale,
    /// The values it spans; without, those of the data.
    pub range: Option<(f64, f64)>,
}

impl Axis {
    /// A linear axis that spans its data.
    #[must_use]
    pub fn linear(label: impl Into<String>) -> Self {
        Self { label: label.into(), scale: Scale::Linear, range: None }
    }

    /// A logarithmic axis that spans its data.
    #[must_use]
    pub fn log(label: impl Into<String>) -> Self {
        Self { label: label.into(), scale: Scale::Log, range: None }
    }

    /// The same axis from `lo` to `hi`.
    #[must_use]
    pub fn from_to(mut self, lo: f64, hi: f64) -> Self {
        self.range = Some((lo, hi));
        self
    }

    /// True for a value that has a place on the axis.
    #[must_use]
    pub fn shows(&self, v: f64) -> bool {
        v.is_finite() && (self.scale == Scale::Linear || v > 0.0)
    }

    /// The axis made definite for these values.
    pub(super) fn fit(&self, values: impl Iterator<Item = f64>) -> Fitted {
        let (lo, hi) = self.range.unwrap_or_else(|| {
            values.filter(|v| self.shows(*v)).fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(v), hi.max(v)))
        });
        match self.scale {
            Scale::Linear => fit_linear(lo, hi, self.range.is_some()),
            Scale::Log => fit_log(lo, hi, self.range.is_some()),
        }
    }
}

/// An axis with its final span and ticks.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Fitted {
    scale: Scale,
    lo: f64,
    hi: f64,
    /// Value and text of each labelled tick.
    pub ticks: Vec<(f64, String)>,
}

impl Fitted {
    /// Where a value lies: 0 at the low end, 1 at the high end; values beyond are held at the ends.
    pub fn place(&self, v: f64) -> f64 {
        let t = match self.scale {
            Scale::Linear => (v - self.lo) / (self.hi - self.lo),
            Scale::Log => (v / self.lo).ln() / (self.hi / self.lo).ln(),
        };
        t.clamp(0.0, 1.0)
    }
}

fn fit_linear(mut lo: f64, mut hi: f64, exact: bool) -> Fitted {
    if !lo.is_finite() || !hi.is_finite() {
        (lo, hi) = (0.0, 1.0);
    }
    if hi - lo <= lo.abs().max(hi.abs()) * 1e-9 {
        (lo, hi) = if lo == 0.0 { (0.0, 1.0) } else { (lo - lo.abs() * 0.1, hi + hi.abs() * 0.1) };
    }
    let step = nice_step((hi - lo) / 4.0);
    if !exact {
        (lo, hi) = ((lo / step + 1e-9).floor() * step, (hi / step - 1e-9).ceil() * step);
    }
    let digits = (-step.log10().floor()).max(0.0) as usize;
    let digits = digits + usize::from(((step * 10f64.powi(digits as i32)).round() - step * 10f64.powi(digits as i32)).abs() > 1e-6);
    let (first, last) = ((lo / step - 1e-9).ceil() as i64, (hi / step + 1e-9).floor() as i64);
    let ticks = (first..=last).map(|k| (k as f64 * step, plain(k as f64 * step, digits))).collect();
    Fitted { scale: Scale::Linear, lo, hi, ticks }
}

fn fit_log(mut lo: f64, mut hi: f64, exact: bool) -> Fitted {
    if !(lo.is_finite() && hi.is_finite() && lo > 0.0) {
        (lo, hi) = (0.1, 1.0);
    }
    if !exact {
        // Whole decades where there are several, else the nearest 1, 2 or 5.
        let whole = |v: f64, up: bool| {
            let decade = 10f64.powf((v.log10() + if up { -1e-9 } else { 1e-9 }).floor());
            let steps = [1.0, 2.0, 5.0, 10.0].map(|m| m * decade);
            let found =
                if up { steps.into_iter().find(|s| *s >= v * (1.0 - 1e-9)) } else { steps.into_iter().rfind(|s| *s <= v * (1.0 + 1e-9)) };
            found.unwrap_or(v)
        };
        (lo, hi) = (whole(lo, false), whole(hi, true));
        if hi <= lo {
            hi = lo * 10.0;
        }
    }
    let (first, last) = ((lo.log10() - 1e-9).ceil() as i32, (hi.log10() + 1e-9).floor() as i32);
    let every = ((last - first) / 5).max(1);
    let mut values: Vec<f64> = (first..=last).filter(|k| (k - first) % every == 0).map(|k| 10f64.powi(k)).collect();
    if last - first < 2 {
        let inner = (first - 1..=last).flat_map(|k| [1.0, 2.0, 5.0].map(|m| m * 10f64.powi(k)));
        values = inner.filter(|v| *v >= lo * (1.0 - 1e-9) && *v <= hi * (1.0 + 1e-9)).collect();
    }
    let ticks = values.into_iter().map(|v| (v, plain(v, (-v.log10().floor()).max(0.0) as usize))).collect();
    Fitted { scale: Scale::Log, lo, hi, ticks }
}

/// 1, 2, 2.5 or 5 times a power of ten, at least `v`.
fn nice_step(v: f64) -> f64 {
    let decade = 10f64.powf(v.log10().floor());
    [1.0, 2.0, 2.5, 5.0, 10.0].into_iter().map(|m| m * decade).find(|s| *s >= v * (1.0 - 1e-9)).unwrap_or(10.0 * decade)
}

fn plain(v: f64, digits: usize) -> String {
    if v != 0.0 && !(1e-4..1e6).contains(&v.abs()) {
        return format!("{v:e}");
    }
    let text = format!("{v:.digits$}");
    if text.trim_start_matches('-').chars().all(|c| c == '0' || c == '.') { "0".into() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(axis: &Axis, values: &[f64]) -> Vec<String> {
        axis.fit(values.iter().copied()).ticks.into_iter().map(|t| t.1).collect()
    }

    #[test]
    fn ticks_are_round_and_cover_the_data() {
        assert_eq!(labels(&Axis::linear("x"), &[0.03, 0.94]), ["0", "0.25", "0.50", "0.75", "1.00"]);
        assert_eq!(labels(&Axis::linear("x"), &[0.0, 130.0]), ["0", "50", "100", "150"]);
        assert_eq!(labels(&Axis::log("x"), &[0.002, 30.0]), ["0.01", "0.1", "1", "10"]);
        assert_eq!(labels(&Axis::log("x"), &[3.0, 30.0]), ["2", "5", "10", "20", "50"]);
    }

    #[test]
    fn nothing_to_show_is_no_panic() {
        for axis in [Axis::linear("x"), Axis::log("x")] {
            assert!(!labels(&axis, &[]).is_empty());
            assert!(axis.fit([f64::NAN, -1.0].into_iter()).place(0.5).is_finite());
            assert!(axis.fit([3.0, 3.0].into_iter()).place(3.0).is_finite());
        }
    }
}
