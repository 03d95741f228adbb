//! A star on a filled rectangle.
use super::{Geometry, SQUARE};

pub(super) const GEOMETRY: Geometry = Geometry {
    outline: SQUARE,
    filled: true,
    framed: false,
    lines: &[[[0.0, 0.0], [1.0, 1.0]], [[1.0, 0.0], [0.0, 1.0]], [[0.5, 0.0], [0.5, 1.0]], [[0.0, 0.5], [1.0, 0.5]]],
    oriented: false,
};
