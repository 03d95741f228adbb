//! Upsampling and max pooling over `[batch, height, width, channels]`, with their gradients. Memory traffic only: plain loops over rows.
use crate::buffer::buffer;
use rayon::prelude::*;

/// Each pixel repeated 2 x 2.
#[must_use]
pub fn upsample(x: &[f32], [batch, height, width, channels]: [usize; 4]) -> Vec<f32> {
    assert_eq!(x.len(), batch * height * width * channels);
    let mut out = buffer(4 * x.len());
    let row = width * channels;
    out.par_chunks_mut(4 * row).zip(x.par_chunks(row)).for_each(|(out, x)| {
        let (upper, lower) = out.split_at_mut(2 * row);
        for (to, from) in upper.chunks_exact_mut(2 * channels).zip(x.chunks_exact(channels)) {
            to[..channels].copy_from_slice(from);
            to[channels..].copy_from_slice(from);
        }
        lower.copy_from_slice(upper);
    });
    out
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
pub fn max_pool(x: &[f32], [batch, height, width, channels]: [usize; 4], stride: usize) -> (Vec<f32>, Vec<u8>) {
    assert_eq!(x.len(), batch * height * width * channels);
    let (out_height, out_width) = (height.div_ceil(stride), width.div_ceil(stride));
    let row = out_width * channels;
    let mut out = buffer(batch * out_height * row);
    let mut winners = vec![0u8; out.len()];
    out.par_chunks_mut(row).zip(winners.par_chunks_mut(row)).enumerate().for_each(|(r, (out, winners))| {
        let (image, y) = (r / out_height, r % out_height * stride);
        for k in 0..4 {
            let (source_row, shift) = (y + k / 2, k % 2);
            if source_row >= height {
                break;
            }
            let from = &x[(image * height + source_row) * width * channels..][..width * channels];
            for column in 0..out_width {
                let source = column * stride + shift;
                if source >= width {
                    continue;
                }
                let values = &from[source * channels..(source + 1) * channels];
                let range = column * channels..(column + 1) * channels;
                for ((o, w), v) in out[range.clone()].iter_mut().zip(&mut winners[range]).zip(values) {
                    if k == 0 || *v > *o {
                        *o = *v;
                        *w = k as u8;
                    }
                }
            }
        }
    });
    (out, winners)
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
