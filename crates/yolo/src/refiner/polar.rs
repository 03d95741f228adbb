//! What the refiner looks at: a claim in polar coordinates around its middle, where the arms of a marker are straight bars side by side and
//! turning it is shifting it, so that they can be counted wherever they point.
use super::frame::{self, Frame, Linear};
use image::RgbImage;
use tcross_dataset::PixelBox;

/// Rows of a view: distances from the middle.
pub const RINGS: usize = 16;
/// Columns that go once around.
pub const RAYS: usize = 72;
/// Columns that are seen again on each side, so that what lies across the seam is seen whole: as many as two layers over a view reach to one
/// side.
pub const MARGIN: usize = 2;
/// All columns of a view.
pub const COLUMNS: usize = RAYS + 2 * MARGIN;
/// Numbers of a view, `[3, RINGS, COLUMNS]`.
pub const VIEW: usize = 3 * RINGS * COLUMNS;

/// Pixels of a patch's side.
const SIDE: usize = 64;
/// Side of a patch in sides of its claim.
const PATCH_SIDES: f32 = 1.7;
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
        let place = |v: f32| ((v / PATCH_SIDES + 1.0) * (SIDE as f32 / 2.0) - 0.5).clamp(0.0, SIDE as f32 - 1.001);
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
    let step = side * f64::from(PATCH_SIDES) / SIDE as f64;
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

/// How a patch is looked at: what is taken for the marker, and, in training, how it is turned over and coloured anew.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Glance {
    /// Middle of the view in the claim's units.
    pub center: [f32; 2],
    /// Takes the view's units around its middle to the claim's.
    pub axes: Linear,
    /// Which channel is seen as red, as green and as blue.
    pub channels: [usize; 3],
    /// Whether bright is seen as dark.
    pub negative: bool,
}

impl Default for Glance {
    /// At the claim itself.
    fn default() -> Self {
        Self { center: [0.0; 2], axes: [[1.0, 0.0], [0.0, 1.0]], channels: [0, 1, 2], negative: false }
    }
}

impl Glance {
    /// At another box or in a marker's own frame, given in the claim's units.
    #[must_use]
    pub fn at(frame: &Frame) -> Self {
        Self { center: frame.center, axes: frame.axes, ..Self::default() }
    }

    /// The same through another map before.
    #[must_use]
    pub fn after(self, first: &Linear) -> Self {
        Self { axes: frame::product(&self.axes, first), ..self }
    }

    /// A box in the claim's units as it is seen: of upright glances.
    #[must_use]
    pub fn seen(&self, b: UnitBox) -> UnitBox {
        let back = frame::inverse(&self.axes);
        around([[b[0], b[1]], [b[2], b[3]]].map(|p| frame::apply(&back, [p[0] - self.center[0], p[1] - self.center[1]])))
    }

    /// A box as it is seen, in the claim's units.
    #[must_use]
    pub fn unseen(&self, b: UnitBox) -> UnitBox {
        let there = |p: [f32; 2]| {
            let moved = frame::apply(&self.axes, p);
            [self.center[0] + moved[0], self.center[1] + moved[1]]
        };
        around([there([b[0], b[1]]), there([b[2], b[3]])])
    }

    /// A frame in the claim's units as it is seen.
    #[must_use]
    pub fn seen_frame(&self, f: &Frame) -> Frame {
        let back = frame::inverse(&self.axes);
        f.mapped(frame::apply(&back, self.center.map(|v| -v)), &back)
    }

    /// A frame as it is seen, in the claim's units.
    #[must_use]
    pub fn unseen_frame(&self, f: &Frame) -> Frame {
        f.mapped(self.center, &self.axes)
    }

    /// The same as a mirror shows it, left and right exchanged.
    #[must_use]
    pub fn mirrored(self) -> Self {
        self.after(&[[-1.0, 0.0], [0.0, 1.0]])
    }

    /// The view, `[3, RINGS, COLUMNS]`: of mean 0 and, unless it is nearly even, of deviation 1.
    ///
    /// # Panics
    /// If `out` is not [`VIEW`] long.
    pub fn look(&self, patch: &Patch, out: &mut [f32]) {
        assert_eq!(out.len(), VIEW, "a view");
        let plane = RINGS * COLUMNS;
        for (ray, (sin, cos)) in (0..RAYS).map(|ray| (ray, (std::f32::consts::TAU * ray as f32 / RAYS as f32).sin_cos())) {
            let direction = frame::apply(&self.axes, [cos, sin]);
            for ring in 0..RINGS {
                let radius = RADII[0] + (RADII[1] - RADII[0]) * ring as f32 / (RINGS - 1) as f32;
                let [x, y] = [0, 1].map(|axis| self.center[axis] + radius * direction[axis]);
                let pixel = patch.at(x, y);
                for (channel, &source) in self.channels.iter().enumerate() {
                    out[channel * plane + ring * COLUMNS + MARGIN + ray] = pixel[source];
                }
            }
        }
        let once = |row: &[f32]| -> Vec<f32> { row[MARGIN..MARGIN + RAYS].to_vec() };
        let all: Vec<f32> = out.chunks_exact(COLUMNS).flat_map(once).collect();
        let mean = all.iter().sum::<f32>() / all.len() as f32;
        let deviation = (all.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / all.len() as f32).sqrt();
        let scale = if self.negative { -1.0 } else { 1.0 } / (deviation + FLAT);
        for row in out.chunks_exact_mut(COLUMNS) {
            row[MARGIN..MARGIN + RAYS].iter_mut().for_each(|v| *v = (*v - mean) * scale);
            row.copy_within(RAYS..RAYS + MARGIN, 0);
            row.copy_within(MARGIN..2 * MARGIN, MARGIN + RAYS);
        }
    }
}

