//! Where an image lies in a network's input: an axis-aligned map that moves pixels and labels alike.
//!
//! Flips, changes of size, crops, canvases and the tiles of a mosaic are all such maps; composed, they resample the pixels once.
use super::planes::Planes;
use tcross_dataset::PixelBox;

/// `out = scale * in + shift` along each axis, in pixels; a negative scale mirrors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// Along x and y.
    pub scale: [f64; 2],
    /// Along x and y, in pixels of the output.
    pub shift: [f64; 2],
}

impl Placement {
    /// Everything stays.
    pub const IDENTITY: Self = Self { scale: [1.0; 2], shift: [0.0; 2] };

    /// Mirrors an image of this width, left to right.
    #[must_use]
    pub fn flip(width: usize) -> Self {
        Self { scale: [-1.0, 1.0], shift: [width as f64, 0.0] }
    }

    /// Maps one rectangle onto another.
    #[must_use]
    pub fn rectangle(from: &PixelBox, to: &PixelBox) -> Self {
        let scale = [to.width() / from.width(), to.height() / from.height()];
        Self { scale, shift: [to.x_min - scale[0] * from.x_min, to.y_min - scale[1] * from.y_min] }
    }

    /// First this map, then `next`.
    #[must_use]
    pub fn then(self, next: Self) -> Self {
        let axis = |k: usize| (next.scale[k] * self.scale[k], next.scale[k] * self.shift[k] + next.shift[k]);
        let ((sx, tx), (sy, ty)) = (axis(0), axis(1));
        Self { scale: [sx, sy], shift: [tx, ty] }
    }

    /// A point of the image in the output.
    #[must_use]
    pub fn point(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [self.scale[0] * x + self.shift[0], self.scale[1] * y + self.shift[1]]
    }

    /// A box of the image in the output.
    #[must_use]
    pub fn bounds(&self, b: &PixelBox) -> PixelBox {
        let (p, q) = (self.point([b.x_min, b.y_min]), self.point([b.x_max, b.y_max]));
        PixelBox::from([p[0].min(q[0]), p[1].min(q[1]), p[0].max(q[0]), p[1].max(q[1])])
    }

    /// Draws the image into the part of `out` inside `window` (whole pixels); what lies outside the image stays as it is.
    pub fn draw(&self, image: &Planes, window: &PixelBox, kernel: Kernel, out: &mut Planes) {
        let x = Taps::new(self.scale[0], self.shift[0], image.width, (window.x_min, window.x_max), out.width, kernel);
        let y = Taps::new(self.scale[1], self.shift[1], image.height, (window.y_min, window.y_max), out.height, kernel);
        if x.is_empty() || y.is_empty() {
            return;
        }
        for channel in 0..3 {
            if y.single() && x.single() {
                copy(image, out, channel, &x, &y);
            } else {
                resample(image, out, channel, &x, &y);
            }
        }
    }
}

/// How a pixel of the output is made from those of the image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kernel {
    /// A triangle over all pixels that a smaller output covers.
    Smooth,
    /// A triangle over the nearest two along each axis.
    Bilinear,
    /// The nearest pixel.
    Nearest,
}

/// For each output pixel along one axis: which input pixels it is made from, and their weights.
struct Taps {
    /// First output pixel.
    first: usize,
    /// First input pixel of each output pixel.
    starts: Vec<usize>,
    /// `count` a pixel, summing to 1.
    weights: Vec<f32>,
    /// Input pixels an output pixel.
    count: usize,
}

impl Taps {
    fn new(scale: f64, shift: f64, length: usize, window: (f64, f64), out: usize, kernel: Kernel) -> Self {
        // A pixel is drawn where its centre lies inside the image and the window.
        let ends = [shift, scale * length as f64 + shift];
        let low = ends[0].min(ends[1]).max(window.0).max(0.0);
        let high = ends[0].max(ends[1]).min(window.1).min(out as f64);
        let first = (low - 0.5).ceil().max(0.0) as usize;
        let last = ((high - 0.5).ceil().max(0.0) as usize).max(first);
        let step = 1.0 / scale.abs();
        let whole = step == 1.0 && shift.fract() == 0.0;
        let radius = match kernel {
            Kernel::Smooth => step.max(1.0),
            Kernel::Bilinear | Kernel::Nearest => 1.0,
        };
        let count = if whole || kernel == Kernel::Nearest { 1 } else { ((2.0 * radius).ceil() as usize).min(length) };
        let mut taps = Self { first, starts: Vec::new(), weights: Vec::new(), count };
        for pixel in first..last {
            let at = (pixel as f64 + 0.5 - shift) / scale - 0.5; // in pixel centres of the image
            let start = if count == 1 { at.round() } else { (at - radius).floor() + 1.0 };
            let start = start.clamp(0.0, (length - count) as f64);
            taps.starts.push(start as usize);
            let weights = (0..count).map(|k| (1.0 - (start + k as f64 - at).abs() / radius).max(0.0) as f32);
            let begin = taps.weights.len();
            taps.weights.extend(weights);
            let sum: f32 = taps.weights[begin..].iter().sum();
            if sum > 0.0 && count > 1 {
                taps.weights[begin..].iter_mut().for_each(|w| *w /= sum);
            } else {
                taps.weights[begin..].fill(1.0 / count as f32);
            }
        }
        taps
    }

