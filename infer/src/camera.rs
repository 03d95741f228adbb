//! Pose in space: from a marker's corners and the camera to rotation and translation, with both solutions of the plane.
//!
//! Camera: x right, y down, z forward. Marker: origin in its centre, x from the stem's corner to the next one clockwise, y to
//! the one after that, z away from the viewer; seen head-on with the stem's corner at the top left its rotation is the
//! identity. The two solutions are those of IPPE (Collins and Bartoli, "Infinitesimal plane-based pose estimation", 2014),
//! each refined by Levenberg-Marquardt on the reprojection error.
use crate::error::InferError;
use nalgebra::{Matrix2, Matrix3, Rotation3, SMatrix, SVector, Vector2, Vector3};
use tcross_dataset::{Homography, Pose, Quad, detections::RivalPose};

/// A pinhole camera with lens distortion in OpenCV's model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Focal lengths in pixels.
    pub focal: [f64; 2],
    /// Principal point in pixels, continuous: (0, 0) is the outer corner of the first pixel.
    pub center: [f64; 2],
    /// `k1, k2, p1, p2, k3`; zeros for none.
    pub distortion: [f64; 5],
}

/// A camera as a user knows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lens {
    /// Calibrated, for images of one size.
    Known(Camera),
    /// Horizontal field of view in degrees; the axis in the middle of the image, no distortion.
    FieldOfView(f64),
}

impl Lens {
    /// The camera of an image of this size.
    #[must_use]
    pub fn camera(&self, width: u32, height: u32) -> Camera {
        match self {
            Self::Known(camera) => *camera,
            Self::FieldOfView(degrees) => Camera::from_half_angle(degrees.to_radians() / 2.0, width, height),
        }
    }
}

impl std::str::FromStr for Lens {
    type Err = InferError;

    /// One number is a horizontal field of view in degrees; several are [`Camera`]'s.
    fn from_str(text: &str) -> Result<Self, InferError> {
        match text.trim().parse::<f64>() {
            Ok(degrees) => Camera::from_field_of_view(degrees, 1, 1).map(|_| Self::FieldOfView(degrees)),
            Err(_) => text.parse().map(Self::Known),
        }
    }
}

/// One rotation and translation, and how well it fits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solution {
    /// From the marker's frame to the camera's.
    pub rotation: Matrix3<f64>,
    /// The marker's centre in the camera's frame, in the unit of the side.
    pub translation: Vector3<f64>,
    /// Root mean square over the corners, in pixels.
    pub reprojection_px: f64,
}

/// Both solutions of a plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solutions {
    /// The one that fits better.
    pub best: Solution,
    /// The other, where there is one.
    pub rival: Option<Solution>,
}

impl Solutions {
    /// The rival's reprojection error over the best one's: near 1 the plane is ambiguous; `None` without a rival.
    #[must_use]
    pub fn ratio(&self) -> Option<f64> {
        self.rival.map(|r| r.reprojection_px / self.best.reprojection_px.max(1e-9))
    }
}

impl std::str::FromStr for Camera {
    type Err = InferError;

    /// `fx,fy,cx,cy` in pixels, then up to five numbers of distortion `k1,k2,p1,p2,k3`.
    fn from_str(text: &str) -> Result<Self, InferError> {
        let wrong = || InferError::Value {
            key: "camera",
            found: text.into(),
            allowed: "fx,fy,cx,cy[,k1,k2[,p1,p2[,k3]]] in pixels with fx and fy above 0, or a field of view in degrees",
        };
        let numbers = text.split(',').map(|v| v.trim().parse::<f64>()).collect::<Result<Vec<_>, _>>().map_err(|_| wrong())?;
        if !(4..=9).contains(&numbers.len()) || numbers.iter().any(|v| !v.is_finite()) || numbers[0] <= 0.0 || numbers[1] <= 0.0 {
            return Err(wrong());
        }
        let mut distortion = [0.0; 5];
        distortion[..numbers.len() - 4].copy_from_slice(&numbers[4..]);
        Ok(Self { focal: [numbers[0], numbers[1]], center: [numbers[2], numbers[3]], distortion })
    }
}

impl Camera {
    /// A camera without distortion that looks at the middle of an image under this horizontal field of view in degrees,
    /// above 0 and below 180.
    ///
    /// # Errors
    /// If the angle is not in that range.
    pub fn from_field_of_view(degrees: f64, width: u32, height: u32) -> Result<Self, InferError> {
        if !(degrees > 0.0 && degrees < 180.0) {
            return Err(InferError::Value { key: "field of view", found: degrees.to_string(), allowed: "degrees above 0 and below 180" });
        }
        Ok(Self::from_half_angle(degrees.to_radians() / 2.0, width, height))
    }

