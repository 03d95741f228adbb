//! Errors of recovered poses. A pose is compared with its marker corner by corner, by identity: a pose turned by a quarter
//! is wrong by a side, however well its outline fits.
use crate::{
    interval::quantile,
    matching::{Claim, MarkerIndex, Verdict, by_falling_score},
};
use serde::Serialize;
use tcross_dataset::{Detection, Marker, Pose, PoseOutcome, Quad, geom::quad::angle_deg};

/// 95 % of a chi-squared variable with two degrees of freedom: the squared radius of the 95 % ellipse.
const ELLIPSE_95: f64 = 5.991_464_547_107_979;

/// Errors of one recovered pose.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseError {
    /// Index of the record.
    pub image: usize,
    /// Index of the marker in the record.
    pub marker: usize,
    /// The marker's side in pixels: the root of its quadrilateral's area.
    pub side_px: f64,
    /// Distance of the centres in pixels.
    pub center_px: f64,
    /// Difference of the angles in degrees, signed, in (-180, 180].
    pub angle_deg: f64,
    /// Root mean square distance of the corners in pixels, each with its own.
    pub corner_px: f64,
    /// Overlap of the quadrilaterals, 0..1.
    pub quad_iou: f64,
    /// True if the centre's error lies within the claimed 95 % ellipse; `None` where the covariance is no such.
    pub covered: Option<bool>,
    /// The claimed quality, 0..1.
    pub quality: f64,
}

impl PoseError {
    /// Centre's error in percent of the side.
    #[must_use]
    pub fn center_percent(&self) -> f64 {
        100.0 * self.center_px / self.side_px
    }

    /// Corners' error in percent of the side.
    #[must_use]
    pub fn corner_percent(&self) -> f64 {
        100.0 * self.corner_px / self.side_px
    }

    /// How many quarters the pose is turned: 0 (right), 1, 2 or 3, counter-clockwise as seen.
    #[must_use]
    pub fn quarters(&self) -> usize {
        ((self.angle_deg / 90.0).round() as i64).rem_euclid(4) as usize
    }
}

/// What became of the markers' poses.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PoseOutcomes {
    /// Markers whose true pose is known.
    pub markers: u64,
    /// Of these, markers without a detection.
    pub missed: u64,
    /// Of these, markers with a detection but no pose: by reason.
    pub refused: std::collections::BTreeMap<String, u64>,
    /// Poses claimed for false positives: a refusal would have been right.
    pub false_poses: u64,
    /// False positives.
    pub false_positives: u64,
    /// One a recovered pose, in order of the truth.
    pub errors: Vec<PoseError>,
}

impl PoseOutcomes {
    /// Adds those of further images.
    pub fn append(&mut self, mut other: Self) {
        self.markers += other.markers;
        self.missed += other.missed;
        self.false_poses += other.false_poses;
        self.false_positives += other.false_positives;
        self.errors.append(&mut other.errors);
        for (reason, n) in other.refused {
            *self.refused.entry(reason).or_default() += n;
        }
    }
}

/// Measures the poses of one image at a threshold. `claims` are those of the same detections.
#[must_use]
pub fn measure_poses(image: usize, markers: &[Marker], detections: &[Detection], claims: &[Claim], threshold: f64) -> PoseOutcomes {
    let mut out = PoseOutcomes::default();
    let order = by_falling_score(detections);
    let kept: Vec<(&Claim, &Detection)> =
        claims.iter().zip(order.iter().map(|&k| &detections[k])).filter(|(c, _)| c.score >= threshold).collect();
    for (claim, detection) in &kept {
        if claim.verdict == Verdict::FalsePositive {
            out.false_positives += 1;
            out.false_poses += u64::from(matches!(detection.pose, Some(PoseOutcome::Found(_))));
        }
    }
    for (m, marker) in markers.iter().enumerate() {
        let Some(corners) = marker.corners else { continue };
        out.markers += 1;
        let hit = kept.iter().find(|(c, _)| c.verdict == Verdict::Hit && c.marker == MarkerIndex::new(m));
        match hit.map(|(_, d)| &d.pose) {
            None => out.missed += 1,
            Some(None) => *out.refused.entry("no pose in the file".into()).or_default() += 1,
            Some(Some(PoseOutcome::Refused { refused })) => *out.refused.entry(refused.clone()).or_default() += 1,
            Some(Some(PoseOutcome::Found(pose))) => out.errors.push(compare(image, m, marker, &corners, pose)),
        }
    }
    out
}

