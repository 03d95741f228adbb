//! The gradient of a convolution's weights: a real matrix product, inputs x outputs summed over pixels.
//!
//! A register tile holds 6 inputs (taps and channels, contiguous in a padded row) by one panel of output channels; each pixel adds an outer
//! product. The output's gradient is packed a band at a time, so that the tile reads it in order.
use crate::{
    ConvShape,
    gather::{Activation, Band, SharedMut, copy_band, least_pixels, with_scratch},
    simd::{Isa, Simd, dispatch},
    winograd,
};
use rayon::prelude::*;

/// Floats of a band's scratch (inputs and packed gradients together).
const BAND_FLOATS: usize = 48 * 1024;
/// Below this many weights every chunk of images gets sums of its own; above, threads share the output channels.
const SMALL: usize = 96 * 1024;
/// Chunks of pixels of a small gradient: fixed, so that the order of the sum does not depend on the number of threads.
const CHUNKS: usize = 8;

struct Job<'a> {
    isa: Isa,
    shape: ConvShape,
    x: &'a [f32],
    activation: Option<Activation<'a>>,
    dz: &'a [f32],
    /// Output rows of a band.
    rows: usize,
    /// Output channels of a panel.
    width: usize,
}

/// The gradient of the weights `[out, in, kernel, kernel]` from the input `x` (after `activation`, where given) and the output's gradient.
#[must_use]
pub fn weight_gradient(isa: Isa, shape: &ConvShape, x: &[f32], activation: Option<Activation>, dz: &[f32]) -> Vec<f32> {
    shape.check();
    assert!(x.len() == shape.input_len() && dz.len() == shape.output_len());
    if winograd::pays(shape) {
        return winograd::weight_gradient(isa, shape, x, activation, dz);
    }
    let isa = isa.filled_by(shape.out_channels);
    let width = 2 * isa.lanes();
    let panels = shape.out_channels.div_ceil(width);
    let inputs = shape.kernel * shape.kernel * shape.in_channels;
    let row = (shape.out_width() * shape.stride + 2) * shape.stride * shape.in_channels + shape.out_width() * width;
    let least = least_pixels(inputs * shape.out_channels).div_ceil(shape.out_width());
    let rows = (BAND_FLOATS / row).max(least).clamp(1, shape.out_height());
    let rows = shape.out_height().div_ceil(shape.out_height().div_ceil(rows)); // bands of equal height
    let job = Job { isa, shape: *shape, x, activation, dz, rows, width };
    let bands = shape.out_height().div_ceil(rows);
    let units = shape.batch * bands;
    // Sums in `[panel][input][width]`.
    let mut sums = vec![0f32; panels * inputs * width];
    if sums.len() <= SMALL {
        let chunks = CHUNKS.min(units);
        let parts: Vec<Vec<f32>> = (0..chunks)
            .into_par_iter()
            .with_max_len(1)
            .map(|c| {
                let mut part = vec![0f32; panels * inputs * width];
                for unit in c * units / chunks..(c + 1) * units / chunks {
                    job.add(unit / bands, unit % bands, 0..panels, SharedMut(part.as_mut_ptr()));
                }
                part
            })
            .collect();
        for part in parts {
            for (s, p) in sums.iter_mut().zip(part) {
                *s += p;
            }
        }
    } else {
        let groups = panels.min(4 * rayon::current_num_threads()).min(panels.div_ceil(2).max(1)).max(1);
        let to = SharedMut(sums.as_mut_ptr());
        (0..groups).into_par_iter().with_max_len(1).for_each(|g| {
            for unit in 0..units {
                job.add(unit / bands, unit % bands, g * panels / groups..(g + 1) * panels / groups, SharedMut(to.at(0)));
            }
        });
    }
    unpack(shape, width, &sums)
}

