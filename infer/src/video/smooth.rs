//! Poses smoothed over time: each marker followed from frame to frame, each coordinate through a One-Euro filter
//! (Casiez, Roussel and Vogel, "1 Euro filter", CHI 2012): strong smoothing at rest, little delay in motion.
use crate::error::InferError;
use serde::{Deserialize, Serialize};
use tcross_dataset::{Homography, Pose, Quad, geom::quad::angle_deg};

/// How poses of neighbouring frames are smoothed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Whether poses of videos and cameras are smoothed.
    pub on: bool,
    /// Cut-off at rest in hertz: lower is steadier.
    pub cutoff_hz: f64,
    /// Growth of the cut-off with speed, in hertz for each side of the marker a second: higher follows faster.
    pub beta: f64,
    /// A marker that is not seen for this many seconds is forgotten.
    pub hold_secs: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self { on: false, cutoff_hz: 1.5, beta: 6.0, hold_secs: 0.5 }
    }
}

impl Config {
    /// Checks every value.
    ///
    /// # Errors
    /// The first value that is not allowed.
    pub fn validate(&self) -> Result<(), InferError> {
        for (key, value) in [
            ("infer.smoothing.cutoff_hz", self.cutoff_hz),
            ("infer.smoothing.beta", self.beta),
            ("infer.smoothing.hold_secs", self.hold_secs),
        ] {
            if !(value >= 0.0 && value.is_finite()) || (key.ends_with("cutoff_hz") && value == 0.0) {
                return Err(InferError::Value { key, found: value.to_string(), allowed: "a number above 0 (beta and hold_secs: or 0)" });
            }
        }
        Ok(())
    }
}

/// Corners and centre, coordinate by coordinate.
type State = [f64; 10];

/// Cut-off of the speed's own filter, Hz: the paper's choice.
const SPEED_CUTOFF_HZ: f64 = 1.0;

/// Share of a new value at a cut-off frequency and a time since the last.
fn share(cutoff_hz: f64, secs: f64) -> f64 {
    let tau = 1.0 / (std::f64::consts::TAU * cutoff_hz);
    1.0 / (1.0 + tau / secs)
}

/// One followed marker.
#[derive(Debug, Clone)]
struct Track {
    value: State,
    /// Pixels a second.
    speed: State,
    seen_secs: f64,
}

/// All followed markers.
#[derive(Debug, Clone)]
pub struct Smoother {
    config: Config,
    tracks: Vec<Track>,
}

fn state(pose: &Pose) -> State {
    let c = pose.corners.0;
    [c[0][0], c[0][1], c[1][0], c[1][1], c[2][0], c[2][1], c[3][0], c[3][1], pose.center[0], pose.center[1]]
}

fn corners(state: &State) -> Quad {
    Quad(std::array::from_fn(|k| [state[2 * k], state[2 * k + 1]]))
}

impl Smoother {
    /// Follows nothing yet.
    #[must_use]
    pub fn new(config: Config) -> Self {
        Self { config, tracks: Vec::new() }
    }

    /// Smooths the poses of one frame, taken `secs` after the start. A pose continues the track whose corners are nearest, within
    /// half a side; the stated covariance stays that of the frame alone.
    pub fn smooth<'a>(&mut self, secs: f64, poses: impl Iterator<Item = &'a mut Pose>) {
        let hold = self.config.hold_secs;
        self.tracks.retain(|t| secs - t.seen_secs <= hold);
        let mut free: Vec<bool> = vec![true; self.tracks.len()];
        for pose in poses {
            let (now, side) = (state(pose), pose.corners.side_px());
            let far = |t: &Track| (0..10).map(|i| (t.value[i] - now[i]).powi(2)).fold(0.0, f64::max).sqrt();
            let nearest = (0..free.len()).filter(|k| free[*k]).min_by(|a, b| far(&self.tracks[*a]).total_cmp(&far(&self.tracks[*b])));
            let Some(k) = nearest.filter(|k| far(&self.tracks[*k]) < 0.5 * side) else {
                self.tracks.push(Track { value: now, speed: [0.0; 10], seen_secs: secs });
                continue;
            };
            free[k] = false;
            self.tracks[k].follow(&now, secs, side, &self.config);
            apply(&self.tracks[k].value, pose);
        }
    }
}

