//! The geometry of a convolution.

/// A square convolution over activations laid out as `[batch, height, width, channels]`, padded by `kernel / 2` on every side.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ConvShape {
    /// Images.
    pub batch: usize,
    /// Input rows.
    pub height: usize,
    /// Input columns.
    pub width: usize,
    /// Input channels.
    pub in_channels: usize,
    /// Output channels.
    pub out_channels: usize,
    /// Side of the kernel; 1 or 3 on the fast path.
    pub kernel: usize,
    /// 1 or 2.
    pub stride: usize,
}

/// Whether there are fast kernels for convolutions of this side and stride. Every other one takes burn's operations in training, and
/// [`crate::conv::forward_plain`] in inference.
#[must_use]
pub fn covers(kernel: usize, stride: usize) -> bool {
    matches!((kernel, stride), (1, 1) | (3, 1) | (3, 2))
}

impl ConvShape {
    /// Zeros added on every side.
    #[must_use]
    pub fn padding(&self) -> usize {
        self.kernel / 2
    }

    /// Output rows.
    #[must_use]
    pub fn out_height(&self) -> usize {
        (self.height + 2 * self.padding() - self.kernel) / self.stride + 1
    }

    /// Output columns.
    #[must_use]
    pub fn out_width(&self) -> usize {
        (self.width + 2 * self.padding() - self.kernel) / self.stride + 1
    }

    /// Output pixels of the whole batch.
    #[must_use]
    pub fn out_pixels(&self) -> usize {
        self.batch * self.out_height() * self.out_width()
    }

    /// Floats of the input.
    #[must_use]
    pub fn input_len(&self) -> usize {
        self.batch * self.height * self.width * self.in_channels
    }

    /// Floats of the output.
    #[must_use]
    pub fn output_len(&self) -> usize {
        self.out_pixels() * self.out_channels
    }

    /// Floats of the weights `[out, in, kernel, kernel]`.
    #[must_use]
    pub fn weight_len(&self) -> usize {
        self.out_channels * self.in_channels * self.kernel * self.kernel
    }

    /// Arithmetic of one forward pass; multiply and add counted apart.
    #[must_use]
    pub fn flops(&self) -> f64 {
        2.0 * self.out_pixels() as f64 * self.weight_len() as f64
    }

    /// Panics unless the fast kernels cover it: callers choose by [`covers`].
    pub(crate) fn check(&self) {
        assert!(self.is_supported(), "unsupported convolution {self:?}");
    }

    fn is_supported(&self) -> bool {
        covers(self.kernel, self.stride)
            && [self.batch, self.height, self.width, self.in_channels, self.out_channels].iter().all(|&n| n > 0)
    }
}
