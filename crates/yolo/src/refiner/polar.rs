//! What the refiner looks at: a claim in polar coordinates around its middle, where the arms of a marker are straight bars side by side and
//! turning it is shifting it, so that they can be counted wherever they point.
use image::RgbImage;
use tcross_dataset::PixelBox;

/// Rows of a view: distances from the middle.
pub const RINGS: usize = 16;
/// Columns that go once around.
pub const RAYS: usize = 72;
/// Columns that are seen again on each side, so that what lies across the seam is seen whole: at least as many as the layers over a view
/// reach to one side, 1 + 2 * 2 + 2 * 4.
pub const OVERLAP: usize = 16;
/// All columns of a view.
pub const COLUMNS: usize = RAYS + 2 * OVERLAP;
/// Numbers of a view, `[3, RINGS, COLUMNS]`.
pub const VIEW: usize = 3 * RINGS * COLUMNS;

/// Pixels of a patch's side.
const SIDE: usize = 64;
/// Side of a patch in sides of its claim.
const MARGIN: f32 = 1.7;
/// Radii of the first and the last ring, in half sides of the box.
const RADII: [f32; 2] = [0.08, 1.45];
/// Added to a view's deviation: what is nearly even is not blown up.
const FLAT: f32 = 8.0;
/// Claims narrower than this are looked at as if they were as wide.
const LEAST_SIDE_PX: f64 = 6.0;

/// `[x_min, y_min, x_max, y_max]` where a box, the claim's or a view's, is `[-1, -1, 1, 1]`.
pub type UnitBox = [f32; 4];

/// A claim's surroundings, stretched so that the claim becomes a square: all that the refiner sees of the image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Patch {
    /// Interleaved RGB, row by row.
    pixels: Vec<u8>,
}

impl Patch {
    /// Memory that it takes.
    pub const BYTES: usize = 3 * SIDE * SIDE;

    /// Cuts a claim (continuous pixels) out of an image. Beyond the border the image's outermost pixels go on.
    ///
    /// # Panics
    /// If the image has no pixels.
    #[must_use]
    pub fn cut(image: &RgbImage, claim: &PixelBox) -> Self {
        assert!(image.width() > 0 && image.height() > 0, "an image without pixels");
        let ([cx, cy], [width, height]) = (claim.center(), sides(claim));
        let (columns, rows) = (taps(cx, width, image.width() as usize), taps(cy, height, image.height() as usize));
        let (first, last) = rows.iter().fold((usize::MAX, 0), |(a, b), (start, w)| (a.min(*start), b.max(start + w.len())));
        let stride = 3 * image.width() as usize;
        let mut narrowed = vec![[0.0f32; 3]; (last - first) * SIDE];
        for (row, out) in narrowed.chunks_exact_mut(SIDE).enumerate() {
            let source = &image.as_raw()[(first + row) * stride..][..stride];
            for (out, (start, weights)) in out.iter_mut().zip(&columns) {
                for (pixel, weight) in source[3 * start..].chunks_exact(3).zip(weights) {
                    out.iter_mut().zip(pixel).for_each(|(sum, v)| *sum += weight * f32::from(*v));
                }
            }
        }
        let mut pixels = Vec::with_capacity(3 * SIDE * SIDE);
        for (start, weights) in &rows {
            let mut row = [[0.5f32; 3]; SIDE];
            for (source, weight) in narrowed[(start - first) * SIDE..].chunks_exact(SIDE).zip(weights) {
                for (sum, v) in row.as_flattened_mut().iter_mut().zip(source.as_flattened()) {
                    *sum += weight * v;
                }
            }
            pixels.extend(row.as_flattened().iter().map(|v| *v as u8));
        }
        Self { pixels }
    }

    /// Bilinear between pixels' middles; the outermost go on. In the claim's units.
    fn at(&self, x: f32, y: f32) -> [f32; 3] {
        let place = |v: f32| ((v / MARGIN + 1.0) * (SIDE as f32 / 2.0) - 0.5).clamp(0.0, SIDE as f32 - 1.001);
        let (x, y) = (place(x), place(y));
        let (left, top) = (x as usize, y as usize);
        let (fx, fy) = (x - left as f32, y - top as f32);
        let at = 3 * (top * SIDE + left);
        std::array::from_fn(|c| {
            let p = |offset: usize| f32::from(self.pixels[at + offset + c]);
            let (upper, lower) = (p(0) + fx * (p(3) - p(0)), p(3 * SIDE) + fx * (p(3 * SIDE + 3) - p(3 * SIDE)));
            upper + fy * (lower - upper)
        })
    }
}

