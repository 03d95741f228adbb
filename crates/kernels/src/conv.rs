//! Convolutions over `[batch, height, width, channels]`: forward and the gradient of the input. The gradient of the weights is in
//! [`crate::weight_gradient`].
use crate::{
    ConvShape,
    gather::{Activation, Finish, Gather, Group},
    matrix::{Matrix, multiply_add},
    pack::{self, Panels},
    simd::Isa,
};
use rayon::prelude::*;

fn run(
    shape: &ConvShape,
    x: &[f32],
    weights: &Panels,
    activation: Option<Activation>,
    finish: Finish,
    out: &mut [f32],
) -> Option<Vec<[f64; 2]>> {
    shape.check();
    let gather = Gather {
        batch: shape.batch,
        source: x,
        source_size: [shape.height, shape.width, shape.in_channels],
        activation,
        grid: [shape.out_height(), shape.out_width()],
        step: shape.stride,
        padding: shape.padding(),
        window: shape.kernel,
        groups: &[Group { weights, rows: shape.kernel, columns: shape.kernel, first_row: 0, first_column: 0 }],
        out_size: [shape.out_height(), shape.out_width(), shape.out_channels],
        out_step: 1,
        finish,
    };
    gather.run(out)
}

/// The plain convolution of `x` with packed weights ([`pack::forward`]) into `out`.
pub fn forward(shape: &ConvShape, x: &[f32], weights: &Panels, out: &mut [f32]) {
    run(shape, x, weights, None, Finish::Store, out);
}

/// As [`forward`], with an activation applied to `x` on the way in, and with each output channel's sum and sum of squares on the way out.
pub fn forward_with_statistics(
    shape: &ConvShape,
    x: &[f32],
    activation: Option<Activation>,
    weights: &Panels,
    out: &mut [f32],
) -> Vec<[f64; 2]> {
    run(shape, x, weights, activation, Finish::Statistics, out).unwrap_or_default()
}

/// What inference does to a convolution's result before it is written.
#[derive(Debug, Clone, Copy)]
pub struct Epilogue<'a> {
    /// Added to each output channel (batch norm folded).
    pub bias: &'a [f32],
    /// Of the leaky unit; 1 for none.
    pub slope: f32,
    /// Added after the activation; of the output's shape.
    pub residual: Option<&'a [f32]>,
}

/// `leaky(convolution + bias) + residual` in one pass.
pub fn forward_activated(shape: &ConvShape, x: &[f32], weights: &Panels, epilogue: Epilogue, out: &mut [f32]) {
    let Epilogue { bias, slope, residual } = epilogue;
    run(shape, x, weights, None, Finish::Activate { bias, slope, residual }, out);
}

/// As [`forward_activated`] for any kernel and stride, as one product with a matrix of all windows: slower, and memory for that matrix.
/// `weight` is `[out, in, kernel, kernel]`.
pub fn forward_plain(shape: &ConvShape, x: &[f32], weight: &[f32], epilogue: Epilogue, out: &mut [f32]) {
    let (window, pad) = (shape.in_channels * shape.kernel * shape.kernel, shape.padding());
    let mut windows = vec![0.0; shape.out_pixels() * window];
    windows.par_chunks_mut(window).enumerate().for_each(|(pixel, window)| {
        let (row, column) = (pixel / shape.out_width() % shape.out_height(), pixel % shape.out_width());
        let first = pixel / (shape.out_height() * shape.out_width()) * shape.height;
        for (tap, (dy, dx)) in (0..shape.kernel).flat_map(|dy| (0..shape.kernel).map(move |dx| (dy, dx))).enumerate() {
            let (y, x_at) = (row * shape.stride + dy, column * shape.stride + dx);
            if (pad..shape.height + pad).contains(&y) && (pad..shape.width + pad).contains(&x_at) {
                let from = ((first + y - pad) * shape.width + x_at - pad) * shape.in_channels;
                for (c, value) in x[from..from + shape.in_channels].iter().enumerate() {
                    window[c * shape.kernel * shape.kernel + tap] = *value;
                }
            }
        }
    });
    let rows = Matrix::new(weight, shape.out_channels, window).transposed();
    multiply_add(out, 0.0, 1.0, Matrix::new(&windows, shape.out_pixels(), window), rows);
    let Epilogue { bias, slope, residual } = epilogue;
    for (at, value) in out.iter_mut().enumerate() {
        let z = *value + bias[at % shape.out_channels];
        *value = z.max(slope * z) + residual.map_or(0.0, |r| r[at]);
    }
}

/// The gradient of the convolution's input from that of its output, `weight` as `[out, in, kernel, kernel]`; written to `dx`, or added
/// to what is there.
pub fn input_gradient(isa: Isa, shape: &ConvShape, dz: &[f32], weight: &[f32], accumulate: bool, dx: &mut [f32]) {
    shape.check();
    // Tap k of a forward row reads input i = stride * o + k - padding. At stride 1 that is a convolution with the taps in reverse order; at
    // stride 2 even inputs meet tap 1 of output i / 2, odd ones tap 2 of output (i - 1) / 2 and tap 0 of the next.
    let taps: Vec<(usize, Vec<usize>)> = match (shape.kernel, shape.stride) {
        (1, _) => vec![(0, vec![0])],
        (_, 1) => vec![(0, vec![2, 1, 0])],
        _ => vec![(0, vec![1]), (1, vec![2, 0])],
    };
    let pairs: Vec<_> = taps.iter().flat_map(|r| taps.iter().map(move |c| (r, c))).collect();
    let packed: Vec<Panels> = pairs.iter().map(|(r, c)| pack::transposed(isa, shape, weight, &r.1, &c.1)).collect();
    let group = |((r, c), weights): (&(&(usize, Vec<usize>), &(usize, Vec<usize>)), _)| Group {
        weights,
        rows: r.1.len(),
        columns: c.1.len(),
        first_row: r.0,
        first_column: c.0,
    };
    let groups: Vec<Group> = pairs.iter().zip(&packed).map(group).collect();
    let strided = shape.stride == 2;
    Gather {
        batch: shape.batch,
        source: dz,
        source_size: [shape.out_height(), shape.out_width(), shape.out_channels],
        activation: None,
        grid: if strided { [shape.height.div_ceil(2), shape.width.div_ceil(2)] } else { [shape.height, shape.width] },
        step: 1,
        padding: if strided { 0 } else { shape.padding() },
        window: if strided { 2 } else { shape.kernel },
        groups: &groups,
        out_size: [shape.height, shape.width, shape.in_channels],
        out_step: shape.stride,
        finish: if accumulate { Finish::Accumulate } else { Finish::Store },
    }
    .run(dx);
}