fn compare(image: usize, index: usize, marker: &Marker, corners: &Quad, pose: &Pose) -> PoseError {
    let middle = || corners.diagonal_crossing().unwrap_or(corners.0[0]);
    let center = marker.center.unwrap_or_else(middle);
    let angle = marker.angle.unwrap_or_else(|| angle_deg(corners.0[0][0] - center[0], corners.0[0][1] - center[1]));
    let squared = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
    let corner = corners.0.iter().zip(&pose.corners.0).map(|(a, b)| squared(*a, *b)).sum::<f64>() / 4.0;
    PoseError {
        image,
        marker: index,
        side_px: corners.side_px(),
        center_px: squared(center, pose.center).sqrt(),
        angle_deg: wrap_deg(pose.angle - angle),
        corner_px: corner.sqrt(),
        quad_iou: corners.iou(&pose.corners),
        covered: covered([pose.center[0] - center[0], pose.center[1] - center[1]], pose.covariance),
        quality: pose.quality,
    }
}

/// An angle's difference brought to (-180, 180].
#[must_use]
pub fn wrap_deg(difference: f64) -> f64 {
    180.0 - (180.0 - difference).rem_euclid(360.0)
}

fn covered([x, y]: [f64; 2], [xx, xy, yy]: [f64; 3]) -> Option<bool> {
    let det = xx * yy - xy * xy;
    (det > 0.0 && xx > 0.0).then(|| (yy * x * x - 2.0 * xy * x * y + xx * y * y) / det <= ELLIPSE_95)
}

/// Median and 95th percentile.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// Half of the values are below.
    pub median: f64,
    /// 95 % of the values are below.
    pub p95: f64,
    /// Arithmetic mean.
    pub mean: f64,
}

impl Spread {
    pub(crate) fn of(values: impl Iterator<Item = f64>) -> Option<Self> {
        let mut v: Vec<f64> = values.collect();
        v.sort_by(f64::total_cmp);
        let mean = v.iter().sum::<f64>() / v.len() as f64;
        Some(Self { median: quantile(&v, 0.5)?, p95: quantile(&v, 0.95)?, mean })
    }
}

/// The block `pose` of `metrics.json`; fractions are 0..1, percents are of the marker's side.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PoseScores {
    /// Markers whose true pose is known.
    pub markers: u64,
    /// Fraction of them with a recovered pose.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recovered: Option<f64>,
    /// Fraction of them detected but refused.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refused: Option<f64>,
    /// Fraction of them not detected.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub missed: Option<f64>,
    /// Error of the centre, percent of the side.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub center_percent: Option<Spread>,
    /// Error of the centre, pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub center_px: Option<Spread>,
    /// Error of the angle, degrees, without its sign.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub angle_deg: Option<Spread>,
    /// Error of the corners (root mean square of four), percent of the side.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub corner_percent: Option<Spread>,
    /// Error of the corners, pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub corner_px: Option<Spread>,
    /// Overlap of the quadrilaterals.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quad_iou: Option<Spread>,
    /// Fraction of recovered poses whose angle is wrong by more than 45 degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wrong_orientation: Option<f64>,
    /// Recovered poses turned by 0, 90, 180, 270 degrees.
    pub turned: [u64; 4],
    /// Fraction of stated 95 % ellipses that hold the true centre; honest is 0.95.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ellipse_coverage: Option<f64>,
    /// Fraction of all markers within 2 % (centre), 2 degrees and 4 % (corners).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub within_tight: Option<f64>,
    /// Fraction of all markers within 4 %, 5 degrees and 6 %.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub within_loose: Option<f64>,
    /// Fraction of recovered poses within the paper's authors' marks: centre < 60 px, angle < 30 degrees, IoU > 0.3.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub authors_marks: Option<f64>,
    /// Fraction of false positives for which a pose was claimed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub false_poses: Option<f64>,
    /// Refusals by reason.
    pub reasons: std::collections::BTreeMap<String, u64>,
}

