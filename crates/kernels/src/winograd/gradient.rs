//! The gradient of the weights: sixteen products of matrices, inputs x outputs summed over tiles.
use super::{POINTS, SKEW, Tiles, Windows, transform};
use crate::{
    ConvShape,
    buffer::buffer,
    gather::{Activation, SharedMut, with_scratch},
    simd::{Isa, Simd, dispatch},
};
use rayon::prelude::*;
use std::ops::Range;

/// Floats of a block's windows: half of a 512 KiB second-level cache.
const WINDOW_FLOATS: usize = 64 * 1024;
/// A block of fewer tiles would read and write the sums too often.
const LEAST_TILES: usize = 48;
/// Above this many sums threads share the output channels; below, every chunk of tiles gets sums of its own.
const SMALL: usize = 256 * 1024;
/// Chunks of tiles of a small gradient: fixed, so that the order of a sum does not depend on the number of threads.
const CHUNKS: usize = 8;

/// As [`crate::weight_gradient::weight_gradient`].
pub(crate) fn weight_gradient(isa: Isa, shape: &ConvShape, x: &[f32], activation: Option<Activation>, dz: &[f32]) -> Vec<f32> {
    let isa = isa.filled_by(shape.out_channels);
    let width = 2 * isa.lanes();
    let panels = shape.out_channels.div_ceil(width);
    let tiles = Tiles { batch: shape.batch, height: shape.height, width: shape.width };
    let per_row = tiles.columns() * POINTS * shape.in_channels;
    let rows = (WINDOW_FLOATS / per_row).max(LEAST_TILES.div_ceil(tiles.columns())).clamp(1, tiles.units());
    let job = Job { isa, tiles, x, inputs: shape.in_channels, activation, dz, outputs: shape.out_channels, rows };
    let units = tiles.units();
    // Sums in `[panel][point][input][width]`.
    let len = panels * POINTS * shape.in_channels * width;
    // A panel whose upper vector stays empty keeps zeros there; all else is written.
    let fresh = |len| if (1..=width / 2).contains(&(shape.out_channels % width)) { vec![0f32; len] } else { buffer(len) };
    let mut sums = fresh(len);
    if len <= SMALL {
        let chunks = CHUNKS.min(units.div_ceil(2));
        let mut parts = fresh((chunks - 1) * len);
        let all = std::iter::once(&mut sums[..]).chain(parts.chunks_mut(len)).collect::<Vec<_>>();
        all.into_par_iter().enumerate().with_max_len(1).for_each(|(c, part)| {
            job.add(c * units / chunks..(c + 1) * units / chunks, 0..panels, SharedMut(part.as_mut_ptr()));
        });
        sums.par_chunks_mut(4096).enumerate().for_each(|(k, sums)| {
            for part in parts.chunks_exact(len) {
                sums.iter_mut().zip(&part[k * 4096..]).for_each(|(s, p)| *s += p);
            }
        });
    } else {
        // Every group transforms the windows anew; how many there are changes no sum.
        let groups = panels.min(2 * rayon::current_num_threads());
        let to = SharedMut(sums.as_mut_ptr());
        (0..groups).into_par_iter().with_max_len(1).for_each(|g| {
            job.add(0..units, g * panels / groups..(g + 1) * panels / groups, SharedMut(to.at(0)));
        });
    }
    unpack(isa, shape, &sums)
}

/// From `[panel][point][input][width]` to `[out, in, 3, 3]`.
fn unpack(isa: Isa, shape: &ConvShape, sums: &[f32]) -> Vec<f32> {
    let (cin, width) = (shape.in_channels, 2 * isa.lanes());
    let mut weight = buffer(shape.weight_len());
    weight.par_chunks_mut(width * 9 * cin).zip(sums.par_chunks(POINTS * cin * width)).for_each(|(rows, panel)| {
        let mut taps = [0f32; 9 * 32];
        for c in 0..cin {
            let from = &panel[c * width..];
            assert!(from.len() >= (POINTS - 1) * cin * width + width);
            transform_gradients(isa, from, cin * width, &mut taps);
            for (lane, row) in rows.chunks_exact_mut(9 * cin).enumerate() {
                for (t, value) in row[9 * c..9 * c + 9].iter_mut().enumerate() {
                    *value = taps[t * width + lane];
                }
            }
        }
    });
    weight
}

fn transform_gradients(isa: Isa, from: &[f32], pitch: usize, taps: &mut [f32; 9 * 32]) {
    use transform::kernel_gradients;
    dispatch!(isa, kernel_gradients::<S>(from: &[f32], pitch: usize, taps: &mut [f32; 9 * 32]));
}

struct Job<'a> {
    isa: Isa,
    tiles: Tiles,
    x: &'a [f32],
    inputs: usize,
    activation: Option<Activation<'a>>,
    dz: &'a [f32],
    outputs: usize,
    /// Rows of tiles of a block.
    rows: usize,
}