/// From `[panel][row, column, channel][width]` to `[out, in, kernel, kernel]`.
fn unpack(shape: &ConvShape, width: usize, sums: &[f32]) -> Vec<f32> {
    let (cin, taps) = (shape.in_channels, shape.kernel * shape.kernel);
    let mut weight = vec![0f32; shape.weight_len()];
    weight.par_chunks_mut(width * taps * cin).zip(sums.par_chunks(width * taps * cin)).for_each(|(rows, panel)| {
        let lanes = rows.len() / (taps * cin);
        for c in 0..cin {
            for tap in 0..taps {
                for (lane, value) in panel[(tap * cin + c) * width..][..lanes].iter().enumerate() {
                    rows[lane * taps * cin + c * taps + tap] = *value;
                }
            }
        }
    });
    weight
}

impl Job<'_> {
    /// Adds one band of one image to the panels' sums.
    fn add(&self, image: usize, band: usize, panels: std::ops::Range<usize>, sums: SharedMut) {
        let s = &self.shape;
        let (out_width, cin, cout) = (s.out_width(), s.in_channels, s.out_channels);
        let rows = band * self.rows..((band + 1) * self.rows).min(s.out_height());
        let source_len = s.height * s.width * cin;
        let x = &self.x[image * source_len..(image + 1) * source_len];
        let dz = &self.dz[(image * s.out_height() + rows.start) * out_width * cout..][..rows.len() * out_width * cout];
        let columns = (out_width - 1) * s.stride + s.kernel;
        let band_rows = (rows.len() - 1) * s.stride + s.kernel;
        let direct = s.kernel == 1 && self.activation.is_none();
        let band_len = if direct { 0 } else { band_rows * columns * cin };
        let pixels = rows.len() * out_width;
        with_scratch(band_len + pixels * self.width, |scratch| {
            let (copy, packed) = scratch.split_at_mut(band_len);
            let band = if direct {
                &x[rows.start * s.width * cin..][..pixels * cin]
            } else {
                let band = Band {
                    source_size: [s.height, s.width, cin],
                    first_row: (rows.start * s.stride) as isize - s.padding() as isize,
                    rows: band_rows,
                    columns,
                    padding: s.padding(),
                    activation: self.activation,
                    isa: self.isa,
                };
                copy_band(&band, x, copy);
                copy
            };
            let inputs = s.kernel * s.kernel * cin;
            for p in panels {
                let first = p * self.width;
                let lanes = self.width.min(cout - first);
                // A gradient of exactly one or two vectors a pixel is read where it lies.
                let in_place = cout == self.width || cout == self.width / 2;
                if !in_place {
                    for (to, from) in packed.chunks_exact_mut(self.width).zip(dz.chunks_exact(cout)) {
                        to[..lanes].copy_from_slice(&from[first..first + lanes]);
                        to[lanes..].fill(0.0);
                    }
                }
                let outer = Outer {
                    x: band,
                    rows: rows.len(),
                    columns: out_width,
                    row_pitch: columns * cin * s.stride,
                    pixel_pitch: cin * s.stride,
                    tap_pitch: columns * cin,
                    taps: s.kernel,
                    run_len: s.kernel * cin,
                    dz: if in_place { dz } else { packed },
                    dz_pitch: if in_place { cout } else { self.width },
                    width: self.width,
                    one_vector: lanes <= self.width / 2,
                    sums: SharedMut(sums.at(p * inputs * self.width)),
                };
                run_outer(self.isa, &outer);
            }
        });
    }
}

/// Sum over pixels of input x packed gradient, for one panel.
struct Outer<'a> {
    x: &'a [f32],
    rows: usize,
    columns: usize,
    row_pitch: usize,
    pixel_pitch: usize,
    /// From one kernel row to the next.
    tap_pitch: usize,
    taps: usize,
    /// Inputs of one kernel row.
    run_len: usize,
    dz: &'a [f32],
    /// From one pixel's gradient to the next.
    dz_pitch: usize,
    width: usize,
    /// The panel's upper vector is all zeros.
    one_vector: bool,
    /// `[taps * run_len][width]`.
    sums: SharedMut,
}

