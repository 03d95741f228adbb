//! How a sheet is seen: a pinhole camera with a radial lens, a pose in space, and a slight bend of the paper.
//!
//! The marker's plane is measured in sides of the marker from the middle of its rectangle, x to the right, y down; the camera's frame is x
//! right, y down, z forward, in the same unit.
use tcross_dataset::{Quad, Rng};

/// Pinhole with radial distortion, as OpenCV defines it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Focal length in pixels.
    pub focal: f64,
    /// Principal point in pixels.
    pub center: [f64; 2],
    /// Radial distortion: r becomes r (1 + k1 r^2), r in focal lengths.
    pub k1: f64,
}

/// Beyond this squared radius the distortion's factor stands still, so that what lies far outside the image never folds back into it.
const FAR: f64 = 3.0;

impl Camera {
    /// The pixel of a point in front of the camera.
    #[must_use]
    pub fn project(&self, [x, y, z]: [f64; 3]) -> Option<[f64; 2]> {
        if z < 1e-3 {
            return None;
        }
        let (u, v) = (x / z, y / z);
        let factor = 1.0 + self.k1 * (u * u + v * v).min(FAR);
        Some([self.center[0] + self.focal * u * factor, self.center[1] + self.focal * v * factor])
    }

    /// The ray (x/z, y/z) of a pixel.
    #[must_use]
    pub fn ray(&self, pixel: [f64; 2]) -> [f64; 2] {
        let (du, dv) = ((pixel[0] - self.center[0]) / self.focal, (pixel[1] - self.center[1]) / self.focal);
        let (mut u, mut v) = (du, dv);
        for _ in 0..6 {
            let factor = 1.0 + self.k1 * (u * u + v * v).min(FAR);
            (u, v) = (du / factor, dv / factor);
        }
        [u, v]
    }
}

/// A sheet in space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Marker to camera, row-major.
    pub rotation: [f64; 9],
    /// The middle of the marker's rectangle in the camera's frame, in sides.
    pub translation: [f64; 3],
    /// Curvature of the paper: side over radius; 0 is flat.
    pub bend: f64,
    /// Direction in the marker's plane along which it bends: cosine and sine.
    pub bend_along: [f64; 2],
}

impl Pose {
    /// Where a point of the sheet is in the camera's frame.
    #[must_use]
    pub fn apply(&self, [x, y]: [f64; 2]) -> [f64; 3] {
        let p = if self.bend == 0.0 {
            [x, y, 0.0]
        } else {
            let [c, s] = self.bend_along;
            let (along, across) = (x * c + y * s, y * c - x * s);
            let turn = self.bend * along;
            let bent = libm::sin(turn) / self.bend;
            [bent * c - across * s, bent * s + across * c, (1.0 - libm::cos(turn)) / self.bend]
        };
        let (r, t) = (&self.rotation, &self.translation);
        std::array::from_fn(|k| r[k * 3] * p[0] + r[k * 3 + 1] * p[1] + r[k * 3 + 2] * p[2] + t[k])
    }
}

/// A sheet before a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// The camera.
    pub camera: Camera,
    /// The sheet.
    pub pose: Pose,
}

impl View {
    /// The pixel of a point of the sheet; `None` behind the camera.
    #[must_use]
    pub fn image_from_plane(&self, p: [f64; 2]) -> Option<[f64; 2]> {
        self.camera.project(self.pose.apply(p))
    }

