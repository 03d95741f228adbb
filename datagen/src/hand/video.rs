//! Short videos of one drawn marker by a hand-held camera: where the camera is at a time, and what its motion does to an image.
//!
//! The camera wanders about the place from which the marker was aimed at, keeps the marker in the frame without ever holding it still, and
//! trembles. The background is a plane through the marker that faces the camera's first place, so that the two stay together.
use super::view::{Camera, Pose, Stance, View, product, to_ray, transposed, turn};
use crate::{canvas::Canvas, config::VideoConfig, effects::Blur};
use tcross_dataset::Rng;

/// Which moment of which sequence an image shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    /// Number of the sequence, from 0.
    pub sequence: u64,
    /// Number of the frame in the camera's count.
    pub frame: u64,
    /// Since the sequence's first frame.
    pub time_s: f64,
}

impl Moment {
    /// The moment of image `index` of `images`; `None` where the config asks for single images.
    #[must_use]
    pub fn of(config: &VideoConfig, images: u64, index: u64) -> Option<Self> {
        let sequences = u128::from(config.sequences);
        if sequences == 0 || images == 0 {
            return None;
        }
        let sequence = (u128::from(index) * sequences / u128::from(images)) as u64;
        let first = (u128::from(sequence) * u128::from(images)).div_ceil(sequences) as u64;
        let frame = (index - first) * config.every;
        Some(Self { sequence, frame, time_s: frame as f64 / config.fps })
    }
}

/// A smooth wander within about -1 and 1: three waves, the slowest the largest.
#[derive(Debug, Clone, Copy)]
struct Wave([(f64, f64, f64); 3]);

impl Wave {
    fn sample(hz: f64, rng: &mut Rng) -> Self {
        let mut part = |k: f64| (0.6 / k, hz * k * rng.uniform(0.7, 1.3), rng.uniform(0.0, std::f64::consts::TAU));
        Self([part(1.0), part(1.9), part(3.7)])
    }

    fn at(&self, t: f64) -> f64 {
        self.0.iter().map(|(size, hz, phase)| size * libm::sin(std::f64::consts::TAU * hz * t + phase)).sum()
    }
}

