//! Plane projective maps.
use serde::{Deserialize, Serialize};

/// A 3x3 map between planes, row-major. A marker's maps the unit square (0,0), (1,0), (1,1), (0,1), whose corners are
/// `corners` in order, to pixels: read `image_from_marker`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Homography(pub [f64; 9]);

impl Homography {
    /// Maps the unit square's corners (0,0), (1,0), (1,1), (0,1) to `corners`; `None` where three of them are on one line
    /// (Heckbert's closed form).
    #[must_use]
    pub fn from_unit_square(corners: &[[f64; 2]; 4]) -> Option<Self> {
        let [p0, p1, p2, p3] = *corners;
        let (dx1, dx2, dx3) = (p1[0] - p2[0], p3[0] - p2[0], p0[0] - p1[0] + p2[0] - p3[0]);
        let (dy1, dy2, dy3) = (p1[1] - p2[1], p3[1] - p2[1], p0[1] - p1[1] + p2[1] - p3[1]);
        let det = dx1 * dy2 - dx2 * dy1;
        if det.abs() < 1e-12 {
            return None;
        }
        let g = (dx3 * dy2 - dx2 * dy3) / det;
        let h = (dx1 * dy3 - dx3 * dy1) / det;
        let map = Self([
            p1[0] - p0[0] + g * p1[0],
            p3[0] - p0[0] + h * p3[0],
            p0[0],
            p1[1] - p0[1] + g * p1[1],
            p3[1] - p0[1] + h * p3[1],
            p0[1],
            g,
            h,
            1.0,
        ]);
        (map.determinant().abs() > 1e-12).then_some(map)
    }

    /// The image of a point; not finite where the point lies on the map's horizon.
    #[must_use]
    pub fn apply(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let m = &self.0;
        let w = m[6] * x + m[7] * y + m[8];
        [(m[0] * x + m[1] * y + m[2]) / w, (m[3] * x + m[4] * y + m[5]) / w]
    }

    /// `self` after `first`.
    #[must_use]
    pub fn after(&self, first: &Self) -> Self {
        let mut out = [0.0; 9];
        for r in 0..3 {
            for c in 0..3 {
                out[r * 3 + c] = (0..3).map(|k| self.0[r * 3 + k] * first.0[k * 3 + c]).sum();
            }
        }
        Self(out)
    }

    /// Of the 3x3 matrix.
    #[must_use]
    pub fn determinant(&self) -> f64 {
        let m = &self.0;
        m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) + m[2] * (m[3] * m[7] - m[4] * m[6])
    }

    /// The way back; `None` for a singular map.
    #[must_use]
    pub fn inverse(&self) -> Option<Self> {
        let m = &self.0;
        let det = self.determinant();
        if det.abs() < 1e-300 || !det.is_finite() {
            return None;
        }
        let c = |a: usize, b: usize, c: usize, d: usize| (m[a] * m[d] - m[b] * m[c]) / det;
        Some(Self([
            c(4, 5, 7, 8),
            c(2, 1, 8, 7),
            c(1, 2, 4, 5),
            c(5, 3, 8, 6),
            c(0, 2, 6, 8),
            c(2, 0, 5, 3),
            c(3, 4, 6, 7),
            c(1, 0, 7, 6),
            c(0, 1, 3, 4),
        ]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_go_where_they_should_and_come_back() {
        let quad = [[10.0, 12.0], [90.0, 20.0], [80.0, 95.0], [5.0, 70.0]];
        let h = Homography::from_unit_square(&quad).unwrap();
        let back = h.inverse().unwrap();
        for (unit, pixel) in [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].into_iter().zip(quad) {
            let (there, again) = (h.apply(unit), back.apply(pixel));
            for k in 0..2 {
                assert!((there[k] - pixel[k]).abs() < 1e-9 && (again[k] - unit[k]).abs() < 1e-9);
            }
        }
        let same = back.after(&h).0;
        assert!((same[0] / same[8] - 1.0).abs() < 1e-9 && (same[1] / same[8]).abs() < 1e-9);
    }

    #[test]
    fn a_line_is_no_square() {
        assert!(Homography::from_unit_square(&[[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [3.0, 3.0]]).is_none());
    }
}
