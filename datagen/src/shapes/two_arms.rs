//! A filled rectangle whose cross lacks two arms: a near miss.
use super::{Geometry, SQUARE};

pub(super) const GEOMETRY: Geometry =
    Geometry { outline: SQUARE, filled: true, framed: false, lines: &[[[0.5, 0.5], [0.0, 0.0]], [[0.5, 0.5], [1.0, 0.0]]], oriented: true };
