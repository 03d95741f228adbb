//! Winograd's F(2x2, 3x3): 3x3 convolutions of stride 1 with 16 multiplications where the plain sum takes 36.
//!
//! The output is cut into tiles of 2 x 2, each of which reads a 4 x 4 window of the input. With the matrices of Lavin and Gray, "Fast
//! Algorithms for Convolutional Neural Networks" (CVPR 2016), a tile is `A' [(G g G') * (B' d B)] A`: additions, sixteen products of
//! matrices (tiles x inputs by inputs x outputs, one a point of the window), additions. The gradient of the input is a convolution of the same
//! kind; that of the weights is `G' [(A dY A') (B' d B)] G`, a sum over tiles, with the same transforms.
//!
//! A task takes some rows of tiles, over images where these are small, and transforms them into its scratch; what is written once is read from
//! the second-level cache, and nothing but the output goes to memory.
mod forward;
mod gradient;
mod transform;

use crate::{
    ConvShape,
    gather::{Activation, Band, copy_band},
    pack::{Form, Panels},
    simd::{Isa, dispatch},
};
pub(crate) use forward::run;
pub(crate) use gradient::weight_gradient;

/// Numbers that a window is transformed into.
pub(crate) const POINTS: usize = 16;
/// Floats from one point's matrix to the next are made no multiple of a page: sixteen streams would share a few sets of the cache.
const SKEW: usize = 16;
/// Fewer channels than this, in or out, are not worth the transforms.
const LEAST_CHANNELS: usize = 16;

/// Tiles in a batch below which a training step would spend more on transforming the weights than it saves.
const LEAST_TILES: usize = 128;

/// Whether a convolution can be computed this way, with gain once its weights are transformed.
pub(crate) fn applies(shape: &ConvShape) -> bool {
    (shape.kernel, shape.stride) == (3, 1) && shape.in_channels.min(shape.out_channels) >= LEAST_CHANNELS
}

/// Whether a training step computes a convolution and its gradients this way: a function of the shape alone.
pub(crate) fn pays(shape: &ConvShape) -> bool {
    applies(shape) && shape.batch * shape.height.div_ceil(2) * shape.width.div_ceil(2) >= LEAST_TILES
}

/// The forward weights, from `[out, in, 3, 3]`.
pub(crate) fn pack_forward(isa: Isa, shape: &ConvShape, weight: &[f32]) -> Panels {
    let cin = shape.in_channels;
    assert_eq!(weight.len(), shape.weight_len());
    pack(isa, shape.out_channels, cin, |o, i| &weight[(o * cin + i) * 9..][..9], false)
}

/// The weights of the gradient of the input: roles of the channels exchanged, taps in reverse order.
pub(crate) fn pack_transposed(isa: Isa, shape: &ConvShape, weight: &[f32]) -> Panels {
    let cin = shape.in_channels;
    assert_eq!(weight.len(), shape.weight_len());
    pack(isa, cin, shape.out_channels, |i, o| &weight[(o * cin + i) * 9..][..9], true)
}

/// `[panel][point][input][width]` from the nine taps that `kernel(output, input)` gives.
fn pack<'a>(isa: Isa, outputs: usize, inputs: usize, kernel: impl Fn(usize, usize) -> &'a [f32] + Sync, reversed: bool) -> Panels {
    let isa = isa.filled_by(outputs);
    Panels::pack(isa, Form::Winograd, outputs, inputs, |first, lanes, panel| {
        let width = 2 * isa.lanes();
        let mut taps = [0f32; 9 * 32];
        for i in 0..inputs {
            for lane in 0..lanes {
                for (t, value) in kernel(first + lane, i).iter().enumerate() {
                    taps[if reversed { 8 - t } else { t } * width + lane] = *value;
                }
            }
            let to = &mut panel[i * width..];
            assert!(to.len() > (POINTS - 1) * inputs * width);
            transform_kernels(isa, &taps, to, inputs * width);
        }
    })
}

fn transform_kernels(isa: Isa, taps: &[f32; 9 * 32], to: &mut [f32], pitch: usize) {
    use transform::kernels;
    dispatch!(isa, kernels::<S>(taps: &[f32; 9 * 32], to: &mut [f32], pitch: usize));
}

/// Rows of tiles of a batch of images, numbered through.
#[derive(Clone, Copy)]
struct Tiles {
    batch: usize,
    height: usize,
    width: usize,
}

impl Tiles {
    /// Rows of tiles in an image.
    fn rows(&self) -> usize {
        self.height.div_ceil(2)
    }

    /// Tiles in a row.
    fn columns(&self) -> usize {
        self.width.div_ceil(2)
    }

    /// Rows of tiles in all images.
    fn units(&self) -> usize {
        self.batch * self.rows()
    }

    /// Floats of a band of `rows` rows of tiles with `channels` a pixel, zeros around included.
    fn band_len(&self, rows: usize, channels: usize) -> usize {
        (2 * rows + 2) * self.band_columns() * channels
    }

    fn band_columns(&self) -> usize {
        2 * self.columns() + 2
    }

    /// Rows of tiles that are copied at a time: a band stays in the first levels of the cache, and few rows are copied twice.
    fn band_rows(&self, channels: usize) -> usize {
        (16 * 1024 / (2 * self.band_columns() * channels)).clamp(1, self.rows())
    }
}

/// The transformed windows of some rows of tiles: `[point][tile][channel]`.
struct Windows<'a> {
    isa: Isa,
    tiles: Tiles,
    source: &'a [f32],
    channels: usize,
    activation: Option<Activation<'a>>,
    /// Rows of tiles, numbered through the batch.
    units: std::ops::Range<usize>,
}

impl Windows<'_> {
    /// Floats from one point's matrix to the next.
    fn pitch(&self) -> usize {
        self.units.len() * self.tiles.columns() * self.channels + SKEW
    }

    /// Floats of `to` and `band` in [`Self::write`].
    fn lens(&self) -> (usize, usize) {
        (POINTS * self.pitch(), self.tiles.band_len(self.tiles.band_rows(self.channels), self.channels))
    }

    fn write(&self, band: &mut [f32], to: &mut [f32]) {
        let (rows, pitch, columns) = (self.tiles.rows(), self.pitch(), self.tiles.columns());
        let image_len = self.tiles.height * self.tiles.width * self.channels;
        let most = self.tiles.band_rows(self.channels);
        let mut unit = self.units.start;
        while unit < self.units.end {
            let (image, row) = (unit / rows, unit % rows);
            let count = most.min(rows - row).min(self.units.end - unit);
            let copied = Band {
                source_size: [self.tiles.height, self.tiles.width, self.channels],
                first_row: 2 * row as isize - 1,
                rows: 2 * count + 2,
                columns: self.tiles.band_columns(),
                padding: 1,
                activation: self.activation,
                isa: self.isa,
            };
            copy_band(&copied, &self.source[image * image_len..][..image_len], band);
            let tile = (unit - self.units.start) * columns;
            assert!(band.len() >= self.tiles.band_len(count, self.channels) && to.len() >= POINTS * pitch);
            let windows = transform::Source {
                band: band.as_ptr(),
                row_pitch: self.tiles.band_columns() * self.channels,
                rows: count,
                columns,
                channels: self.channels,
                to: to[tile * self.channels..].as_mut_ptr(),
                pitch,
            };
            transform_windows(self.isa, &windows);
            unit += count;
        }
    }
}

fn transform_windows(isa: Isa, source: &transform::Source) {
    use transform::windows;
    dispatch!(isa, windows::<S>(source: &transform::Source))
}
