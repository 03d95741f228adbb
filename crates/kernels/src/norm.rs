//! Batch norm with leaky activation over `[pixels, channels]`: one pass forward, two backward.
//!
//! Forward writes `y = leaky(z * scale + shift) (+ residual)` with `scale = gamma / sqrt(var + epsilon)` and `shift = beta - mean * scale`.
//! Backward recomputes from `z` what it needs, so that nothing but `z` is kept.
use crate::{
    gather::{Activation, SharedMut, load_lanes, store_lanes},
    simd::{Isa, Simd, dispatch},
};
use rayon::prelude::*;

/// Per-channel constants of a batch norm in one step.
#[derive(Debug, Clone)]
pub struct Affine {
    /// `gamma * inverse_deviation`.
    pub scale: Vec<f32>,
    /// `beta - mean * scale`.
    pub shift: Vec<f32>,
    /// Of the batch, or the running one.
    pub mean: Vec<f32>,
    /// `1 / sqrt(variance + epsilon)`.
    pub inverse_deviation: Vec<f32>,
}

impl Affine {
    /// From statistics (mean and biased variance) and parameters.
    #[must_use]
    pub fn new(mean: Vec<f32>, variance: &[f32], gamma: &[f32], beta: &[f32], epsilon: f32) -> Self {
        let inverse_deviation: Vec<f32> = variance.iter().map(|v| 1.0 / (v + epsilon).sqrt()).collect();
        let scale: Vec<f32> = gamma.iter().zip(&inverse_deviation).map(|(g, i)| g * i).collect();
        let shift = beta.iter().zip(&mean).zip(&scale).map(|((b, m), s)| b - m * s).collect();
        Self { scale, shift, mean, inverse_deviation }
    }

    /// As applied on the way into the next convolution.
    #[must_use]
    pub fn activation(&self, slope: f32) -> Activation<'_> {
        Activation { scale: &self.scale, shift: &self.shift, slope }
    }
}

/// Mean and biased variance of each channel from its sums over `pixels`.
#[must_use]
pub fn mean_and_variance(sums: &[[f64; 2]], pixels: usize) -> (Vec<f32>, Vec<f32>) {
    let n = pixels as f64;
    sums.iter()
        .map(|[s, q]| {
            let mean = s / n;
            (mean as f32, (q / n - mean * mean).max(0.0) as f32)
        })
        .unzip()
}

/// Pixels that a task takes: about 64 KiB of a tensor, the same on every machine.
fn pixels_per_task(channels: usize) -> usize {
    (16 * 1024 / channels).max(1)
}

/// `out = leaky(z * scale + shift) (+ residual)`, all `[pixels, channels]`.
pub fn activate(isa: Isa, z: &[f32], activation: Activation, residual: Option<&[f32]>, out: &mut [f32]) {
    let channels = activation.scale.len();
    assert!(z.len() == out.len() && z.len().is_multiple_of(channels) && residual.is_none_or(|r| r.len() == z.len()));
    let chunk = pixels_per_task(channels) * channels;
    out.par_chunks_mut(chunk).enumerate().for_each(|(i, out)| {
        let range = i * chunk..i * chunk + out.len();
        row(isa, &z[range.clone()], activation, residual.map(|r| &r[range]), out);
    });
}

/// One thread's worth of [`activate`], without a residual.
pub(crate) fn activate_row(isa: Isa, from: &[f32], activation: Activation, to: &mut [f32]) {
    row(isa, from, activation, None, to);
}

fn row(isa: Isa, from: &[f32], a: Activation, residual: Option<&[f32]>, to: &mut [f32]) {
    assert!(from.len() == to.len() && a.scale.len() == a.shift.len() && from.len().is_multiple_of(a.scale.len()));
    assert!(residual.is_none_or(|r| r.len() == from.len()));
    dispatch!(isa.filled_by(a.scale.len()), row_body::<S>(from: &[f32], a: Activation, residual: Option<&[f32]>, to: &mut [f32]))
}

