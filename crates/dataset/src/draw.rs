//! Lines, boxes and truths drawn onto pictures: previews, overlays and batches all look alike.
use crate::{PixelBox, Record, dataset::BoxConvention, geom::quad::Quad};
use image::{Rgb, RgbImage};

/// Truth.
pub const TRUTH: Rgb<u8> = Rgb([0, 230, 118]);
/// What a detector claims.
pub const CLAIM: Rgb<u8> = Rgb([255, 64, 129]);
/// The stem and its corner.
pub const STEM: Rgb<u8> = Rgb([255, 214, 0]);

/// A straight line of this width in pixels with soft edges; parts outside the picture are left out.
pub fn line(image: &mut RgbImage, from: [f64; 2], to: [f64; 2], width: f64, color: Rgb<u8>) {
    if ![from, to].iter().flatten().all(|v| v.is_finite()) {
        return;
    }
    let reach = width / 2.0 + 1.0;
    let span = |k: usize, end: u32| {
        let low = (from[k].min(to[k]) - reach).floor().clamp(0.0, f64::from(end));
        let high = (from[k].max(to[k]) + reach).ceil().clamp(0.0, f64::from(end));
        low as u32..high as u32
    };
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    let length = dx.hypot(dy).max(1e-9);
    for y in span(1, image.height()) {
        for x in span(0, image.width()) {
            let (px, py) = (f64::from(x) + 0.5 - from[0], f64::from(y) + 0.5 - from[1]);
            let along = ((px * dx + py * dy) / (length * length)).clamp(0.0, 1.0);
            let distance = (px - along * dx).hypot(py - along * dy);
            blend(image.get_pixel_mut(x, y), color, (width / 2.0 + 0.5 - distance).clamp(0.0, 1.0));
        }
    }
}

fn blend(pixel: &mut Rgb<u8>, color: Rgb<u8>, share: f64) {
    for (old, new) in pixel.0.iter_mut().zip(color.0) {
        *old = (f64::from(*old) + (f64::from(new) - f64::from(*old)) * share).round() as u8;
    }
}

/// A closed run of lines.
pub fn polygon(image: &mut RgbImage, points: &[[f64; 2]], width: f64, color: Rgb<u8>) {
    for (k, from) in points.iter().enumerate() {
        line(image, *from, points[(k + 1) % points.len()], width, color);
    }
}

/// The outline of a box in continuous pixels.
pub fn rectangle(image: &mut RgbImage, b: &PixelBox, width: f64, color: Rgb<u8>) {
    polygon(image, &[[b.x_min, b.y_min], [b.x_max, b.y_min], [b.x_max, b.y_max], [b.x_min, b.y_max]], width, color);
}

/// The corners' outline, and an arrow from the centre to the stem's corner.
pub fn quad(image: &mut RgbImage, quad: &Quad, center: Option<[f64; 2]>, width: f64, color: Rgb<u8>) {
    polygon(image, &quad.0, width, color);
    if let Some(center) = center.or_else(|| quad.diagonal_crossing()) {
        line(image, center, quad.0[0], width * 1.5, STEM);
    }
}

/// Every marker of a record, on its picture enlarged or shrunk by `scale`: the box and, where known, corners and stem.
pub fn truth(image: &mut RgbImage, record: &Record, boxes: BoxConvention, scale: f64) {
    let width = (image.width().max(image.height()) as f64 / 350.0).max(1.0);
    for marker in &record.markers {
        let (b, one) = (&marker.bounds, boxes.extra());
        rectangle(image, &[b.x_min * scale, b.y_min * scale, (b.x_max + one) * scale, (b.y_max + one) * scale].into(), width, TRUTH);
        if let Some(corners) = &marker.corners {
            let scaled = Quad(corners.0.map(|p| p.map(|v| v * scale)));
            quad(image, &scaled, marker.center.map(|p| p.map(|v| v * scale)), width, CLAIM);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_covers_what_it_should() {
        let mut image = RgbImage::new(20, 10);
        line(&mut image, [2.0, 5.0], [12.0, 5.0], 2.0, Rgb([255, 0, 0]));
        assert_eq!((image.get_pixel(6, 4)[0], image.get_pixel(6, 5)[0]), (255, 255));
        assert_eq!((image.get_pixel(6, 2)[0], image.get_pixel(6, 7)[0], image.get_pixel(15, 5)[0]), (0, 0, 0));
    }

    #[test]
    fn lines_outside_or_without_numbers_do_nothing() {
        let mut image = RgbImage::new(4, 4);
        line(&mut image, [-100.0, -100.0], [-50.0, -40.0], 3.0, TRUTH);
        line(&mut image, [f64::NAN, 0.0], [4.0, 4.0], 3.0, TRUTH);
        assert!(image.pixels().all(|p| p.0 == [0; 3]));
    }
}