fn run_outer(isa: Isa, outer: &Outer) {
    let last = (outer.rows - 1) * outer.row_pitch + (outer.columns - 1) * outer.pixel_pitch + (outer.taps - 1) * outer.tap_pitch;
    assert!(last + outer.run_len <= outer.x.len() && outer.dz.len() >= outer.rows * outer.columns * outer.dz_pitch);
    assert!(outer.dz_pitch >= if outer.one_vector { outer.width / 2 } else { outer.width });
    dispatch!(isa, outer_body::<S>(outer: &Outer))
}

/// # Safety
/// Bounds as asserted by `run_outer`; `sums` has `taps * run_len * width` floats that no other task touches.
#[inline(always)]
unsafe fn outer_body<S: Simd>(outer: &Outer) {
    // SAFETY: passed on.
    unsafe { if outer.one_vector { outer_vectors::<S, 1>(outer) } else { outer_vectors::<S, 2>(outer) } }
}

#[inline(always)]
unsafe fn outer_vectors<S: Simd, const V: usize>(outer: &Outer) {
    for tap in 0..outer.taps {
        let mut at = 0;
        // SAFETY: passed on; `at + M` stays within the run.
        unsafe {
            // One vector alone needs more rows to hide the latency of the multiply-adds; 9 is the kernel row of a picture.
            while V == 1 && outer.run_len - at >= 12 {
                outer_tile::<S, 12, V>(outer, tap, at);
                at += 12;
            }
            while V == 1 && outer.run_len - at >= 9 {
                outer_tile::<S, 9, V>(outer, tap, at);
                at += 9;
            }
            while S::TILE >= 12 && outer.run_len - at >= 12 {
                outer_tile::<S, 12, V>(outer, tap, at);
                at += 12;
            }
            while S::TILE >= 6 && outer.run_len - at >= 6 {
                outer_tile::<S, 6, V>(outer, tap, at);
                at += 6;
            }
            while outer.run_len - at >= 4 {
                outer_tile::<S, 4, V>(outer, tap, at);
                at += 4;
            }
            while outer.run_len - at >= 2 {
                outer_tile::<S, 2, V>(outer, tap, at);
                at += 2;
            }
            if at < outer.run_len {
                outer_tile::<S, 1, V>(outer, tap, at);
            }
        }
    }
}

#[inline(always)]
unsafe fn outer_tile<S: Simd, const M: usize, const V: usize>(outer: &Outer, tap: usize, at: usize) {
    // SAFETY: see `outer_body`.
    unsafe {
        let sums = outer.sums.0.add((tap * outer.run_len + at) * outer.width);
        let mut acc = [[S::splat(0.0); V]; M];
        for (m, row) in acc.iter_mut().enumerate() {
            for (v, a) in row.iter_mut().enumerate() {
                *a = S::load(sums.add(m * outer.width + v * S::LANES));
            }
        }
        let mut d = outer.dz.as_ptr();
        for r in 0..outer.rows {
            let mut x = outer.x.as_ptr().add(r * outer.row_pitch + tap * outer.tap_pitch + at);
            for _ in 0..outer.columns {
                let mut dv = [S::splat(0.0); V];
                for (v, g) in dv.iter_mut().enumerate() {
                    *g = S::load(d.add(v * S::LANES));
                }
                for (m, row) in acc.iter_mut().enumerate() {
                    let b = S::splat(*x.add(m));
                    for (a, g) in row.iter_mut().zip(dv) {
                        *a = S::fma(b, g, *a);
                    }
                }
                d = d.add(outer.dz_pitch);
                x = x.wrapping_add(outer.pixel_pitch);
            }
        }
        for (m, row) in acc.iter().enumerate() {
            for (v, a) in row.iter().enumerate() {
                S::store(sums.add(m * outer.width + v * S::LANES), *a);
            }
        }
    }
}