    fn is_empty(&self) -> bool {
        self.starts.is_empty()
    }

    fn single(&self) -> bool {
        self.count == 1
    }

    fn range(&self) -> std::ops::Range<usize> {
        self.first..self.first + self.starts.len()
    }
}

/// One input pixel for each output pixel: copied, mirrored, or picked.
fn copy(image: &Planes, out: &mut Planes, channel: usize, x: &Taps, y: &Taps) {
    let (from, to) = (x.starts[0], x.starts[x.starts.len() - 1]);
    let n = x.starts.len();
    for (k, &source) in y.starts.iter().enumerate() {
        let row = image.row(channel, source);
        let target = &mut out.row_mut(channel, y.first + k)[x.range()];
        if to + 1 == from + n {
            target.copy_from_slice(&row[from..from + n]);
        } else if from + 1 == to + n {
            target.iter_mut().zip(row[to..to + n].iter().rev()).for_each(|(t, s)| *t = *s);
        } else {
            target.iter_mut().zip(&x.starts).for_each(|(t, s)| *t = row[*s]);
        }
    }
}

/// Weighted sums, first along x into the rows that are needed, then along y.
fn resample(image: &Planes, out: &mut Planes, channel: usize, x: &Taps, y: &Taps) {
    let n = x.starts.len();
    let low = y.starts.iter().copied().min().unwrap_or(0);
    let high = y.starts.iter().copied().max().unwrap_or(0) + y.count;
    let mut rows = vec![0.0_f32; (high - low) * n];
    for (k, row) in rows.chunks_exact_mut(n).enumerate() {
        let source = image.row(channel, low + k);
        for ((value, &start), weights) in row.iter_mut().zip(&x.starts).zip(x.weights.chunks_exact(x.count)) {
            let pixels = &source[start..start + x.count];
            *value = pixels.iter().zip(weights).map(|(p, w)| f32::from(*p) * w).sum();
        }
    }
    let mut sum = vec![0.0_f32; n];
    for (k, (&start, weights)) in y.starts.iter().zip(y.weights.chunks_exact(y.count)).enumerate() {
        sum.fill(0.5); // rounds to the nearest
        for (j, weight) in weights.iter().enumerate() {
            let at = (start + j - low) * n;
            sum.iter_mut().zip(&rows[at..at + n]).for_each(|(s, v)| *s += weight * v);
        }
        let target = &mut out.row_mut(channel, y.first + k)[x.range()];
        target.iter_mut().zip(&sum).for_each(|(t, s)| *t = *s as u8);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tcross_dataset::Rng;

    fn noise(width: usize, height: usize) -> Planes {
        let mut rng = Rng::for_item(1, "test/planes", 0);
        Planes { width, height, data: (0..3 * width * height).map(|_| rng.int(0, 255) as u8).collect() }
    }

    fn everywhere(p: &Planes) -> PixelBox {
        PixelBox::from([0.0, 0.0, p.width as f64, p.height as f64])
    }

    #[test]
    fn a_flip_is_exact_and_its_own_inverse() {
        let image = noise(13, 7);
        let flip = Placement::flip(13);
        let (mut once, mut twice) = (Planes::grey(13, 7), Planes::grey(13, 7));
        flip.draw(&image, &everywhere(&image), Kernel::Smooth, &mut once);
        for channel in 0..3 {
            for y in 0..7 {
                assert!(once.row(channel, y).iter().eq(image.row(channel, y).iter().rev()));
            }
        }
        flip.draw(&once, &everywhere(&image), Kernel::Smooth, &mut twice);
        assert_eq!(twice, image);
        let b = PixelBox::from([2.0, 1.0, 5.5, 4.0]);
        assert_eq!(flip.bounds(&b), PixelBox::from([7.5, 1.0, 11.0, 4.0]));
        assert_eq!(flip.bounds(&flip.bounds(&b)), b);
    }

    /// The naive twin: every output pixel from the formula of a bilinear sample.
    #[test]
    fn bilinear_equals_its_naive_twin() {
        let image = noise(11, 9);
        for (scale, shift) in [([1.7, 0.8], [3.2, -1.5]), ([-0.9, 1.3], [12.0, 2.25]), ([1.0, 1.0], [4.0, -2.0])] {
            let placement = Placement { scale, shift };
            let mut out = Planes::grey(16, 14);
            placement.draw(&image, &PixelBox::from([1.0, 0.0, 15.0, 14.0]), Kernel::Bilinear, &mut out);
            for (y, x) in (0..14).flat_map(|y| (0..16).map(move |x| (y, x))) {
                let at = [(x as f64 + 0.5 - shift[0]) / scale[0], (y as f64 + 0.5 - shift[1]) / scale[1]];
                let inside = at[0] > 0.0 && at[0] < 11.0 && at[1] > 0.0 && at[1] < 9.0 && (1..15).contains(&x);
                let pixel = |cx: f64, cy: f64| f64::from(image.row(1, cy.clamp(0.0, 8.0) as usize)[cx.clamp(0.0, 10.0) as usize]);
                let (u, v) = (at[0] - 0.5, at[1] - 0.5);
                let (fu, fv) = (u - u.floor(), v - v.floor());
                let (u, v) = (u.floor(), v.floor());
                let top = pixel(u, v) * (1.0 - fu) + pixel(u + 1.0, v) * fu;
                let bottom = pixel(u, v + 1.0) * (1.0 - fu) + pixel(u + 1.0, v + 1.0) * fu;
                let want = if inside { top * (1.0 - fv) + bottom * fv } else { 128.0 };
                let got = f64::from(out.row(1, y)[x]);
                assert!((got - want).abs() <= 0.51, "{placement:?} at ({x}, {y}): {got} {want}");
            }
        }
    }

    #[test]
    fn smooth_halving_keeps_the_mean() {
        let image = noise(64, 64);
        let mut out = Planes::grey(32, 32);
        Placement { scale: [0.5; 2], shift: [0.0; 2] }.draw(&image, &everywhere(&out), Kernel::Smooth, &mut out);
        let mean = |p: &Planes| p.plane(0).iter().map(|v| f64::from(*v)).sum::<f64>() / p.plane(0).len() as f64;
        assert!((mean(&image) - mean(&out)).abs() < 1.0);
    }

    proptest! {
        #[test]
        fn composition_is_one_after_the_other(s in prop::array::uniform4(0.2..3.0f64), t in prop::array::uniform4(-50.0..50.0f64), x in 0.0..100.0f64, y in 0.0..100.0f64) {
            let a = Placement { scale: [s[0], -s[1]], shift: [t[0], t[1]] };
            let b = Placement { scale: [-s[2], s[3]], shift: [t[2], t[3]] };
            let (p, q) = (a.then(b).point([x, y]), b.point(a.point([x, y])));
            prop_assert!((p[0] - q[0]).abs() < 1e-9 && (p[1] - q[1]).abs() < 1e-9);
        }

        #[test]
        fn a_marked_pixel_lands_where_its_box_says(px in 0usize..20, py in 0usize..20, s in 1.0..3.0f64, mirrored: bool, tx in -10.0..10.0f64) {
            let mut image = Planes { width: 20, height: 20, data: vec![0; 1200] };
            image.row_mut(0, py)[px] = 255;
            let placement = Placement { scale: [if mirrored { -s } else { s }, s], shift: [if mirrored { 20.0 * s + tx } else { tx }, 1.0] };
            let mut out = Planes { width: 80, height: 80, data: vec![0; 3 * 6400] };
            placement.draw(&image, &everywhere(&out), Kernel::Nearest, &mut out);
            let b = placement.bounds(&PixelBox::from([px as f64, py as f64, px as f64 + 1.0, py as f64 + 1.0]));
            for (y, x) in (0..80).flat_map(|y| (0..80).map(move |x| (y, x))) {
                let (cx, cy) = (x as f64 + 0.5, y as f64 + 0.5);
                let inside = cx > b.x_min + 1e-9 && cx < b.x_max - 1e-9 && cy > b.y_min + 1e-9 && cy < b.y_max - 1e-9;
                if inside {
                    prop_assert_eq!(out.row(0, y)[x], 255);
                }
                if cx < b.x_min - 1e-9 || cx > b.x_max + 1e-9 || cy < b.y_min - 1e-9 || cy > b.y_max + 1e-9 {
                    prop_assert_eq!(out.row(0, y)[x], 0);
                }
            }
        }
    }
}