    fn from_half_angle(radians: f64, width: u32, height: u32) -> Self {
        let (w, h) = (f64::from(width), f64::from(height));
        Self { focal: [w / 2.0 / radians.tan(); 2], center: [w / 2.0, h / 2.0], distortion: [0.0; 5] }
    }

    /// A point of the camera's frame in the image; `None` behind the camera.
    #[must_use]
    pub fn project(&self, p: &Vector3<f64>) -> Option<[f64; 2]> {
        if !(p.z > 1e-9) {
            return None;
        }
        let [x, y] = self.distort([p.x / p.z, p.y / p.z]);
        let pixel = [self.focal[0] * x + self.center[0], self.focal[1] * y + self.center[1]];
        pixel.iter().all(|v| v.is_finite()).then_some(pixel)
    }

    fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        [x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x), y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y]
    }

    /// A pixel's ray at depth 1, the distortion undone by fixed-point iteration.
    fn ray(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let seen = [(x - self.center[0]) / self.focal[0], (y - self.center[1]) / self.focal[1]];
        let mut ray = seen;
        for _ in 0..20 {
            let there = self.distort(ray);
            ray = [ray[0] + seen[0] - there[0], ray[1] + seen[1] - there[1]];
        }
        ray
    }

    /// Both poses of a square of this side (any unit) with these corners, clockwise as seen, the stem's first. `None` where
    /// the corners hold no square in front of the camera, or anything is not finite.
    #[must_use]
    pub fn solve(&self, corners: &Quad, side: f64) -> Option<Solutions> {
        if !(side > 0.0 && side.is_finite()) || corners.0.iter().flatten().any(|v| !v.is_finite()) {
            return None;
        }
        let longest = (0..4).map(|k| (corners.0[k][0] - corners.0[(k + 1) % 4][0]).hypot(corners.0[k][1] - corners.0[(k + 1) % 4][1]));
        if corners.signed_area() < 1e-4 * longest.fold(0.0, f64::max).powi(2) {
            return None; // a needle, or seen from behind
        }
        let rays = corners.0.map(|c| self.ray(c));
        let square = Homography::from_unit_square(&rays)?;
        // From the square of side 1 around the origin: shift by one half first.
        let h = square.after(&Homography([1.0, 0.0, 0.5, 0.0, 1.0, 0.5, 0.0, 0.0, 1.0])).0;
        if !(h[8].abs() > 1e-9) {
            return None;
        }
        let h = h.map(|v| v / h[8]);
        let center = Vector2::new(h[2], h[5]);
        let slope = Matrix2::new(h[0] - h[6] * h[2], h[1] - h[7] * h[2], h[3] - h[6] * h[5], h[4] - h[7] * h[5]);
        let mut solutions: Vec<Solution> =
            rotations(center, slope)?.iter().filter_map(|r| self.refined(*r, translation(r, &rays)?, corners)).collect();
        solutions.sort_by(|a, b| a.reprojection_px.total_cmp(&b.reprojection_px));
        let scaled = |s: &Solution| Solution { translation: s.translation * side, ..*s };
        let best = solutions.first()?;
        // Head-on both solutions are one.
        let apart = |s: &&Solution| Rotation3::from_matrix_unchecked(best.rotation.transpose() * s.rotation).angle() > 0.01;
        Some(Solutions { best: scaled(best), rival: solutions.get(1).filter(apart).map(scaled) })
    }

    /// Adds rotation, translation, reprojection error and rival to a pose of a marker of this side; leaves the pose as it is
    /// where there is no solution.
    pub fn locate(&self, pose: &mut Pose, side: f64) {
        let Some(solutions) = self.solve(&pose.corners, side) else { return };
        let best = solutions.best;
        pose.rotation = Some(rows(&best.rotation));
        pose.translation = Some(best.translation.into());
        pose.reprojection_px = Some(best.reprojection_px);
        pose.rival = solutions.rival.map(|r| RivalPose {
            rotation: rows(&r.rotation),
            translation: r.translation.into(),
            reprojection_px: r.reprojection_px,
        });
    }

    /// Pixel residuals of the four corners of a square of side 1.
    fn residuals(&self, r: &Matrix3<f64>, t: &Vector3<f64>, corners: &Quad) -> Option<SVector<f64, 8>> {
        let mut out = SVector::<f64, 8>::zeros();
        for k in 0..4 {
            let p = self.project(&(r * SQUARE[k] + t))?;
            out[2 * k] = p[0] - corners.0[k][0];
            out[2 * k + 1] = p[1] - corners.0[k][1];
        }
        Some(out)
    }

    fn refined(&self, mut r: Matrix3<f64>, mut t: Vector3<f64>, corners: &Quad) -> Option<Solution> {
        let mut e = self.residuals(&r, &t, corners)?;
        let mut damping = 1e-4;
        for _ in 0..30 {
            let moved = |step: &SVector<f64, 6>| {
                let turn = Rotation3::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
                (turn.matrix() * r, t + Vector3::new(step[3], step[4], step[5]))
            };
            let mut slopes = SMatrix::<f64, 8, 6>::zeros();
            for p in 0..6 {
                let mut step = SVector::<f64, 6>::zeros();
                step[p] = 1e-6;
                let (r1, t1) = moved(&step);
                slopes.set_column(p, &((self.residuals(&r1, &t1, corners)? - e) / 1e-6));
            }
            let normal = slopes.transpose() * slopes;
            let right = -slopes.transpose() * e;
            let mut damped = normal;
            for p in 0..6 {
                damped[(p, p)] += damping * normal[(p, p)].max(1e-12);
            }
            let step = damped.cholesky()?.solve(&right);
            let (r1, t1) = moved(&step);
            match self.residuals(&r1, &t1, corners) {
                Some(e1) if e1.norm_squared() <= e.norm_squared() => {
                    let gain = e.norm_squared() - e1.norm_squared();
                    (r, t, e, damping) = (r1, t1, e1, damping * 0.3);
                    if gain < 1e-14 {
                        break;
                    }
                }
                _ if damping > 1e6 => break,
                _ => damping *= 10.0,
            }
        }
        let reprojection_px = (e.norm_squared() / 4.0).sqrt();
        let sound = r.iter().chain(t.iter()).all(|v| v.is_finite()) && reprojection_px.is_finite() && t.z > 0.0;
        sound.then_some(Solution { rotation: r, translation: t, reprojection_px })
    }
}