/// Width and height, none of them too small to look at.
fn sides(claim: &PixelBox) -> [f64; 2] {
    [claim.width().max(LEAST_SIDE_PX), claim.height().max(LEAST_SIDE_PX)]
}

/// Which pixels of a row, and with which weights, make each of a patch's pixels: a triangle as wide as a step, or as a pixel of the image
/// if that is wider.
fn taps(center: f64, side: f64, length: usize) -> Vec<(usize, Vec<f32>)> {
    let step = side * f64::from(MARGIN) / SIDE as f64;
    let reach = step.max(1.0);
    let last = length as f64 - 1.0;
    let one = |k: usize| {
        let at = center + (k as f64 + 0.5 - SIDE as f64 / 2.0) * step - 0.5;
        let (from, to) = ((at - reach).ceil().clamp(0.0, last), (at + reach).floor().clamp(0.0, last));
        let mut weights = vec![0.0; (to - from) as usize + 1];
        let (low, high) = ((at - reach).ceil() as i64, (at + reach).floor() as i64);
        for source in low..=high {
            let weight = 1.0 - (source as f64 - at).abs() / reach;
            weights[((source as f64).clamp(from, to) - from) as usize] += weight;
        }
        let sum: f64 = weights.iter().sum();
        (from as usize, weights.iter().map(|w| (w / sum) as f32).collect())
    };
    (0..SIDE).map(one).collect()
}

/// How a patch is looked at: which box is taken for the marker's, and, in training, how it is turned over and coloured anew.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Glance {
    /// Middle of that box in the claim's units.
    pub center: [f32; 2],
    /// Its half sides in the claim's units; a negative one mirrors.
    pub half: [f32; 2],
    /// Whether x and y change places.
    pub transposed: bool,
    /// Which channel is seen as red, as green and as blue.
    pub channels: [usize; 3],
    /// Whether bright is seen as dark.
    pub negative: bool,
}

impl Default for Glance {
    /// At the claim itself.
    fn default() -> Self {
        Self { center: [0.0; 2], half: [1.0; 2], transposed: false, channels: [0, 1, 2], negative: false }
    }
}

impl Glance {
    /// At another box, given in the claim's units.
    #[must_use]
    pub fn at(b: UnitBox) -> Self {
        Self { center: [(b[0] + b[2]) / 2.0, (b[1] + b[3]) / 2.0], half: [(b[2] - b[0]) / 2.0, (b[3] - b[1]) / 2.0], ..Self::default() }
    }

    /// A box in the claim's units as it is seen.
    #[must_use]
    pub fn seen(&self, b: UnitBox) -> UnitBox {
        let axis = |axis: usize| {
            let [a, b] = [b[axis], b[axis + 2]].map(|v| (v - self.center[axis]) / self.half[axis]);
            [a.min(b), a.max(b)]
        };
        let [x, y] = if self.transposed { [axis(1), axis(0)] } else { [axis(0), axis(1)] };
        [x[0], y[0], x[1], y[1]]
    }

    /// A box as it is seen, in the claim's units.
    #[must_use]
    pub fn unseen(&self, b: UnitBox) -> UnitBox {
        let [left, top, right, bottom] = if self.transposed { [b[1], b[0], b[3], b[2]] } else { b };
        let axis = |axis: usize, low: f32, high: f32| {
            let [a, b] = [low, high].map(|v| v * self.half[axis] + self.center[axis]);
            [a.min(b), a.max(b)]
        };
        let ([left, right], [top, bottom]) = (axis(0, left, right), axis(1, top, bottom));
        [left, top, right, bottom]
    }

    /// The same as a mirror shows it, left and right exchanged.
    #[must_use]
    pub fn mirrored(self) -> Self {
        Self { half: [-self.half[0], self.half[1]], ..self }
    }