/// # Safety
/// Lengths as asserted by `row`.
#[inline(always)]
unsafe fn row_body<S: Simd>(from: &[f32], a: Activation, residual: Option<&[f32]>, to: &mut [f32]) {
    let channels = a.scale.len();
    // SAFETY: every access stays below `channels` within a pixel.
    unsafe {
        let slope = S::splat(a.slope);
        let mut c = 0;
        while c < channels {
            let lanes = S::LANES.min(channels - c);
            let (scale, shift) = (load_lanes::<S>(a.scale.as_ptr().add(c), lanes), load_lanes::<S>(a.shift.as_ptr().add(c), lanes));
            let mut at = c;
            while at < from.len() {
                let z = S::fma(load_lanes::<S>(from.as_ptr().add(at), lanes), scale, shift);
                let mut y = S::max(z, S::mul(z, slope));
                if let Some(r) = residual {
                    y = S::add(y, load_lanes::<S>(r.as_ptr().add(at), lanes));
                }
                store_lanes::<S>(to.as_mut_ptr().add(at), y, lanes);
                at += channels;
            }
            c += S::LANES;
        }
    }
}

/// What the backward pass of batch norm and activation yields besides the gradient of `z`.
#[derive(Debug, Clone)]
pub struct NormGradients {
    /// Of gamma.
    pub gamma: Vec<f32>,
    /// Of beta.
    pub beta: Vec<f32>,
}

/// Turns the gradient of `leaky(z * scale + shift)` into that of `z`, written over `z`, and gives those of gamma and beta. `frozen`: the
/// statistics were constants (running ones), so no gradient flows through them.
pub fn backward(isa: Isa, gradient: &[f32], affine: &Affine, slope: f32, frozen: bool, z: &mut [f32]) -> NormGradients {
    let channels = affine.scale.len();
    assert!(gradient.len() == z.len() && z.len().is_multiple_of(channels));
    let chunk = pixels_per_task(channels) * channels;
    // Sums of g' and g' * (z - mean) a channel, in f32 over a task and f64 over tasks, in their order.
    let parts: Vec<Vec<f32>> = gradient
        .par_chunks(chunk)
        .zip(z.par_chunks(chunk))
        .map(|(g, z)| {
            let mut sums = vec![0f32; 2 * channels];
            backward_sums(isa, g, z, affine, slope, &mut sums);
            sums
        })
        .collect();
    let mut totals = vec![[0f64; 2]; channels];
    for part in &parts {
        for (c, t) in totals.iter_mut().enumerate() {
            t[0] += f64::from(part[c]);
            t[1] += f64::from(part[channels + c]);
        }
    }
    let n = (z.len() / channels) as f64;
    let mut gradients = NormGradients { gamma: vec![0.0; channels], beta: vec![0.0; channels] };
    // dz = scale * (g' - mean(g') - zhat * mean(g' zhat)) = a * g' + b * (z - mean) + c, with zhat = (z - mean) * inverse_deviation. The
    // mean is taken off first, here and in the sums: where it is large beside the deviation, the difference of products would be rounding.
    let mut lines = [vec![0f32; channels], vec![0f32; channels]];
    for c in 0..channels {
        let inverse = f64::from(affine.inverse_deviation[c]);
        let (beta, gamma) = (totals[c][0], totals[c][1] * inverse);
        gradients.beta[c] = beta as f32;
        gradients.gamma[c] = gamma as f32;
        if !frozen {
            let scale = f64::from(affine.scale[c]);
            lines[0][c] = (-scale * gamma / n * inverse) as f32;
            lines[1][c] = (-scale * beta / n) as f32;
        }
    }
    let to = SharedMut(z.as_mut_ptr());
    let tasks = z.len().div_ceil(chunk);
    let len = z.len();
    (0..tasks).into_par_iter().for_each(|i| {
        let range = i * chunk..((i + 1) * chunk).min(len);
        // SAFETY: tasks take disjoint ranges of `z`, which outlives them.
        #[allow(unsafe_code)]
        let z = unsafe { std::slice::from_raw_parts_mut(to.at(range.start), range.len()) };
        backward_apply(isa, &gradient[range], affine, slope, &lines, z);
    });
    gradients
}

