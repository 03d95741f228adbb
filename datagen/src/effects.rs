//! What happens to light between the scene and the file: motion, defocus, shadows, exposure, noise.
use crate::{canvas::Canvas, color::Linear, noise};
use tcross_dataset::Rng;
use tcross_kernels::simd::{Portable, widest};

/// A blur as a list of shifts in whole pixels, each with its weight; the weights add up to one.
#[derive(Debug, Clone, PartialEq)]
pub struct Blur {
    taps: Vec<(i32, i32, f32)>,
    /// The farthest shift in pixels.
    pub reach: usize,
}

impl Blur {
    /// The path of a motion: `length` pixels along `angle`, bent so that its middle stands `curve` lengths off its ends' chord. The
    /// picture's truth is at mid-exposure, the middle of the path.
    #[must_use]
    pub fn motion(length: f64, angle: f64, curve: f64) -> Self {
        let steps = (length * 2.0).ceil().max(2.0) as usize;
        let (c, s) = (libm::cos(angle), libm::sin(angle));
        let mut taps: std::collections::BTreeMap<(i32, i32), f64> = std::collections::BTreeMap::new();
        for k in 0..steps {
            let t = (k as f64 + 0.5) / steps as f64 - 0.5;
            let (along, across) = (t * length, 4.0 * curve * length * t * t);
            let (x, y) = (along * c - across * s, along * s + across * c);
            // Each moment is shared between the four nearest pixels, so that the path's centre stays exact.
            let (i, j) = (x.floor(), y.floor());
            let (u, v) = (x - i, y - j);
            for (dx, dy, w) in [(0, 0, (1.0 - u) * (1.0 - v)), (1, 0, u * (1.0 - v)), (0, 1, (1.0 - u) * v), (1, 1, u * v)] {
                *taps.entry((j as i32 + dy, i as i32 + dx)).or_default() += w / steps as f64;
            }
        }
        let taps: Vec<(i32, i32, f32)> = taps.into_iter().filter(|(_, w)| *w > 1e-6).map(|((y, x), w)| (x, y, w as f32)).collect();
        let reach = taps.iter().map(|t| t.0.unsigned_abs().max(t.1.unsigned_abs()) as usize).max().unwrap_or(0);
        Self { taps, reach }
    }

    /// Blurs a plane of `width` by `height`; beyond its border the nearest pixel goes on.
    pub fn apply(&self, plane: &mut Vec<f32>, width: usize, height: usize) {
        *plane = widest(Move { taps: &self.taps, plane, width, height });
    }
}

/// What [`Blur::apply`] does.
struct Move<'a> {
    taps: &'a [(i32, i32, f32)],
    plane: &'a [f32],
    width: usize,
    height: usize,
}

impl Portable for Move<'_> {
    type Output = Vec<f32>;

    #[inline(always)]
    fn run(self) -> Vec<f32> {
        let Self { taps, plane, width, height } = self;
        let mut out = vec![0f32; plane.len()];
        for y in 0..height {
            let row = &mut out[y * width..][..width];
            for &(dx, dy, weight) in taps {
                let from = (y as i32 - dy).clamp(0, height as i32 - 1) as usize;
                let source = &plane[from * width..][..width];
                let dx = dx.clamp(-(width as i32), width as i32);
                let (lo, hi) = (dx.max(0) as usize, (width as i32 + dx.min(0)) as usize);
                for (o, s) in row[lo..hi].iter_mut().zip(&source[(lo as i32 - dx) as usize..]) {
                    *o += weight * s;
                }
                row[..lo].iter_mut().for_each(|o| *o += weight * source[0]);
                row[hi..].iter_mut().for_each(|o| *o += weight * source[width - 1]);
            }
        }
        out
    }
}

/// A Gaussian blur of deviation `sigma` pixels; beyond the border the nearest pixel goes on.
pub fn soften(plane: &mut [f32], width: usize, height: usize, sigma: f32) {
    if sigma < 0.05 || width == 0 {
        return;
    }
    let radius = (sigma * 3.0).ceil() as usize;
    let raw: Vec<f32> = (0..=radius).map(|k| libm::expf(-((k * k) as f32) / (2.0 * sigma * sigma))).collect();
    let sum = raw[0] + 2.0 * raw[1..].iter().sum::<f32>();
    let weights: Vec<f32> = raw.iter().map(|w| w / sum).collect();
    widest(Soften { plane, width, height, weights: &weights });
}

