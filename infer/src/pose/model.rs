//! Our method, the default: colour model -> quadrilateral -> sub-pixel outline -> arms -> the T cross fitted as a whole.
use super::{
    Config, Refusal,
    arms::{self, Arms},
    crop::{Coarse, Picture},
    edges,
    evidence::{Maps, Score},
    fit::{self, Constraint, Fit},
    plane::{Line, Point, Weighted, along, distance, fit_line},
    quad,
    search::{self, Guess},
};
use image::RgbImage;
use tcross_dataset::{
    Homography, PixelBox, Pose, Quad,
    geom::{boxes::iou, quad::angle_deg},
};

/// Deviation of the centre of a marker that leaves nothing to wish, in sides and in pixels: what a hand errs and what pixels hide. With
/// [`DOUBT`] fitted to the errors on 700 drawn markers (a heavy-tailed likelihood, then scaled so that 95 % ellipses hold 94 %).
const CENTER: f64 = 0.0084;
const CENTER_PX: f64 = 0.28;
/// Growth of that deviation from quality 1 to quality 0.
const DOUBT: f64 = 4.0;

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
    let mut answer: Result<Pose, Refusal> = Err(Refusal::NoOutline);
    for settled in candidates(&view, &inside) {
        let found = look(&picture, settled.corners, &settled).and_then(|looked| {
            looked.evidence.check(config.min_quality)?;
            pose(&looked)
        });
        match (&found, &answer) {
            (Ok(pose), _) if pose.quality > SURE => return found,
            (Ok(pose), Ok(other)) if pose.quality > other.quality => answer = found,
            (Ok(_), Err(_)) | (Err(_), Err(Refusal::NoOutline)) => answer = found,
            _ => {}
        }
    }
    answer
}

/// Every quadrilateral that [`recover`] would consider, with its evidence, whatever its quality: for fitting the quality's weights.
#[must_use]
pub fn considered(image: &RgbImage, bounds: &PixelBox, config: &Config) -> Vec<(Pose, Evidence)> {
    let Ok((picture, inside)) = super::checked(image, bounds, config) else { return Vec::new() };
    let Some(view) = Coarse::new(&picture, &super::padded(&picture, &inside, config.padding)) else { return Vec::new() };
    let all = candidates(&view, &inside).filter_map(|settled| {
        let looked = look(&picture, settled.corners, &settled).ok()?;
        Some((pose(&looked).ok()?, looked.evidence))
    });
    all.collect()
}

/// A quadrilateral in pixels, how well it explains the coarse view, and how well it fills its box.
struct Settled {
    corners: [Point; 4],
    score: Score,
    /// Overlap of its extent with the box, IoU.
    agreement: f64,
}

/// Quadrilaterals for a box, best first, each settled as it is asked for.
fn candidates<'a>(view: &'a Coarse, inside: &PixelBox) -> impl Iterator<Item = Settled> + use<'a> {
    let mut maps = Maps::new(view, inside);
    let bounds = view.to_cells(inside);
    let mut guesses: Vec<Guess> =
        search::guesses(&maps, &bounds, GUESSES).into_iter().map(|g| search::nudge(&maps, g, &[0.06, 0.03])).collect();
    guesses.sort_by(|a, b| b.score.total().total_cmp(&a.score.total()));
    guesses.into_iter().map(move |guess| {
        let (mut corners, mut score) = (guess.corners, guess.score);
        for (gap, reach) in [(0.06, 0.10), (0.03, 0.06)] {
            maps.relearn(&corners, gap);
            let Some(there) = search::settle(&maps, &corners, reach) else { continue };
            // A side may run away to the border of the sheet: the box tells.
            let fits = |c: &[Point; 4]| iou(&Quad(*c).bounds(), &bounds);
            if fits(&there) > fits(&corners) - 0.15 {
                corners = there;
            }
        }
        score = maps.score(&corners).unwrap_or(score);
        let agreement = iou(&Quad(corners).bounds(), &bounds);
        Settled { corners: corners.map(|p| view.to_source(p)), score, agreement }
    })
}

/// A pose of this quality ends the search.
const SURE: f64 = 0.97;

/// So many first quadrilaterals are followed up.
const GUESSES: usize = 4;

/// True where no channel of any cell differs from another cell's by more than two grey levels or so.
fn is_plain(view: &Coarse) -> bool {
    (0..3).all(|c| {
        let (lo, hi) = view.cells.iter().fold((f32::MAX, f32::MIN), |(lo, hi), v| (lo.min(v[c]), hi.max(v[c])));
        hi - lo < 0.012
    })
}