fn backward_sums(isa: Isa, g: &[f32], z: &[f32], affine: &Affine, slope: f32, sums: &mut [f32]) {
    dispatch!(isa.filled_by(affine.scale.len()), sums_body::<S>(g: &[f32], z: &[f32], affine: &Affine, slope: f32, sums: &mut [f32]))
}

/// # Safety
/// `g` and `z` have the same length, a multiple of the channels.
#[inline(always)]
unsafe fn sums_body<S: Simd>(g: &[f32], z: &[f32], affine: &Affine, slope: f32, sums: &mut [f32]) {
    let channels = affine.scale.len();
    // SAFETY: every access stays below `channels` within a pixel.
    unsafe {
        let mut c = 0;
        while c < channels {
            let lanes = S::LANES.min(channels - c);
            let load = |v: &[f32]| load_lanes::<S>(v.as_ptr().add(c), lanes);
            let (scale, shift, mean) = (load(&affine.scale), load(&affine.shift), load(&affine.mean));
            // Two of each, so that additions do not wait for each other.
            let (mut s, mut q) = ([S::splat(0.0); 2], [S::splat(0.0); 2]);
            let mut at = c;
            let mut k = 0;
            while at < g.len() {
                let zv = load_lanes::<S>(z.as_ptr().add(at), lanes);
                let gv = S::mul(load_lanes::<S>(g.as_ptr().add(at), lanes), S::leaky_factor(S::fma(zv, scale, shift), slope));
                s[k] = S::add(s[k], gv);
                q[k] = S::fma(gv, S::sub(zv, mean), q[k]);
                k ^= 1;
                at += channels;
            }
            store_lanes::<S>(sums.as_mut_ptr().add(c), S::add(s[0], s[1]), lanes);
            store_lanes::<S>(sums.as_mut_ptr().add(channels + c), S::add(q[0], q[1]), lanes);
            c += S::LANES;
        }
    }
}

fn backward_apply(isa: Isa, g: &[f32], affine: &Affine, slope: f32, lines: &[Vec<f32>; 2], z: &mut [f32]) {
    dispatch!(isa.filled_by(affine.scale.len()), apply_body::<S>(g: &[f32], affine: &Affine, slope: f32, lines: &[Vec<f32>; 2], z: &mut [f32]))
}

/// # Safety
/// As `sums_body`.
#[inline(always)]
unsafe fn apply_body<S: Simd>(g: &[f32], affine: &Affine, slope: f32, lines: &[Vec<f32>; 2], z: &mut [f32]) {
    let channels = affine.scale.len();
    // SAFETY: every access stays below `channels` within a pixel.
    unsafe {
        let mut c = 0;
        while c < channels {
            let lanes = S::LANES.min(channels - c);
            let load = |v: &[f32]| load_lanes::<S>(v.as_ptr().add(c), lanes);
            let (scale, shift, mean) = (load(&affine.scale), load(&affine.shift), load(&affine.mean));
            let (line, constant) = (load(&lines[0]), load(&lines[1]));
            let mut at = c;
            while at < g.len() {
                let zv = load_lanes::<S>(z.as_ptr().add(at), lanes);
                let gv = S::mul(load_lanes::<S>(g.as_ptr().add(at), lanes), S::leaky_factor(S::fma(zv, scale, shift), slope));
                store_lanes::<S>(z.as_mut_ptr().add(at), S::fma(gv, scale, S::fma(S::sub(zv, mean), line, constant)), lanes);
                at += channels;
            }
            c += S::LANES;
        }
    }
}