/// The way of a hand-held camera.
#[derive(Debug, Clone)]
pub struct Path {
    camera: Camera,
    /// The marker from the camera's first place, straight ahead.
    pose: Pose,
    /// How far the camera goes to the side, up and forward, in sides of the marker.
    reach: [f64; 3],
    /// How far the marker wanders from the middle of the frame, in pixels.
    aim: [f64; 2],
    roll: f64,
    tremor: f64,
    wander: [Wave; 6],
    shake: [Wave; 3],
    exposure_s: f64,
    /// What was drawn from the config, by its keys.
    pub drawn: [(&'static str, f64); 4],
}

/// How far beyond the frame the background reaches.
pub const BEYOND: f64 = 1.6;

impl Path {
    /// Draws a way for a marker of this stance. `None` where the marker cannot stand before the camera.
    #[must_use]
    pub fn sample(config: &VideoConfig, stance: &Stance, camera: Camera, size: [f64; 2], rng: &mut Rng) -> Option<Self> {
        let (view, quad) = stance.view(&camera, camera.center)?;
        let depth = view.pose.translation[2];
        let wander = config.wander.sample(rng);
        let far = wander * depth;
        let bounds = quad.bounds();
        let room = |size: f64, marker: f64| (size / 2.0 - 0.7 * marker).max(0.0) * 0.8;
        let pace_hz = config.pace_hz.sample(rng);
        let roll = rng.uniform(5.0, 25.0).to_radians();
        let tremor_deg = config.tremor_deg.sample(rng);
        let waves = std::array::from_fn(|_| Wave::sample(pace_hz, rng));
        let shake = std::array::from_fn(|_| Wave::sample(rng.uniform(3.0, 5.0), rng));
        let exposure_ms = config.exposure_ms.sample(rng);
        Some(Self {
            camera,
            pose: view.pose,
            reach: [far, 0.7 * far, 0.5 * far],
            aim: [room(size[0], bounds.width()), room(size[1], bounds.height())],
            roll,
            tremor: tremor_deg.to_radians(),
            wander: waves,
            shake,
            exposure_s: exposure_ms / 1000.0,
            drawn: [("wander", wander), ("pace_hz", pace_hz), ("tremor_deg", tremor_deg), ("exposure_ms", exposure_ms)],
        })
    }

    /// Where the camera has gone, and how it has turned.
    fn motion(&self, t: f64) -> ([f64; 3], [f64; 9]) {
        let moved: [f64; 3] = std::array::from_fn(|k| self.reach[k] * self.wander[k].at(t));
        let to: [f64; 3] = std::array::from_fn(|k| self.pose.translation[k] - moved[k]);
        let shaken = |k: usize| {
            self.camera.center[k] + self.aim[k] * self.wander[3 + k].at(t) + self.camera.focal * self.tremor * self.shake[k].at(t)
        };
        let [u, v] = self.camera.ray([shaken(0), shaken(1)]);
        let roll = self.roll * self.wander[5].at(t) + self.tremor * self.shake[2].at(t);
        let forward = to[2].max(1e-3);
        let turned = product(&to_ray(u, v), &product(&turn(roll), &transposed(&to_ray(to[0] / forward, to[1] / forward))));
        (moved, turned)
    }

    /// The marker as it is seen at a time.
    #[must_use]
    pub fn view(&self, t: f64) -> View {
        let (moved, turned) = self.motion(t);
        let to: [f64; 3] = std::array::from_fn(|k| self.pose.translation[k] - moved[k]);
        let translation = std::array::from_fn(|k| (0..3).map(|j| turned[k * 3 + j] * to[j]).sum());
        View { camera: self.camera, pose: Pose { rotation: product(&turned, &self.pose.rotation), translation, ..self.pose } }
    }

    /// The blur of the marker's middle while the shutter is open: its length in pixels, its direction in radians, and its bend (sagitta over
    /// length).
    #[must_use]
    pub fn blur(&self, t: f64) -> (f64, f64, f64) {
        let at = |t: f64| self.view(t).image_from_plane([0.0, 0.0]).unwrap_or(self.camera.center);
        let (before, now, after) = (at(t - self.exposure_s / 2.0), at(t), at(t + self.exposure_s / 2.0));
        let d = [after[0] - before[0], after[1] - before[1]];
        let length = (d[0] * d[0] + d[1] * d[1]).sqrt();
        let off = [(before[0] + after[0]) / 2.0 - now[0], (before[1] + after[1]) / 2.0 - now[1]];
        let bend = if length > 1e-6 { (off[1] * d[0] - off[0] * d[1]) / (length * length) } else { 0.0 };
        (length, libm::atan2(d[1], d[0]), bend.clamp(-0.5, 0.5))
    }

    /// The background as it is seen at a time; `source` reaches [`BEYOND`] the frame of the camera's first place.
    #[must_use]
    pub fn warp(&self, source: &Canvas, width: usize, height: usize, t: f64) -> Canvas {
        /// Pixels between places that are computed exactly.
        const STEP: usize = 8;
        let (moved, turned) = self.motion(t);
        let depth = self.pose.translation[2];
        let per_ray = {
            let reach = |k: usize| self.camera.center[k] / self.camera.focal * 2.0 * BEYOND;
            (source.width as f64 / reach(0)).min(source.height as f64 / reach(1))
        };
        let node = |i: usize, j: usize| -> [f32; 2] {
            let [u, v] = self.camera.ray([(i * STEP) as f64, (j * STEP) as f64]);
            let ray: [f64; 3] = std::array::from_fn(|k| turned[k] * u + turned[3 + k] * v + turned[6 + k]);
            let far = (depth - moved[2]) / ray[2].max(0.05);
            let at = |k: usize, size: usize| (size as f64 / 2.0 + (moved[k] + far * ray[k]) / depth * per_ray) as f32;
            [at(0, source.width), at(1, source.height)]
        };
        let mut out = Canvas::filled(width, height, [0.0; 3]);
        let (columns, rows) = (width.div_ceil(STEP), height.div_ceil(STEP));
        let line = |j: usize| (0..=columns).map(|i| node(i, j)).collect::<Vec<_>>();
        let mut upper = line(0);
        for j in 0..rows {
            let lower = line(j + 1);
            for y in j * STEP..((j + 1) * STEP).min(height) {
                let v = ((y - j * STEP) as f32 + 0.5) / STEP as f32;
                for x in 0..width {
                    let (i, u) = (x / STEP, ((x % STEP) as f32 + 0.5) / STEP as f32);
                    let at: [f32; 2] = std::array::from_fn(|k| {
                        let (top, bottom) =
                            (upper[i][k] + (upper[i + 1][k] - upper[i][k]) * u, lower[i][k] + (lower[i + 1][k] - lower[i][k]) * u);
                        top + (bottom - top) * v
                    });
                    out.set(x, y, mirrored(source, at));
                }
            }
            upper = lower;
        }
        out
    }
}

/// The blur of [`Path::blur`]; `None` where it is too short to be seen.
#[must_use]
pub fn shutter((length, angle, bend): (f64, f64, f64)) -> Option<Blur> {
    (length > 0.3).then(|| Blur::motion(length, angle, bend))
}

/// A picture at a continuous place, bilinear; beyond its border it goes on as in a mirror.
fn mirrored(source: &Canvas, [x, y]: [f32; 2]) -> [f32; 3] {
    let fold = |v: f32, size: usize| {
        let limit = (size - 1) as f32;
        let v = (v - 0.5).rem_euclid(2.0 * limit.max(0.5));
        (if v > limit { 2.0 * limit - v } else { v }).clamp(0.0, limit)
    };
    let (x, y) = (fold(x, source.width), fold(y, source.height));
    let (i, j) = ((x as usize).min(source.width.saturating_sub(2)), (y as usize).min(source.height.saturating_sub(2)));
    let (u, v) = (x - i as f32, y - j as f32);
    let (right, below) = (usize::from(source.width > 1), if source.height > 1 { source.width } else { 0 });
    let k = j * source.width + i;
    std::array::from_fn(|c| {
        let plane = &source.planes[c];
        let (a, b, d, e) = (plane[k], plane[k + right], plane[k + below], plane[k + below + right]);
        let (top, bottom) = (a + (b - a) * u, d + (e - d) * u);
        top + (bottom - top) * v
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dist::Dist;

    fn path(seed: u64) -> Path {
        let stance = Stance { side_px: 160.0, tilt: 0.5, azimuth: 1.0, roll: 2.0, half: [0.5, 0.5], bend: (0.0, 0.0), may_be_cut: false };
        let camera = Camera { focal: 1000.0, center: [640.0, 360.0], k1: -0.02 };
        Path::sample(&VideoConfig::default(), &stance, camera, [1280.0, 720.0], &mut Rng::for_item(seed, "test/video", 0)).unwrap()
    }

    #[test]
    fn images_are_dealt_to_sequences_in_order() {
        let config = VideoConfig { sequences: 18, ..Default::default() };
        let moments: Vec<Moment> = (0..550).map(|k| Moment::of(&config, 550, k).unwrap()).collect();
        assert!(moments.windows(2).all(|m| {
            let same = m[0].sequence == m[1].sequence;
            if same { m[1].frame == m[0].frame + 10 } else { m[1].sequence == m[0].sequence + 1 && m[1].frame == 0 }
        }));
        assert_eq!((moments[0].frame, moments[549].sequence), (0, 17));
        assert!(Moment::of(&VideoConfig { sequences: 0, ..config }, 550, 3).is_none());
    }

    #[test]
    fn the_marker_stays_in_the_frame_and_moves() {
        for seed in 0..30 {
            let path = path(seed);
            let at: Vec<[f64; 2]> = (0..100).map(|k| path.view(f64::from(k) / 10.0).image_from_plane([0.0, 0.0]).unwrap()).collect();
            assert!(at.iter().all(|p| (0.0..1280.0).contains(&p[0]) && (0.0..720.0).contains(&p[1])), "{seed}: {at:?}");
            assert!(at.windows(2).any(|w| (w[0][0] - w[1][0]).hypot(w[0][1] - w[1][1]) > 5.0));
        }
    }

    #[test]
    fn the_blur_is_the_way_of_the_marker_while_the_shutter_is_open() {
        let mut path = path(3);
        path.exposure_s = 0.02;
        let at = |t: f64| path.view(t).image_from_plane([0.0, 0.0]).unwrap();
        let (length, angle, _) = path.blur(1.0);
        let (a, b) = (at(0.99), at(1.01));
        assert!((length - (b[0] - a[0]).hypot(b[1] - a[1])).abs() < 1e-9);
        assert!((angle.cos() * length - (b[0] - a[0])).abs() < 1e-9);
    }

    #[test]
    fn the_background_stays_with_the_marker() {
        // A dot on the background where the marker's middle is at first is where its middle is at any time.
        let path = path(5);
        let mut source = Canvas::filled(2048, 1152, [0.0; 3]);
        for y in 1152 / 2 - 3..1152 / 2 + 3 {
            for x in 1021..1027 {
                source.set(x, y, [1.0; 3]);
            }
        }
        for t in [0.0, 1.3, 4.2] {
            let seen = path.warp(&source, 1280, 720, t);
            let (mut sum, mut mean) = (0.0, [0.0; 2]);
            for (k, v) in seen.planes[0].iter().enumerate() {
                sum += f64::from(*v);
                mean[0] += f64::from(*v) * ((k % 1280) as f64 + 0.5);
                mean[1] += f64::from(*v) * ((k / 1280) as f64 + 0.5);
            }
            let want = path.view(t).image_from_plane([0.0, 0.0]).unwrap();
            assert!(sum > 5.0 && (mean[0] / sum - want[0]).hypot(mean[1] / sum - want[1]) < 0.3, "{t}: {mean:?}/{sum} {want:?}");
        }
    }

    #[test]
    fn what_the_config_says_is_drawn() {
        let still = VideoConfig { wander: Dist::constant(0.0), tremor_deg: Dist::constant(0.0), ..Default::default() };
        let stance = Stance { side_px: 100.0, tilt: 0.3, azimuth: 0.0, roll: 0.0, half: [0.5; 2], bend: (0.0, 0.0), may_be_cut: false };
        let camera = Camera { focal: 1000.0, center: [640.0, 360.0], k1: 0.0 };
        let path = Path::sample(&still, &stance, camera, [1280.0, 720.0], &mut Rng::for_item(0, "test/video", 1)).unwrap();
        let depth = |t: f64| path.view(t).pose.translation.iter().map(|v| v * v).sum::<f64>().sqrt();
        assert!((depth(0.0) - depth(3.0)).abs() < 1e-9);
        assert!((path.view(2.0).tilt() - 0.3).abs() < 1e-9);
    }
}