/// Everything that was measured of one quadrilateral.
struct Looked {
    fitted: Fit,
    arms: Arms,
    map: Homography,
    evidence: Evidence,
}

fn look(picture: &Picture, corners: [Point; 4], settled: &Settled) -> Result<Looked, Refusal> {
    let side_px = Quad(corners).side_px();
    let (outline, clean) = outline(picture, &corners, side_px);
    let sharp = fit::fit(corners, &outline).map(|f| f.corners).filter(quad::is_sound).unwrap_or(corners);
    let map = Homography::from_unit_square(&sharp).ok_or(Refusal::NoOutline)?;
    let arms = arms::read(picture, &map).ok_or(Refusal::NoCross)?;
    let mut constraints = outline;
    constraints.extend(arms.points.iter().map(|(k, at, weight)| Constraint {
        at: *at,
        corners: (k % 2, k % 2 + 2),
        outline: false,
        weight: *weight,
    }));
    let fitted = fit::fit(sharp, &constraints).ok_or(Refusal::NoOutline)?;
    if !quad::is_sound(&fitted.corners) {
        return Err(Refusal::NoOutline);
    }
    let beyond = 1.5 + 0.03 * side_px;
    if fitted.corners.iter().any(|c| !picture.holds(*c, -beyond)) {
        return Err(Refusal::CutByBorder);
    }
    let evidence = Evidence::of(&fitted, &arms, settled, clean);
    Ok(Looked { fitted, arms, map, evidence })
}

/// Strokes of a hand end beyond the outline it aims at, by so many sides (measured over drawn markers).
const OVERSHOOT: f64 = 0.020;
/// What blur adds to that, in pixels.
const SPREAD_PX: f64 = 0.7;

/// Points of the outline: along a side whose edge is sharp on the full-resolution picture those of its edge, along a ragged one those of
/// the settled side; and how many sides are sharp.
fn outline(picture: &Picture, corners: &[Point; 4], side_px: f64) -> (Vec<Constraint>, usize) {
    let measured = edges::measure(picture, corners, (0.05 * side_px).max(3.0));
    let mut constraints = Vec::with_capacity(4 * edges::PROFILES);
    let mut clean = 0;
    for side in 0..4 {
        let on = (side, (side + 1) % 4);
        let points: Vec<Weighted> = measured.iter().filter(|p| p.side == side).map(|p| Weighted { at: p.at, weight: p.weight }).collect();
        let sharp = Line::through(corners[on.0], corners[on.1]).filter(|_| 3 * points.len() >= 2 * edges::PROFILES).and_then(|start| {
            let line = fit_line(&points, start, 0.05 * side_px, 0.5)?;
            let mut off: Vec<f64> = points.iter().map(|p| line.distance(p.at).abs()).collect();
            let middle = off.len() / 2;
            let deviation = 1.483 * *off.select_nth_unstable_by(middle, f64::total_cmp).1;
            let moved = line.distance(corners[on.0]).abs().max(line.distance(corners[on.1]).abs());
            (deviation < 0.4 + 0.006 * side_px && moved < 1.0 + 0.03 * side_px).then_some(line)
        });
        if sharp.is_some() {
            clean += 1;
            constraints.extend(points.iter().map(|p| Constraint { at: p.at, corners: on, outline: true, weight: p.weight }));
        } else {
            let Some(line) = Line::through(corners[on.0], corners[on.1]) else { continue };
            let places = (0..edges::PROFILES / 2).map(|i| quad::on_side(corners, side, (i as f64 + 0.5) / (edges::PROFILES / 2) as f64));
            let aimed = places.map(|at| along(at, line.normal, -(OVERSHOOT * side_px + SPREAD_PX)));
            constraints.extend(aimed.map(|at| Constraint { at, corners: on, outline: true, weight: 1.0 }));
        }
    }
    (constraints, clean)
}

/// What speaks for a T cross. The quality is the probability that logistic regression gives to these numbers.
#[derive(Debug, Clone, Copy)]
pub struct Evidence {
    /// Named in [`FEATURES`].
    pub features: [f64; FEATURES.len()],
    /// Of lines and fill, in square roots of light.
    pub contrast: f64,
}

/// Names of the evidence, in order.
pub const FEATURES: [&str; 13] = [
    "weakest side's log odds",
    "all sides' log odds",
    "cross in the coarse view",
    "weakest line against noise",
    "stem's margin",
    "separation",
    "likeness",
    "evenness of the lines",
    "wobble",
    "stations seen",
    "agreement with the box",
    "sharp sides",
    "perspective",
];