/// Corners of a square of side 1 around the origin, in the order of `corners`.
const SQUARE: [Vector3<f64>; 4] =
    [Vector3::new(-0.5, -0.5, 0.0), Vector3::new(0.5, -0.5, 0.0), Vector3::new(0.5, 0.5, 0.0), Vector3::new(-0.5, 0.5, 0.0)];

fn rows(m: &Matrix3<f64>) -> [f64; 9] {
    std::array::from_fn(|i| m[(i / 3, i % 3)])
}

/// The two rotations of a plane whose map to rays at depth 1 has this value and slope at the origin.
fn rotations(center: Vector2<f64>, slope: Matrix2<f64>) -> Option<[Matrix3<f64>; 2]> {
    let sight = Vector3::new(center.x, center.y, 1.0);
    let turn = Rotation3::rotation_between(&Vector3::z(), &sight)?.into_inner();
    let b = Matrix2::new(
        turn[(0, 0)] - center.x * turn[(2, 0)],
        turn[(0, 1)] - center.x * turn[(2, 1)],
        turn[(1, 0)] - center.y * turn[(2, 0)],
        turn[(1, 1)] - center.y * turn[(2, 1)],
    );
    let a = b.try_inverse()? * slope;
    let square = a * a.transpose();
    let (sum, difference) = (square[(0, 0)] + square[(1, 1)], square[(0, 0)] - square[(1, 1)]);
    let scale = (0.5 * (sum + (difference * difference + 4.0 * square[(0, 1)].powi(2)).sqrt())).sqrt();
    if !(scale > 1e-12 && scale.is_finite()) {
        return None;
    }
    let q = a / scale;
    // What is missing to columns of length 1 goes along the line of sight, in one of two directions.
    let first = (1.0 - q.column(0).norm_squared()).max(0.0).sqrt();
    let second = (1.0 - q.column(1).norm_squared()).max(0.0).sqrt();
    let second = if q.column(0).dot(&q.column(1)) > 0.0 { -second } else { second };
    let build = |sign: f64| {
        let u = Vector3::new(q[(0, 0)], q[(1, 0)], sign * first);
        let v = Vector3::new(q[(0, 1)], q[(1, 1)], sign * second);
        let frame = Matrix3::from_columns(&[u, v, u.cross(&v)]);
        // Exactly orthogonal, whatever rounding did.
        Rotation3::from_matrix(&(turn * frame)).into_inner()
    };
    Some([build(1.0), build(-1.0)])
}

