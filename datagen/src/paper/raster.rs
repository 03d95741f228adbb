//! Rectangles and lines exactly as OpenCV draws them without antialiasing, because the paper's images were drawn by it.
//!
//! Thickness 1 is the 8-connected Bresenham line from left to right; thickness 2 (the only other one in the paper) is a convex polygon in 16-bit fixed
//! point with its outline, and a disc at each end. The tests hold pixels drawn by OpenCV itself.
use image::{Rgb, RgbImage};

const SHIFT: u32 = 16;
const ONE: i64 = 1 << SHIFT;
const HALF: i64 = ONE / 2;

/// A place in whole pixels.
pub type Point = (i64, i64);

fn put(image: &mut RgbImage, x: i64, y: i64, color: Rgb<u8>) {
    if x >= 0 && y >= 0 && x < i64::from(image.width()) && y < i64::from(image.height()) {
        image.put_pixel(x as u32, y as u32, color);
    }
}

fn row(image: &mut RgbImage, x0: i64, x1: i64, y: i64, color: Rgb<u8>) {
    for x in x0.max(0)..=x1.min(i64::from(image.width()) - 1) {
        put(image, x, y, color);
    }
}

/// A filled rectangle, both corners in.
pub fn fill_rectangle(image: &mut RgbImage, (x0, y0): Point, (x1, y1): Point, color: Rgb<u8>) {
    for y in y0..=y1 {
        row(image, x0, x1, y, color);
    }
}

/// A line with both ends in; `thickness` is 1 or 2, as in the paper (odd widths from 3 up differ from OpenCV's).
pub fn line(image: &mut RgbImage, from: Point, to: Point, color: Rgb<u8>, thickness: u32) {
    if thickness <= 1 { thin_line(image, from, to, color) } else { thick_line(image, from, to, color, i64::from(thickness)) }
}

/// OpenCV's `LineIterator`, always walked from left to right.
fn thin_line(image: &mut RgbImage, from: Point, to: Point, color: Rgb<u8>) {
    let (from, to) = if to.0 < from.0 { (to, from) } else { (from, to) };
    let (dx, dy) = (to.0 - from.0, (to.1 - from.1).abs());
    let down = (to.1 - from.1).signum();
    let steep = dy > dx;
    let (long, short) = if steep { (dy, dx) } else { (dx, dy) };
    let (mut x, mut y, mut error) = (from.0, from.1, long - 2 * short);
    for _ in 0..=long {
        put(image, x, y, color);
        let sideways = error < 0;
        error += if sideways { 2 * long } else { 0 } - 2 * short;
        if steep || sideways {
            y += down;
        }
        if !steep || sideways {
            x += 1;
        }
    }
}

/// OpenCV's `ThickLine`: a convex quadrilateral in fixed point, and a disc at each end.
fn thick_line(image: &mut RgbImage, from: Point, to: Point, color: Rgb<u8>, thickness: i64) {
    let (dx, dy) = ((from.0 - to.0) as f64, (to.1 - from.1) as f64);
    let length = (dx * dx + dy * dy).sqrt();
    let half = thickness << (SHIFT - 1);
    if length > 0.0 {
        let scale = half as f64 / length;
        let (ox, oy) = ((dy * scale).round_ties_even() as i64, (dx * scale).round_ties_even() as i64);
        let fixed = |p: Point| (p.0 << SHIFT, p.1 << SHIFT);
        let (p, q) = (fixed(from), fixed(to));
        fill_convex(image, &[(p.0 + ox, p.1 + oy), (p.0 - ox, p.1 - oy), (q.0 - ox, q.1 - oy), (q.0 + ox, q.1 + oy)], color);
    }
    for center in [from, to] {
        fill_disc(image, center, (half + HALF) >> SHIFT, color);
    }
}

