//! What the photo tells of its own making, so that a marker can be put into it: the light that falls on a sheet, the noise, the sharpness.
use super::film::Light;
use crate::{canvas::Canvas, color};
use tcross_dataset::Rng;

/// The light that falls on a sheet, taken from the photo: its level, its colour, its slopes.
pub(super) struct PhotoLight {
    columns: usize,
    levels: Vec<f32>,
    tone: color::Linear,
    /// Deviation of the photo's noise in linear light.
    pub(super) grain: f32,
    /// Deviation of the blur of the photo's sharpest edges, in pixels.
    pub(super) sharpness_px: f32,
    pub(super) seed: u64,
    strength: f64,
    follow: f64,
    tint: f64,
}

/// Pixels a cell of the light.
const LIGHT_CELL: usize = 32;

impl PhotoLight {
    pub(super) fn of(canvas: &Canvas, rng: &mut Rng, seed: u64) -> Self {
        // Every fourth pixel of every fourth row tells enough of the light: sums over cells.
        let (columns, rows) = (canvas.width.div_ceil(LIGHT_CELL) + 1, canvas.height.div_ceil(LIGHT_CELL) + 1);
        let mut sums = vec![([0f32; 3], 0f32); columns * rows];
        for y in (0..canvas.height).step_by(4) {
            for x in (0..canvas.width).step_by(4) {
                let (sum, count) = &mut sums[y / LIGHT_CELL * columns + x / LIGHT_CELL];
                let pixel = canvas.at(x, y);
                (0..3).for_each(|c| sum[c] += pixel[c]);
                *count += 1.0;
            }
        }
        // Light is smoother than what it falls on: a dark thing beside a sheet is no shadow on it. Two box means, two cells to each side.
        let around = |k: usize, n: usize| k.saturating_sub(2)..(k + 3).min(n);
        let mut near = sums.clone();
        for _ in 0..2 {
            let add = |a: ([f32; 3], f32), b: &([f32; 3], f32)| (std::array::from_fn(|c| a.0[c] + b.0[c]), a.1 + b.1);
            let of = |k: usize| {
                let cells = around(k / columns, rows).flat_map(|j| around(k % columns, columns).map(move |i| j * columns + i));
                cells.fold(([0f32; 3], 0f32), |sum, k| add(sum, &near[k]))
            };
            near = (0..near.len()).map(of).collect();
        }
        let mean_of = |(sum, count): ([f32; 3], f32)| (count > 0.0).then(|| color::scaled(sum, 1.0 / count));
        let all = sums.iter().fold(([0f32; 3], 0f32), |(sum, n), s| (std::array::from_fn(|c| sum[c] + s.0[c]), n + s.1));
        let mean = mean_of(all).unwrap_or([0.2; 3]);
        let level = color::luminance(mean).max(0.01);
        let follow = rng.uniform(0.1, 0.6);
        let strength = ((f64::from(level) * 1.7 + 0.12) * rng.uniform(0.75, 1.25)).clamp(0.08, 1.05);
        let at = |cell: &([f32; 3], f32)| {
            let local = mean_of(*cell).map_or(level, color::luminance).max(0.005);
            (strength * libm::pow(f64::from(local / level), follow).clamp(0.35, 1.6)) as f32
        };
        let levels = near.iter().map(at).collect();
        let tint = rng.uniform(0.0, 0.5);
        let tone = mean.map(|v| libm::pow(f64::from(v / level).clamp(0.5, 1.6), tint) as f32);
        Self { columns, levels, tone, grain: grain_of(canvas), sharpness_px: sharpness_of(canvas), seed, strength, follow, tint }
    }
}

impl PhotoLight {
    /// For the record: `strength` (1 is a sheet in full light), `follow` (how much of the photo's light and dark falls on it), `tint` (how
    /// much of its colour), `grain` (deviation of its noise in linear light).
    pub(super) fn parameters(&self) -> serde_json::Value {
        let short = |v: f64| (v * 1e4).round() / 1e4;
        serde_json::json!({
            "strength": short(self.strength),
            "follow": short(self.follow),
            "tint": short(self.tint),
            "grain": short(f64::from(self.grain)),
        })
    }
}