/// The translation that fits a rotation best: least squares of `ray x (R p + t) = 0` over the corners.
fn translation(rotation: &Matrix3<f64>, rays: &[[f64; 2]; 4]) -> Option<Vector3<f64>> {
    let mut normal = Matrix3::<f64>::zeros();
    let mut right = Vector3::<f64>::zeros();
    for (p, [x, y]) in SQUARE.iter().zip(rays) {
        let q = rotation * p;
        for row in [Vector3::new(1.0, 0.0, -x), Vector3::new(0.0, 1.0, -y)] {
            normal += row * row.transpose();
            right -= row * row.dot(&q);
        }
    }
    normal.try_inverse().map(|inverse| inverse * right).filter(|t| t.iter().all(|v| v.is_finite()) && t.z > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn camera() -> Camera {
        "900,880,650,350,-0.1,0.02,0.001,-0.001".parse().unwrap()
    }

    fn seen(camera: &Camera, r: &Matrix3<f64>, t: &Vector3<f64>, side: f64) -> Option<Quad> {
        let mut quad = [[0.0; 2]; 4];
        for k in 0..4 {
            quad[k] = camera.project(&(r * SQUARE[k] * side + t))?;
        }
        Some(Quad(quad))
    }

    #[test]
    fn head_on_is_the_identity_and_has_no_rival() {
        let camera = Camera { distortion: [0.0; 5], ..camera() };
        let quad = seen(&camera, &Matrix3::identity(), &Vector3::new(0.0, 0.0, 2.0), 0.1).unwrap();
        let got = camera.solve(&quad, 0.1).unwrap();
        assert!((got.best.rotation - Matrix3::identity()).norm() < 1e-3, "{}", got.best.rotation);
        assert!((got.best.translation - Vector3::new(0.0, 0.0, 2.0)).norm() < 1e-4);
        assert!(got.rival.is_none_or(|r| r.reprojection_px < 1.0));
    }

    #[test]
    fn nonsense_has_no_pose() {
        let camera = camera();
        for quad in [
            [[0.0; 2]; 4],
            [[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [3.0, 3.0]],
            [[f64::NAN; 2]; 4],
            [[f64::INFINITY, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
        ] {
            assert!(camera.solve(&Quad(quad), 1.0).is_none());
        }
        let good = Quad([[600.0, 300.0], [700.0, 300.0], [700.0, 400.0], [600.0, 400.0]]);
        assert!(camera.solve(&good, 0.0).is_none() && camera.solve(&good, f64::NAN).is_none());
        assert!("1,2,3".parse::<Camera>().is_err() && "0,1,2,3".parse::<Camera>().is_err() && "a,b,c,d".parse::<Camera>().is_err());
    }

    proptest! {
        #[test]
        fn a_seen_square_is_put_back(roll in 0.0..std::f64::consts::TAU, tilt in 0.05..1.2f64, axis in 0.0..std::f64::consts::TAU, x in -0.3..0.3f64, y in -0.2..0.2f64, z in 0.6..6.0f64) {
            let camera = camera();
            let direction = Vector3::new(axis.cos(), axis.sin(), 0.0);
            let rotation = (Rotation3::from_scaled_axis(direction * tilt) * Rotation3::from_scaled_axis(Vector3::z() * roll)).into_inner();
            let t = Vector3::new(x * z, y * z, z);
            let quad = seen(&camera, &rotation, &t, 0.2).unwrap();
            let got = camera.solve(&quad, 0.2).unwrap();
            let near = |s: &Solution| (s.rotation - rotation).norm() < 2e-3 && (s.translation - t).norm() < 2e-3 * z;
            prop_assert!(near(&got.best), "{:?}", got);
            prop_assert!(got.best.reprojection_px < 1e-4);
            if let Some(rival) = got.rival {
                prop_assert!(rival.reprojection_px >= got.best.reprojection_px && got.ratio().unwrap() >= 1.0);
            }
        }

        #[test]
        fn any_numbers_are_answered(c in proptest::array::uniform8(-2000.0..4000.0f64)) {
            let quad = Quad([[c[0], c[1]], [c[2], c[3]], [c[4], c[5]], [c[6], c[7]]]);
            if let Some(s) = camera().solve(&quad, 1.0) {
                prop_assert!(s.best.rotation.iter().chain(s.best.translation.iter()).all(|v| v.is_finite()));
                prop_assert!((s.best.rotation.determinant() - 1.0).abs() < 1e-6);
            }
        }
    }
}
