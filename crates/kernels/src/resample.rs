//! Upsampling and max pooling over `[batch, height, width, channels]`, with their gradients. Memory traffic only: plain loops over rows.
use crate::buffer::buffer;
use rayon::prelude::*;

/// `[batch, channels, pixels]` to `[batch, pixels, channels]`.
#[must_use]
pub fn interleave(planes: &[f32], batch: usize, pixels: usize, channels: usize) -> Vec<f32> {
    assert_eq!(planes.len(), batch * pixels * channels);
    let mut out = buffer(planes.len());
    // A stretch of pixels whose planes and result stay in the first-level cache.
    let stretch = (2048 / channels).clamp(16, pixels.max(16));
    out.par_chunks_mut(pixels * channels).zip(planes.par_chunks(pixels * channels)).for_each(|(out, planes)| {
        out.par_chunks_mut(stretch * channels).with_min_len(8).enumerate().for_each(|(k, out)| {
            let count = out.len() / channels;
            for (c, plane) in planes.chunks_exact(pixels).enumerate() {
                for (to, from) in out[c..].iter_mut().step_by(channels).zip(&plane[k * stretch..][..count]) {
                    *to = *from;
                }
            }
        });
    });
    out
}

/// Each pixel repeated 2 x 2.
#[must_use]
pub fn upsample(x: &[f32], size: [usize; 4]) -> Vec<f32> {
    let mut out = buffer(4 * x.len());
    upsample_into(x, size, &mut out);
    out
}

/// As [`upsample`], into a buffer of four times the length.
pub fn upsample_into(x: &[f32], [batch, height, width, channels]: [usize; 4], out: &mut [f32]) {
    assert!(x.len() == batch * height * width * channels && out.len() == 4 * x.len());
    let row = width * channels;
    out.par_chunks_mut(4 * row).zip(x.par_chunks(row)).for_each(|(out, x)| {
        let (upper, lower) = out.split_at_mut(2 * row);
        for (to, from) in upper.chunks_exact_mut(2 * channels).zip(x.chunks_exact(channels)) {
            to[..channels].copy_from_slice(from);
            to[channels..].copy_from_slice(from);
        }
        lower.copy_from_slice(upper);
    });
}

/// The gradient of [`upsample`]'s input, whose size is given: each pixel gathers its four copies'.
#[must_use]
pub fn upsample_gradient(gradient: &[f32], [batch, height, width, channels]: [usize; 4]) -> Vec<f32> {
    assert_eq!(gradient.len(), 4 * batch * height * width * channels);
    let row = width * channels;
    let mut out = buffer(batch * height * row);
    out.par_chunks_mut(row).zip(gradient.par_chunks(4 * row)).for_each(|(out, g)| {
        let (upper, lower) = g.split_at(2 * row);
        for (x, to) in out.chunks_exact_mut(channels).enumerate() {
            let at = 2 * x * channels;
            for (c, to) in to.iter_mut().enumerate() {
                let (left, right) = (at + c, at + channels + c);
                *to = upper[left] + upper[right] + lower[left] + lower[right];
            }
        }
    });
    out
}

/// Maximum over 2 x 2 windows, which are cut at the right and lower edge; with it, which of the four won (row * 2 + column, the first of
/// equals).
#[must_use]
pub fn max_pool(x: &[f32], size: [usize; 4], stride: usize) -> (Vec<f32>, Vec<u8>) {
    let len = size[0] * size[1].div_ceil(stride) * size[2].div_ceil(stride) * size[3];
    let (mut out, mut winners) = (buffer(len), vec![0u8; len]);
    let row = size[2].div_ceil(stride) * size[3];
    out.par_chunks_mut(row).zip(winners.par_chunks_mut(row)).enumerate().for_each(|(r, (out, winners))| {
        pool_row(x, size, stride, r, |k, to, value| {
            if k == 0 || value > out[to] {
                out[to] = value;
                winners[to] = k as u8;
            }
        });
    });
    (out, winners)
}

/// As [`max_pool`], into a buffer and without the winners.
pub fn max_pool_into(x: &[f32], size: [usize; 4], stride: usize, out: &mut [f32]) {
    let row = size[2].div_ceil(stride) * size[3];
    assert_eq!(out.len(), size[0] * size[1].div_ceil(stride) * row);
    out.par_chunks_mut(row).enumerate().for_each(|(r, out)| {
        pool_row(x, size, stride, r, |k, to, value| {
            if k == 0 || value > out[to] {
                out[to] = value;
            }
        });
    });
}

/// Shows `see` the values of one output row: which of the window's four, index within the row, value; the first of each window comes first.
#[inline(always)]
fn pool_row(x: &[f32], [batch, height, width, channels]: [usize; 4], stride: usize, row: usize, mut see: impl FnMut(usize, usize, f32)) {
    assert_eq!(x.len(), batch * height * width * channels);
    let (out_height, out_width) = (height.div_ceil(stride), width.div_ceil(stride));
    let (image, y) = (row / out_height, row % out_height * stride);
    for k in 0..4 {
        let (source_row, shift) = (y + k / 2, k % 2);
        if source_row >= height {
            break;
        }
        let from = &x[(image * height + source_row) * width * channels..][..width * channels];
        for column in 0..out_width {
            let source = column * stride + shift;
            if source < width {
                for (c, v) in from[source * channels..(source + 1) * channels].iter().enumerate() {
                    see(k, column * channels + c, *v);
                }
            }
        }
    }
}

/// The gradient of [`max_pool`]'s input, whose size is given.
#[must_use]
pub fn max_pool_gradient(gradient: &[f32], winners: &[u8], [batch, height, width, channels]: [usize; 4], stride: usize) -> Vec<f32> {
    let (out_height, out_width) = (height.div_ceil(stride), width.div_ceil(stride));
    assert!(gradient.len() == batch * out_height * out_width * channels && winners.len() == gradient.len());
    let mut out = vec![0f32; batch * height * width * channels];
    // Windows overlap at stride 1, so a task takes a whole image.
    out.par_chunks_mut(height * width * channels).enumerate().for_each(|(image, out)| {
        for y in 0..out_height {
            for x in 0..out_width {
                let at = ((image * out_height + y) * out_width + x) * channels;
                for c in 0..channels {
                    let k = usize::from(winners[at + c]);
                    out[((y * stride + k / 2) * width + x * stride + k % 2) * channels + c] += gradient[at + c];
                }
            }
        }
    });
    out
}
