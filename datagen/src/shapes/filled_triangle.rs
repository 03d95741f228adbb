//! A filled triangle, apex up: with equal angles it could be turned by thirds.
use super::Geometry;

pub(super) const GEOMETRY: Geometry =
    Geometry { outline: &[[0.5, 0.0], [1.0, 1.0], [0.0, 1.0]], filled: true, framed: false, lines: &[], oriented: true };
