//! The one inner loop behind the forward pass and the gradient of the input.
//!
//! In `[batch, height, width, channels]` the three taps of a kernel row and all their channels are contiguous, so a convolution is a few
//! long dot products a pixel: no im2col buffer. A task copies a band of input rows into a small scratch with zeros around it (on the way
//! it may apply the previous layer's normalisation and activation, so that this need not be stored), then runs a register tile of
//! pixels x channels over it. Sums for batch norm are taken while the result is still in registers.
use crate::{
    pack::{Form, Panels},
    simd::{Isa, Simd, dispatch},
    winograd,
};
use rayon::prelude::*;
use std::cell::{Cell, RefCell};

/// Normalisation and activation applied to an input as it is read: `leaky(x * scale[c] + shift[c])`.
#[derive(Debug, Clone, Copy)]
pub struct Activation<'a> {
    /// A factor a channel.
    pub scale: &'a [f32],
    /// An offset a channel.
    pub shift: &'a [f32],
    /// Of the leaky unit, in (0, 1].
    pub slope: f32,
}

/// What happens to a finished tile.
#[derive(Clone, Copy)]
pub(crate) enum Finish<'a> {
    /// Written.
    Store,
    /// Added to what is there.
    Accumulate,
    /// Written, and summed a channel: see [`Gather::run`].
    Statistics,
    /// `leaky(value + bias[c])`, plus a residual of the output's shape where there is one.
    Activate { bias: &'a [f32], slope: f32, residual: Option<&'a [f32]> },
}

/// Taps that share weights, and the output pixels they make. A forward convolution has one group; the gradient of a strided one has a
/// group for each parity of row and column.
pub(crate) struct Group<'a> {
    pub weights: &'a Panels,
    /// Rows of the band that a pixel reads.
    pub rows: usize,
    /// Columns of the band that a pixel reads.
    pub columns: usize,
    /// Where grid pixel (g, h) lands in the output: row `g * out_step + first_row`, column alike.
    pub first_row: usize,
    pub first_column: usize,
}

/// A convolution over a source, seen as a grid of pixels that each read a small window.
pub(crate) struct Gather<'a> {
    pub batch: usize,
    /// `[batch, rows, columns, channels]`.
    pub source: &'a [f32],
    pub source_size: [usize; 3],
    pub activation: Option<Activation<'a>>,
    /// Rows and columns of the grid.
    pub grid: [usize; 2],
    /// Step of the window in the source from one grid pixel to the next.
    pub step: usize,
    /// Zeros above and left of the source.
    pub padding: usize,
    /// Rows and columns of the largest window.
    pub window: usize,
    pub groups: &'a [Group<'a>],
    /// Rows, columns, channels of an output image.
    pub out_size: [usize; 3],
    pub out_step: usize,
    pub finish: Finish<'a>,
}

/// Tasks that a call is cut into at least, where the shape allows: the same on every machine, so that sums over tasks do not depend on
/// the number of threads.
pub(crate) const MIN_TASKS: usize = 8;
/// Floats of a band's scratch: half of a 512 KiB second-level cache, the rest is for weights and output.
const BAND_FLOATS: usize = 40 * 1024;

/// Pixels that a band has at least, for so many weights: what does not fit a second-level cache should not be read for a few pixels.
pub(crate) fn least_pixels(weights: usize) -> usize {
    if weights > 256 * 1024 { 96 } else { 24 }
}

/// A pointer that tasks share; each writes its own pixels and channels.
#[derive(Clone, Copy)]
pub(crate) struct SharedMut(pub *mut f32);
// SAFETY: tasks write disjoint ranges, which each user of `SharedMut` argues where it writes.
unsafe impl Send for SharedMut {}
// SAFETY: as above.
unsafe impl Sync for SharedMut {}

impl SharedMut {
    /// The address `offset` floats on. (A method, so that closures capture the whole, which may cross threads, and not the bare pointer.)
    pub fn at(&self, offset: usize) -> *mut f32 {
        self.0.wrapping_add(offset)
    }
}