impl PoseOutcomes {
    /// The summary.
    #[must_use]
    pub fn scores(&self) -> PoseScores {
        let e = &self.errors;
        let of = |count: usize, all: u64| (all > 0).then(|| count as f64 / all as f64);
        let some = |f: &dyn Fn(&PoseError) -> bool| e.iter().filter(|e| f(e)).count();
        let within = |center: f64, angle: f64, corner: f64| {
            of(some(&|e| e.center_percent() <= center && e.angle_deg.abs() <= angle && e.corner_percent() <= corner), self.markers)
        };
        let recovered = e.len() as u64;
        let mut turned = [0; 4];
        e.iter().for_each(|e| turned[e.quarters()] += 1);
        let stated = e.iter().filter(|e| e.covered.is_some()).count() as u64;
        PoseScores {
            markers: self.markers,
            recovered: of(e.len(), self.markers),
            refused: of(self.refused.values().sum::<u64>() as usize, self.markers),
            missed: of(self.missed as usize, self.markers),
            center_percent: Spread::of(e.iter().map(PoseError::center_percent)),
            center_px: Spread::of(e.iter().map(|e| e.center_px)),
            angle_deg: Spread::of(e.iter().map(|e| e.angle_deg.abs())),
            corner_percent: Spread::of(e.iter().map(PoseError::corner_percent)),
            corner_px: Spread::of(e.iter().map(|e| e.corner_px)),
            quad_iou: Spread::of(e.iter().map(|e| e.quad_iou)),
            wrong_orientation: of(some(&|e| e.angle_deg.abs() > 45.0), recovered),
            turned,
            ellipse_coverage: of(some(&|e| e.covered == Some(true)), stated),
            within_tight: within(2.0, 2.0, 4.0),
            within_loose: within(4.0, 5.0, 6.0),
            authors_marks: of(some(&|e| e.center_px < 60.0 && e.angle_deg.abs() < 30.0 && e.quad_iou > 0.3), recovered),
            false_poses: of(self.false_poses as usize, self.false_positives),
            reasons: self.refused.clone(),
        }
    }
}

#[cfg(test)]
mod reference {
    //! Errors of a pose word for word: vectors for the angle, a grid of points for the overlap.
    use tcross_dataset::{Pose, Quad};

    /// Angle between the two stems, 0..180 degrees, from their scalar product.
    pub fn angle_between(center: [f64; 2], corner: [f64; 2], pose: &Pose) -> f64 {
        let a = [corner[0] - center[0], corner[1] - center[1]];
        let b = [pose.angle.to_radians().cos(), -pose.angle.to_radians().sin()];
        let cos = (a[0] * b[0] + a[1] * b[1]) / a[0].hypot(a[1]);
        cos.clamp(-1.0, 1.0).acos().to_degrees()
    }

