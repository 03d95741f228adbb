//! Quadrilaterals: a marker's four corners.
use super::boxes::PixelBox;
use serde::{Deserialize, Serialize};

/// Four corners in pixels, clockwise as seen (y grows downwards), the stem's corner first.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Quad(pub [[f64; 2]; 4]);

impl Quad {
    /// Twice-signed area halved: positive for corners that run clockwise as seen.
    #[must_use]
    pub fn signed_area(&self) -> f64 {
        polygon_area(&self.0)
    }

    /// The root of the area: the marker's side in pixels.
    #[must_use]
    pub fn side_px(&self) -> f64 {
        self.signed_area().abs().sqrt()
    }

    /// The smallest box that holds all corners.
    #[must_use]
    pub fn bounds(&self) -> PixelBox {
        let fold = |k: usize, f: fn(f64, f64) -> f64, start: f64| self.0.iter().fold(start, |m, p| f(m, p[k]));
        PixelBox {
            x_min: fold(0, f64::min, f64::INFINITY),
            y_min: fold(1, f64::min, f64::INFINITY),
            x_max: fold(0, f64::max, f64::NEG_INFINITY),
            y_max: fold(1, f64::max, f64::NEG_INFINITY),
        }
    }

    /// Where the diagonals cross; `None` where they are parallel.
    #[must_use]
    pub fn diagonal_crossing(&self) -> Option<[f64; 2]> {
        let [a, b, c, d] = self.0;
        let (u, v) = ([c[0] - a[0], c[1] - a[1]], [d[0] - b[0], d[1] - b[1]]);
        let det = u[0] * v[1] - u[1] * v[0];
        if det.abs() < 1e-12 {
            return None;
        }
        let t = ((b[0] - a[0]) * v[1] - (b[1] - a[1]) * v[0]) / det;
        Some([a[0] + t * u[0], a[1] + t * u[1]])
    }

    /// Intersection over union of two convex quadrilaterals.
    #[must_use]
    pub fn iou(&self, other: &Self) -> f64 {
        let common = polygon_area(&clip_convex(&clockwise(&self.0), &clockwise(&other.0))).abs();
        let union = self.signed_area().abs() + other.signed_area().abs() - common;
        if union > 0.0 { common / union } else { 0.0 }
    }
}

/// The paper's angle of a vector in degrees, [0, 360): 0 is right, 90 is up, counter-clockwise as seen.
#[must_use]
pub fn angle_deg(dx: f64, dy: f64) -> f64 {
    let angle = (-dy).atan2(dx).to_degrees().rem_euclid(360.0);
    if angle >= 360.0 { 0.0 } else { angle }
}

/// Shoelace area; positive for points that run clockwise as seen.
#[must_use]
pub fn polygon_area(points: &[[f64; 2]]) -> f64 {
    let n = points.len();
    (0..n).map(|i| points[i][0] * points[(i + 1) % n][1] - points[(i + 1) % n][0] * points[i][1]).sum::<f64>() / 2.0
}

fn clockwise(quad: &[[f64; 2]; 4]) -> Vec<[f64; 2]> {
    let mut points = quad.to_vec();
    if polygon_area(&points) < 0.0 {
        points.reverse();
    }
    points
}

/// Sutherland-Hodgman: the part of `subject` inside the convex `clip`, both clockwise as seen.
#[must_use]
pub fn clip_convex(subject: &[[f64; 2]], clip: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut out = subject.to_vec();
    for i in 0..clip.len() {
        let (a, b) = (clip[i], clip[(i + 1) % clip.len()]);
        let side = |p: [f64; 2]| (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]);
        let input = std::mem::take(&mut out);
        for (k, &p) in input.iter().enumerate() {
            let q = input[(k + 1) % input.len()];
            let (sp, sq) = (side(p), side(q));
            if sp >= 0.0 {
                out.push(p);
            }
            if (sp > 0.0 && sq < 0.0) || (sp < 0.0 && sq > 0.0) {
                let t = sp / (sp - sq);
                out.push([p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])]);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_as_in_the_paper() {
        for (d, want) in [([1.0, 0.0], 0.0), ([0.0, -1.0], 90.0), ([-1.0, 0.0], 180.0), ([0.0, 1.0], 270.0)] {
            assert!((angle_deg(d[0], d[1]) - want).abs() < 1e-12);
        }
    }

    #[test]
    fn squares_overlap() {
        let a = Quad([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]);
        let b = Quad([[1.0, 1.0], [3.0, 1.0], [3.0, 3.0], [1.0, 3.0]]);
        let mut reversed = b;
        reversed.0.reverse();
        assert!(a.signed_area() > 0.0);
        assert!((a.iou(&b) - 1.0 / 7.0).abs() < 1e-12 && (a.iou(&reversed) - 1.0 / 7.0).abs() < 1e-12);
        assert_eq!(a.diagonal_crossing(), Some([1.0, 1.0]));
    }
}