thread_local! {
    static SCRATCH: RefCell<Vec<f32>> = const { RefCell::new(Vec::new()) };
    /// See [`Gather::list_pixels`]; kept so that a call allocates nothing.
    static PIXELS: Cell<Vec<(u32, u32)>> = const { Cell::new(Vec::new()) };
}

/// Lends the thread's scratch, at least `len` floats of it, contents undefined.
pub(crate) fn with_scratch<R>(len: usize, f: impl FnOnce(&mut [f32]) -> R) -> R {
    SCRATCH.with(|cell| {
        // A task that is stolen while another waits on this thread finds the scratch in use; it gets one of its own.
        match cell.try_borrow_mut() {
            Ok(mut scratch) => {
                if scratch.len() < len {
                    scratch.resize(len, 0.0);
                }
                f(&mut scratch[..len])
            }
            Err(_) => f(&mut vec![0.0; len]),
        }
    })
}

/// Runs `tasks` on all threads. With [`Finish::Statistics`] each gets `3 * padded` floats for its channels' pivots, sums and sums of squares
/// (see [`Sums`]); `run` returns its pixels. They are added in f64, in the tasks' order.
pub(crate) fn run_tasks(
    tasks: usize,
    finish: Finish,
    channels: usize,
    padded: usize,
    run: impl Fn(usize, &mut [f32]) -> usize + Sync,
) -> Option<Vec<[f64; 2]>> {
    if !matches!(finish, Finish::Statistics) {
        (0..tasks).into_par_iter().with_max_len(1).for_each(|task| {
            run(task, &mut []);
        });
        return None;
    }
    let mut sums = vec![0f32; tasks * 3 * padded];
    let pixels: Vec<usize> = sums.par_chunks_mut(3 * padded).enumerate().with_max_len(1).map(|(task, sums)| run(task, sums)).collect();
    let mut total = vec![[0f64; 2]; channels];
    for (task, pixels) in sums.chunks_exact(3 * padded).zip(pixels) {
        for (c, t) in total.iter_mut().enumerate() {
            let [pivot, sum, square] = [0, 1, 2].map(|k| f64::from(task[k * padded + c]));
            // A task that shares its band with others has written some panels only; the others' three numbers are zeros and add nothing.
            let pixels = pixels as f64;
            t[0] += sum + pixels * pivot;
            t[1] += square + 2.0 * pivot * sum + pixels * pivot * pivot;
        }
    }
    Some(total)
}

/// Sums of a vector of channels over pixels, taken of the distance from a pivot: the first pixel's value. Where a channel varies little
/// around a large mean, plain sums of squares would lose its variance to rounding.
pub(crate) struct Sums<S: Simd> {
    pivot: S::V,
    sum: S::V,
    square: S::V,
}

impl<S: Simd> Sums<S> {
    /// None yet, around `pivot`.
    #[inline(always)]
    pub unsafe fn around(pivot: S::V) -> Self {
        // SAFETY: registers only.
        unsafe { Self { pivot, sum: S::splat(0.0), square: S::splat(0.0) } }
    }

    /// Those that [`Self::store`] left.
    #[inline(always)]
    unsafe fn load(from: &[f32], channel: usize) -> Self {
        // SAFETY: the caller vouches for a vector of channels from `channel` on.
        unsafe {
            let at = |k: usize| from.as_ptr().add(k * (from.len() / 3) + channel);
            Self { pivot: S::load(at(0)), sum: S::load(at(1)), square: S::load(at(2)) }
        }
    }

    #[inline(always)]
    pub unsafe fn add(&mut self, value: S::V) {
        // SAFETY: registers only.
        unsafe {
            let distance = S::sub(value, self.pivot);
            self.sum = S::add(self.sum, distance);
            self.square = S::fma(distance, distance, self.square);
        }
    }

    #[inline(always)]
    pub unsafe fn store(&self, to: &mut [f32], channel: usize) {
        // SAFETY: as in `load`.
        unsafe {
            let third = to.len() / 3;
            S::store(to.as_mut_ptr().add(channel), self.pivot);
            S::store(to.as_mut_ptr().add(third + channel), self.sum);
            S::store(to.as_mut_ptr().add(2 * third + channel), self.square);
        }
    }
}