    /// The point of the sheet seen at a pixel; `None` where the sheet is not before the camera.
    #[must_use]
    pub fn plane_from_image(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        let [u, v] = self.camera.ray(pixel);
        let Pose { rotation: r, translation: t, bend, bend_along: [c, s] } = &self.pose;
        // In the sheet's frame, turned so that it bends along the first axis: the camera's place, and the ray's direction.
        let sheet = |p: [f64; 3]| {
            let [x, y, z]: [f64; 3] = std::array::from_fn(|k| r[k] * p[0] + r[3 + k] * p[1] + r[6 + k] * p[2]);
            [x * c + y * s, y * c - x * s, z]
        };
        let (o, d) = (sheet(t.map(|v| -v)), sheet([u, v, 1.0]));
        // The sheet is a part of the cylinder bend (x² + z²) = 2 z: a quadratic equation for the depth, of whose answers the one is wanted at
        // which the ray comes through from the front.
        let squared = bend * (d[0] * d[0] + d[2] * d[2]);
        let half = bend * (o[0] * d[0] + o[2] * d[2]) - d[2];
        let constant = bend * (o[0] * o[0] + o[2] * o[2]) - 2.0 * o[2];
        let root = (half * half - squared * constant).sqrt();
        let depth = if half < 0.0 { constant / (root - half) } else { -(root + half) / squared };
        if !(depth >= 1e-3) {
            return None;
        }
        let [bent, across, rise]: [f64; 3] = std::array::from_fn(|k| o[k] + depth * d[k]);
        let turn = libm::atan2(bend * bent, 1.0 - bend * rise);
        let along = if *bend == 0.0 { bent } else { turn / bend };
        // A sheet that turned farther would be a tube.
        let p = [along * c - across * s, along * s + across * c];
        (turn.abs() <= 1.5 && p.iter().all(|v| v.abs() < 1e3)).then_some(p)
    }

    /// Angle between the sheet's normal at its middle and the line of sight, in radians.
    #[must_use]
    pub fn tilt(&self) -> f64 {
        let (r, t) = (&self.pose.rotation, &self.pose.translation);
        let length = (t[0] * t[0] + t[1] * t[1] + t[2] * t[2]).sqrt();
        libm::acos(((r[2] * t[0] + r[5] * t[1] + r[8] * t[2]) / length).clamp(-1.0, 1.0))
    }

    /// Pixels a side at a point of the sheet: the largest and the smallest over all directions.
    #[must_use]
    pub fn scales(&self, p: [f64; 2]) -> Option<(f64, f64)> {
        const STEP: f64 = 1e-3;
        let (at, right, down) =
            (self.image_from_plane(p)?, self.image_from_plane([p[0] + STEP, p[1]])?, self.image_from_plane([p[0], p[1] + STEP])?);
        let (a, c) = ((right[0] - at[0]) / STEP, (right[1] - at[1]) / STEP);
        let (b, d) = ((down[0] - at[0]) / STEP, (down[1] - at[1]) / STEP);
        let (sum, det) = ((a * a + b * b + c * c + d * d) / 2.0, a * d - b * c);
        let root = (sum * sum - det * det).max(0.0).sqrt();
        Some(((sum + root).sqrt(), (sum - root).max(0.0).sqrt()))
    }
}

/// How a marker is to stand; what [`place`] turns into a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stance {
    /// Root of the area of the quadrilateral in the image, in pixels.
    pub side_px: f64,
    /// Angle between the normal and the line of sight, in radians.
    pub tilt: f64,
    /// Direction of the tilt, in radians.
    pub azimuth: f64,
    /// Turn about the normal, in radians.
    pub roll: f64,
    /// Half the width and half the height of the rectangle, in sides.
    pub half: [f64; 2],
    /// Curvature and its direction.
    pub bend: (f64, f64),
    /// True where the marker may stand so that the border cuts it.
    pub may_be_cut: bool,
}

impl Stance {
    /// The least focal length, in pixels, at which a marker of this size and tilt stands wholly before the camera.
    #[must_use]
    pub fn least_focal(&self) -> f64 {
        1.25 * self.side_px / libm::cos(self.tilt).max(0.05).sqrt()
    }

    fn pose(&self, camera: &Camera, at: [f64; 2], depth: f64) -> Pose {
        let [u, v] = camera.ray(at);
        let rotation = product(&to_ray(u, v), &product(&turn(self.azimuth), &product(&lean(self.tilt), &turn(self.roll - self.azimuth))));
        Pose {
            rotation,
            translation: [u * depth, v * depth, depth],
            bend: self.bend.0,
            bend_along: [libm::cos(self.bend.1), libm::sin(self.bend.1)],
        }
    }