/// The box of two opposite corners.
fn around([a, b]: [[f32; 2]; 2]) -> UnitBox {
    [a[0].min(b[0]), a[1].min(b[1]), a[0].max(b[0]), a[1].max(b[1])]
}

/// The claim's units for a point in continuous pixels.
#[must_use]
pub fn point_in_units_of(claim: &PixelBox, p: [f64; 2]) -> [f32; 2] {
    let (center, sides) = (claim.center(), sides(claim));
    std::array::from_fn(|axis| ((p[axis] - center[axis]) / (sides[axis] / 2.0)) as f32)
}

/// The claim's units for a box in continuous pixels.
#[must_use]
pub fn in_units_of(claim: &PixelBox, b: &PixelBox) -> UnitBox {
    let [[left, top], [right, bottom]] = [[b.x_min, b.y_min], [b.x_max, b.y_max]].map(|p| point_in_units_of(claim, p));
    [left, top, right, bottom]
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
        let bright = |ray: usize| view[(RINGS / 2) * COLUMNS + MARGIN + ray] > 0.5;
        assert!([0, RAYS / 4, RAYS / 2].into_iter().all(bright));
        assert!([RAYS / 8, 3 * RAYS / 8, 5 * RAYS / 8, 3 * RAYS / 4, 7 * RAYS / 8].into_iter().all(|ray| !bright(ray)));
        // The seam is seen from both sides.
        assert_eq!(view[..MARGIN], view[RAYS..RAYS + MARGIN]);
        assert_eq!(view[COLUMNS - MARGIN..COLUMNS], view[MARGIN..2 * MARGIN]);
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
        let a = view(&Patch::cut(&image, &claim), Glance { axes: [[1.0, 0.0], [0.0, -1.0]], ..Default::default() });
        let b = view(&Patch::cut(&mirrored, &other), Glance::default());
        let worst = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 0.05, "{worst}");
    }

    #[test]
    fn boxes_and_frames_move_with_the_glance() {
        let glance = Glance { center: [0.1, -0.2], axes: [[0.0, -0.5], [2.0, 0.0]], ..Default::default() };
        // Seen y is (x - 0.1) / -0.5: -1 and -2; seen x is (y + 0.2) / 2: 0.1 and 1.
        let b = [0.6, 0.0, 1.1, 1.8];
        let close = |a: UnitBox, b: UnitBox| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
        let seen = glance.seen(b);
        assert!(close(seen, [0.1, -2.0, 1.0, -1.0]) && close(glance.unseen(seen), b), "{seen:?}");
        let at = Glance::at(&Frame::of_box([-0.5, 0.0, 1.5, 1.0]));
        assert!(close(at.unseen([-1.0, -1.0, 1.0, 1.0]), [-0.5, 0.0, 1.5, 1.0]));
        // The frame of an upright marker goes with its box, there and back.
        let numbers = |f: Frame| [f.center[0], f.center[1], f.axes[0][0], f.axes[1][1]];
        let (frame, of_seen) = (Frame::of_box(b), Frame::of_box(seen));
        assert!(close(numbers(glance.seen_frame(&frame)), numbers(of_seen)), "{of_seen:?}");
        assert!(close(numbers(glance.unseen_frame(&of_seen)), numbers(frame)));
    }

    /// A marker that is slanted looks, in its frame, as it does without, but for how far it is turned.
    #[test]
    fn a_slanted_marker_looks_upright_in_its_frame() {
        let (_, claim) = image();
        let upright: Linear = [[1.0, 0.0], [0.0, 1.0]];
        let slant: Linear = [[1.0, 0.5], [0.1, 0.8]];
        let seen = |map: &Linear| {
            let back = frame::inverse(map);
            let image = RgbImage::from_fn(120, 90, |x, y| {
                let [x, y] = frame::apply(&back, [x as f32 + 0.5 - 60.0, y as f32 + 0.5 - 40.0]);
                let bar = y.abs() < 2.5 || (x.abs() < 2.5 && y > 0.0);
                if x.abs().max(y.abs()) < 16.0 && bar { Rgb([250; 3]) } else { Rgb([20, 90, 20]) }
            });
            let corners = [[-0.64, -0.64], [0.64, -0.64], [0.64, 0.64], [-0.64, 0.64]].map(|p| frame::apply(map, p));
            view(&Patch::cut(&image, &claim), Glance::at(&Frame::of(corners, [0.0; 2])))
        };
        let (plain, slanted) = (seen(&upright), seen(&slant));
        let ring = (RINGS / 2) * COLUMNS + MARGIN;
        let apart = |turn: usize| (0..RAYS).map(|k| (plain[ring + k] - slanted[ring + (k + turn) % RAYS]).abs()).sum::<f32>() / RAYS as f32;
        let best = (0..RAYS).map(apart).fold(f32::MAX, f32::min);
        assert!(best < 0.2 && apart(RAYS / 2) > 0.4, "{best} {}", apart(RAYS / 2));
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
