//! Four sides.
use super::{Geometry, SQUARE};

pub(super) const GEOMETRY: Geometry = Geometry { outline: SQUARE, filled: false, framed: true, lines: &[], oriented: false };