    fn quad(&self, view: &View) -> Option<Quad> {
        let [w, h] = self.half;
        let corners = [[-w, -h], [w, -h], [w, h], [-w, h]].map(|p| view.image_from_plane(p));
        Some(Quad([corners[0]?, corners[1]?, corners[2]?, corners[3]?]))
    }

    /// The view of this marker with its middle near `at`, at the depth that gives it its size.
    pub(super) fn view(&self, camera: &Camera, at: [f64; 2]) -> Option<(View, Quad)> {
        let mut depth = camera.focal * libm::cos(self.tilt).sqrt() / self.side_px;
        for _ in 0..4 {
            let view = View { camera: *camera, pose: self.pose(camera, at, depth) };
            depth *= (self.quad(&view)?.side_px() / self.side_px).clamp(0.5, 2.0);
        }
        let view = View { camera: *camera, pose: self.pose(camera, at, depth) };
        let quad = self.quad(&view)?;
        Some((view, quad))
    }
}

/// Places a marker: uniformly over the places where it lies wholly inside the image, or, if it may be cut or is too large, over those where
/// its middle does. `None` where it cannot stand before the camera at all.
pub fn place(stance: &Stance, camera: &Camera, width: f64, height: f64, rng: &mut Rng) -> Option<(View, Quad)> {
    let share = [rng.unit(), rng.unit()];
    let size = [width, height];
    let middle = [width / 2.0, height / 2.0];
    let (_, quad) = stance.view(camera, middle)?;
    let bounds = quad.bounds();
    let (lo, hi) = ([bounds.x_min - middle[0], bounds.y_min - middle[1]], [bounds.x_max - middle[0], bounds.y_max - middle[1]]);
    let mut at: [f64; 2] = std::array::from_fn(|k| {
        let (first, last) = (-lo[k], size[k] - hi[k]);
        if stance.may_be_cut {
            share[k] * size[k]
        } else {
            // Where the marker is larger than the image the two ends change places: it covers the image, and its middle stays inside.
            first + share[k] * (last - first)
        }
    });
    // Perspective changes with the place: nudge what protrudes.
    for _ in 0..3 {
        let (view, quad) = stance.view(camera, at)?;
        let b = quad.bounds();
        let over = |min: f64, max: f64, size: f64| if max - min > size { 0.0 } else { (-min).max(0.0) - (max - size).max(0.0) };
        let nudge = [over(b.x_min, b.x_max, width), over(b.y_min, b.y_max, height)];
        if stance.may_be_cut || nudge == [0.0, 0.0] {
            return Some((view, quad));
        }
        at = [at[0] + nudge[0] * 1.02, at[1] + nudge[1] * 1.02];
    }
    stance.view(camera, at)
}

pub(super) fn turn(angle: f64) -> [f64; 9] {
    let (c, s) = (libm::cos(angle), libm::sin(angle));
    [c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0]
}

fn lean(angle: f64) -> [f64; 9] {
    let (c, s) = (libm::cos(angle), libm::sin(angle));
    [1.0, 0.0, 0.0, 0.0, c, -s, 0.0, s, c]
}

/// The way back of a rotation.
pub(super) fn transposed(m: &[f64; 9]) -> [f64; 9] {
    std::array::from_fn(|k| m[k % 3 * 3 + k / 3])
}

/// The shortest turn that takes the optical axis to the ray (u, v, 1).
pub(super) fn to_ray(u: f64, v: f64) -> [f64; 9] {
    let n = (u * u + v * v + 1.0).sqrt();
    let (x, y, z) = (u / n, v / n, 1.0 / n);
    let k = 1.0 / (1.0 + z);
    [1.0 - x * x * k, -x * y * k, x, -x * y * k, 1.0 - y * y * k, y, -x, -y, z]
}

