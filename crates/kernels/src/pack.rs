//! Weights rearranged so that the inner loop reads them in order.
//!
//! A panel holds `width` output channels (two vectors): `[panel][k][width]`, where `k` runs over the inputs in the order in which the
//! kernel meets them. The last panel is filled up with zeros.
use crate::{ConvShape, simd::Isa};
use rayon::prelude::*;

/// Packed weights of one group of taps.
#[derive(Debug, Clone, Default)]
pub struct Panels {
    /// `[panel][k][width]`.
    pub(crate) data: Vec<f32>,
    /// Inputs of one output: taps times channels.
    pub(crate) k: usize,
    /// Output channels of a panel.
    pub(crate) width: usize,
    /// Output channels in all.
    pub(crate) channels: usize,
}

impl Panels {
    /// Packs `channels` outputs of `k` inputs; `fill(c, column)` writes the inputs of output `c` through `column(k, value)`.
    fn pack(isa: Isa, channels: usize, k: usize, fill: impl Fn(usize, &mut dyn FnMut(usize, f32)) + Sync) -> Self {
        let width = 2 * isa.lanes();
        let panels = channels.div_ceil(width);
        let mut data = vec![0f32; panels * k * width];
        data.par_chunks_mut(k * width).enumerate().for_each(|(p, panel)| {
            for lane in 0..width.min(channels - p * width) {
                fill(p * width + lane, &mut |at, value| panel[at * width + lane] = value);
            }
        });
        Self { data, k, width, channels }
    }

    /// Number of panels.
    pub(crate) fn count(&self) -> usize {
        self.channels.div_ceil(self.width)
    }
}

/// The forward weights, from `[out, in, kernel, kernel]`: k runs over (row, column, input channel).
#[must_use]
pub fn forward(isa: Isa, shape: &ConvShape, weight: &[f32]) -> Panels {
    let (cin, taps) = (shape.in_channels, shape.kernel * shape.kernel);
    assert_eq!(weight.len(), shape.weight_len());
    let width = 2 * isa.lanes();
    let k = taps * cin;
    let panels = shape.out_channels.div_ceil(width);
    let mut data = vec![0f32; panels * k * width];
    data.par_chunks_mut(k * width).enumerate().for_each(|(p, panel)| {
        let first = p * width;
        let lanes = width.min(shape.out_channels - first);
        // Tap by tap, so that writes go out in order; the 16 rows being read stay in the cache.
        for tap in 0..taps {
            for (c, row) in panel[tap * cin * width..(tap + 1) * cin * width].chunks_exact_mut(width).enumerate() {
                for (lane, to) in row[..lanes].iter_mut().enumerate() {
                    *to = weight[(first + lane) * k + c * taps + tap];
                }
            }
        }
    });
    Panels { data, k, width, channels: shape.out_channels }
}

/// The weights of the gradient of the input: the roles of input and output channels exchanged, k over (row, column, output channel) for
/// the taps `rows` x `columns` of the forward kernel, in this order.
#[must_use]
pub(crate) fn transposed(isa: Isa, shape: &ConvShape, weight: &[f32], rows: &[usize], columns: &[usize]) -> Panels {
    let (cin, cout, kernel) = (shape.in_channels, shape.out_channels, shape.kernel);
    assert_eq!(weight.len(), shape.weight_len());
    Panels::pack(isa, cin, rows.len() * columns.len() * cout, |c, put| {
        for (r, &row) in rows.iter().enumerate() {
            for (q, &column) in columns.iter().enumerate() {
                let at = (r * columns.len() + q) * cout;
                for o in 0..cout {
                    put(at + o, weight[((o * cin + c) * kernel + row) * kernel + column]);
                }
            }
        }
    })
}
