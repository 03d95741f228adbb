//! How far a training has come, and the learning rate there.
use crate::config::{Config, Schedule, ScheduleKind};
use tcross_yolo::NetSize;

/// The length of a training, in the units it was given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Length {
    /// Steps in one pass over the training images; not a whole number.
    pub steps_per_epoch: f64,
    /// Where the last step is known beforehand.
    pub total_steps: Option<u64>,
    /// Where the clock ends the training.
    pub max_seconds: Option<f64>,
    /// Which share of the training sees windows, and what a step on windows costs, by its pixels, beside one on whole images.
    pub(crate) windows: (f64, f64),
}

impl Length {
    /// Of so many equal steps, and of no more than these minutes.
    #[must_use]
    pub fn of_steps(steps_per_epoch: f64, total: u64, max_minutes: Option<f64>) -> Self {
        Self { steps_per_epoch, total_steps: Some(total), max_seconds: max_minutes.map(|m| 60.0 * m), windows: (0.0, 1.0) }
    }

    /// Of a training over `images` images, each an input of this size when it is shown whole.
    #[must_use]
    pub fn new(config: &Config, images: usize, net: NetSize) -> Self {
        let steps_per_epoch = images as f64 / config.batch as f64;
        let by_epochs = config.epochs.map(|epochs| ((epochs * steps_per_epoch).ceil() as u64).max(1));
        let total_steps = [by_epochs, config.steps].into_iter().flatten().min();
        let windows = (config.windows.until, config.windows.side.pow(2) as f64 / (net.width * net.height) as f64);
        Self { steps_per_epoch, total_steps, max_seconds: config.max_minutes.map(|m| m * 60.0), windows }
    }

    /// How much of the training lies before `step` (0-based) when `seconds` have passed: 0..=1. Steps and clock run together, and
    /// the one that is further ahead counts: a training that was planned by the clock comes to its end however fast the machine is.
    #[must_use]
    pub fn fraction(&self, step: u64, seconds: f64) -> f64 {
        let by_steps = self.total_steps.map_or(0.0, |total| step as f64 / total as f64);
        let by_clock = self.max_seconds.map_or(0.0, |limit| seconds / limit);
        by_steps.max(by_clock).clamp(0.0, 1.0)
    }

    /// Seconds still to go, from the pace so far; steps on windows and on whole images count by their pixels.
    #[must_use]
    pub fn seconds_left(&self, step: u64, seconds: f64) -> Option<f64> {
        let (until, cost) = self.windows;
        let work = |fraction: f64| cost * fraction.min(until) + (fraction - until).max(0.0);
        let by_steps = self.total_steps.filter(|_| step > 0).map(|total| {
            let done = work((step as f64 / total as f64).min(1.0));
            seconds * (work(1.0) - done) / done
        });
        let by_clock = self.max_seconds.map(|limit| (limit - seconds).max(0.0));
        [by_steps, by_clock].into_iter().flatten().reduce(f64::min)
    }
}

impl Schedule {
    /// The factor on the highest rate at `step`, of which `fraction` (0..=1) of the training lies before it.
    #[must_use]
    pub fn factor(&self, step: u64, fraction: f64, length: &Length) -> f64 {
        let epoch = step as f64 / length.steps_per_epoch;
        let warmed = match self.warmup_epochs {
            Some(epochs) if epochs > 0.0 => (step as f64 + 1.0) / (epochs * length.steps_per_epoch),
            Some(_) => 1.0,
            None if self.warmup > 0.0 => (fraction + 1e-3) / self.warmup,
            None => 1.0,
        };
        let rise = warmed.min(1.0).powf(self.warmup_power);
        let form = match self.kind {
            ScheduleKind::Constant => 1.0,
            ScheduleKind::Cosine => self.end + (1.0 - self.end) * 0.5 * (1.0 + (std::f64::consts::PI * fraction).cos()),
            ScheduleKind::Steps if self.at_epochs.is_empty() => piece(&self.at, &self.factors, fraction),
            ScheduleKind::Steps => piece(&self.at_epochs, &self.factors, epoch - self.warmup_epochs.unwrap_or(0.0)),
        };
        rise * form
    }
}