impl Track {
    fn follow(&mut self, now: &State, secs: f64, side: f64, config: &Config) {
        let passed = (secs - self.seen_secs).max(1e-4);
        let keep = share(SPEED_CUTOFF_HZ, passed);
        for ((speed, now), value) in self.speed.iter_mut().zip(now).zip(&self.value) {
            *speed += keep * ((now - value) / passed - *speed);
        }
        // One cut-off for all: coordinates that lag differently would bend the marker.
        let fastest = (0..5).map(|k| self.speed[2 * k].hypot(self.speed[2 * k + 1])).fold(0.0, f64::max);
        let keep = share(config.cutoff_hz + config.beta * fastest / side.max(1.0), passed);
        for (value, now) in self.value.iter_mut().zip(now) {
            *value += keep * (now - *value);
        }
        self.seen_secs = secs;
    }
}

/// Puts smoothed coordinates into a pose, where they still make one.
fn apply(state: &State, pose: &mut Pose) {
    let quad = corners(state);
    let Some(homography) = Homography::from_unit_square(&quad.0) else { return };
    pose.corners = quad;
    pose.center = [state[8], state[9]];
    pose.homography = homography;
    pose.angle = angle_deg(quad.0[0][0] - pose.center[0], quad.0[0][1] - pose.center[1]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use tcross_dataset::Rng;

    fn pose_at(x: f64, y: f64) -> Pose {
        let quad = Quad([[x, y], [x + 100.0, y], [x + 100.0, y + 100.0], [x, y + 100.0]]);
        Pose {
            center: [x + 50.0, y + 50.0],
            corners: quad,
            angle: 135.0,
            homography: Homography::from_unit_square(&quad.0).unwrap(),
            covariance: [1.0, 0.0, 1.0],
            quality: 1.0,
            rotation: None,
            translation: None,
            reprojection_px: None,
            rival: None,
        }
    }

    fn noisy(rng: &mut Rng, x: f64, y: f64) -> Pose {
        pose_at(x + rng.normal(), y + rng.normal())
    }

    #[test]
    fn rest_is_steady_and_motion_is_followed() {
        let mut smoother = Smoother::new(Config { on: true, ..Config::default() });
        let mut rng = Rng::for_item(1, "test/smooth", 0);
        let mut rest = 0.0f64;
        for frame in 0..120 {
            let mut pose = noisy(&mut rng, 40.0, 60.0);
            smoother.smooth(f64::from(frame) / 30.0, std::iter::once(&mut pose));
            if frame >= 30 {
                rest += (pose.center[0] - 90.0).powi(2) / 90.0;
            }
        }
        assert!(rest.sqrt() < 0.6, "deviation {} of a noise of 1", rest.sqrt());
        // Then it moves by three sides a second.
        let mut lag = 0.0f64;
        for frame in 0..30 {
            let x = 40.0 + 10.0 * f64::from(frame);
            let mut pose = noisy(&mut rng, x, 60.0);
            smoother.smooth(4.0 + f64::from(frame) / 30.0, std::iter::once(&mut pose));
            lag = x + 50.0 - pose.center[0];
        }
        assert!(lag.abs() < 15.0, "{lag} px behind at 300 px a second");
        assert_eq!(smoother.tracks.len(), 1);
    }

    #[test]
    fn markers_are_not_mixed_and_the_lost_are_forgotten() {
        let mut smoother = Smoother::new(Config { on: true, ..Config::default() });
        for frame in 0..5 {
            let (mut a, mut b) = (pose_at(0.0, 0.0), pose_at(300.0, 0.0));
            let order: [&mut Pose; 2] = if frame % 2 == 0 { [&mut a, &mut b] } else { [&mut b, &mut a] };
            smoother.smooth(f64::from(frame) / 30.0, order.into_iter());
            assert!((a.center[0] - 50.0).abs() < 1e-9 && (b.center[0] - 350.0).abs() < 1e-9);
        }
        assert_eq!(smoother.tracks.len(), 2);
        smoother.smooth(9.0, std::iter::empty());
        assert!(smoother.tracks.is_empty());
        // A marker turned by a quarter is another: nothing is averaged over a turn.
        let mut pose = pose_at(0.0, 0.0);
        smoother.smooth(9.0, std::iter::once(&mut pose));
        let mut turned = pose_at(0.0, 0.0);
        turned.corners.0.rotate_left(1);
        smoother.smooth(9.03, std::iter::once(&mut turned));
        assert_eq!(turned.corners.0[0], [100.0, 0.0]);
    }

    #[test]
    fn wrong_values_are_named() {
        assert!(Config::default().validate().is_ok());
        let error = Config { cutoff_hz: 0.0, ..Config::default() }.validate().unwrap_err().to_string();
        assert!(error.starts_with("infer.smoothing.cutoff_hz"), "{error}");
    }
}