    /// Inside a convex quadrilateral: on one side of all four edges.
    fn inside(q: &Quad, p: [f64; 2]) -> bool {
        let side = |k: usize| {
            let (a, b) = (q.0[k], q.0[(k + 1) % 4]);
            (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
        };
        (0..4).all(|k| side(k) >= 0.0) || (0..4).all(|k| side(k) <= 0.0)
    }

    /// Overlap counted over points a quarter of a pixel apart.
    pub fn iou(a: &Quad, b: &Quad) -> f64 {
        let (mut both, mut either) = (0u64, 0u64);
        for y in 0..480 {
            for x in 0..480 {
                let p = [f64::from(x) / 4.0 - 10.0, f64::from(y) / 4.0 - 10.0];
                let (in_a, in_b) = (inside(a, p), inside(b, p));
                both += u64::from(in_a && in_b);
                either += u64::from(in_a || in_b);
            }
        }
        both as f64 / either as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::{Rule, match_image};
    use tcross_dataset::Homography;

    fn marker(turn: usize) -> Marker {
        let mut corners = [[10.0, 10.0], [50.0, 10.0], [50.0, 50.0], [10.0, 50.0]];
        corners.rotate_left(turn);
        let quad = Quad(corners);
        let center = quad.diagonal_crossing().unwrap();
        Marker {
            corners: Some(quad),
            center: Some(center),
            angle: Some(angle_deg(corners[0][0] - center[0], corners[0][1] - center[1])),
            ..Marker::from_box("t_cross", quad.bounds())
        }
    }

    fn pose_of(m: &Marker, shift: f64) -> PoseOutcome {
        let corners = m.corners.unwrap().0.map(|p| [p[0] + shift, p[1]]);
        let center = m.center.unwrap();
        PoseOutcome::Found(Box::new(Pose {
            center: [center[0] + shift, center[1]],
            corners: Quad(corners),
            angle: m.angle.unwrap(),
            homography: Homography::from_unit_square(&corners).unwrap(),
            covariance: [1.0, 0.0, 1.0],
            quality: 0.9,
            rotation: None,
            translation: None,
            reprojection_px: None,
            rival: None,
        }))
    }

    fn measured(truth: &Marker, pose: Option<PoseOutcome>) -> PoseScores {
        let markers = [truth.clone()];
        let detections = [Detection { score: 0.9, class: 0, bounds: truth.bounds, pose }];
        let claims = match_image(&markers, &detections, &Rule::default());
        measure_poses(0, &markers, &detections, &claims, 0.3).scores()
    }

    #[test]
    fn a_shift_is_measured_in_percent_of_the_side() {
        let s = measured(&marker(0), Some(pose_of(&marker(0), 2.0)));
        assert_eq!((s.recovered, s.wrong_orientation, s.turned), (Some(1.0), Some(0.0), [1, 0, 0, 0]));
        assert!((s.center_percent.unwrap().median - 5.0).abs() < 1e-9 && (s.corner_percent.unwrap().p95 - 5.0).abs() < 1e-9);
        assert!((s.quad_iou.unwrap().median - 38.0 / 42.0).abs() < 1e-9);
        assert_eq!((s.ellipse_coverage, s.within_tight, s.within_loose), (Some(1.0), Some(0.0), Some(0.0)));
        assert_eq!(measured(&marker(0), Some(pose_of(&marker(0), 2.5))).ellipse_coverage, Some(0.0));
    }

    #[test]
    fn a_quarter_turn_is_wrong_however_well_the_outline_fits() {
        for turn in 0..4 {
            let s = measured(&marker(0), Some(pose_of(&marker(turn), 0.0)));
            assert_eq!(s.quad_iou.unwrap().median, 1.0);
            assert_eq!(s.wrong_orientation, Some(if turn == 0 { 0.0 } else { 1.0 }));
            // Corners run clockwise, angles counter-clockwise.
            let mut turned = [0; 4];
            turned[(4 - turn) % 4] = 1;
            assert_eq!(s.turned, turned);
        }
    }

    #[test]
    fn errors_are_those_of_the_definitions_on_random_poses() {
        for item in 0..60 {
            let mut rng = tcross_dataset::Rng::for_item(6, "eval/test/pose", item);
            // A square turned, sheared a little, its corners moved: still convex.
            let mut drawn = |around: [f64; 2], turn: f64| {
                let corner = |k: usize, rng: &mut tcross_dataset::Rng| {
                    let a = (turn + 90.0 * k as f64).to_radians();
                    [around[0] + 30.0 * a.cos() + rng.uniform(-4.0, 4.0), around[1] + 30.0 * a.sin() + rng.uniform(-4.0, 4.0)]
                };
                Quad([0, 1, 2, 3].map(|k| corner(k, &mut rng)))
            };
            let turn = 360.0 * item as f64 / 60.0;
            let (truth, seen) = (drawn([50.0, 50.0], turn), drawn([53.0, 48.0], turn + (item % 7) as f64 * 31.0));
            let center = truth.diagonal_crossing().unwrap();
            let marker = Marker { corners: Some(truth), ..Marker::from_box("t_cross", truth.bounds()) };
            let found = seen.diagonal_crossing().unwrap();
            let angle = angle_deg(seen.0[0][0] - found[0], seen.0[0][1] - found[1]);
            let PoseOutcome::Found(pose) = pose_of(&Marker { center: Some(found), angle: Some(angle), ..marker.clone() }, 0.0) else {
                panic!("a pose")
            };
            let pose = Pose { corners: seen, ..*pose };
            let got = super::compare(0, 0, &marker, &truth, &pose);
            let distance = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
            assert!((got.center_px - distance(center, found)).abs() < 1e-9);
            let rms = (0..4).map(|k| distance(truth.0[k], seen.0[k]).powi(2)).sum::<f64>() / 4.0;
            assert!((got.corner_px - rms.sqrt()).abs() < 1e-9);
            assert!((got.angle_deg.abs() - reference::angle_between(center, truth.0[0], &pose)).abs() < 1e-5, "{}", got.angle_deg);
            assert!((got.quad_iou - reference::iou(&truth, &seen)).abs() < 0.01, "{} item {item}", got.quad_iou);
        }
    }

    #[test]
    fn refusals_and_misses_are_told_apart() {
        let s = measured(&marker(0), Some(PoseOutcome::Refused { refused: "cut by the border".into() }));
        assert_eq!((s.recovered, s.refused, s.missed, s.center_percent), (Some(0.0), Some(1.0), Some(0.0), None));
        assert_eq!(s.reasons["cut by the border"], 1);
        let none = measure_poses(0, &[marker(0)], &[], &[], 0.3).scores();
        assert_eq!((none.missed, none.wrong_orientation), (Some(1.0), None));
    }

    #[test]
    fn angles_wrap() {
        for (d, want) in [(359.0, -1.0), (-359.0, 1.0), (180.0, 180.0), (-180.0, 180.0), (90.0, 90.0), (0.0, 0.0)] {
            assert!((wrap_deg(d) - want).abs() < 1e-12, "{d}");
        }
    }
}