/// The factor of the last change that is not after `x`; 1 before the first.
fn piece(at: &[f64], factors: &[f64], x: f64) -> f64 {
    at.iter().zip(factors).take_while(|(at, _)| x >= **at).last().map_or(1.0, |(_, factor)| *factor)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Windows;

    fn length(epochs: Option<f64>, minutes: Option<f64>) -> Length {
        Length::new(&Config { batch: 10, epochs, max_minutes: minutes, ..Config::default() }, 1000, NetSize::square(416))
    }

    #[test]
    fn cosine_with_warm_up() {
        let (schedule, length) = (Schedule::default(), length(Some(10.0), None));
        let at = |step: u64| schedule.factor(step, length.fraction(step, 0.0), &length);
        assert!((at(0) - 0.025).abs() < 1e-12); // (0 + 1e-3) / 0.04
        assert!((at(20) - (0.021 / 0.04) * (0.01 + 0.99 * 0.5 * (1.0 + (std::f64::consts::PI * 0.02).cos()))).abs() < 1e-12);
        assert!((at(500) - (0.01 + 0.99 * 0.5)).abs() < 1e-12);
        assert!((at(1000) - 0.01).abs() < 1e-12);
    }

    #[test]
    fn pieces_by_share_and_by_epoch() {
        let length = length(Some(50.0), None);
        let by_share = Schedule { kind: ScheduleKind::Steps, warmup: 0.0, ..Schedule::default() };
        let at = |step: u64| by_share.factor(step, length.fraction(step, 0.0), &length);
        assert_eq!([at(3999), at(4000), at(4499), at(4500)], [1.0, 0.1, 0.1, 0.01]);
        // The paper: 3 epochs of linear rise, then 1, 0.3 from epoch 30, 0.1 from 50, counted after the rise.
        let paper = Schedule {
            kind: ScheduleKind::Steps,
            warmup_epochs: Some(3.0),
            at_epochs: vec![30.0, 50.0],
            factors: vec![0.3, 0.1],
            ..Schedule::default()
        };
        let at = |step: u64| paper.factor(step, 0.0, &length);
        assert!((at(149) - 0.5).abs() < 1e-12);
        assert_eq!([at(299), at(300), at(3299), at(3300), at(5300)], [1.0, 1.0, 1.0, 0.3, 0.1]);
    }

    #[test]
    fn the_clock_and_the_steps_run_together() {
        let length = length(Some(1.0), Some(1.0));
        assert_eq!(length.total_steps, Some(100));
        assert_eq!((length.fraction(50, 0.0), length.fraction(50, 45.0), length.fraction(90, 70.0)), (0.5, 0.75, 1.0));
        assert_eq!((length.seconds_left(25, 10.0), length.seconds_left(25, 50.0)), (Some(30.0), Some(10.0)));
    }

    /// A window of half the side costs a quarter: after three quarters of the steps, all on windows, 3 of 7 parts of the work are done.
    #[test]
    fn whole_images_are_known_to_take_longer_than_windows() {
        let windows = Windows { until: 0.75, side: 208, ..Windows::default() };
        let length = Length::new(&Config { batch: 10, epochs: Some(1.0), windows, ..Config::default() }, 1000, NetSize::square(416));
        for (step, seconds) in [(25, 1.0), (75, 3.0), (85, 4.6), (100, 7.0)] {
            let left = length.seconds_left(step, seconds).unwrap();
            assert!((left - (7.0 - seconds)).abs() < 1e-9, "after {seconds} s: {left}");
        }
        assert_eq!(length.seconds_left(0, 0.0), None);
    }
}
