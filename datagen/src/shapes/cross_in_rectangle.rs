//! Both diagonals on a filled rectangle: the nearest relative of the T cross.
use super::{Geometry, SQUARE};

pub(super) const GEOMETRY: Geometry = Geometry {
    outline: SQUARE,
    filled: true,
    framed: false,
    lines: &[[[0.0, 0.0], [1.0, 1.0]], [[1.0, 0.0], [0.0, 1.0]]],
    oriented: false,
};
