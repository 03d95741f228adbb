//! The paper's artificial images, pixel for pixel: integers, OpenCV's lines, inclusive boxes.
use crate::{
    color,
    config::{PaperColors, PaperConfig},
    shapes::{Shape, UnitPoint},
};
use image::{Rgb, RgbImage};
use raster::Point;
use tcross_dataset::{Homography, Marker, PixelBox, Quad, Rng, geom::quad::angle_deg};

pub mod raster;

/// The whole-pixel frame in which a shape is drawn: its first pixel, and its width and height less one.
struct Frame {
    origin: Point,
    width: i64,
    height: i64,
    /// Which corner of the frame the shape's first corner lies on, clockwise from the top left.
    turn: usize,
}

impl Frame {
    /// A corner, a middle of a side or the middle; halves are rounded down, as in the paper's code.
    fn place(&self, point: UnitPoint) -> Point {
        let [u, v] = turned(point, self.turn);
        let along = |t: f64, length: i64| (t * length as f64).floor() as i64;
        (self.origin.0 + along(u, self.width), self.origin.1 + along(v, self.height))
    }
}

/// A point of the unit frame after `turn` quarter turns clockwise as seen.
fn turned([u, v]: UnitPoint, turn: usize) -> UnitPoint {
    (0..turn).fold([u, v], |[u, v], _| [1.0 - v, u])
}

/// Draws one marker somewhere on the picture and returns its truth. `rng` is the image's own stream.
///
/// Draws in this order: width, height, x, y, thickness, variant, colours.
pub fn draw(image: &mut RgbImage, config: &PaperConfig, rng: &mut Rng) -> Marker {
    let whole = |dist: &crate::dist::Dist, rng: &mut Rng| dist.sample(rng).floor() as i64;
    let (width, height) = if config.shape == Shape::AtSign {
        let side = whole(&config.at_sign_side, rng);
        (side, side)
    } else {
        (whole(&config.width, rng), whole(&config.height, rng))
    };
    let x = rng.int(1, i64::from(image.width()) - width - 1);
    let y = rng.int(1, i64::from(image.height()) - height - 1);
    let thickness = whole(&config.thickness, rng) as u32;
    let geometry = config.shape.geometry();
    let turn = if config.shape == Shape::TCross { rng.index(4) } else { 0 };
    let (fill, lines) = colors(config.colors, rng);
    let frame = Frame { origin: (x, y), width, height, turn };

    let line_color = if geometry.filled { lines } else { fill };
    match config.shape {
        Shape::AtSign => draw_at_sign(image, &frame, fill, thickness),
        Shape::FilledTriangle => fill_triangle(image, &frame, fill),
        _ if geometry.filled => raster::fill_rectangle(image, (x, y), (x + width, y + height), fill),
        _ => {}
    }
    if geometry.framed {
        for k in 0..geometry.outline.len() {
            let (a, b) = (geometry.outline[k], geometry.outline[(k + 1) % geometry.outline.len()]);
            raster::line(image, frame.place(a), frame.place(b), line_color, thickness);
        }
    }
    if config.shape != Shape::AtSign {
        for [a, b] in geometry.lines {
            raster::line(image, frame.place(*a), frame.place(*b), line_color, thickness);
        }
    }
    truth(config.shape, &frame, thickness, fill, lines)
}

/// Green and blue, or the paper's coloured variants: two of three channels, and one channel, at the same draws of 200..255.
fn colors(kind: PaperColors, rng: &mut Rng) -> (Rgb<u8>, Rgb<u8>) {
    if kind == PaperColors::Fixed {
        return (Rgb([0, 200, 0]), Rgb([0, 0, 200]));
    }
    let level: [u8; 3] = std::array::from_fn(|_| rng.int(200, 255) as u8);
    let (dark, bright) = (rng.index(3), rng.index(3));
    (
        Rgb(std::array::from_fn(|c| if c == dark { 0 } else { level[c] })),
        Rgb(std::array::from_fn(|c| if c == bright { level[c] } else { 0 })),
    )
}

/// OpenCV's `putText` of "@" in the face that [`Shape::AtSign`] holds: scale width/23, origin (x - 2, y - 1 + height).
fn draw_at_sign(image: &mut RgbImage, frame: &Frame, color: Rgb<u8>, thickness: u32) {
    // The sign's strokes reach over 21 units; its box starts 3 units right of the pen and ends on the 9th unit below the middle line.
    let scale = frame.width as f64 / 23.0;
    let (pen_x, pen_y) = ((frame.origin.0 - 2) as f64, (frame.origin.1 - 1 + frame.height) as f64);
    let place = |[u, v]: UnitPoint| -> Point {
        ((pen_x + (u * 21.0 + 3.0) * scale).round_ties_even() as i64, (pen_y + (v * 21.0 - 21.0) * scale).round_ties_even() as i64)
    };
    for [a, b] in Shape::AtSign.geometry().lines {
        raster::line(image, place(*a), place(*b), color, thickness);
    }
}

