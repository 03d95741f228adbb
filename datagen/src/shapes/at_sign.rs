//! The @ sign: the strokes of the Hershey font's complex Roman face, which OpenCV calls `FONT_HERSHEY_COMPLEX` (A. V. Hershey,
//! National Bureau of Standards, 1967; free to use), scaled so that its strokes fill the unit square.
use super::{Geometry, SQUARE, UnitPoint};

/// Units of the font from one side of the sign to the other.
const SIDE: f64 = 21.0;

const fn at(x0: u8, y0: u8, x1: u8, y1: u8) -> [UnitPoint; 2] {
    [[x0 as f64 / SIDE, y0 as f64 / SIDE], [x1 as f64 / SIDE, y1 as f64 / SIDE]]
}

pub(super) const GEOMETRY: Geometry = Geometry {
    outline: SQUARE,
    filled: false,
    framed: false,
    #[rustfmt::skip] // a table
    lines: &[
        at(15, 8, 14, 6), at(14, 6, 12, 5), at(12, 5, 9, 5), at(9, 5, 7, 6), at(7, 6, 6, 7),
        at(6, 7, 5, 10), at(5, 10, 5, 13), at(5, 13, 6, 15), at(6, 15, 8, 16), at(8, 16, 11, 16),
        at(11, 16, 13, 15), at(13, 15, 14, 13), at(9, 5, 7, 7), at(7, 7, 6, 10), at(6, 10, 6, 13),
        at(6, 13, 7, 15), at(7, 15, 8, 16), at(15, 5, 14, 13), at(14, 13, 14, 15), at(14, 15, 16, 16),
        at(16, 16, 18, 16), at(18, 16, 20, 14), at(20, 14, 21, 11), at(21, 11, 21, 9), at(21, 9, 20, 6),
        at(20, 6, 19, 4), at(19, 4, 17, 2), at(17, 2, 15, 1), at(15, 1, 12, 0), at(12, 0, 9, 0),
        at(9, 0, 6, 1), at(6, 1, 4, 2), at(4, 2, 2, 4), at(2, 4, 1, 6), at(1, 6, 0, 9),
        at(0, 9, 0, 12), at(0, 12, 1, 15), at(1, 15, 2, 17), at(2, 17, 4, 19), at(4, 19, 6, 20),
        at(6, 20, 9, 21), at(9, 21, 12, 21), at(12, 21, 15, 20), at(15, 20, 17, 19), at(17, 19, 18, 18),
        at(16, 5, 15, 13), at(15, 13, 15, 15), at(15, 15, 16, 16),
    ],
    oriented: true,
};