impl Job<'_> {
    /// Sums rows of tiles for some panels.
    fn add(&self, units: Range<usize>, panels: Range<usize>, sums: SharedMut) {
        let mut first = units.start;
        while first < units.end {
            // Blocks of equal size.
            let blocks = (units.end - first).div_ceil(self.rows);
            let next = first + (units.end - first).div_ceil(blocks);
            self.block(first..next, panels.clone(), first > units.start, sums);
            first = next;
        }
    }

    /// Sums a block, on top of what is there where `add` says so.
    fn block(&self, units: Range<usize>, panels: Range<usize>, add: bool, sums: SharedMut) {
        let width = 2 * self.isa.lanes();
        let windows = Windows {
            isa: self.isa,
            tiles: self.tiles,
            source: self.x,
            channels: self.inputs,
            activation: self.activation,
            units: units.clone(),
        };
        let count = units.len() * self.tiles.columns();
        let (window_len, band_len) = windows.lens();
        let pitch = count * width + SKEW;
        with_scratch(window_len + band_len.max(POINTS * pitch), |scratch| {
            let (transformed, rest) = scratch.split_at_mut(window_len);
            windows.write(&mut rest[..band_len], transformed);
            for panel in panels {
                let lanes = width.min(self.outputs - panel * width);
                self.write_gradients(units.clone(), panel * width, lanes, &mut rest[..POINTS * pitch], pitch);
                let outer = Outer {
                    windows: transformed,
                    window_pitch: windows.pitch(),
                    inputs: self.inputs,
                    tiles: count,
                    gradients: &rest[..POINTS * pitch],
                    gradient_pitch: pitch,
                    width,
                    one_vector: lanes <= width / 2,
                    add,
                    sums: SharedMut(sums.at(panel * POINTS * self.inputs * width)),
                };
                run_outer(self.isa, &outer);
            }
        });
    }

    /// The transformed gradients of one panel, `[point][tile][width]`.
    fn write_gradients(&self, units: Range<usize>, channel: usize, lanes: usize, to: &mut [f32], pitch: usize) {
        let Tiles { height, width, .. } = self.tiles;
        let (rows, columns, panel) = (self.tiles.rows(), self.tiles.columns(), 2 * self.isa.lanes());
        let mut unit = units.start;
        while unit < units.end {
            let (image, row) = (unit / rows, unit % rows);
            let count = (rows - row).min(units.end - unit);
            let from = &self.dz[image * height * width * self.outputs..][..height * width * self.outputs];
            let tile = (unit - units.start) * columns;
            assert!(to.len() >= POINTS * pitch && pitch >= (tile + count * columns) * panel);
            let gradients = transform::TileGradients {
                from: from[channel..].as_ptr(),
                height,
                width,
                channels: self.outputs,
                lanes,
                first_row: row,
                rows: count,
                columns,
                to: to[tile * panel..].as_mut_ptr(),
                pitch,
                panel,
            };
            transform_tiles(self.isa, &gradients);
            unit += count;
        }
    }
}

fn transform_tiles(isa: Isa, gradients: &transform::TileGradients) {
    use transform::tile_gradients;
    dispatch!(isa, tile_gradients::<S>(gradients: &transform::TileGradients))
}

/// Sums over tiles of window x gradient at every point, for one panel.
struct Outer<'a> {
    /// `[point][tile][input]`.
    windows: &'a [f32],
    window_pitch: usize,
    inputs: usize,
    tiles: usize,
    /// `[point][tile][width]`.
    gradients: &'a [f32],
    gradient_pitch: usize,
    width: usize,
    /// The panel's upper vector is all zeros.
    one_vector: bool,
    /// On top of what is there.
    add: bool,
    /// `[point][input][width]`.
    sums: SharedMut,
}

fn run_outer(isa: Isa, outer: &Outer) {
    dispatch!(isa, outer_body::<S>(outer: &Outer))
}

/// # Safety
/// Sizes as `Outer` says; nobody else touches the panel's sums.
#[inline(always)]
unsafe fn outer_body<S: Simd>(outer: &Outer) {
    for point in 0..POINTS {
        // SAFETY: passed on.
        unsafe { if outer.one_vector { point_body::<S, 1>(outer, point) } else { point_body::<S, 2>(outer, point) } }
    }
}

#[inline(always)]
unsafe fn point_body<S: Simd, const V: usize>(outer: &Outer, point: usize) {
    // SAFETY: passed on; `at` and the tile's height stay within the inputs.
    unsafe {
        let mut at = 0;
        while (S::TILE >= 12 || V == 1) && outer.inputs - at >= 12 {
            product::<S, 12, V>(outer, point, at);
            at += 12;
        }
        while S::TILE >= 6 && outer.inputs - at >= 8 && V == 1 {
            product::<S, 8, V>(outer, point, at);
            at += 8;
        }
        while S::TILE >= 6 && outer.inputs - at >= 6 {
            product::<S, 6, V>(outer, point, at);
            at += 6;
        }
        while outer.inputs - at >= 4 {
            product::<S, 4, V>(outer, point, at);
            at += 4;
        }
        while outer.inputs - at >= 2 {
            product::<S, 2, V>(outer, point, at);
            at += 2;
        }
        if at < outer.inputs {
            product::<S, 1, V>(outer, point, at);
        }
    }
}

#[inline(always)]
unsafe fn product<S: Simd, const M: usize, const V: usize>(outer: &Outer, point: usize, at: usize) {
    // SAFETY: see `outer_body`.
    unsafe {
        let sums = outer.sums.at((point * outer.inputs + at) * outer.width);
        let mut x = outer.windows.as_ptr().add(point * outer.window_pitch + at);
        let mut g = outer.gradients.as_ptr().add(point * outer.gradient_pitch);
        let mut acc = [[S::splat(0.0); V]; M];
        for _ in 0..outer.tiles {
            let mut gv = [S::splat(0.0); V];
            for (v, g_v) in gv.iter_mut().enumerate() {
                *g_v = S::load(g.add(v * S::LANES));
            }
            for (m, row) in acc.iter_mut().enumerate() {
                let b = S::splat(*x.add(m));
                for (a, g_v) in row.iter_mut().zip(gv) {
                    *a = S::fma(b, g_v, *a);
                }
            }
            x = x.wrapping_add(outer.inputs);
            g = g.wrapping_add(outer.width);
        }
        for (m, row) in acc.iter().enumerate() {
            for (v, a) in row.iter().enumerate() {
                let to = sums.add(m * outer.width + v * S::LANES);
                S::store(to, if outer.add { S::add(S::load(to), *a) } else { *a });
            }
        }
    }
}