    /// The view, `[3, RINGS, COLUMNS]`: of mean 0 and, unless it is nearly even, of deviation 1.
    ///
    /// # Panics
    /// If `out` is not [`VIEW`] long.
    pub fn look(&self, patch: &Patch, out: &mut [f32]) {
        assert_eq!(out.len(), VIEW, "a view");
        let plane = RINGS * COLUMNS;
        for (ray, (sin, cos)) in (0..RAYS).map(|ray| (ray, (std::f32::consts::TAU * ray as f32 / RAYS as f32).sin_cos())) {
            let direction = if self.transposed { [sin, cos] } else { [cos, sin] };
            for ring in 0..RINGS {
                let radius = RADII[0] + (RADII[1] - RADII[0]) * ring as f32 / (RINGS - 1) as f32;
                let [x, y] = [0, 1].map(|axis| self.center[axis] + radius * direction[axis] * self.half[axis]);
                let pixel = patch.at(x, y);
                for (channel, &source) in self.channels.iter().enumerate() {
                    out[channel * plane + ring * COLUMNS + OVERLAP + ray] = pixel[source];
                }
            }
        }
        let once = |row: &[f32]| -> Vec<f32> { row[OVERLAP..OVERLAP + RAYS].to_vec() };
        let all: Vec<f32> = out.chunks_exact(COLUMNS).flat_map(once).collect();
        let mean = all.iter().sum::<f32>() / all.len() as f32;
        let deviation = (all.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / all.len() as f32).sqrt();
        let scale = if self.negative { -1.0 } else { 1.0 } / (deviation + FLAT);
        for row in out.chunks_exact_mut(COLUMNS) {
            row[OVERLAP..OVERLAP + RAYS].iter_mut().for_each(|v| *v = (*v - mean) * scale);
            row.copy_within(RAYS..RAYS + OVERLAP, 0);
            row.copy_within(OVERLAP..2 * OVERLAP, OVERLAP + RAYS);
        }
    }
}

/// The claim's units for a box in continuous pixels.
#[must_use]
pub fn in_units_of(claim: &PixelBox, b: &PixelBox) -> UnitBox {
    let ([cx, cy], [width, height]) = (claim.center(), sides(claim));
    let x = |v: f64| ((v - cx) / (width / 2.0)) as f32;
    let y = |v: f64| ((v - cy) / (height / 2.0)) as f32;
    [x(b.x_min), y(b.y_min), x(b.x_max), y(b.y_max)]
}