impl Gather<'_> {
    fn band_columns(&self) -> usize {
        (self.grid[1] - 1) * self.step + self.window
    }

    /// True where a pixel reads just itself and nothing is applied on the way: no scratch is needed.
    fn reads_directly(&self) -> bool {
        self.window == 1 && self.step == 1 && self.activation.is_none()
    }

    /// Grid rows of a band, and parts that the output's panels are cut into.
    fn partition(&self) -> (usize, usize) {
        let row = self.band_columns() * self.source_size[2] * self.step;
        // A band of few pixels would read the weights too often, the more so where they fill the cache.
        let weights: usize = self.groups.iter().map(|g| g.weights.data.len()).sum();
        let least = least_pixels(weights).div_ceil(self.grid[1]);
        let mut rows = (BAND_FLOATS / row).max(least).clamp(1, self.grid[0]);
        while rows > 1 && self.batch * self.grid[0].div_ceil(rows) < MIN_TASKS && rows * self.grid[1] >= 96 && rows >= 2 * least {
            rows = rows.div_ceil(2);
        }
        rows = self.grid[0].div_ceil(self.grid[0].div_ceil(rows)); // bands of equal height
        let bands = self.batch * self.grid[0].div_ceil(rows);
        let panels = self.groups[0].weights.count();
        let mut parts = 1;
        while bands * parts < MIN_TASKS && parts * 2 <= panels {
            parts *= 2;
        }
        (rows, parts)
    }

    /// Runs it into `out` (`[batch, rows, columns, channels]`). With [`Finish::Statistics`] returns for every channel the sum and the sum
    /// of squares, in f64 over the tasks' f32 sums, in the tasks' order.
    pub fn run(&self, out: &mut [f32]) -> Option<Vec<[f64; 2]>> {
        let [out_rows, out_columns, channels] = self.out_size;
        assert_eq!(out.len(), self.batch * out_rows * out_columns * channels);
        assert_eq!(self.source.len(), self.batch * self.source_size.iter().product::<usize>());
        if let Finish::Activate { bias, residual, .. } = self.finish {
            assert!(bias.len() == channels && residual.is_none_or(|r| r.len() == out.len()));
        }
        if self.groups[0].weights.form == Form::Winograd {
            return winograd::run(self, out);
        }
        for group in self.groups {
            assert!(group.weights.k == group.rows * group.columns * self.source_size[2] && group.weights.channels == channels);
            assert!(group.rows <= self.window && group.columns <= self.window);
            assert!(group.weights.form == Form::Direct && group.weights.width == 2 * group.weights.isa.lanes());
        }
        let (rows, parts) = self.partition();
        let bands = self.grid[0].div_ceil(rows);
        let padded = self.groups[0].weights.count() * self.groups[0].weights.width;
        let to = SharedMut(out.as_mut_ptr());
        let mut pixels = PIXELS.take();
        self.list_pixels(rows, &mut pixels);
        let total = run_tasks(self.batch * bands * parts, self.finish, channels, padded, |task, sums| {
            let (image, band, part) = (task / (bands * parts), task / parts % bands, task % parts);
            let grid_rows = band * rows..((band + 1) * rows).min(self.grid[0]);
            self.task(image, grid_rows.clone(), part, parts, &pixels, to, sums);
            grid_rows.len() * self.grid[1]
        });
        PIXELS.set(pixels);
        total
    }

    /// Where the pixels of a band of `rows` grid rows are read in the band and written in the output, from the band's first row on; for
    /// each group in turn, rows first. All bands have the same list, the last one takes the beginning of it.
    fn list_pixels(&self, rows: usize, pixels: &mut Vec<(u32, u32)>) {
        let [_, out_columns, channels] = self.out_size;
        let pitch = self.band_columns() * self.source_size[2];
        pixels.clear();
        for group in self.groups {
            for g in 0..rows {
                for h in 0..self.columns_of(group) {
                    let from = g * self.step * pitch + h * self.step * self.source_size[2];
                    let to = (g * self.out_step * out_columns + h * self.out_step + group.first_column) * channels;
                    pixels.push((from as u32, to as u32));
                }
            }
        }
    }

    /// Columns of the grid whose pixel of this group lies in the output.
    fn columns_of(&self, group: &Group) -> usize {
        (self.out_size[1] - group.first_column).div_ceil(self.out_step).min(self.grid[1])
    }

    #[allow(clippy::too_many_arguments)]
    fn task(
        &self,
        image: usize,
        grid_rows: std::ops::Range<usize>,
        part: usize,
        parts: usize,
        pixels: &[(u32, u32)],
        out: SharedMut,
        sums: &mut [f32],
    ) {
        let source_len: usize = self.source_size.iter().product();
        let source = &self.source[image * source_len..(image + 1) * source_len];
        if self.reads_directly() {
            let first = grid_rows.start * self.grid[1] * self.source_size[2];
            self.compute(image, grid_rows, part, parts, pixels, &source[first..], out, sums);
            return;
        }
        let band_rows = (grid_rows.len() - 1) * self.step + self.window;
        with_scratch(band_rows * self.band_columns() * self.source_size[2], |scratch| {
            copy_band(&self.band(grid_rows.start, band_rows), source, scratch);
            self.compute(image, grid_rows, part, parts, pixels, scratch, out, sums);
        });
    }

    fn band(&self, first_grid_row: usize, rows: usize) -> Band<'_> {
        Band {
            source_size: self.source_size,
            first_row: (first_grid_row * self.step) as isize - self.padding as isize,
            rows,
            columns: self.band_columns(),
            padding: self.padding,
            activation: self.activation,
            isa: self.groups[0].weights.isa,
        }
    }

    #[allow(clippy::too_many_arguments)]
    fn compute(
        &self,
        image: usize,
        rows: std::ops::Range<usize>,
        part: usize,
        parts: usize,
        pixels: &[(u32, u32)],
        band: &[f32],
        out: SharedMut,
        sums: &mut [f32],
    ) {
        let [out_rows, out_columns, channels] = self.out_size;
        let pitch = self.band_columns() * self.source_size[2];
        let full_rows = pixels.len() / self.groups.iter().map(|g| self.columns_of(g)).sum::<usize>();
        let mut runs = [0usize; 3];
        let mut pixels = pixels;
        for group in self.groups {
            let (listed, others) = pixels.split_at(full_rows * self.columns_of(group));
            pixels = others;
            // The grid's last row may have no pixel of this group.
            let group_rows = (out_rows - group.first_row).div_ceil(self.out_step).min(rows.end).saturating_sub(rows.start);
            let listed = &listed[..group_rows * self.columns_of(group)];
            let runs = &mut runs[..group.rows];
            runs.iter_mut().enumerate().for_each(|(r, run)| *run = r * pitch);
            let run_len = group.columns * self.source_size[2];
            let first = (rows.start * self.out_step + group.first_row) * out_columns * channels;
            if let (Some(last), Some(run)) = (listed.last(), runs.last()) {
                assert!(last.0 as usize + run + run_len <= band.len());
                assert!(first + last.1 as usize + channels <= out_rows * out_columns * channels);
            }
            let count = group.weights.count();
            let image_offset = image * out_rows * out_columns * channels + first;
            let work = Work {
                pixels: listed,
                runs,
                run_len,
                band: band.as_ptr(),
                out: out.at(image_offset),
                residual_offset: image_offset,
                weights: group.weights,
                panels: part * count / parts..(part + 1) * count / parts,
                finish: self.finish,
            };
            run_work(group.weights.isa, &work, sums);
        }
    }
}

