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
    judge(&fitted, &arms, outline.len(), config)?;
    pose(&fitted, &arms)
}

fn outline_constraints(outline: &[EdgePoint]) -> Vec<Constraint> {
    outline.iter().map(|p| Constraint { at: p.at, corners: (p.side, (p.side + 1) % 4), outline: true, weight: p.weight }).collect()
}

fn judge(_fitted: &Fit, arms: &arms::Arms, _outline: usize, _config: &Config) -> Result<(), Refusal> {
    if arms.presence.iter().filter(|p| **p > 0.35).count() < 3 || arms.likeness < 0.5 {
        return Err(Refusal::NoCross);
    }
    if arms.separation < 3.0 {
        return Err(Refusal::Ambiguous);
    }
    Ok(())
}

fn pose(fitted: &Fit, arms: &arms::Arms) -> Result<Pose, Refusal> {
    let corners: [Point; 4] = std::array::from_fn(|k| fitted.corners[(arms.stem + k) % 4]);
    let homography = Homography::from_unit_square(&corners).ok_or(Refusal::NoOutline)?;
    let center = homography.apply([0.5, 0.5]);
    let covariance = fit::center_covariance(&fitted.corners, &fitted.covariance).ok_or(Refusal::NoOutline)?;
    Ok(Pose {
        center,
        corners: Quad(corners),
        angle: angle_deg(corners[0][0] - center[0], corners[0][1] - center[1]),
        homography,
        covariance,
        quality: 1.0,
        rotation: None,
        translation: None,
        reprojection_px: None,
        rival: None,
    })
}