/// OpenCV's `FillConvexPoly` of points in 16-bit fixed point: the outline, then the rows between the two edges.
fn fill_convex(image: &mut RgbImage, points: &[Point; 4], color: Rgb<u8>) {
    for k in 0..4 {
        fixed_line(image, points[(k + 3) % 4], points[k], color);
    }
    let rounded = |v: i64| (v + HALF) >> SHIFT;
    let top = (0..4).fold(0, |best, k| if points[k].1 < points[best].1 { k } else { best });
    let last = rounded(points.iter().map(|p| p.1).max().unwrap_or(0)).min(i64::from(image.height()) - 1);
    let mut y = rounded(points[top].1);
    // Each edge: where it stands (index of the corner it left, x, slope) and the row at which it ends; one walks forwards, one backwards.
    let mut edges = [(top, 1, -ONE, 0, y), (top, 3, -ONE, 0, y)];
    let mut left_to_visit = 4;
    while y <= last {
        for (at, step, x, slope, end) in &mut edges {
            if y < *end {
                continue;
            }
            let (mut here, mut next) = (*at, (*at + *step) % 4);
            while left_to_visit > 0 {
                left_to_visit -= 1;
                let bottom = rounded(points[next].1);
                if bottom > y {
                    let rows = bottom - y;
                    *end = bottom;
                    *slope = ((points[next].0 - points[here].0) * 2 + rows) / (2 * rows);
                    *x = points[here].0;
                    *at = next;
                    break;
                }
                here = next;
                next = (next + *step) % 4;
            }
        }
        let (a, b) = (edges[0].2.min(edges[1].2), edges[0].2.max(edges[1].2));
        if y >= 0 {
            row(image, rounded(a), rounded(b), y, color);
        }
        for (_, _, x, slope, _) in &mut edges {
            *x += *slope;
        }
        y += 1;
    }
}

/// OpenCV's `Line2`: a line between fixed-point ends.
fn fixed_line(image: &mut RgbImage, from: Point, to: Point, color: Rgb<u8>) {
    let (dx, dy) = (to.0 - from.0, to.1 - from.1);
    if dx.abs() > dy.abs() {
        let (from, to, dy) = if dx < 0 { (to, from, -dy) } else { (from, to, dy) };
        put(image, (to.0 + HALF) >> SHIFT, (to.1 + HALF) >> SHIFT, color);
        let slope = dy * ONE / (dx.abs() | 1);
        let (mut x, mut y) = ((from.0 + HALF) >> SHIFT, from.1 + HALF);
        for _ in 0..=((to.0 - from.0) >> SHIFT) {
            put(image, x, y >> SHIFT, color);
            x += 1;
            y += slope;
        }
    } else {
        let (from, to, dx) = if dy < 0 { (to, from, -dx) } else { (from, to, dx) };
        put(image, (to.0 + HALF) >> SHIFT, (to.1 + HALF) >> SHIFT, color);
        let slope = dx * ONE / (dy.abs() | 1);
        let (mut x, mut y) = (from.0 + HALF, (from.1 + HALF) >> SHIFT);
        for _ in 0..=((to.1 - from.1) >> SHIFT) {
            put(image, x >> SHIFT, y, color);
            x += slope;
            y += 1;
        }
    }
}

/// OpenCV's filled `Circle` (midpoint algorithm).
fn fill_disc(image: &mut RgbImage, (cx, cy): Point, radius: i64, color: Rgb<u8>) {
    let (mut dx, mut dy, mut error, mut plus, mut minus) = (radius, 0, 0, 1, 2 * radius - 1);
    while dx >= dy {
        for (w, h) in [(dx, dy), (dy, dx)] {
            row(image, cx - w, cx + w, cy - h, color);
            row(image, cx - w, cx + w, cy + h, color);
        }
        dy += 1;
        error += plus;
        plus += 2;
        if error > 0 {
            error -= minus;
            dx -= 1;
            minus -= 2;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lines drawn by OpenCV 4.14 (`cv2.line`, `LINE_8`), one a row: x0 y0 x1 y1 thickness, then the BLAKE3 of the 80x80 mask.
    const DRAWN_BY_OPENCV: &str = include_str!("../../tests/fixtures/opencv_lines.txt");

    #[test]
    fn lines_equal_opencvs_pixel_for_pixel() {
        let mut count = 0;
        for row in DRAWN_BY_OPENCV.lines().filter(|l| !l.starts_with('#')) {
            let words: Vec<&str> = row.split(' ').collect();
            let n = |k: usize| words[k].parse::<i64>().unwrap();
            let mut image = RgbImage::new(80, 80);
            line(&mut image, (n(0), n(1)), (n(2), n(3)), Rgb([255; 3]), n(4) as u32);
            let mask: Vec<u8> = image.pixels().map(|p| p[0]).collect();
            assert_eq!(&blake3::hash(&mask).to_hex()[..16], words[5], "line {row}");
            count += 1;
        }
        assert!(count >= 350);
    }

    #[test]
    fn rectangles_hold_both_ends() {
        let mut image = RgbImage::new(10, 10);
        fill_rectangle(&mut image, (2, 3), (5, 4), Rgb([255; 3]));
        assert_eq!(image.pixels().filter(|p| p[0] == 255).count(), 4 * 2);
    }
}
