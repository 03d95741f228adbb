//! What is known of four corners together: a marker is about a square, so that its shape up to an affine map tells how it is tilted, and
//! this how perspective bends the parallelogram that it would be from far away.
use super::{
    fit::Corner,
    plane::{Point, dot, norm},
};

/// Focal length of an unknown camera, in longer sides of its picture: a view of 64 degrees, as telephones have.
const FOCAL: f64 = 0.8;
/// Deviation of the bend from what the tilt tells: a share of it, since focal lengths differ and hands do not draw squares, and in sides
/// and pixels.
const SHARE: f64 = 0.5;
const FLOOR: f64 = 0.03;
const FLOOR_PX: f64 = 0.5;

/// `c0 - c1 + c2 - c3`: zero for a parallelogram.
fn bend(corners: &[Point; 4]) -> Point {
    [0, 1].map(|axis| corners[0][axis] - corners[1][axis] + corners[2][axis] - corners[3][axis])
}

/// The sides of the parallelogram that these corners are but for perspective: those from the first corner to the second and to the fourth.
fn sides([a, b, c, d]: &[Point; 4]) -> [Point; 2] {
    [[0, 1].map(|axis| 0.5 * (b[axis] - a[axis] + c[axis] - d[axis])), [0, 1].map(|axis| 0.5 * (d[axis] - a[axis] + c[axis] - b[axis]))]
}

/// The squared side of the square that looks like a parallelogram of sides `u` and `v` when it is tilted. Its sides, of one length, have
/// these as shadows: with z the third coordinates, |u|^2 + zu^2 = |v|^2 + zv^2 and u.v + zu zv = 0.
fn squared_side(u: Point, v: Point) -> f64 {
    let (uu, vv) = (dot(u, u), dot(v, v));
    0.5 * (uu + vv) + (0.5 * (uu - vv)).hypot(dot(u, v))
}

/// Cosine of the angle by which a square is tilted that looks like these corners: 1 from the front. A part of a square that is taken for the
/// whole looks tilted.
#[must_use]
pub fn cos_tilt(corners: &[Point; 4]) -> f64 {
    let [u, v] = sides(corners);
    (u[0] * v[1] - u[1] * v[0]).abs() / squared_side(u, v).max(1e-9)
}

/// How a square bends that looks like these corners but for perspective, up to its sign: the corners tell how much it is tilted, not
/// which way. `focal` in pixels.
fn bend_of_square(corners: &[Point; 4], focal: f64) -> Point {
    let [u, v] = sides(corners);
    let square = squared_side(u, v);
    let (zu, zv) = ((square - dot(u, u)).max(0.0).sqrt(), (square - dot(v, v)).max(0.0).sqrt());
    let zv = if dot(u, v) > 0.0 { -zv } else { zv };
    // A point (i, j) of the square lies (i zu + j zv) farther than the middle, whose distance is `focal` in these pixels: divided by that, the
    // product i j is left.
    [0, 1].map(|axis| (zu * v[axis] + zv * u[axis]) / focal)
}

