//! Scenes that need no file: rooms, landscapes, desks and patches with the spectra, lights and colours of photographs, and with much
//! saturated clutter, because that is what a marker must not be taken for.
use crate::{
    canvas::Canvas,
    color,
    config::{self, Config, SceneKind},
    noise::{Spectrum, Tile},
    stickers,
};
use tcross_dataset::Rng;
use tcross_kernels::simd::{Portable, widest};

mod desk;
mod leaves;
mod material;
mod outdoors;
mod painter;
mod room;

pub(crate) use material::Material;
use painter::Scene;
pub(crate) use painter::{fill, polygon, scan};

/// Moves with every change of the scenes' pixels.
pub const VERSION: u32 = 2;

/// Paints a scene of the configured size; returns its name and its light.
pub fn paint(config: &Config, rng: &mut Rng) -> (String, Canvas) {
    let kind = config::choose(&config.background.scenes, rng).unwrap_or(SceneKind::Leaves);
    let (width, height) = (config.width as usize, config.height as usize);
    let behind = color::muted(rng);
    let mut scene = Scene::new(width, height);
    match kind {
        SceneKind::Room => room::paint(&mut scene, rng),
        SceneKind::Outdoors => outdoors::paint(&mut scene, rng),
        SceneKind::Desk => desk::paint(&mut scene, rng),
        SceneKind::Leaves => leaves::paint(&mut scene, rng),
    }
    let mut canvas = scene.paint(behind);
    if rng.chance(0.6) {
        for _ in 0..rng.int(1, 6) {
            stickers::paint(&mut canvas, rng);
        }
    }
    light(&mut canvas, rng);
    (format!("embedded/{}", kind.name()), canvas)
}

/// Uneven light over the whole picture: a slope, slow clouds, a vignette; then contrast and a cast.
fn light(canvas: &mut Canvas, rng: &mut Rng) {
    let (width, height) = (canvas.width, canvas.height);
    let tile = Tile::of(Spectrum::Soft);
    let (angle, slope) = (rng.uniform(0.0, std::f64::consts::TAU), rng.uniform(0.0, 0.8));
    let (sx, sy) = ((libm::cos(angle) * slope) as f32 / width as f32, (libm::sin(angle) * slope) as f32 / height as f32);
    let (ox, oy) = (rng.uniform(0.0, 256.0) as f32, rng.uniform(0.0, 256.0) as f32);
    let clouds = rng.uniform(0.0, 0.25) as f32;
    let scale = rng.uniform(20.0, 90.0) as f32 / width as f32;
    let vignette = rng.uniform(0.0, 0.5) as f32;
    let exposure = rng.log_uniform(0.45, 1.6) as f32;
    let cast = color::from_hsv(rng.uniform(0.0, 360.0), rng.uniform(0.0, 0.18), 1.0);
    // Light changes slowly: it is computed at every few pixels and interpolated.
    let columns = width.div_ceil(STEP) + 2;
    let at = |i: usize, j: usize| {
        let (x, y) = ((i * STEP) as f32, (j * STEP) as f32);
        let (u, v) = (x / width as f32 - 0.5, y / height as f32 - 0.5);
        let slow =
            1.0 + sx * (x - width as f32 / 2.0) + sy * (y - height as f32 / 2.0) + clouds * tile.smooth(ox + x * scale, oy + y * scale);
        exposure * slow.max(0.15) * (1.0 - vignette * (u * u + v * v))
    };
    let lattice = |j: usize| (0..columns).map(|i| at(i, j)).collect::<Vec<f32>>();
    let nodes: Vec<Vec<f32>> = (0..=height.div_ceil(STEP)).map(lattice).collect();
    widest(Illuminate { canvas, nodes: &nodes, cast });
}

/// Pixels between two places at which the light is known.
const STEP: usize = 8;

/// Multiplies a picture by the light of every [`STEP`]th pixel of every [`STEP`]th row, interpolated, and by a colour.
struct Illuminate<'a> {
    canvas: &'a mut Canvas,
    nodes: &'a [Vec<f32>],
    cast: color::Linear,
}

impl Portable for Illuminate<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let (width, height) = (self.canvas.width, self.canvas.height);
        let mut row = vec![0f32; width.next_multiple_of(STEP)];
        for y in 0..height {
            let (upper, lower, v) = (&self.nodes[y / STEP], &self.nodes[y / STEP + 1], (y % STEP) as f32 / STEP as f32);
            for (k, cell) in row.as_chunks_mut::<STEP>().0.iter_mut().enumerate() {
                let left = upper[k] + (lower[k] - upper[k]) * v;
                let right = upper[k + 1] + (lower[k + 1] - upper[k + 1]) * v;
                for (m, light) in cell.iter_mut().enumerate() {
                    *light = left + (right - left) * (m as f32 / STEP as f32);
                }
            }
            for (plane, gain) in self.canvas.planes.iter_mut().zip(self.cast) {
                plane[y * width..][..width].iter_mut().zip(&row).for_each(|(value, light)| *value *= light * gain);
            }
        }
    }
}