/// The triangle with both ends of every row in, and its outline.
fn fill_triangle(image: &mut RgbImage, frame: &Frame, color: Rgb<u8>) {
    let [apex, right, left] = [[0.5, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|p| frame.place(p));
    for y in apex.1..=left.1 {
        let t = (y - apex.1) as f64 / (left.1 - apex.1).max(1) as f64;
        let side = |end: Point| apex.0 as f64 + (end.0 - apex.0) as f64 * t;
        raster::fill_rectangle(image, ((side(left) + 0.5).floor() as i64, y), ((side(right) + 0.5).floor() as i64, y), color);
    }
    for (a, b) in [(apex, right), (right, left), (left, apex)] {
        raster::line(image, a, b, color, 1);
    }
}

/// The paper's box (inclusive), and the outer corners of what is drawn in continuous pixels.
fn truth(shape: Shape, frame: &Frame, thickness: u32, fill: Rgb<u8>, lines: Rgb<u8>) -> Marker {
    let (x, y) = (frame.origin.0 as f64, frame.origin.1 as f64);
    let (w, h) = (frame.width as f64, frame.height as f64);
    let mut marker = Marker::from_box(shape.name(), PixelBox { x_min: x, y_min: y, x_max: x + w, y_max: y + h });
    let corner = |p: UnitPoint| {
        let [u, v] = turned(p, frame.turn);
        [x + u * (w + 1.0), y + v * (h + 1.0)]
    };
    let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(corner);
    marker.corners = Some(Quad(corners));
    marker.homography = Homography::from_unit_square(&corners);
    let center = frame.place([0.5, 0.5]);
    marker.center = Some([center.0 as f64 + 0.5, center.1 as f64 + 0.5]);
    let geometry = shape.geometry();
    if geometry.oriented {
        let end = if shape == Shape::TCross { frame.place([0.0, 0.0]) } else { frame.place([0.5, 0.0]) };
        marker.angle = Some(angle_deg((end.0 - center.0) as f64, (end.1 - center.1) as f64));
    }
    if shape == Shape::TCross {
        marker.stem = Some(0);
    }
    marker.visible = Some(1.0);
    marker.fill = Some(color::hex(color::linear(fill)));
    if geometry.filled && !geometry.lines.is_empty() {
        marker.line = Some(color::hex(color::linear(lines)));
    }
    marker.thickness = Some(f64::from(thickness));
    marker
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dist::Dist;

    fn drawn(config: &PaperConfig, index: u64) -> (RgbImage, Marker) {
        let mut image = RgbImage::new(416, 416);
        let marker = draw(&mut image, config, &mut Rng::for_item(0, "test/paper", index));
        (image, marker)
    }

    #[test]
    fn the_box_is_what_is_drawn_and_the_corners_its_outside() {
        for index in 0..200 {
            let (image, marker) = drawn(&PaperConfig { thickness: Dist::constant(1.0), ..Default::default() }, index);
            let at = |k: fn(u32, u32) -> u32| image.enumerate_pixels().filter(|(_, _, p)| p.0 != [0; 3]).map(move |(x, y, _)| k(x, y));
            let x = |x: u32, _: u32| x;
            let y = |_: u32, y: u32| y;
            let extent = [at(x).min(), at(y).min(), at(x).max(), at(y).max()].map(|v| f64::from(v.unwrap()));
            assert_eq!(<[f64; 4]>::from(marker.bounds), extent);
            let outside = marker.corners.unwrap();
            assert!(outside.signed_area() > 0.0, "clockwise");
            assert_eq!(<[f64; 4]>::from(outside.bounds()), [extent[0], extent[1], extent[2] + 1.0, extent[3] + 1.0]);
        }
    }

    #[test]
    fn the_stem_is_where_the_truth_says() {
        let mut seen = [0; 4];
        for index in 0..200 {
            let (image, marker) = drawn(&PaperConfig { thickness: Dist::constant(1.0), ..Default::default() }, index);
            let (corners, center) = (marker.corners.unwrap().0, marker.center.unwrap());
            // The last pixel before each corner is blue but for the corner opposite the stem.
            let blue = corners.map(|c| {
                let inside = |k: usize| if c[k] < center[k] { c[k] } else { c[k] - 1.0 };
                image.get_pixel(inside(0) as u32, inside(1) as u32).0 == [0, 0, 200]
            });
            assert_eq!(blue, [true, true, false, true]);
            let quarter = (marker.angle.unwrap() / 90.0) as usize;
            seen[quarter] += 1;
        }
        assert!(seen.iter().all(|n| *n > 25), "{seen:?}");
    }

    #[test]
    fn every_shape_of_the_paper_is_drawn_inside_its_box() {
        for shape in Shape::ALL {
            for index in 0..50 {
                let (image, marker) = drawn(&PaperConfig { shape, ..Default::default() }, index);
                let grown = marker.bounds;
                let mut count = 0;
                for (px, py, p) in image.enumerate_pixels().filter(|(_, _, p)| p.0 != [0; 3]) {
                    let (x, y) = (f64::from(px), f64::from(py));
                    count += 1;
                    let margin = 2.0; // the discs at the ends of thick lines, and the sign's own bearings
                    assert!(
                        x >= grown.x_min - margin && x <= grown.x_max + margin && y >= grown.y_min - margin && y <= grown.y_max + margin,
                        "{shape:?} {index}: {p:?} at {x} {y} outside {grown:?}"
                    );
                }
                assert!(count > 10, "{shape:?}");
            }
        }
    }
}
