//! Upsampling and max pooling over `[batch, height, width, channels]`, with their gradients. Memory traffic only: plain loops over rows.
use crate::buffer::buffer;
use rayon::prelude::*;

/// `[batch, channels, pixels]` to `[batch, pixels, channels]`.
#[must_use]
pub fn interleave(planes: &[f32], batch: usize, pixels: usize, channels: usize) -> Vec<f32> {
    let mut out = buffer(planes.len());
    interleave_into(planes, batch, pixels, channels, &mut out);
    out
}

/// As [`interleave`], into a buffer of the same length.
pub fn interleave_into(planes: &[f32], batch: usize, pixels: usize, channels: usize, out: &mut [f32]) {
    assert!(planes.len() == batch * pixels * channels && out.len() == planes.len());
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
        let pixels = out.chunks_exact_mut(size[3]).zip(winners.chunks_exact_mut(size[3]));
        for ((out, winners), [a, b, c, d]) in pixels.zip(windows(x, size, stride, r)) {
            let seen = a.iter().zip(b).zip(c.iter().zip(d));
            for ((out, winner), ((a, b), (c, d))) in out.iter_mut().zip(winners).zip(seen) {
                // Without branches, which would be guessed wrong.
                let (upper, lower) = (if b > a { *b } else { *a }, if d > c { *d } else { *c });
                let below = lower > upper;
                *out = if below { lower } else { upper };
                *winner = if below { 2 + u8::from(d > c) } else { u8::from(b > a) };
            }
        }
    });
    (out, winners)
}

/// As [`max_pool`], into a buffer and without the winners.
pub fn max_pool_into(x: &[f32], size: [usize; 4], stride: usize, out: &mut [f32]) {
    let row = size[2].div_ceil(stride) * size[3];
    assert_eq!(out.len(), size[0] * size[1].div_ceil(stride) * row);
    out.par_chunks_mut(row).with_min_len(2).enumerate().for_each(|(r, out)| {
        for (out, [a, b, c, d]) in out.chunks_exact_mut(size[3]).zip(windows(x, size, stride, r)) {
            for ((out, (a, b)), (c, d)) in out.iter_mut().zip(a.iter().zip(b)).zip(c.iter().zip(d)) {
                let (upper, lower) = (if b > a { *b } else { *a }, if d > c { *d } else { *c });
                *out = if lower > upper { lower } else { upper };
            }
        }
    });
}

/// The windows of one output row: four pixels each, upper row first. A pixel beyond the edge stands for its neighbour, which changes no maximum.
fn windows(x: &[f32], [batch, height, width, channels]: [usize; 4], stride: usize, row: usize) -> impl Iterator<Item = [&[f32]; 4]> {
    assert_eq!(x.len(), batch * height * width * channels);
    let (image, y) = (row / height.div_ceil(stride), row % height.div_ceil(stride) * stride);
    let line = |y: usize| &x[(image * height + y.min(height - 1)) * width * channels..][..width * channels];
    let (upper, lower) = (line(y), line(y + 1));
    (0..width.div_ceil(stride)).map(move |column| {
        let (left, right) = (column * stride * channels, (column * stride + 1).min(width - 1) * channels);
        [&upper[left..left + channels], &upper[right..right + channels], &lower[left..left + channels], &lower[right..right + channels]]
    })
}

/// The gradient of [`max_pool`]'s input, whose size is given.
#[must_use]
pub fn max_pool_gradient(gradient: &[f32], winners: &[u8], [batch, height, width, channels]: [usize; 4], stride: usize) -> Vec<f32> {
    let (out_height, out_width) = (height.div_ceil(stride), width.div_ceil(stride));
    assert!(gradient.len() == batch * out_height * out_width * channels && winners.len() == gradient.len());
    let mut out = vec![0f32; batch * height * width * channels];
    // Windows overlap at stride 1, so that a task takes a whole image; else it takes the rows of a few windows.
    let rows = if stride == 1 { height } else { (16 * 1024 / (width * channels)).next_multiple_of(2).min(height) };
    let images = out.par_chunks_mut(height * width * channels).enumerate();
    images.for_each(|(image, out)| {
        out.par_chunks_mut(rows * width * channels).enumerate().for_each(|(band, out)| {
            let first = image * out_height + band * rows / stride;
            for y in 0..(out.len() / (width * channels)).div_ceil(stride) {
                for x in 0..out_width {
                    let at = ((first + y) * out_width + x) * channels;
                    for k in 0..4 {
                        let (row, column) = (y * stride + k / 2, x * stride + k % 2);
                        if column >= width || (row * width + column) * channels >= out.len() {
                            continue;
                        }
                        let to = &mut out[(row * width + column) * channels..][..channels];
                        for (to, (g, w)) in to.iter_mut().zip(gradient[at..at + channels].iter().zip(&winners[at..at + channels])) {
                            *to += if usize::from(*w) == k { *g } else { 0.0 };
                        }
                    }
                }
            }
        });
    });
    out
}

/// The sum of two activations.
pub fn add_into(a: &[f32], b: &[f32], out: &mut [f32]) {
    assert!(a.len() == out.len() && b.len() == out.len());
    const CHUNK: usize = 16 * 1024;
    let tasks = out.par_chunks_mut(CHUNK).zip(a.par_chunks(CHUNK)).zip(b.par_chunks(CHUNK));
    tasks.for_each(|((out, a), b)| out.iter_mut().zip(a.iter().zip(b)).for_each(|(o, (a, b))| *o = a + b));
}

/// Copies `[pixels, channels]` to the channels from `first` on of `[pixels, all]`.
pub fn concat_into(part: &[f32], channels: usize, first: usize, all: usize, out: &mut [f32]) {
    assert!(part.len().is_multiple_of(channels) && out.len() == part.len() / channels * all && first + channels <= all);
    let pixels = (16 * 1024 / all).max(1);
    out.par_chunks_mut(pixels * all).zip(part.par_chunks(pixels * channels)).for_each(|(out, part)| {
        for (to, from) in out.chunks_exact_mut(all).zip(part.chunks_exact(channels)) {
            to[first..first + channels].copy_from_slice(from);
        }
    });
}

/// `[pixels, channels]` to `[channels, pixels]`.
pub fn planes_into(values: &[f32], channels: usize, out: &mut [f32]) {
    assert_eq!(values.len(), out.len());
    let pixels = values.len() / channels;
    // Sixteen planes at a time: each cache line is read once.
    out.par_chunks_mut(16 * pixels).enumerate().for_each(|(k, planes)| {
        let count = planes.len() / pixels;
        for (p, from) in values.chunks_exact(channels).enumerate() {
            for (c, value) in from[16 * k..16 * k + count].iter().enumerate() {
                planes[c * pixels + p] = *value;
            }
        }
    });
}
