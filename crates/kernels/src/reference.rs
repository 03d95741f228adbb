//! Plain loops with f64 sums: the judge of every kernel. Slow on purpose.
use crate::ConvShape;

/// Calls `f(output pixel, input pixel, tap)` for every pair inside the image, of every image.
fn pairs(shape: &ConvShape, mut f: impl FnMut(usize, usize, usize)) {
    let (oh, ow, pad) = (shape.out_height(), shape.out_width(), shape.padding());
    for n in 0..shape.batch {
        for oy in 0..oh {
            for ox in 0..ow {
                for ky in 0..shape.kernel {
                    for kx in 0..shape.kernel {
                        let (y, x) = (oy * shape.stride + ky, ox * shape.stride + kx);
                        if y >= pad && x >= pad && y - pad < shape.height && x - pad < shape.width {
                            f((n * oh + oy) * ow + ox, (n * shape.height + y - pad) * shape.width + x - pad, ky * shape.kernel + kx);
                        }
                    }
                }
            }
        }
    }
}

/// The convolution of `x` (`[batch, height, width, in]`) with `weight` (`[out, in, kernel, kernel]`).
#[must_use]
pub fn forward(shape: &ConvShape, x: &[f32], weight: &[f32]) -> Vec<f64> {
    let (cin, cout, taps) = (shape.in_channels, shape.out_channels, shape.kernel * shape.kernel);
    let mut out = vec![0f64; shape.output_len()];
    pairs(shape, |o, i, tap| {
        for c in 0..cout {
            for k in 0..cin {
                out[o * cout + c] += f64::from(x[i * cin + k]) * f64::from(weight[(c * cin + k) * taps + tap]);
            }
        }
    });
    out
}

/// The gradient of the input.
#[must_use]
pub fn input_gradient(shape: &ConvShape, dz: &[f32], weight: &[f32]) -> Vec<f64> {
    let (cin, cout, taps) = (shape.in_channels, shape.out_channels, shape.kernel * shape.kernel);
    let mut dx = vec![0f64; shape.input_len()];
    pairs(shape, |o, i, tap| {
        for c in 0..cout {
            for k in 0..cin {
                dx[i * cin + k] += f64::from(dz[o * cout + c]) * f64::from(weight[(c * cin + k) * taps + tap]);
            }
        }
    });
    dx
}

/// The gradient of the weights.
#[must_use]
pub fn weight_gradient(shape: &ConvShape, x: &[f32], dz: &[f32]) -> Vec<f64> {
    let (cin, cout, taps) = (shape.in_channels, shape.out_channels, shape.kernel * shape.kernel);
    let mut dw = vec![0f64; shape.weight_len()];
    pairs(shape, |o, i, tap| {
        for c in 0..cout {
            for k in 0..cin {
                dw[(c * cin + k) * taps + tap] += f64::from(dz[o * cout + c]) * f64::from(x[i * cin + k]);
            }
        }
    });
    dw
}
