//! What the things of a scene are made of: two colours, noise of some spectrum, and a pattern.
use crate::{
    color::{self, Linear},
    noise::{Spectrum, Tile, floor},
};
use tcross_dataset::Rng;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Pattern {
    Plain,
    Stripes,
    Checks,
    Bricks,
    Planks,
    Dots,
}

/// A material, asked for its colour at a place.
#[derive(Debug, Clone)]
pub(crate) struct Material {
    base: Linear,
    second: Linear,
    pattern: Pattern,
    period: f32,
    joint: f32,
    tile: &'static Tile,
    grain: f32,
    scale: f32,
    offset: [f32; 2],
    turn: [f32; 2],
}

impl Material {
    /// A muted material, such as most things are made of. Lengths are in the units in which it will be asked.
    pub(crate) fn muted(rng: &mut Rng) -> Self {
        let base = color::muted(rng);
        Self::of(base, rng)
    }

    /// A saturated material, such as toys, book covers and signs are made of.
    pub(crate) fn saturated(rng: &mut Rng) -> Self {
        let base = color::saturated(rng);
        let mut material = Self::of(base, rng);
        material.grain *= 0.5;
        material
    }

    /// A material of a given main colour.
    pub(crate) fn of(base: Linear, rng: &mut Rng) -> Self {
        let second = match rng.index(4) {
            0 => color::scaled(base, rng.uniform(0.3, 0.8) as f32),
            1 => color::mix(base, [0.9; 3], rng.uniform(0.2, 0.9) as f32),
            2 => color::muted(rng),
            _ => color::mix(base, color::saturated(rng), 0.4),
        };
        let patterns = [Pattern::Plain, Pattern::Stripes, Pattern::Checks, Pattern::Bricks, Pattern::Planks, Pattern::Dots];
        let angle = rng.uniform(0.0, std::f64::consts::TAU);
        Self {
            base,
            second,
            pattern: patterns[rng.weighted(&[6.0, 0.6, 0.5, 0.7, 0.9, 0.4])],
            period: rng.log_uniform(8.0, 80.0) as f32,
            joint: rng.uniform(0.03, 0.15) as f32,
            tile: Tile::of([Spectrum::Soft, Spectrum::Pink, Spectrum::Rough, Spectrum::Grain][rng.weighted(&[2.0, 3.0, 1.5, 1.5])]),
            grain: rng.log_uniform(0.03, 0.45) as f32,
            scale: rng.log_uniform(0.25, 2.5) as f32,
            offset: [rng.uniform(0.0, 256.0) as f32, rng.uniform(0.0, 256.0) as f32],
            turn: [libm::cos(angle) as f32, libm::sin(angle) as f32],
        }
    }

    /// No pattern but noise.
    pub(crate) fn plain(mut self) -> Self {
        self.pattern = Pattern::Plain;
        self
    }

    /// The colour at a place.
    #[inline]
    pub(crate) fn at(&self, x: f32, y: f32) -> Linear {
        self.at_each(&[x], &[y]).map(|[v]| v)
    }

    /// The colours at some places: red, green, blue. In plain loops, which the compiler turns into vectors, and all in line with them, so that
    /// the caller decides for which.
    #[inline(always)]
    pub(crate) fn at_each<const N: usize>(&self, x: &[f32; N], y: &[f32; N]) -> [[f32; N]; 3] {
        let [cos, sin] = self.turn;
        let (mut u, mut v) = ([0f32; N], [0f32; N]);
        for k in 0..N {
            u[k] = (x[k] * cos + y[k] * sin) * self.scale + self.offset[0];
            v[k] = (y[k] * cos - x[k] * sin) * self.scale + self.offset[1];
        }
        let mut noise = [0f32; N];
        if self.scale < 0.9 {
            for k in 0..N {
                noise[k] = self.tile.smooth(u[k], v[k]);
            }
        } else {
            for k in 0..N {
                noise[k] = self.tile.nearest(u[k], v[k]);
            }
        }
        let mut share = [0f32; N];
        // The pattern is chosen once for all of them.
        macro_rules! each {
            ($at:ident => $value:expr) => {
                for $at in 0..N {
                    share[$at] = $value;
                }
            };
        }
        let (period, joint) = (self.period, self.joint);
        match self.pattern {
            Pattern::Plain => each!(k => (noise[k] * 0.2).clamp(0.0, 1.0)),
            Pattern::Stripes => each!(k => sure(wrap(x[k] / period) < 0.5)),
            Pattern::Checks => each!(k => sure((wrap(x[k] / period) < 0.5) != (wrap(y[k] / period) < 0.5))),
            Pattern::Bricks => each!(k => {
                let row = floor(y[k] / period) as f32;
                sure(wrap(x[k] / period * 0.45 + row * 0.5) < joint * 0.5 || wrap(y[k] / period) < joint)
            }),
            Pattern::Planks => each!(k => {
                let column = floor(x[k] / period) as f32;
                let edge = sure(wrap(x[k] / period) < joint * 0.4);
                // Each plank has its own shade.
                edge.max(0.5 + 0.5 * self.tile.nearest(column * 37.0, 11.0).clamp(-1.0, 1.0) * 0.7)
            }),
            Pattern::Dots => each!(k => {
                let (a, b) = (wrap(x[k] / period) - 0.5, wrap(y[k] / period) - 0.5);
                sure(a * a + b * b < 0.07)
            }),
        }
        let mut colors = [[0f32; N]; 3];
        for (c, color) in colors.iter_mut().enumerate() {
            let (base, way) = (self.base[c], self.second[c] - self.base[c]);
            for k in 0..N {
                color[k] = (base + way * share[k]) * (1.0 + self.grain * noise[k]).max(0.1);
            }
        }
        colors
    }
}

#[inline(always)]
fn wrap(v: f32) -> f32 {
    v - floor(v) as f32
}

/// 1 where it holds.
#[inline(always)]
fn sure(holds: bool) -> f32 {
    f32::from(u8::from(holds))
}
