//! A filled rectangle: easy to find, but it says nothing of its rotation.
use super::{Geometry, SQUARE};

pub(super) const GEOMETRY: Geometry = Geometry { outline: SQUARE, filled: true, framed: false, lines: &[], oriented: false };
