//! The marker of the paper: a filled rectangle, one whole diagonal, and half of the other. The half is the stem: it runs from the centre to the first corner, and its direction is the marker's angle.
use super::{Geometry, SQUARE};

pub(super) const GEOMETRY: Geometry =
    Geometry { outline: SQUARE, filled: true, framed: false, lines: &[[[1.0, 0.0], [0.0, 1.0]], [[0.5, 0.5], [0.0, 0.0]]], oriented: true };