/// The corners moved, each as far as it is unsure, such that they are more like a square in perspective. `size` is the picture's longer side.
#[must_use]
pub fn regular(corners: [Corner; 4], side_px: f64, size: f64) -> [Point; 4] {
    let places = corners.map(|c| c.at);
    let found = bend(&places);
    let tilted = bend_of_square(&places, FOCAL * size);
    // Tilted one way, the other, or no square at all and seen from the front.
    let from = |[x, y]: Point| norm([found[0] - x, found[1] - y]);
    let wanted = [[0.0, 0.0], tilted, tilted.map(|v| -v)].into_iter().min_by(|a, b| from(*a).total_cmp(&from(*b))).unwrap_or_default();
    let slack = (FLOOR * side_px).hypot(FLOOR_PX).hypot(SHARE * norm(tilted)).powi(2);
    let mut sum = [slack, 0.0, slack];
    for corner in &corners {
        (0..3).for_each(|k| sum[k] += corner.covariance[k]);
    }
    let [xx, xy, yy] = sum;
    let det = xx * yy - xy * xy;
    if !(det > 0.0) {
        return places;
    }
    let off = [found[0] - wanted[0], found[1] - wanted[1]];
    let pull = [(yy * off[0] - xy * off[1]) / det, (xx * off[1] - xy * off[0]) / det];
    let mut sign = -1.0;
    corners.map(|Corner { at, covariance: [xx, xy, yy] }| {
        let moved = [at[0] + sign * (xx * pull[0] + xy * pull[1]), at[1] + sign * (xy * pull[0] + yy * pull[1])];
        sign = -sign;
        moved
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A square of `side`, turned, tilted about an axis and seen from a distance.
    pub fn seen(side: f64, turn: f64, tilt: f64, axis: f64, distance: f64, focal: f64) -> [Point; 4] {
        let (sin, cos) = axis.sin_cos();
        [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)].map(|(x, y)| {
            let [x, y] = [side * (x * turn.cos() - y * turn.sin()), side * (x * turn.sin() + y * turn.cos())];
            let (along, across) = (x * cos + y * sin, y * cos - x * sin);
            let (across, z) = (across * tilt.cos(), distance + across * tilt.sin());
            [focal * (along * cos - across * sin) / z, focal * (along * sin + across * cos) / z]
        })
    }

    #[test]
    fn the_tilt_tells_the_bend() {
        for (turn, tilt, axis) in [(0.0, 0.9, 0.0), (0.3, 0.9, 0.0), (0.3, -0.9, 1.1), (1.0, 0.5, 2.0), (0.7, 1.0, -0.4)] {
            let corners = seen(1.0, turn, tilt, axis, 20.0, 1000.0);
            let (found, told) = (bend(&corners), bend_of_square(&corners, 1000.0));
            let sign = dot(found, told).signum();
            let off = norm([found[0] - sign * told[0], found[1] - sign * told[1]]);
            assert!(off < 0.1 * norm(found), "{turn} {tilt} {axis}: {found:?} {told:?}");
            assert!((cos_tilt(&corners) - tilt.cos()).abs() < 0.01, "{turn} {tilt} {axis}: {}", cos_tilt(&corners));
        }
        assert!(norm(bend_of_square(&seen(1.0, 0.4, 0.0, 0.0, 20.0, 1000.0), 1000.0)) < 1e-6);
    }

    #[test]
    fn a_corner_that_is_off_is_drawn_back_and_the_others_hardly_move() {
        let true_corners = seen(1.0, 0.3, 0.7, 0.5, 10.0, 1000.0);
        let mut corners = true_corners.map(|at| Corner { at, covariance: [1.0, 0.0, 1.0] });
        // Along the bend, so that it is the tilt's and not its opposite that is nearest.
        let bend = bend(&true_corners);
        for axis in 0..2 {
            corners[2].at[axis] += 12.0 * bend[axis] / norm(bend);
        }
        corners[2].covariance = [100.0, 0.0, 100.0];
        let after = regular(corners, 90.0, 1250.0);
        let off = |k: usize| norm([after[k][0] - true_corners[k][0], after[k][1] - true_corners[k][1]]);
        assert!(off(2) < 7.0 && off(0) < 0.5, "{} {}", off(2), off(0));
    }

    #[test]
    fn what_fits_stays() {
        let stays = |corners: [Point; 4], most: f64| {
            let after = regular(corners.map(|at| Corner { at, covariance: [4.0, 1.0, 4.0] }), 90.0, 1250.0);
            let off: Vec<f64> = after.iter().zip(&corners).map(|(a, b)| norm([a[0] - b[0], a[1] - b[1]])).collect();
            assert!(off.iter().all(|off| *off <= most), "{off:?}");
        };
        stays(seen(1.0, 0.3, 0.7, 0.5, 10.0, 1000.0), 0.7);
        // A rectangle twice as wide as high, from the front: it looks like a tilted square, but does not bend.
        stays([[0.0, 0.0], [120.0, 0.0], [120.0, 60.0], [0.0, 60.0]], 1e-9);
    }
}
