//! Quadrilaterals as four corners: which of them a square in space can look like, and how they follow from their sides.
use super::plane::{Line, Point, between, distance, sub};
use tcross_dataset::Quad;

/// The corners where neighbouring sides cross: `sides[k]` runs from corner k to corner k + 1.
#[must_use]
pub fn corners_of(sides: &[Line; 4]) -> Option<[Point; 4]> {
    let mut corners = [[0.0; 2]; 4];
    for k in 0..4 {
        corners[k] = sides[(k + 3) % 4].crossing(&sides[k])?;
    }
    Some(corners)
}

/// True for four finite corners that run clockwise as seen, turn everywhere the same way and stay away from a triangle
/// or a needle.
#[must_use]
pub fn is_sound(corners: &[Point; 4]) -> bool {
    let quad = Quad(*corners);
    let area = quad.signed_area();
    let longest = (0..4).map(|k| distance(corners[k], corners[(k + 1) % 4])).fold(0.0, f64::max);
    area.is_finite()
        && area > 0.02 * longest * longest
        && (0..4).all(|k| {
            let (u, v) = (sub(corners[(k + 1) % 4], corners[k]), sub(corners[(k + 2) % 4], corners[(k + 1) % 4]));
            u[0] * v[1] - u[1] * v[0] > 0.08 * area
        })
}

/// A point on the side from corner `k` to corner `k + 1`.
#[must_use]
pub fn on_side(corners: &[Point; 4], k: usize, t: f64) -> Point {
    between(corners[k], corners[(k + 1) % 4], t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn needles_and_bow_ties_are_unsound() {
        assert!(is_sound(&[[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]]));
        assert!(!is_sound(&[[0.0, 0.0], [10.0, 10.0], [10.0, 0.0], [0.0, 10.0]]));
        assert!(!is_sound(&[[0.0, 0.0], [100.0, 0.0], [100.0, 0.5], [0.0, 0.5]]));
        assert!(!is_sound(&[[f64::NAN; 2]; 4]));
    }
}
