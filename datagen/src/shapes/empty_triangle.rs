//! Three sides, apex up.
use super::Geometry;

pub(super) const GEOMETRY: Geometry =
    Geometry { outline: &[[0.5, 0.0], [1.0, 1.0], [0.0, 1.0]], filled: false, framed: true, lines: &[], oriented: true };
