//! The transforms, vector by vector of channels. Matrices as in the paper that the module names.
#![allow(clippy::needless_range_loop)] // columns: the index runs across several rows at once
use crate::{
    gather::{load_lanes, store_lanes},
    simd::Simd,
};

/// One line of `B' d`.
#[inline(always)]
unsafe fn window_line<S: Simd>(a: [S::V; 4]) -> [S::V; 4] {
    // SAFETY: registers only.
    unsafe { [S::sub(a[0], a[2]), S::add(a[1], a[2]), S::sub(a[2], a[1]), S::sub(a[1], a[3])] }
}

/// One line of `A' m`.
#[inline(always)]
unsafe fn tile_line<S: Simd>(a: [S::V; 4]) -> [S::V; 2] {
    // SAFETY: registers only.
    unsafe { [S::add(S::add(a[0], a[1]), a[2]), S::sub(S::sub(a[1], a[2]), a[3])] }
}

/// One line of `A dY`.
#[inline(always)]
unsafe fn tile_gradient_line<S: Simd>(a: [S::V; 2]) -> [S::V; 4] {
    // SAFETY: registers only.
    unsafe { [a[0], S::add(a[0], a[1]), S::sub(a[0], a[1]), S::sub(S::splat(0.0), a[1])] }
}

/// One line of `G g`.
#[inline(always)]
unsafe fn kernel_line<S: Simd>(a: [S::V; 3]) -> [S::V; 4] {
    // SAFETY: registers only.
    unsafe {
        let half = S::splat(0.5);
        let (even, odd) = (S::mul(half, S::add(a[0], a[2])), S::mul(half, a[1]));
        [a[0], S::add(even, odd), S::sub(even, odd), a[2]]
    }
}

/// One line of `G' u`.
#[inline(always)]
unsafe fn kernel_gradient_line<S: Simd>(a: [S::V; 4]) -> [S::V; 3] {
    // SAFETY: registers only.
    unsafe {
        let half = S::splat(0.5);
        let (sum, difference) = (S::mul(half, S::add(a[1], a[2])), S::mul(half, S::sub(a[1], a[2])));
        [S::add(a[0], sum), difference, S::add(sum, a[3])]
    }
}

/// `A' m A`: a tile of 2 x 2 from the sixteen products, `m[row][column]`.
#[inline(always)]
pub(super) unsafe fn tile<S: Simd>(m: [[S::V; 4]; 4]) -> [[S::V; 2]; 2] {
    // SAFETY: registers only.
    unsafe {
        let r = [tile_line::<S>(m[0]), tile_line::<S>(m[1]), tile_line::<S>(m[2]), tile_line::<S>(m[3])];
        let left = tile_line::<S>([r[0][0], r[1][0], r[2][0], r[3][0]]);
        let right = tile_line::<S>([r[0][1], r[1][1], r[2][1], r[3][1]]);
        [[left[0], right[0]], [left[1], right[1]]]
    }
}

/// `G g G'` for two vectors of kernels, `taps[tap][width]`; point p is written `p * pitch` on.
///
/// # Safety
/// `to` holds two vectors behind each of the sixteen offsets.
#[inline(always)]
pub(super) unsafe fn kernels<S: Simd>(taps: &[f32; 9 * 32], to: &mut [f32], pitch: usize) {
    // SAFETY: nine rows of two vectors are read from `taps`; the caller vouches for `to`.
    unsafe {
        for v in 0..2 {
            let mut rows = [[S::splat(0.0); 4]; 3];
            for (r, row) in rows.iter_mut().enumerate() {
                let at = taps.as_ptr().add((6 * r + v) * S::LANES);
                *row = kernel_line::<S>([S::load(at), S::load(at.add(2 * S::LANES)), S::load(at.add(4 * S::LANES))]);
            }
            for c in 0..4 {
                for (r, value) in kernel_line::<S>([rows[0][c], rows[1][c], rows[2][c]]).into_iter().enumerate() {
                    S::store(to.as_mut_ptr().add((4 * r + c) * pitch + v * S::LANES), value);
                }
            }
        }
    }
}

/// `G' u G` for two vectors of kernels, from points `pitch` apart to `taps[tap][width]`.
///
/// # Safety
/// `from` holds two vectors behind each of the sixteen offsets.
#[inline(always)]
pub(super) unsafe fn kernel_gradients<S: Simd>(from: &[f32], pitch: usize, taps: &mut [f32; 9 * 32]) {
    // SAFETY: as in `kernels`.
    unsafe {
        for v in 0..2 {
            let mut rows = [[S::splat(0.0); 3]; 4];
            for (r, row) in rows.iter_mut().enumerate() {
                let at = from.as_ptr().add(4 * r * pitch + v * S::LANES);
                *row = kernel_gradient_line::<S>([
                    S::load(at),
                    S::load(at.add(pitch)),
                    S::load(at.add(2 * pitch)),
                    S::load(at.add(3 * pitch)),
                ]);
            }
            for c in 0..3 {
                let column = kernel_gradient_line::<S>([rows[0][c], rows[1][c], rows[2][c], rows[3][c]]);
                for (r, value) in column.into_iter().enumerate() {
                    S::store(taps.as_mut_ptr().add((2 * (3 * r + c) + v) * S::LANES), value);
                }
            }
        }
    }
}