/// What [`soften`] does: `weights` are those of the middle and of one side.
struct Soften<'a> {
    plane: &'a mut [f32],
    width: usize,
    height: usize,
    weights: &'a [f32],
}

impl Portable for Soften<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { plane, width, height, weights } = self;
        let radius = weights.len() - 1;
        let mut padded = vec![0f32; width + 2 * radius];
        for row in plane.chunks_exact_mut(width) {
            padded[..radius].fill(row[0]);
            padded[radius..radius + width].copy_from_slice(row);
            padded[radius + width..].fill(row[width - 1]);
            for (o, s) in row.iter_mut().zip(&padded[radius..]) {
                *o = weights[0] * s;
            }
            for (k, w) in weights.iter().enumerate().skip(1) {
                for ((o, a), b) in row.iter_mut().zip(&padded[radius - k..]).zip(&padded[radius + k..]) {
                    *o += w * (a + b);
                }
            }
        }
        // Down the columns: a ring of the rows that are still needed, because rows are overwritten from the top.
        let mut above: std::collections::VecDeque<Vec<f32>> = (0..=radius).map(|_| plane[..width].to_vec()).collect();
        for y in 0..height {
            let mut out = vec![0f32; width];
            let current = plane[y * width..][..width].to_vec();
            out.iter_mut().zip(&current).for_each(|(o, s)| *o = weights[0] * s);
            above.push_back(current);
            above.pop_front();
            for (k, w) in weights.iter().enumerate().skip(1) {
                let up = &above[radius - k];
                let down = &plane[(y + k).min(height - 1) * width..][..width];
                for ((o, a), b) in out.iter_mut().zip(up).zip(down) {
                    *o += w * (a + b);
                }
            }
            plane[y * width..][..width].copy_from_slice(&out);
        }
    }
}

/// A shadow with a soft straight edge over a part of the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shadow {
    /// Direction into the shadow, in radians.
    pub angle: f64,
    /// Distance of its edge from the picture's first corner along that direction, in pixels.
    pub at: f32,
    /// Width of the half shadow in pixels.
    pub soft: f32,
    /// What part of the light it takes, 0..1.
    pub depth: f32,
    /// Its width in pixels; shadows of a hand or a pole have two edges, infinity where there is one.
    pub band: f32,
}

impl Shadow {
    /// Any shadow over a picture of this size.
    pub fn sample(width: usize, height: usize, rng: &mut Rng) -> Self {
        let (w, h) = (width as f64, height as f64);
        let angle = rng.uniform(0.0, std::f64::consts::TAU);
        let (nx, ny) = (libm::cos(angle) as f32, libm::sin(angle) as f32);
        let at = (rng.uniform(0.1, 0.9) * w) as f32 * nx + (rng.uniform(0.1, 0.9) * h) as f32 * ny;
        let soft = rng.log_uniform(1.0, 60.0) as f32;
        let depth = rng.uniform(0.25, 0.75) as f32;
        let band = if rng.chance(0.5) { rng.uniform(20.0, w * 0.5) as f32 } else { f32::INFINITY };
        Self { angle, at, soft, depth, band }
    }

    /// Darkens the picture.
    pub fn cast(&self, canvas: &mut Canvas) {
        let (nx, ny) = (libm::cos(self.angle) as f32, libm::sin(self.angle) as f32);
        let mut light = vec![1f32; canvas.width];
        for y in 0..canvas.height {
            let first = y as f32 * ny - self.at;
            for (x, light) in light.iter_mut().enumerate() {
                let into = x as f32 * nx + first;
                let covered = (into / self.soft + 0.5).min((self.band - into) / self.soft + 0.5).clamp(0.0, 1.0);
                *light = 1.0 - self.depth * covered;
            }
            for plane in &mut canvas.planes {
                plane[y * canvas.width..][..canvas.width].iter_mut().zip(&light).for_each(|(v, l)| *v *= l);
            }
        }
    }

