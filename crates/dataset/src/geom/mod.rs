//! Geometry of boxes, quadrilaterals, homographies and the letterbox. Pixels are continuous: (0, 0) is the outer corner of
//! the first pixel, x right, y down.
pub mod boxes;
pub mod homography;
pub mod letterbox;
pub mod quad;
