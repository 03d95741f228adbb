//! Our method, the default: colour model -> quadrilateral -> sub-pixel outline -> arms -> the T cross fitted as a whole.
use super::{
    Config, Refusal, arms,
    crop::{Coarse, Picture},
    edges::{self, EdgePoint},
    fit::{self, Constraint, Fit},
    plane::Point,
    quad, segment,
};
use image::RgbImage;
use tcross_dataset::{Homography, PixelBox, Pose, Quad, geom::quad::angle_deg};

/// Neighbouring points of one stroke err together: so many of them count as one.
const CORRELATION: f64 = 19.0;
/// What a hand misses even where every stroke is straight, in sides (one deviation).
const HAND: f64 = 0.0012;

/// Recovers the pose of the T cross in `bounds` (pixels of `image`).
///
/// # Errors
/// The reason for which no pose is claimed.
pub fn recover(image: &RgbImage, bounds: &PixelBox, config: &Config) -> Result<Pose, Refusal> {
    let (picture, inside) = super::checked(image, bounds, config)?;
    let window = super::padded(&picture, &inside, config.padding);
    let view = Coarse::new(&picture, &window).ok_or(Refusal::TooSmall)?;
    if is_plain(&view) {
        return Err(Refusal::OneColour);
    }
    let mask = segment::segment(&view, &inside);
    let first = quad::quadrilateral(&view, &mask).ok_or(Refusal::NoOutline)?;
    refine(&picture, first, config)
}

/// True where no channel of any cell differs from another cell's by more than two grey levels or so.
fn is_plain(view: &Coarse) -> bool {
    (0..3).all(|c| {
        let (lo, hi) = view.cells.iter().fold((f32::MAX, f32::MIN), |(lo, hi), v| (lo.min(v[c]), hi.max(v[c])));
        hi - lo < 0.012
    })
}

/// From a first quadrilateral to a pose, or to the reason why it is none.
fn refine(picture: &Picture, first: [Point; 4], config: &Config) -> Result<Pose, Refusal> {
    let outside = |corners: &[Point; 4]| corners.iter().any(|c| !picture.holds(*c, -1.5));
    let mut corners = first;
    let mut outline: Vec<EdgePoint> = Vec::new();
    for reach in [0.16, 0.10] {
        let side_px = Quad(corners).side_px();
        outline = edges::measure(picture, &corners, (reach * side_px).max(3.0));
        let fitted = fit::fit(corners, &outline_constraints(&outline)).ok_or(Refusal::NoOutline)?;
        if !quad::is_sound(&fitted.corners) {
            return Err(Refusal::NoOutline);
        }
        corners = fitted.corners;
    }
    if outside(&corners) {
        return Err(Refusal::CutByBorder);
    }
    let map = Homography::from_unit_square(&corners).ok_or(Refusal::NoOutline)?;
    let arms = arms::read(picture, &map).ok_or(Refusal::NoCross)?;
    let mut constraints = outline_constraints(&outline);
    constraints.extend(arms.points.iter().map(|(k, at, weight)| Constraint {
        at: *at,
        corners: (k % 2, k % 2 + 2),
        outline: false,
        weight: *weight,
    }));
    let fitted = fit::fit(corners, &constraints).ok_or(Refusal::NoOutline)?;
    if !quad::is_sound(&fitted.corners) {
        return Err(Refusal::NoOutline);
    }
    let evidence = Evidence::of(&fitted, &arms, &outline);
    evidence.check(&arms, config.min_quality)?;
    pose(&fitted, &arms, evidence.quality())
}

fn outline_constraints(outline: &[EdgePoint]) -> Vec<Constraint> {
    outline.iter().map(|p| Constraint { at: p.at, corners: (p.side, (p.side + 1) % 4), outline: true, weight: p.weight }).collect()
}

/// Evidence for a T cross, each 0..1 and 1 where nothing is left to wish; the quality is their product.
struct Evidence {
    /// Share of the weakest side's outline that was seen and agrees with the others.
    outline: f64,
    /// How far the three lines stand out from the half diagonal without.
    stem: f64,
    /// How alike the three lines are in colour and in strength.
    lines: f64,
    /// How straight outline and lines are, against the side.
    straight: f64,
    /// Share of the stations at which a line was seen.
    arms: f64,
}

impl Evidence {
    fn of(fitted: &Fit, arms: &arms::Arms, outline: &[EdgePoint]) -> Self {
        let seen = |k: usize| {
            let weight: f64 = outline.iter().filter(|p| p.side == k).map(|p| p.weight).sum();
            weight / edges::PROFILES as f64 * fitted.held[k]
        };
        let mut presence = arms.presence;
        presence.sort_by(f64::total_cmp);
        let side_px = Quad(fitted.corners).side_px();
        // A pixel of raggedness is no fault of a small marker.
        let ragged = |px: f64| 1.0 / (1.0 + ((px - 0.5).max(0.0) / (0.02 * side_px)).powi(2));
        Self {
            outline: ((0..4).map(seen).fold(1.0, f64::min) / 0.7).min(1.0),
            stem: ((presence[1] - presence[0].max(-0.2)) / 0.7).clamp(0.0, 1.0),
            lines: (arms.likeness.max(0.0) * (presence[1] / presence[3].max(1e-6)) / 0.6).clamp(0.0, 1.0),
            straight: ragged(fitted.outline_px) * ragged(fitted.arms_px),
            arms: (arms.points.len() as f64 / (0.9 * (3 * arms::STATIONS) as f64)).min(1.0),
        }
    }

    fn quality(&self) -> f64 {
        self.outline * self.stem * self.lines * self.straight * self.arms
    }

    /// The reason to refuse, if any.
    fn check(&self, arms: &arms::Arms, least: f64) -> Result<(), Refusal> {
        if self.lines * self.arms < 0.2 {
            return Err(Refusal::NoCross);
        }
        if self.stem < 0.4 || arms.separation < 1.2 {
            return Err(Refusal::Ambiguous);
        }
        if self.outline < 0.35 {
            return Err(Refusal::Occluded);
        }
        if self.quality() < least { Err(Refusal::NoCross) } else { Ok(()) }
    }
}

fn pose(fitted: &Fit, arms: &arms::Arms, quality: f64) -> Result<Pose, Refusal> {
    let corners: [Point; 4] = std::array::from_fn(|k| fitted.corners[(arms.stem + k) % 4]);
    let homography = Homography::from_unit_square(&corners).ok_or(Refusal::NoOutline)?;
    let center = homography.apply([0.5, 0.5]);
    let side_px = Quad(corners).side_px();
    let [xx, xy, yy] = fit::center_covariance(&fitted.corners, &fitted.covariance).ok_or(Refusal::NoOutline)?;
    let hand = (HAND * side_px).powi(2);
    let covariance = [CORRELATION * xx + hand, CORRELATION * xy, CORRELATION * yy + hand];
    Ok(Pose {
        center,
        corners: Quad(corners),
        angle: angle_deg(corners[0][0] - center[0], corners[0][1] - center[1]),
        homography,
        covariance,
        quality,
        rotation: None,
        translation: None,
        reprojection_px: None,
        rival: None,
    })
}