/// A band of source rows with its padding.
pub(crate) struct Band<'a> {
    pub source_size: [usize; 3],
    /// May be negative: rows above the source are zeros.
    pub first_row: isize,
    pub rows: usize,
    pub columns: usize,
    pub padding: usize,
    pub activation: Option<Activation<'a>>,
    pub isa: Isa,
}

/// Copies a band of one image into `scratch` (`[rows, columns, channels]`), zeros outside.
pub(crate) fn copy_band(band: &Band, source: &[f32], scratch: &mut [f32]) {
    let [height, width, channels] = band.source_size;
    let left = band.padding * channels;
    // The band may be narrower than source and padding (strides), or wider (a window over the far edge).
    let inside = (width * channels).min(band.columns * channels - left);
    for (r, row) in scratch.chunks_exact_mut(band.columns * channels).take(band.rows).enumerate() {
        let y = band.first_row + r as isize;
        if y < 0 || y >= height as isize {
            row.fill(0.0);
            continue;
        }
        let from = &source[y as usize * width * channels..][..inside];
        row[..left].fill(0.0);
        row[left + inside..].fill(0.0);
        let to = &mut row[left..left + inside];
        match band.activation {
            None => to.copy_from_slice(from),
            Some(a) => crate::norm::activate_row(band.isa, from, a, to),
        }
    }
}

