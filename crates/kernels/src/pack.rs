//! Weights rearranged so that the inner loop reads them in order.
//!
//! A panel holds `width` output channels (two vectors): `[panel][k][width]`, where `k` runs over the inputs in the order in which the
//! kernel meets them. The last panel is filled up with zeros.
use crate::{ConvShape, buffer::buffer, simd::Isa, winograd};
use rayon::prelude::*;

/// Packed weights of one group of taps.
#[derive(Debug, Clone)]
pub struct Panels {
    /// `[panel][k][width]`; for [`Form::Winograd`] `[panel][point][k][width]`.
    pub(crate) data: Vec<f32>,
    /// Inputs of one output: taps times channels; for [`Form::Winograd`] channels alone.
    pub(crate) k: usize,
    /// Output channels of a panel.
    pub(crate) width: usize,
    /// Output channels in all.
    pub(crate) channels: usize,
    /// Whose vectors a panel is made for.
    pub(crate) isa: Isa,
    /// What the numbers are.
    pub(crate) form: Form,
}

/// How a convolution is computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Form {
    /// A dot product over the window.
    Direct,
    /// Products of transformed 4 x 4 windows: see [`crate::winograd`].
    Winograd,
}

impl Panels {
    /// For `channels` outputs of `k` inputs, filled a panel at a time: `fill(first channel, channels, panel)` writes these channels of
    /// every row; the others are zeros.
    pub(crate) fn pack(isa: Isa, form: Form, channels: usize, k: usize, fill: impl Fn(usize, usize, &mut [f32]) + Sync) -> Self {
        let width = 2 * isa.lanes();
        let panel = width * k * if form == Form::Winograd { winograd::POINTS } else { 1 };
        let len = channels.div_ceil(width) * panel;
        // Only a panel that is not full keeps zeros.
        let mut data = if channels.is_multiple_of(width) { buffer(len) } else { vec![0f32; len] };
        data.par_chunks_mut(panel).enumerate().for_each(|(p, panel)| fill(p * width, width.min(channels - p * width), panel));
        Self { data, k, width, channels, isa, form }
    }

    /// Number of panels.
    pub(crate) fn count(&self) -> usize {
        self.channels.div_ceil(self.width)
    }
}

/// The forward weights for one batch of this shape, from `[out, in, kernel, kernel]`: k runs over (row, column, input channel).
#[must_use]
pub fn forward(isa: Isa, shape: &ConvShape, weight: &[f32]) -> Panels {
    if winograd::pays(shape) { pack_once(isa, shape, weight) } else { direct(isa, shape, weight) }
}

/// As [`forward`], for weights that are packed once and used for many pictures of any size: what it takes to pack them does not count.
#[must_use]
pub fn pack_once(isa: Isa, shape: &ConvShape, weight: &[f32]) -> Panels {
    if winograd::applies(shape) { winograd::pack_forward(isa, shape, weight) } else { direct(isa, shape, weight) }
}

/// Channels that are packed at once.
const CHANNELS: usize = 16;

fn direct(isa: Isa, shape: &ConvShape, weight: &[f32]) -> Panels {
    let (cin, taps) = (shape.in_channels, shape.kernel * shape.kernel);
    assert_eq!(weight.len(), shape.weight_len());
    let isa = isa.filled_by(shape.out_channels);
    let (k, width) = (taps * cin, 2 * isa.lanes());
    Panels::pack(isa, Form::Direct, shape.out_channels, k, |first, lanes, panel| {
        // A few channels at once, so that lines that are read are read to their end while what is written stays near.
        for c in (0..cin).step_by(CHANNELS) {
            let channels = CHANNELS.min(cin - c);
            for lane in 0..lanes {
                let from = &weight[(first + lane) * k + c * taps..][..channels * taps];
                for (c, from) in (c..).zip(from.chunks_exact(taps)) {
                    for (tap, from) in from.iter().enumerate() {
                        panel[(tap * cin + c) * width + lane] = *from;
                    }
                }
            }
        }
    })
}

/// The weights of the gradient of the input: the roles of input and output channels exchanged, k over (row, column, output channel) for
/// the taps `rows` x `columns` of the forward kernel, in this order.
#[must_use]
pub(crate) fn transposed(isa: Isa, shape: &ConvShape, weight: &[f32], rows: &[usize], columns: &[usize]) -> Panels {
    let (cin, cout, all) = (shape.in_channels, shape.out_channels, shape.kernel * shape.kernel);
    assert_eq!(weight.len(), shape.weight_len());
    let taps: Vec<usize> = rows.iter().flat_map(|row| columns.iter().map(move |column| row * shape.kernel + column)).collect();
    if winograd::pays(shape) {
        return winograd::pack_transposed(isa, shape, weight);
    }
    let isa = isa.filled_by(cin);
    let width = 2 * isa.lanes();
    Panels::pack(isa, Form::Direct, cin, taps.len() * cout, |first, lanes, panel| {
        for o in 0..cout {
            let from = &weight[(o * cin + first) * all..][..lanes * all];
            for (t, tap) in taps.iter().enumerate() {
                let to = &mut panel[(t * cout + o) * width..][..lanes];
                for (to, from) in to.iter_mut().zip(from[*tap..].iter().step_by(all)) {
                    *to = *from;
                }
            }
        }
    })
}
