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
        let (u, v) = (x * self.turn[0] + y * self.turn[1], y * self.turn[0] - x * self.turn[1]);
        let (tu, tv) = (u * self.scale + self.offset[0], v * self.scale + self.offset[1]);
        let noise = if self.scale < 0.9 { self.tile.smooth(tu, tv) } else { self.tile.nearest(tu, tv) };
        let share = match self.pattern {
            Pattern::Plain => (noise * 0.2).clamp(0.0, 1.0),
            Pattern::Stripes => step(wrap(x / self.period)),
            Pattern::Checks => {
                let (a, b) = (wrap(x / self.period) < 0.5, wrap(y / self.period) < 0.5);
                f32::from(u8::from(a != b))
            }
            Pattern::Bricks => {
                let row = floor(y / self.period) as f32;
                let (a, b) = (wrap(x / self.period * 0.45 + row * 0.5), wrap(y / self.period));
                f32::from(u8::from(a < self.joint * 0.5 || b < self.joint))
            }
            Pattern::Planks => {
                let column = floor(x / self.period) as f32;
                let edge = f32::from(u8::from(wrap(x / self.period) < self.joint * 0.4));
                // Each plank has its own shade.
                edge.max(0.5 + 0.5 * self.tile.nearest(column * 37.0, 11.0).clamp(-1.0, 1.0) * 0.7)
            }
            Pattern::Dots => {
                let (a, b) = (wrap(x / self.period) - 0.5, wrap(y / self.period) - 0.5);
                f32::from(u8::from(a * a + b * b < 0.07))
            }
        };
        let shade = (1.0 + self.grain * noise).max(0.1);
        std::array::from_fn(|c| (self.base[c] + (self.second[c] - self.base[c]) * share) * shade)
    }
}

fn wrap(v: f32) -> f32 {
    v - floor(v) as f32
}

fn step(v: f32) -> f32 {
    f32::from(u8::from(v < 0.5))
}