    /// For the record: `angle_deg`, `at_px`, `soft_px`, `depth`, and `band_px` where it has two edges.
    #[must_use]
    pub fn parameters(&self) -> serde_json::Value {
        let short = |v: f32| (f64::from(v) * 1e3).round() / 1e3;
        let mut out = serde_json::json!({
            "angle_deg": (self.angle.to_degrees() * 1e3).round() / 1e3,
            "at_px": short(self.at),
            "soft_px": short(self.soft),
            "depth": short(self.depth),
        });
        if self.band.is_finite() {
            out["band_px"] = short(self.band).into();
        }
        out
    }
}

/// The noise of a sensor: `percent` hundredths at full light, falling with the root of the light, a tenth of it in the dark. A part of it is
/// common to the three channels, as after demosaicing.
pub fn sensor_noise(canvas: &mut Canvas, percent: f64, rng: &mut Rng) {
    let shot = (percent / 100.0) as f32;
    let (shot2, dark2) = (shot * shot, shot * shot * 0.01);
    let normals = noise::normals();
    let width = canvas.width;
    for y in 0..canvas.height {
        let bits = rng.bits();
        let start = |k: u32| (bits >> (16 * k)) as usize & 0x7fff;
        let common = &normals[start(3)..][..width.min(1 << 15)];
        for (channel, plane) in canvas.planes.iter_mut().enumerate() {
            let own = &normals[start(channel as u32)..][..width.min(1 << 15)];
            for ((v, a), b) in plane[y * width..][..width].iter_mut().zip(common).zip(own) {
                *v += (shot2 * v.max(0.0) + dark2).sqrt() * (0.7 * a + 0.7 * b);
            }
        }
    }
}

/// The gains of an exposure and a white balance, in stops.
#[must_use]
pub fn gains(exposure: f64, balance: f64) -> Linear {
    [exposure + balance, exposure, exposure - balance].map(|stops| libm::exp2(stops) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn centroid(plane: &[f32], width: usize) -> (f32, [f32; 2]) {
        let sum: f32 = plane.iter().sum();
        let mean = |f: fn(usize, usize) -> usize| plane.iter().enumerate().map(|(k, v)| v * (f(k, width) as f32 + 0.5)).sum::<f32>() / sum;
        (sum, [mean(|k, w| k % w), mean(|k, w| k / w)])
    }

    #[test]
    fn straight_motion_keeps_the_light_and_its_centre() {
        let mut plane = vec![0f32; 81 * 61];
        plane[30 * 81 + 40] = 1.0;
        for (length, angle) in [(1.0, 0.3), (7.3, 1.0), (22.0, 2.2)] {
            let mut blurred = plane.clone();
            Blur::motion(length, angle, 0.0).apply(&mut blurred, 81, 61);
            let (sum, center) = centroid(&blurred, 81);
            assert!((sum - 1.0).abs() < 1e-4, "{sum}");
            assert!((center[0] - 40.5).abs() < 1e-3 && (center[1] - 30.5).abs() < 1e-3, "{center:?}");
        }
    }

    #[test]
    fn softening_equals_its_naive_twin() {
        let (w, h, sigma) = (23, 17, 1.3f32);
        let mut rng = Rng::for_item(0, "test/soften", 0);
        let plane: Vec<f32> = (0..w * h).map(|_| rng.unit() as f32).collect();
        let mut fast = plane.clone();
        soften(&mut fast, w, h, sigma);
        let radius = (sigma * 3.0).ceil() as i32;
        for y in 0..h {
            for x in 0..w {
                let (mut sum, mut total) = (0f64, 0f64);
                for dy in -radius..=radius {
                    for dx in -radius..=radius {
                        let weight = (-f64::from(dx * dx + dy * dy) / (2.0 * f64::from(sigma * sigma))).exp();
                        let (sx, sy) = ((x as i32 + dx).clamp(0, w as i32 - 1), (y as i32 + dy).clamp(0, h as i32 - 1));
                        sum += weight * f64::from(plane[sy as usize * w + sx as usize]);
                        total += weight;
                    }
                }
                assert!((f64::from(fast[y * w + x]) - sum / total).abs() < 1e-5);
            }
        }
    }
}
