//! Both diagonals, a vertical and a horizontal line through the middle.
use super::{Geometry, SQUARE};

pub(super) const GEOMETRY: Geometry = Geometry {
    outline: SQUARE,
    filled: false,
    framed: false,
    lines: &[[[0.0, 0.0], [1.0, 1.0]], [[1.0, 0.0], [0.0, 1.0]], [[0.5, 0.0], [0.5, 1.0]], [[0.0, 0.5], [1.0, 0.5]]],
    oriented: false,
};