struct Work<'a> {
    pixels: &'a [(u32, u32)],
    runs: &'a [usize],
    run_len: usize,
    band: *const f32,
    out: *mut f32,
    residual_offset: usize,
    weights: &'a Panels,
    panels: std::ops::Range<usize>,
    finish: Finish<'a>,
}

fn run_work(isa: Isa, work: &Work, sums: &mut [f32]) {
    dispatch!(isa, work_body::<S>(work: &Work, sums: &mut [f32]))
}

/// # Safety
/// Every pixel's window lies in the band and every output pixel in the output (checked by `Gather::compute`); the panels are packed for `S`.
#[inline(always)]
unsafe fn work_body<S: Simd>(work: &Work, sums: &mut [f32]) {
    let panels = work.weights;
    for p in work.panels.clone() {
        let first = p * panels.width;
        // SAFETY: `first` is below `channels`; a panel has `width` floats for each k.
        unsafe { if panels.channels - first > S::LANES { panel_body::<S, 2>(work, p, sums) } else { panel_body::<S, 1>(work, p, sums) } }
    }
}

#[inline(always)]
unsafe fn panel_body<S: Simd, const V: usize>(work: &Work, panel: usize, sums: &mut [f32]) {
    // SAFETY: see `work_body`.
    unsafe {
        let weights = work.weights.data.as_ptr().add(panel * work.weights.k * work.weights.width);
        // The kernel rows of a picture's three channels are so short that their loop must not be one.
        match work.run_len {
            9 => all_tiles::<S, V, 9>(work, weights, panel, sums),
            _ => all_tiles::<S, V, 0>(work, weights, panel, sums),
        }
    }
}

/// `RUN`: the length of a run where it is known beforehand, else 0.
#[inline(always)]
unsafe fn all_tiles<S: Simd, const V: usize, const RUN: usize>(work: &Work, weights: *const f32, panel: usize, sums: &mut [f32]) {
    // SAFETY: see `work_body`.
    unsafe {
        let mut pixels = work.pixels;
        if V == 1 {
            // One vector alone needs more pixels to hide the latency of the multiply-adds.
            tiles::<S, 8, V, RUN>(work, &mut pixels, weights, panel, sums);
        }
        match S::TILE {
            12 => tiles::<S, 12, V, RUN>(work, &mut pixels, weights, panel, sums),
            6 => tiles::<S, 6, V, RUN>(work, &mut pixels, weights, panel, sums),
            _ => {}
        }
        tiles::<S, 4, V, RUN>(work, &mut pixels, weights, panel, sums);
        tiles::<S, 2, V, RUN>(work, &mut pixels, weights, panel, sums);
        tiles::<S, 1, V, RUN>(work, &mut pixels, weights, panel, sums);
    }
}

#[inline(always)]
unsafe fn tiles<S: Simd, const P: usize, const V: usize, const RUN: usize>(
    work: &Work,
    pixels: &mut &[(u32, u32)],
    weights: *const f32,
    panel: usize,
    sums: &mut [f32],
) {
    let run_len = if RUN > 0 { RUN } else { work.run_len };
    while let Some((tile, rest)) = pixels.split_first_chunk::<P>() {
        *pixels = rest;
        // SAFETY: see `work_body`.
        unsafe {
            let mut acc = [[S::splat(0.0); V]; P];
            let mut w = weights;
            for &run in work.runs {
                let mut from = [work.band; P];
                for (f, t) in from.iter_mut().zip(tile) {
                    *f = f.add(t.0 as usize + run);
                }
                for j in 0..run_len {
                    let mut wv = [S::splat(0.0); V];
                    for (v, x) in wv.iter_mut().enumerate() {
                        *x = S::load(w.add(v * S::LANES));
                    }
                    for p in 0..P {
                        let b = S::splat(*from[p].add(j));
                        for v in 0..V {
                            acc[p][v] = S::fma(b, wv[v], acc[p][v]);
                        }
                    }
                    w = w.add(2 * S::LANES);
                }
            }
            // A copy of its own: `finish_tile` indexes it at run time, which would keep the accumulators of the loop above in memory.
            let mut done = [[S::splat(0.0); V]; P];
            for p in 0..P {
                for v in 0..V {
                    done[p][v] = acc[p][v];
                }
            }
            finish_tile::<S, P, V>(work, tile, panel * work.weights.width, &mut done, sums);
        }
    }
}

