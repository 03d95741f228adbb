//! Both diagonals and nothing else: a near miss.
use super::{Geometry, SQUARE};

pub(super) const GEOMETRY: Geometry = Geometry {
    outline: SQUARE,
    filled: false,
    framed: false,
    lines: &[[[0.0, 0.0], [1.0, 1.0]], [[1.0, 0.0], [0.0, 1.0]]],
    oriented: false,
};