impl Evidence {
    fn of(fitted: &Fit, arms: &Arms, settled: &Settled, clean: usize) -> Self {
        let mut presence = arms.presence;
        presence.sort_by(f64::total_cmp);
        let sides = settled.score.sides.map(f64::from);
        Self {
            contrast: arms.contrast,
            features: [
                sides.iter().copied().fold(f64::MAX, f64::min),
                sides.iter().sum::<f64>() / 4.0,
                f64::from(settled.score.cross).clamp(-1.0, 2.0),
                ((presence[1] * arms.contrast).max(1e-3) / (arms.noise + 0.003)).ln().clamp(-3.0, 3.0),
                (presence[1] - presence[0].max(-0.3)).min(1.5),
                arms.separation.clamp(-2.0, 8.0).max(0.0).sqrt(),
                arms.likeness.max(0.0),
                presence[1] / presence[3].max(1e-3),
                (arms.wobble / 0.01).min(3.0),
                arms.points.len() as f64 / (3 * arms::STATIONS) as f64,
                settled.agreement,
                clean as f64 / 4.0,
                perspective(&fitted.corners).min(1.5),
            ],
        }
    }

    fn quality(&self) -> f64 {
        let z = WEIGHTS[0] + self.features.iter().zip(&WEIGHTS[1..]).map(|(f, w)| f * w).sum::<f64>();
        1.0 / (1.0 + (-z).exp())
    }

    /// The reason to refuse, if any.
    fn check(&self, least: f64) -> Result<(), Refusal> {
        let [weakest, all, _, line, margin, separation, ..] = self.features;
        if self.contrast < LEAST_CONTRAST {
            return Err(Refusal::NoCross);
        }
        if margin < 0.12 || separation < 0.4 {
            return Err(Refusal::Ambiguous);
        }
        if self.quality() >= least {
            return Ok(());
        }
        Err(if line < -0.3 || all < 0.0 {
            Refusal::NoCross
        } else if margin < 0.35 || separation < 1.0 {
            Refusal::Ambiguous
        } else if weakest < 1.2 {
            Refusal::Occluded
        } else {
            Refusal::NoCross
        })
    }
}

/// Lines that differ from the fill by less, in square roots of light, are none: rounding and compression reach so far.
const LEAST_CONTRAST: f64 = 0.012;

/// How unlike opposite sides are: the larger logarithm of their ratio.
fn perspective(c: &[Point; 4]) -> f64 {
    let length = |k: usize| distance(c[k], c[(k + 1) % 4]).max(1e-9);
    (0..2).map(|k| (length(k) / length(k + 2)).ln().abs()).fold(0.0, f64::max)
}

/// Bias and weights of [`FEATURES`], by `pose_study --fit` on drawn markers and photo patches.
const WEIGHTS: [f64; FEATURES.len() + 1] =
    [-7.02, 1.956, 0.179, 1.165, 0.938, 0.409, 0.059, 0.775, -1.093, -1.102, -1.528, 2.448, 1.694, -2.489];

fn pose(looked: &Looked) -> Result<Pose, Refusal> {
    let Looked { fitted, arms, map, evidence } = looked;
    let corners: [Point; 4] = std::array::from_fn(|k| fitted.corners[(arms.stem + k) % 4]);
    let homography = Homography::from_unit_square(&corners).ok_or(Refusal::NoOutline)?;
    let center = map.apply(arms.meeting);
    let covariance = covariance(map, arms.meeting, evidence.quality());
    Ok(Pose {
        center,
        corners: Quad(corners),
        angle: angle_deg(corners[0][0] - center[0], corners[0][1] - center[1]),
        homography,
        covariance,
        quality: evidence.quality(),
        rotation: None,
        translation: None,
        reprojection_px: None,
        rival: None,
    })
}

/// Covariance `[xx, xy, yy]` of the centre in px squared: even in the marker's plane, seen through its homography, and the pixels' own.
fn covariance(map: &Homography, [u, v]: Point, quality: f64) -> [f64; 3] {
    const STEP: f64 = 1e-3;
    let (here, right, down) = (map.apply([u, v]), map.apply([u + STEP, v]), map.apply([u, v + STEP]));
    let slope = |to: Point| [(to[0] - here[0]) / STEP, (to[1] - here[1]) / STEP];
    let (a, b) = (slope(right), slope(down));
    let plane = (CENTER * (1.0 + DOUBT * (1.0 - quality))).powi(2);
    let pixels = CENTER_PX * CENTER_PX;
    [plane * (a[0] * a[0] + b[0] * b[0]) + pixels, plane * (a[0] * a[1] + b[0] * b[1]), plane * (a[1] * a[1] + b[1] * b[1]) + pixels]
}