impl Light for PhotoLight {
    fn level(&self, x: f32, y: f32) -> f32 {
        let (x, y) = (x / LIGHT_CELL as f32, y / LIGHT_CELL as f32);
        let (i, j) = (x as usize, y as usize);
        let (u, v) = (x - i as f32, y - j as f32);
        let last = self.levels.len() - 1;
        let at = |i: usize, j: usize| self.levels[(j * self.columns + i).min(last)];
        let top = at(i, j) + (at(i + 1, j) - at(i, j)) * u;
        let bottom = at(i, j + 1) + (at(i + 1, j + 1) - at(i, j + 1)) * u;
        top + (bottom - top) * v
    }

    fn tone(&self) -> color::Linear {
        self.tone
    }
}

/// The photo's own noise: the median difference between neighbours, as a deviation in linear light; fine texture counts too, so it is
/// kept small.
fn grain_of(canvas: &Canvas) -> f32 {
    let plane = &canvas.planes[1];
    let mut steps: Vec<f32> =
        plane.chunks_exact(canvas.width).step_by(7).flat_map(|row| row.windows(2).step_by(5).map(|w| (w[1] - w[0]).abs())).collect();
    if steps.is_empty() {
        return 0.0;
    }
    let middle = steps.len() / 2;
    (*steps.select_nth_unstable_by(middle, f32::total_cmp).1 * 0.75).min(0.015)
}

/// How sharp the photo's edges are: an edge of light blurred by a Gaussian of deviation s rises by erf(1/(2s√2)) over one pixel for
/// erf(3/(2s√2)) over the three around it. The median over the strongest in forty of the edges; 0.5 where there are too few.
fn sharpness_of(canvas: &Canvas) -> f32 {
    let plane = &canvas.planes[1];
    let mut rises: Vec<(f32, f32)> = plane
        .chunks_exact(canvas.width)
        .step_by(5)
        .flat_map(|row| row.windows(4))
        .map(|w| ((w[3] - w[0]).abs(), (w[2] - w[1]).abs(), (w[1] - w[0]).abs().max((w[3] - w[2]).abs())))
        .filter(|(rise, middle, beside)| *rise > 0.05 && middle >= beside)
        .map(|(rise, middle, _)| (rise, middle))
        .collect();
    let strongest = rises.len() / 40;
    if strongest < 8 {
        return 0.5;
    }
    rises.select_nth_unstable_by(strongest, |a, b| b.0.total_cmp(&a.0));
    let mut shares: Vec<f32> = rises[..strongest].iter().map(|r| r.1 / r.0).collect();
    let middle = strongest / 2;
    let share = *shares.select_nth_unstable_by(middle, f32::total_cmp).1;
    let of = |sigma: f32| libm::erff(0.353_55 / sigma) / libm::erff(1.060_66 / sigma);
    // The share falls as the blur grows, from 1 towards a third.
    let (mut lo, mut hi) = (0.2f32, 3.0f32);
    for _ in 0..12 {
        let middle = (lo + hi) / 2.0;
        if of(middle) > share { lo = middle } else { hi = middle }
    }
    lo
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects;

    #[test]
    fn the_blur_of_edges_is_measured() {
        for sigma in [0.5f32, 1.0, 1.8] {
            let mut canvas = Canvas::filled(200, 200, [0.1; 3]);
            // Tiles whose edges fall anywhere between pixels.
            for y in 0..200 {
                for x in 0..200 {
                    let level = if (x as f32 / 23.7).fract() < 0.5 { 0.2 } else { 0.8 };
                    canvas.set(x, y, [level; 3]);
                }
            }
            for plane in &mut canvas.planes {
                effects::soften(plane, 200, 200, sigma);
            }
            let found = sharpness_of(&canvas);
            assert!((found / sigma - 1.0).abs() < 0.25, "{found} for {sigma}");
        }
    }
}