/// Back to continuous pixels.
#[must_use]
pub fn in_pixels(claim: &PixelBox, b: UnitBox) -> PixelBox {
    let ([cx, cy], [width, height]) = (claim.center(), sides(claim));
    let x = |v: f32| cx + f64::from(v) * width / 2.0;
    let y = |v: f32| cy + f64::from(v) * height / 2.0;
    PixelBox { x_min: x(b[0]), y_min: y(b[1]), x_max: x(b[2]), y_max: y(b[3]) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    /// Three bars from the middle of a square, towards 0, 90 and 180 degrees (clockwise from the right).
    fn image() -> (RgbImage, PixelBox) {
        let image = RgbImage::from_fn(120, 90, |x, y| {
            let (dx, dy) = (f64::from(x) + 0.5 - 60.0, f64::from(y) + 0.5 - 40.0);
            let inside = dx.abs() < 25.0 && dy.abs() < 25.0;
            let bar = (dy.abs() < 3.0) || (dx.abs() < 3.0 && dy > 0.0);
            if inside && bar { Rgb([250, 250, 250]) } else { Rgb([20, 90, 20]) }
        });
        (image, PixelBox::from_center(60.0, 40.0, 50.0, 50.0))
    }

    fn view(patch: &Patch, glance: Glance) -> Vec<f32> {
        let mut out = vec![0.0; VIEW];
        glance.look(patch, &mut out);
        out
    }

    #[test]
    fn arms_are_bars_where_they_point() {
        let (image, claim) = image();
        let view = view(&Patch::cut(&image, &claim), Glance::default());
        let bright = |ray: usize| view[(RINGS / 2) * COLUMNS + OVERLAP + ray] > 0.5;
        assert!([0, RAYS / 4, RAYS / 2].into_iter().all(bright));
        assert!([RAYS / 8, 3 * RAYS / 8, 5 * RAYS / 8, 3 * RAYS / 4, 7 * RAYS / 8].into_iter().all(|ray| !bright(ray)));
        // The seam is seen from both sides.
        assert_eq!(view[..OVERLAP], view[RAYS..RAYS + OVERLAP]);
        assert_eq!(view[COLUMNS - OVERLAP..COLUMNS], view[OVERLAP..2 * OVERLAP]);
    }

    /// A large claim and the same at a quarter of the size give the same view: nothing is left out between the samples.
    #[test]
    fn size_does_not_matter() {
        let (small, claim) = image();
        let large = image::imageops::resize(&small, 480, 360, image::imageops::FilterType::Nearest);
        let four = PixelBox::from([4.0 * claim.x_min, 4.0 * claim.y_min, 4.0 * claim.x_max, 4.0 * claim.y_max]);
        let [a, b] = [(&small, claim), (&large, four)].map(|(image, claim)| view(&Patch::cut(image, &claim), Glance::default()));
        let mean = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).sum::<f32>() / a.len() as f32;
        assert!(mean < 0.12, "{mean}");
    }

    #[test]
    fn a_mirrored_glance_sees_the_mirrored_image() {
        let (image, claim) = image();
        let mirrored = image::imageops::flip_vertical(&image);
        let other = PixelBox { y_min: 90.0 - claim.y_max, y_max: 90.0 - claim.y_min, ..claim };
        let a = view(&Patch::cut(&image, &claim), Glance { half: [1.0, -1.0], ..Default::default() });
        let b = view(&Patch::cut(&mirrored, &other), Glance::default());
        let worst = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 0.05, "{worst}");
    }

    #[test]
    fn boxes_move_with_the_glance() {
        let glance = Glance { center: [0.1, -0.2], half: [-0.5, 2.0], transposed: true, ..Default::default() };
        // x: (0.6 - 0.1) / -0.5 = -1, (1.1 - 0.1) / -0.5 = -2; y: (0 + 0.2) / 2 = 0.1, (1.8 + 0.2) / 2 = 1; then they change places.
        let seen = glance.seen([0.6, 0.0, 1.1, 1.8]);
        assert!(seen.iter().zip([0.1, -2.0, 1.0, -1.0]).all(|(a, b)| (a - b).abs() < 1e-6), "{seen:?}");
        let b = [0.6, 0.0, 1.1, 1.8];
        assert!(glance.unseen(seen).iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6), "the way back");
        let at = Glance::at([-0.5, 0.0, 1.5, 1.0]);
        assert_eq!(at.seen(at.unseen([-1.0, -1.0, 1.0, 1.0])), [-1.0, -1.0, 1.0, 1.0]);
        assert_eq!(at.unseen([-1.0, -1.0, 1.0, 1.0]), [-0.5, 0.0, 1.5, 1.0]);
    }

    #[test]
    fn units_and_pixels_are_each_others_way_back() {
        let (claim, b) = (PixelBox::from([10.0, 20.0, 50.0, 40.0]), PixelBox::from([20.0, 15.0, 60.0, 45.0]));
        assert_eq!(in_units_of(&claim, &b), [-0.5, -1.5, 1.5, 1.5]);
        assert_eq!(in_pixels(&claim, in_units_of(&claim, &b)), b);
        // A sliver is looked at as if it were wider.
        assert_eq!(in_units_of(&PixelBox::from([0.0, 0.0, 2.0, 12.0]), &PixelBox::from([-2.0, 0.0, 4.0, 12.0])), [-1.0, -1.0, 1.0, 1.0]);
    }

    #[test]
    fn a_claim_beyond_the_border_is_looked_at() {
        let (image, _) = image();
        for claim in [[-40.0, -40.0, -20.0, -20.0], [100.0, 80.0, 200.0, 160.0], [0.0, 0.0, 120.0, 90.0]] {
            let view = view(&Patch::cut(&image, &PixelBox::from(claim)), Glance::default());
            assert!(view.iter().all(|v| v.is_finite()));
        }
    }
}