/// A band of pixels with its padding, and where its windows go.
pub(super) struct Source {
    pub band: *const f32,
    /// Floats of a row of the band.
    pub row_pitch: usize,
    /// Rows of tiles.
    pub rows: usize,
    /// Tiles in a row.
    pub columns: usize,
    pub channels: usize,
    /// `[point][tile][channel]`.
    pub to: *mut f32,
    /// Floats from one point to the next.
    pub pitch: usize,
}

/// Windows of 4 x 4, two pixels apart.
///
/// # Safety
/// The band has `2 * rows + 2` rows of `2 * columns + 2` pixels, `to` room for all tiles at every point.
#[inline(always)]
pub(super) unsafe fn windows<S: Simd>(s: &Source) {
    // SAFETY: see above; vectors end with the pixel's channels.
    unsafe {
        for row in 0..s.rows {
            for column in 0..s.columns {
                let from = s.band.add(2 * row * s.row_pitch + 2 * column * s.channels);
                let to = s.to.add((row * s.columns + column) * s.channels);
                let mut c = 0;
                while c < s.channels {
                    let lanes = S::LANES.min(s.channels - c);
                    let mut rows = [[S::splat(0.0); 4]; 4];
                    for (r, row) in rows.iter_mut().enumerate() {
                        let at = from.add(r * s.row_pitch + c);
                        *row = window_line::<S>([
                            load_lanes::<S>(at, lanes),
                            load_lanes::<S>(at.add(s.channels), lanes),
                            load_lanes::<S>(at.add(2 * s.channels), lanes),
                            load_lanes::<S>(at.add(3 * s.channels), lanes),
                        ]);
                    }
                    for k in 0..4 {
                        let column = window_line::<S>([rows[0][k], rows[1][k], rows[2][k], rows[3][k]]);
                        for (r, value) in column.into_iter().enumerate() {
                            store_lanes::<S>(to.add((4 * r + k) * s.pitch + c), value, lanes);
                        }
                    }
                    c += S::LANES;
                }
            }
        }
    }
}

/// Gradients of tiles that go to the points of one panel.
pub(super) struct TileGradients {
    /// The image's gradient, `[height, width, channels]`, at the panel's first channel.
    pub from: *const f32,
    pub height: usize,
    pub width: usize,
    pub channels: usize,
    /// Channels of the panel.
    pub lanes: usize,
    /// First row of tiles, and how many.
    pub first_row: usize,
    pub rows: usize,
    pub columns: usize,
    /// `[point][tile][panel width]`.
    pub to: *mut f32,
    pub pitch: usize,
    pub panel: usize,
}

/// `A dY A'` of every tile; pixels outside the image count as zeros.
///
/// # Safety
/// `from` is as its fields say, `to` has room for all tiles at every point.
#[inline(always)]
pub(super) unsafe fn tile_gradients<S: Simd>(g: &TileGradients) {
    // SAFETY: see above.
    unsafe {
        for row in 0..g.rows {
            for column in 0..g.columns {
                let (y, x) = (2 * (g.first_row + row), 2 * column);
                let to = g.to.add((row * g.columns + column) * g.panel);
                let mut c = 0;
                while c < g.panel {
                    let lanes = S::LANES.min(g.lanes.saturating_sub(c));
                    let mut pixels = [[S::splat(0.0); 2]; 2];
                    for (dy, pixels) in pixels.iter_mut().enumerate() {
                        for (dx, pixel) in pixels.iter_mut().enumerate() {
                            if lanes > 0 && y + dy < g.height && x + dx < g.width {
                                *pixel = load_lanes::<S>(g.from.add(((y + dy) * g.width + x + dx) * g.channels + c), lanes);
                            }
                        }
                    }
                    let rows = [tile_gradient_line::<S>(pixels[0]), tile_gradient_line::<S>(pixels[1])];
                    for k in 0..4 {
                        for (r, value) in tile_gradient_line::<S>([rows[0][k], rows[1][k]]).into_iter().enumerate() {
                            S::store(to.add((4 * r + k) * g.pitch + c), value);
                        }
                    }
                    c += S::LANES;
                }
            }
        }
    }
}
