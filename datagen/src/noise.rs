//! Noise: tiles with the spectra of photographs, and a table of normal numbers for grain.
use std::sync::OnceLock;
use tcross_dataset::Rng;

/// Side of a tile in texels; a power of two, so that it wraps by masking.
pub const SIDE: usize = 256;

/// How a tile's contrast is spread over its octaves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spectrum {
    /// Mostly large shapes, like light on a wall.
    Soft,
    /// Equal contrast in every octave: amplitude 1/f, as in photographs of most things.
    Pink,
    /// Mostly fine, like plaster, asphalt or cloth.
    Rough,
    /// Long fibres, like wood or brushed metal.
    Grain,
}

/// A seamless tile of noise with mean 0 and deviation 1.
#[derive(Debug)]
pub struct Tile(Box<[f32; SIDE * SIDE]>);

impl Tile {
    /// The tile of a spectrum; made once.
    pub fn of(spectrum: Spectrum) -> &'static Self {
        static TILES: OnceLock<[Tile; 4]> = OnceLock::new();
        let tiles = TILES.get_or_init(|| {
            let soft: fn(i32) -> f32 = |octave| 0.55f32.powi(octave);
            let pink: fn(i32) -> f32 = |_| 1.0;
            let rough: fn(i32) -> f32 = |octave| 1.5f32.powi(octave);
            [(soft, 1), (pink, 1), (rough, 1), (pink, 16)].map(|(weight, stretch)| Tile::new(weight, stretch))
        });
        &tiles[spectrum as usize]
    }

    fn new(weight: fn(i32) -> f32, stretch: usize) -> Self {
        let mut values = Box::new([0f32; SIDE * SIDE]);
        let mut rng = Rng::for_item(0, "datagen/noise-tile", stretch as u64 * 1000 + (weight(3) * 100.0) as u64);
        for octave in 1..8 {
            let (columns, rows) = (((1 << octave) / stretch).max(2), 1usize << octave);
            let lattice: Vec<f32> = (0..columns * rows).map(|_| rng.normal() as f32 * weight(octave)).collect();
            for y in 0..SIDE {
                let (row, v) = place(y, rows);
                for x in 0..SIDE {
                    let (column, u) = place(x, columns);
                    let at = |i: usize, j: usize| lattice[(j % rows) * columns + i % columns];
                    let top = at(column, row) + (at(column + 1, row) - at(column, row)) * u;
                    let bottom = at(column, row + 1) + (at(column + 1, row + 1) - at(column, row + 1)) * u;
                    values[y * SIDE + x] += top + (bottom - top) * v;
                }
            }
        }
        let n = values.len() as f32;
        let mean = values.iter().sum::<f32>() / n;
        let deviation = (values.iter().map(|v| (v - mean) * (v - mean)).sum::<f32>() / n).sqrt();
        values.iter_mut().for_each(|v| *v = (*v - mean) / deviation);
        Self(values)
    }

    /// The value at a place in texels, wrapped, nearest texel.
    #[must_use]
    #[inline(always)]
    pub fn nearest(&self, x: f32, y: f32) -> f32 {
        let (i, j) = (floor(x) as usize & (SIDE - 1), floor(y) as usize & (SIDE - 1));
        self.0[j * SIDE + i]
    }

    /// The value at a place in texels, wrapped, bilinear.
    #[must_use]
    #[inline(always)]
    pub fn smooth(&self, x: f32, y: f32) -> f32 {
        let (fx, fy) = (floor(x), floor(y));
        let (u, v) = (x - fx as f32, y - fy as f32);
        let (i, j) = (fx as usize & (SIDE - 1), fy as usize & (SIDE - 1));
        let (i1, j1) = ((i + 1) & (SIDE - 1), (j + 1) & (SIDE - 1));
        let top = self.0[j * SIDE + i] + (self.0[j * SIDE + i1] - self.0[j * SIDE + i]) * u;
        let bottom = self.0[j1 * SIDE + i] + (self.0[j1 * SIDE + i1] - self.0[j1 * SIDE + i]) * u;
        top + (bottom - top) * v
    }

    /// The row of a height in texels, wrapped.
    #[must_use]
    pub fn row(&self, y: f32) -> Row {
        let whole = floor(y);
        let v = y - whole as f32;
        let row = |j: usize| &self.0[(j & (SIDE - 1)) * SIDE..][..SIDE];
        let (upper, lower) = (row(whole as usize), row(whole as usize + 1));
        let mut values = [0f32; SIDE + 1];
        for ((value, a), b) in values.iter_mut().zip(upper).zip(lower) {
            *value = a + (b - a) * v;
        }
        values[SIDE] = values[0];
        Row(values)
    }
}

/// One row of a tile, for many places of one height.
#[derive(Debug)]
pub struct Row([f32; SIDE + 1]);

impl Row {
    /// The value at a place in texels, wrapped: what [`Tile::smooth`] says there, but for rounding.
    #[must_use]
    #[inline(always)]
    pub fn smooth(&self, x: f32) -> f32 {
        let whole = floor(x);
        let i = whole as usize & (SIDE - 1);
        self.0[i] + (self.0[i + 1] - self.0[i]) * (x - whole as f32)
    }
}

/// The largest whole number that is not above `v`; without SSE 4.1 the standard library's is a call.
#[must_use]
#[inline(always)]
pub fn floor(v: f32) -> i32 {
    let whole = v as i32;
    whole - i32::from(v < whole as f32)
}

/// The lattice cell of texel `k` and the smoothed fraction inside it.
fn place(k: usize, cells: usize) -> (usize, f32) {
    let at = k as f32 * cells as f32 / SIDE as f32;
    let f = at.fract();
    (at as usize, f * f * (3.0 - 2.0 * f))
}

/// Normal numbers, drawn once; long enough that no row of a picture repeats another's where it starts elsewhere.
pub fn normals() -> &'static [f32; 1 << 16] {
    static NORMALS: OnceLock<Box<[f32; 1 << 16]>> = OnceLock::new();
    NORMALS.get_or_init(|| {
        let mut rng = Rng::for_item(0, "datagen/normals", 0);
        Box::new(std::array::from_fn(|_| rng.normal() as f32))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_wrap_and_differ_in_roughness() {
        // Mean squared step between neighbours, wrapped: soft < pink < rough, none zero.
        let step = |spectrum| {
            let tile = Tile::of(spectrum);
            (0..SIDE).map(|k| (tile.nearest(k as f32 + 0.5, 7.5) - tile.nearest(k as f32 + 1.5, 7.5)).powi(2)).sum::<f32>()
        };
        let (soft, pink, rough) = (step(Spectrum::Soft), step(Spectrum::Pink), step(Spectrum::Rough));
        assert!(0.0 < soft && soft < pink && pink < rough, "{soft} {pink} {rough}");
        let tile = Tile::of(Spectrum::Pink);
        assert_eq!(tile.nearest(3.5, 9.5), tile.nearest(3.5 + SIDE as f32, 9.5 - SIDE as f32 + SIDE as f32));
        assert!((tile.smooth(3.0, 9.0) - tile.nearest(3.0, 9.0)).abs() < 1e-6);
        for (x, y) in [(3.3, 9.8), (-7.25, -3.5), (255.5, 255.5), (700.1, 300.9)] {
            assert!((tile.row(y).smooth(x) - tile.smooth(x, y)).abs() < 1e-4, "{x} {y}");
        }
    }
}