pub(super) fn product(a: &[f64; 9], b: &[f64; 9]) -> [f64; 9] {
    std::array::from_fn(|i| (0..3).map(|k| a[i / 3 * 3 + k] * b[k * 3 + i % 3]).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stance(rng: &mut Rng) -> Stance {
        Stance {
            side_px: rng.log_uniform(8.0, 300.0),
            tilt: rng.uniform(0.0, 1.3),
            azimuth: rng.uniform(0.0, std::f64::consts::TAU),
            roll: rng.uniform(0.0, std::f64::consts::TAU),
            half: [0.55, 0.4545],
            bend: (rng.uniform(-0.5, 0.5), rng.uniform(0.0, 3.0)),
            may_be_cut: rng.chance(0.2),
        }
    }

    #[test]
    fn a_placed_marker_has_its_size_tilt_and_room() {
        let mut rng = Rng::for_item(0, "test/view", 0);
        for _ in 0..300 {
            let s = stance(&mut rng);
            let camera = Camera { focal: s.least_focal().max(350.0), center: [208.0; 2], k1: rng.uniform(-0.08, 0.04) };
            let (view, quad) = place(&s, &camera, 416.0, 416.0, &mut rng).unwrap();
            assert!((quad.side_px() / s.side_px - 1.0).abs() < 0.02, "{} {}", quad.side_px(), s.side_px);
            assert!(quad.signed_area() > 0.0);
            let b = quad.bounds();
            if !s.may_be_cut && b.width() < 400.0 && b.height() < 400.0 {
                assert!(b.x_min > -1.0 && b.y_min > -1.0 && b.x_max < 417.0 && b.y_max < 417.0, "{b:?}");
            }
            let (r, t) = (view.pose.rotation, view.pose.translation);
            let n = (t[0] * t[0] + t[1] * t[1] + t[2] * t[2]).sqrt();
            let cosine = (r[2] * t[0] + r[5] * t[1] + r[8] * t[2]) / n;
            assert!((cosine.clamp(-1.0, 1.0).acos() - s.tilt).abs() < 1e-6);
        }
    }

    /// Far beside a bent sheet the way back must not end on the marker: that would be ink where nothing is drawn.
    #[test]
    fn a_bent_sheet_is_seen_in_one_place_only() {
        let mut rng = Rng::for_item(0, "test/view", 2);
        for _ in 0..200 {
            let s = Stance { bend: (rng.uniform(-0.5, 0.5), rng.uniform(0.0, std::f64::consts::PI)), ..stance(&mut rng) };
            let camera = Camera { focal: s.least_focal().max(350.0), center: [208.0; 2], k1: 0.0 };
            let Some((view, _)) = place(&s, &camera, 416.0, 416.0, &mut rng) else { continue };
            for _ in 0..200 {
                let pixel = [rng.uniform(-400.0, 800.0), rng.uniform(-400.0, 800.0)];
                if let Some(p) = view.plane_from_image(pixel) {
                    let back = view.image_from_plane(p).unwrap();
                    let error = ((pixel[0] - back[0]).powi(2) + (pixel[1] - back[1]).powi(2)).sqrt();
                    assert!(error < 0.01 * s.side_px.max(100.0), "{error} px, {s:?}");
                }
            }
        }
    }

    #[test]
    fn the_way_back_is_the_way_there() {
        let mut rng = Rng::for_item(0, "test/view", 1);
        for _ in 0..300 {
            let s = stance(&mut rng);
            let camera = Camera { focal: s.least_focal().max(350.0), center: [208.0; 2], k1: rng.uniform(-0.08, 0.04) };
            let (view, _) = place(&s, &camera, 416.0, 416.0, &mut rng).unwrap();
            let p = [rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5)];
            let q = view.plane_from_image(view.image_from_plane(p).unwrap()).unwrap();
            let error = ((p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2)).sqrt() * s.side_px;
            assert!(error < 0.01, "{error} px, {s:?}");
        }
    }
}