#[inline(always)]
unsafe fn finish_tile<S: Simd, const P: usize, const V: usize>(
    work: &Work,
    tile: &[(u32, u32); P],
    first: usize,
    acc: &mut [[S::V; V]; P],
    sums: &mut [f32],
) {
    // SAFETY: see `work_body`; the last vector of a pixel is written only as far as its channels go.
    unsafe {
        for v in 0..V {
            let channel = first + v * S::LANES;
            let lanes = work.weights.channels.saturating_sub(channel).min(S::LANES);
            if let Finish::Statistics = work.finish {
                let first = tile.as_ptr() == work.pixels.as_ptr();
                let mut s = if first { Sums::<S>::around(acc[0][v]) } else { Sums::<S>::load(sums, channel) };
                for a in acc.iter() {
                    s.add(a[v]);
                }
                s.store(sums, channel);
            }
            for p in 0..P {
                finish_vector::<S>(work.finish, acc[p][v], work.out, work.residual_offset, tile[p].1 as usize, channel, lanes);
            }
        }
    }
}

/// Writes one vector of a pixel: `lanes` channels from `channel` on, of the pixel `at` floats into the image `out`, which begins
/// `image_offset` floats into the whole output.
#[inline(always)]
pub(crate) unsafe fn finish_vector<S: Simd>(
    finish: Finish,
    value: S::V,
    out: *mut f32,
    image_offset: usize,
    at: usize,
    channel: usize,
    lanes: usize,
) {
    // SAFETY: the caller vouches for `lanes` floats of the output; bias and residual have its channels and its shape (`Gather::run`).
    unsafe {
        let to = out.add(at + channel);
        let value = match finish {
            Finish::Store | Finish::Statistics => value,
            Finish::Accumulate => S::add(value, load_lanes::<S>(to, lanes)),
            Finish::Activate { bias, slope, residual } => {
                let z = S::add(value, load_lanes::<S>(bias.as_ptr().add(channel), lanes));
                let y = S::max(z, S::mul(z, S::splat(slope)));
                match residual {
                    Some(r) => S::add(y, load_lanes::<S>(r.as_ptr().add(image_offset + at + channel), lanes)),
                    None => y,
                }
            }
        };
        store_lanes::<S>(to, value, lanes);
    }
}

/// The first `lanes` floats, zeros behind them.
#[inline(always)]
pub(crate) unsafe fn load_lanes<S: Simd>(from: *const f32, lanes: usize) -> S::V {
    // SAFETY: the caller vouches for `lanes` floats.
    unsafe {
        if lanes == S::LANES {
            return S::load(from);
        }
        let mut buffer = [0f32; 16];
        for (k, b) in buffer.iter_mut().enumerate().take(lanes) {
            *b = *from.add(k);
        }
        S::load(buffer.as_ptr())
    }
}

/// Writes the first `lanes` floats only.
#[inline(always)]
pub(crate) unsafe fn store_lanes<S: Simd>(to: *mut f32, v: S::V, lanes: usize) {
    // SAFETY: the caller vouches for `lanes` floats.
    unsafe {
        if lanes == S::LANES {
            return S::store(to, v);
        }
        let mut buffer = [0f32; 16];
        S::store(buffer.as_mut_ptr(), v);
        for (k, b) in buffer.iter().enumerate().take(lanes) {
            *to.add(k) = *b;
        }
    }
}
