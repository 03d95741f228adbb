//! Activations `[batch, height, width, channels]` whose columns go around a circle: wrapped with a margin, and each column with its
//! neighbours behind one another, with their gradients. Memory traffic only.
use crate::buffer::buffer;
use rayon::prelude::*;

/// Which columns of an activation go once around.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Circle {
    /// Size of the activation, `[batch, height, width, channels]`.
    pub size: [usize; 4],
    /// The first column of the circle; those before and those behind it are not looked at.
    pub first: usize,
    /// Columns of the circle.
    pub count: usize,
}

impl Circle {
    /// Numbers of an image, of which `numbers` has as many as it should.
    fn image(&self, numbers: &[f32]) -> usize {
        let [batch, height, width, channels] = self.size;
        assert!(self.count > 0 && self.first + self.count <= width, "{self:?}");
        assert_eq!(numbers.len(), batch * height * width * channels, "{self:?}");
        height * width * channels
    }

    /// Where the column `steps` to the right of another one of the circle begins, in an image's row `y`.
    fn at(&self, y: usize, column: usize, steps: isize) -> usize {
        let column = (column as isize + steps).rem_euclid(self.count as isize) as usize;
        (y * self.size[2] + self.first + column) * self.size[3]
    }

    /// The circle with `margin` columns of it repeated on each side: `[batch, height, count + 2 * margin, channels]`.
    ///
    /// # Panics
    /// If `x` is not of the circle's size, or the circle does not lie in it.
    #[must_use]
    pub fn wrap(&self, x: &[f32], margin: usize) -> Vec<f32> {
        let [batch, height, _, channels] = self.size;
        let image = self.image(x);
        let width = self.count + 2 * margin;
        let mut out = buffer(batch * height * width * channels);
        let images = out.par_chunks_exact_mut(height * width * channels).zip(x.par_chunks_exact(image));
        images.for_each(|(out, x)| {
            for (y, out) in out.chunks_exact_mut(width * channels).enumerate() {
                for (column, out) in out.chunks_exact_mut(channels).enumerate() {
                    out.copy_from_slice(&x[self.at(y, column, -(margin as isize))..][..channels]);
                }
            }
        });
        out
    }

    /// The gradient of [`Circle::wrap`]'s input.
    ///
    /// # Panics
    /// If `gradient` is not of the size of what was made, or the circle does not lie in its activation.
    #[must_use]
    pub fn wrap_gradient(&self, gradient: &[f32], margin: usize) -> Vec<f32> {
        let [batch, height, _, channels] = self.size;
        let width = self.count + 2 * margin;
        assert_eq!(gradient.len(), batch * height * width * channels);
        let mut out = vec![0.0; self.size.iter().product()];
        let image = self.image(&out);
        let images = out.par_chunks_exact_mut(image).zip(gradient.par_chunks_exact(height * width * channels));
        images.for_each(|(out, gradient)| {
            for (y, gradient) in gradient.chunks_exact(width * channels).enumerate() {
                for (column, gradient) in gradient.chunks_exact(channels).enumerate() {
                    add(&mut out[self.at(y, column, -(margin as isize))..][..channels], gradient);
                }
            }
        });
        out
    }

    /// Each column of the circle with its neighbours, `arc` in all from left to right, of each all rows:
    /// `[batch, 1, count, arc * height * channels]`.
    ///
    /// # Panics
    /// If `x` is not of the circle's size, or the circle does not lie in it.
    #[must_use]
    pub fn around(&self, x: &[f32], arc: usize) -> Vec<f32> {
        let [batch, height, _, channels] = self.size;
        let image = self.image(x);
        let seen = arc * height * channels;
        let mut out = buffer(batch * self.count * seen);
        let images = out.par_chunks_exact_mut(self.count * seen).zip(x.par_chunks_exact(image));
        images.for_each(|(out, x)| {
            for (column, out) in out.chunks_exact_mut(seen).enumerate() {
                for (k, out) in out.chunks_exact_mut(channels).enumerate() {
                    let steps = (k / height) as isize - (arc / 2) as isize;
                    out.copy_from_slice(&x[self.at(k % height, column, steps)..][..channels]);
                }
            }
        });
        out
    }

    /// The gradient of [`Circle::around`]'s input.
    ///
    /// # Panics
    /// If `gradient` is not of the size of what was made, or the circle does not lie in its activation.
    #[must_use]
    pub fn around_gradient(&self, gradient: &[f32], arc: usize) -> Vec<f32> {
        let [batch, height, _, channels] = self.size;
        let seen = arc * height * channels;
        assert_eq!(gradient.len(), batch * self.count * seen);
        let mut out = vec![0.0; self.size.iter().product()];
        let image = self.image(&out);
        let images = out.par_chunks_exact_mut(image).zip(gradient.par_chunks_exact(self.count * seen));
        images.for_each(|(out, gradient)| {
            for (column, gradient) in gradient.chunks_exact(seen).enumerate() {
                for (k, gradient) in gradient.chunks_exact(channels).enumerate() {
                    let steps = (k / height) as isize - (arc / 2) as isize;
                    add(&mut out[self.at(k % height, column, steps)..][..channels], gradient);
                }
            }
        });
        out
    }
}

fn add(sum: &mut [f32], g: &[f32]) {
    sum.iter_mut().zip(g).for_each(|(sum, g)| *sum += g);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two images of two rows, three columns of a circle behind one that is none, one channel.
    const CIRCLE: Circle = Circle { size: [2, 2, 4, 1], first: 1, count: 3 };

    fn x() -> Vec<f32> {
        (0..16).map(|k| k as f32).collect()
    }

    #[test]
    fn columns_go_around() {
        assert_eq!(CIRCLE.wrap(&x(), 1)[..10], [3.0, 1.0, 2.0, 3.0, 1.0, 7.0, 5.0, 6.0, 7.0, 5.0]);
        assert_eq!(CIRCLE.wrap(&x(), 2)[14..21], [10.0, 11.0, 9.0, 10.0, 11.0, 9.0, 10.0]);
        // The left neighbour's two rows, then one's own, then the right neighbour's.
        assert_eq!(CIRCLE.around(&x(), 3)[..6], [3.0, 7.0, 1.0, 5.0, 2.0, 6.0]);
        assert_eq!(CIRCLE.around(&x(), 3)[30..], [10.0, 14.0, 11.0, 15.0, 9.0, 13.0]);
        assert_eq!(CIRCLE.around(&x(), 1)[..6], [1.0, 5.0, 2.0, 6.0, 3.0, 7.0]);
    }

    /// A gradient is the transposed map: the same product from both sides.
    #[test]
    fn gradients_go_back_the_same_way() {
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
        let weights = |n: usize| (0..n).map(|k| ((k * 7) % 11) as f32 - 5.0).collect::<Vec<_>>();
        for n in [1, 2, 5] {
            let (wrapped, around) = (CIRCLE.wrap(&x(), n), CIRCLE.around(&x(), n));
            let (g, h) = (weights(wrapped.len()), weights(around.len()));
            assert_eq!(dot(&wrapped, &g), dot(&x(), &CIRCLE.wrap_gradient(&g, n)));
            assert_eq!(dot(&around, &h), dot(&x(), &CIRCLE.around_gradient(&h, n)));
        }
    }
}
