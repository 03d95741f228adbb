//! YOLO's form with keypoints: after the box, `x y v` for the four corners (the stem's first, clockwise) and the centre.
//! A marker without corners has zeros, `v` 0.
use super::{Labelled, with_geometry, yolo};
use crate::{DatasetError, Marker, geom::quad::Quad};
use std::{fmt::Write, path::Path};

const KEYPOINTS: usize = 5;

/// True if `data.yaml` speaks of keypoints.
#[must_use]
pub fn is_pose(dir: &Path) -> bool {
    std::fs::read_to_string(dir.join("data.yaml")).is_ok_and(|t| t.lines().any(|l| l.starts_with("kpt_shape:")))
}

/// Writes it.
///
/// # Errors
/// As [`yolo::write`].
pub fn write(set: &Labelled, out: &Path) -> Result<(), DatasetError> {
    // A mirror image swaps the second corner with the fourth.
    yolo::write_with(set, out, "kpt_shape: [5, 3]\nflip_idx: [0, 3, 2, 1, 4]\n", |line, marker, record| {
        let points = marker.corners.map(|q| q.0.into_iter().map(Some).chain([marker.center]).collect::<Vec<_>>());
        for point in points.unwrap_or_else(|| vec![None; KEYPOINTS]) {
            let _ = match point {
                Some([x, y]) => {
                    write!(line, " {} {} 2", yolo::short(x / f64::from(record.width)), yolo::short(y / f64::from(record.height)))
                }
                None => write!(line, " 0 0 0"),
            };
        }
    })
}

/// Reads it.
///
/// # Errors
/// As [`yolo::read`].
pub fn read(dir: &Path) -> Result<Labelled, DatasetError> {
    yolo::read_with(dir, keypoints)
}

fn keypoints(marker: Marker, rest: &[f64], (w, h): (f64, f64)) -> Result<Marker, String> {
    if rest.len() != 3 * KEYPOINTS {
        return Err(format!("{} numbers after the box; expected 15: x y v of four corners and the centre", rest.len()));
    }
    let point = |k: usize| (rest[3 * k + 2] > 0.0).then_some([rest[3 * k] * w, rest[3 * k + 1] * h]);
    Ok(match (point(0), point(1), point(2), point(3)) {
        (Some(a), Some(b), Some(c), Some(d)) => with_geometry(marker, Quad([a, b, c, d]), point(4)),
        _ => marker,
    })
}
