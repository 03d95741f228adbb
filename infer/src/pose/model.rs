//! Our method, the default: colour model -> quadrilateral -> sub-pixel outline -> lines -> corners from all of these together.
use super::{
    Config, Refusal,
    arms::{self, Arms},
    crop::{Coarse, Picture},
    edges,
    evidence::{Maps, Score},
    fit::{self, Pull},
    plane::{Line, Point, Weighted, along, distance, fit_line, norm, sub},
    quad,
    search::{self, Guess},
    square,
};
use image::RgbImage;
use tcross_dataset::{
    Homography, PixelBox, Pose, Quad,
    geom::{boxes::iou, quad::angle_deg},
};

/// Deviation of the centre of a marker that leaves nothing to wish, in sides and in pixels: what a hand errs and what pixels hide. With
/// [`DOUBT`] fitted to the errors on 700 drawn markers (a heavy-tailed likelihood, then scaled so that 95 % ellipses hold 94 %).
const CENTER: f64 = 0.0092;
const CENTER_PX: f64 = 0.31;
/// Growth of that deviation from quality 1 to quality 0.
const DOUBT: f64 = 4.0;

/// Recovers the pose of the T cross in `bounds` (pixels of `image`).
///
/// # Errors
/// The reason for which no pose is claimed.
pub fn recover(image: &RgbImage, bounds: &PixelBox, config: &Config) -> Result<Pose, Refusal> {
    let (picture, inside) = super::checked(image, bounds, config)?;
    let window = super::padded(&picture, &inside, config.padding);
    let coarse = Coarse::new(&picture, &window).ok_or(Refusal::TooSmall)?;
    let view = View::new(&picture, inside);
    if is_plain(&coarse) {
        return Err(Refusal::OneColour);
    }
    let mut best: Option<Answer> = None;
    let mut rival: Option<Answer> = None;
    let mut refusal = Refusal::NoOutline;
    for (settled, enough) in candidates(&coarse, &view).zip(ENOUGH) {
        if settled.at_border {
            refusal = Refusal::CutByBorder;
        }
        let answer = match look(&picture, &settled, &view).and_then(|looked| Answer::of(&looked, config.min_quality)) {
            Ok(answer) => answer,
            Err(other) => {
                // The first reason is that of the likeliest quadrilateral.
                if refusal == Refusal::NoOutline {
                    refusal = other;
                }
                continue;
            }
        };
        if best.as_ref().is_none_or(|b| answer.logit > b.logit) {
            rival = best.replace(answer).or(rival);
        } else if rival.as_ref().is_none_or(|r| answer.logit > r.logit) {
            rival = Some(answer);
        }
        if best.as_ref().is_some_and(|b| b.pose.quality > enough) {
            break;
        }
    }
    let Some(best) = best else { return Err(refusal) };
    if best.cut || best.at_border && best.pose.quality < SURE_AT_BORDER {
        return Err(Refusal::CutByBorder);
    }
    if rival.is_some_and(|r| best.logit - r.logit < CLOSE && turned(&best.pose, &r.pose)) {
        return Err(Refusal::Ambiguous);
    }
    Ok(best.pose)
}

/// A pose that may be claimed.
struct Answer {
    pose: Pose,
    logit: f64,
    cut: bool,
    at_border: bool,
}

impl Answer {
    fn of(looked: &Looked, min_quality: f64) -> Result<Self, Refusal> {
        looked.evidence.check(min_quality)?;
        Ok(Self { pose: pose(looked)?, logit: looked.evidence.logit(), cut: looked.cut, at_border: looked.at_border })
    }
}

/// Least quality of what runs along the picture's border: what is left of a marker cut there may look whole.
const SURE_AT_BORDER: f64 = 0.9;

/// Quadrilaterals whose log odds differ by less are equally good.
const CLOSE: f64 = 1.0;

/// Whether two poses tell different turns.
fn turned(a: &Pose, b: &Pose) -> bool {
    let apart = (a.angle - b.angle).rem_euclid(360.0);
    apart.min(360.0 - apart) > 45.0
}

/// A quadrilateral that [`recover`] would consider, whatever its quality: for fitting the quality's weights.
#[derive(Debug, Clone)]
pub struct Considered {
    /// The pose that would be claimed.
    pub pose: Pose,
    /// What speaks for it.
    pub evidence: Evidence,
}

/// Every quadrilateral that [`recover`] would consider.
#[must_use]
pub fn considered(image: &RgbImage, bounds: &PixelBox, config: &Config) -> Vec<Considered> {
    let Ok((picture, inside)) = super::checked(image, bounds, config) else { return Vec::new() };
    let Some(coarse) = Coarse::new(&picture, &super::padded(&picture, &inside, config.padding)) else { return Vec::new() };
    let view = View::new(&picture, inside);
    let all = candidates(&coarse, &view).filter_map(|settled| {
        let looked = look(&picture, &settled, &view).ok()?;
        Some(Considered { pose: pose(&looked).ok()?, evidence: looked.evidence })
    });
    all.collect()
}

/// A quadrilateral in pixels, how well it explains the coarse view, and how well it fills its box.
struct Settled {
    corners: [Point; 4],
    score: Score,
    /// How much like marker it looks inside where it does so least, in log odds.
    deep: f32,
    /// Whether its fill runs along the picture's border, so that it may be cut there.
    at_border: bool,
}

/// Quadrilaterals for a box, best first, each settled as it is asked for.
fn candidates<'a>(coarse: &'a Coarse, view: &View) -> impl Iterator<Item = Settled> + use<'a> {
    let mut maps = Maps::new(coarse, &view.bounds);
    let (bounds, borders) = (coarse.to_cells(&view.bounds), view.borders);
    let mut guesses = search::guesses(&maps, &bounds, GUESSES);
    let likely = AT_ONCE.min(guesses.len());
    for guess in &mut guesses[..likely] {
        *guess = search::nudge(&maps, *guess, &NUDGES);
    }
    guesses[..likely].sort_by(|a, b| b.score.total().total_cmp(&a.score.total()));
    let mut followed: Vec<[Point; 4]> = Vec::with_capacity(2 * GUESSES);
    guesses.into_iter().enumerate().filter_map(move |(k, mut guess)| {
        if k >= likely {
            maps.forget();
            guess = search::nudge(&maps, guess, &NUDGES);
        }
        if followed.iter().any(|f| search::is_near(f, &guess.corners, SAME)) {
            return None;
        }
        followed.push(guess.corners);
        let (mut corners, mut score) = (guess.corners, guess.score);
        for (gap, reach) in [(0.06, 0.10), (0.03, 0.06)] {
            maps.relearn(&corners, gap);
            let Some(there) = search::settle(&maps, &corners, reach) else { continue };
            // A side may run away to the border of the sheet: the box tells.
            let fits = |c: &[Point; 4]| iou(&Quad(*c).bounds(), &bounds);
            if fits(&there) > fits(&corners) - MOST_LOSS {
                corners = there;
            }
            if gap > 0.05 {
                maps.relearn(&corners, gap);
                if let Some(score) = maps.score(&corners) {
                    corners = search::nudge(&maps, Guess { corners, score }, &[0.05]).corners;
                }
            }
        }
        score = maps.score(&corners).unwrap_or(score);
        let at_border = maps.run_along(borders) as f64 > MOST_AT_BORDER * Quad(corners).side_px();
        followed.push(corners);
        Some(Settled { corners: corners.map(|p| coarse.to_source(p)), score, deep: maps.deep(&corners), at_border })
    })
}

/// A corner that touches the picture's border does so with little; with more than so many sides of fill along it the marker may be cut.
const MOST_AT_BORDER: f64 = 0.60;

/// A settled quadrilateral's overlap with the box may fall by so much.
const MOST_LOSS: f64 = 0.04;

/// So many first quadrilaterals are followed up.
const GUESSES: usize = 8;
/// So many of them are nudged before the best of them is followed; the others when their turn comes.
const AT_ONCE: usize = 3;
/// How far the corners of first quadrilaterals are nudged, in sides.
const NUDGES: [f64; 2] = [0.06, 0.03];
/// A quadrilateral whose corners all lie within so many sides of one followed before settles where that did.
const SAME: f64 = 0.06;
/// A best pose of this quality after the first quadrilateral, the second and so on ends the search: the first right one is nearly always the
/// first of all, so the longer the search, the less is to be hoped for.
const ENOUGH: [f64; GUESSES] = [0.9, 0.8, 0.7, 0.5, 0.3, 0.2, 0.1, 0.1];

/// True where no channel of any cell differs from another cell's by more than two grey levels or so.
fn is_plain(view: &Coarse) -> bool {
    (0..3).all(|c| {
        let (lo, hi) = view.cells.iter().fold((f32::MAX, f32::MIN), |(lo, hi), v| (lo.min(v[c]), hi.max(v[c])));
        hi - lo < 0.012
    })
}

/// Everything that was measured of one quadrilateral.
struct Looked {
    corners: [Point; 4],
    arms: Arms,
    map: Homography,
    evidence: Evidence,
    /// Whether a corner lies beyond the picture.
    cut: bool,
    /// As [`Settled::at_border`].
    at_border: bool,
}

/// The box inside the picture, and which of the picture's borders (left, upper, right, lower) it touches.
struct View {
    bounds: PixelBox,
    borders: [bool; 4],
    /// The picture's longer side.
    size: f64,
}

impl View {
    fn new(picture: &Picture, bounds: PixelBox) -> Self {
        let (w, h) = (picture.width as f64, picture.height as f64);
        Self { size: w.max(h), bounds, borders: [bounds.x_min < 1.0, bounds.y_min < 1.0, bounds.x_max > w - 1.0, bounds.y_max > h - 1.0] }
    }
}

/// Mean log odds across the sides of a settled quadrilateral below which it is not looked at: of 8,284 right ones of seed 1 one lies there,
/// of the others two in five.
const LEAST_SIDES: f32 = 0.8;

fn look(picture: &Picture, settled: &Settled, view: &View) -> Result<Looked, Refusal> {
    if settled.score.sides.iter().sum::<f32>() < 4.0 * LEAST_SIDES {
        return Err(Refusal::NoOutline);
    }
    let corners = within(settled.corners, view);
    let side_px = Quad(corners).side_px();
    let sides = outline(picture, &corners, side_px).ok_or(Refusal::NoOutline)?;
    let outlined = quad::corners_of(&sides.map(|s| s.line)).filter(quad::is_sound).unwrap_or(corners);
    let map = Homography::from_unit_square(&outlined).ok_or(Refusal::NoOutline)?;
    let arms = arms::read(picture, &map).ok_or(Refusal::NoCross)?;
    let corners = together(&outlined, &sides, &arms, &map, view).filter(quad::is_sound).ok_or(Refusal::NoOutline)?;
    let beyond = 1.5 + 0.03 * side_px;
    let cut = corners.iter().any(|c| !picture.holds(*c, -beyond));
    let agreement = iou(&Quad(corners).bounds(), &view.bounds);
    let evidence = Evidence::of(&corners, &arms, settled, agreement, &sides);
    Ok(Looked { corners, arms, map, evidence, cut, at_border: settled.at_border })
}

/// A settled quadrilateral may reach beyond the box by so many sides; what reaches farther has run away to the border of a sheet.
const MOST_BEYOND: f64 = 0.035;

/// The quadrilateral drawn together along the picture's axes such that it hardly reaches beyond the box.
fn within(mut corners: [Point; 4], view: &View) -> [Point; 4] {
    let (now, b) = (Quad(corners).bounds(), &view.bounds);
    let slack = MOST_BEYOND * Quad(corners).side_px() + 1.0;
    for (axis, from, to, least, most) in [(0, now.x_min, now.x_max, b.x_min, b.x_max), (1, now.y_min, now.y_max, b.y_min, b.y_max)] {
        let (new_from, new_to) = (from.max(least - slack), to.min(most + slack));
        if to - from > 1.0 && new_to - new_from > 1.0 {
            for c in &mut corners {
                c[axis] = new_from + (c[axis] - from) * (new_to - new_from) / (to - from);
            }
        }
    }
    corners
}

/// Points of an edge from which a side is laid; fewer say too little.
const LEAST_POINTS: usize = 8;
/// An edge lies beyond the outline that the hand aimed at: by so many deviations of its points from a straight line, since the ragged ends of
/// strokes reach farther the more they vary, by so many pixels of blur, and less than these two say by so many sides. Measured over drawn
/// markers, as are the other numbers here.
const RAGGED_BEYOND: f64 = 1.9;
const BLUR_BEYOND_PX: f64 = 0.1;
const LESS_BEYOND: f64 = 0.001;
/// Raggedness in sides beyond which strokes do not reach farther: more is clutter's.
const MOST_RAGGED: f64 = 0.018;
/// Deviation of a side's ends: in sides, in pixels, and in deviations of its points.
const EDGE: f64 = 0.003;
const EDGE_PX: f64 = 0.45;
const EDGE_RAGGED: f64 = 1.3;
/// A side without an edge lies so many sides and pixels inside the settled one, with deviations in sides and pixels.
const SETTLED_BEYOND: f64 = 0.022;
const SETTLED_BEYOND_PX: f64 = 0.7;
const SETTLED: f64 = 0.025;
const SETTLED_PX: f64 = 0.5;

/// One side of the outline that the hand aimed at.
#[derive(Debug, Clone, Copy)]
struct Side {
    line: Line,
    /// Deviation of the edge's points from a straight line, in sides; that of a settled side where there is no edge.
    ragged: f64,
    /// Deviation at its corners, in pixels.
    deviation: f64,
}

/// The sides, a little inside the edges seen on the full-resolution picture.
fn outline(picture: &Picture, corners: &[Point; 4], side_px: f64) -> Option<[Side; 4]> {
    let measured = edges::measure(picture, corners, (0.05 * side_px).max(3.0));
    let mut sides = [None; 4];
    for (side, out) in sides.iter_mut().enumerate() {
        let start = Line::through(corners[side], corners[(side + 1) % 4])?;
        let points: Vec<Weighted> = measured.iter().filter(|p| p.side == side).map(|p| Weighted { at: p.at, weight: p.weight }).collect();
        *out = along_edge(&points, &start, side_px).or_else(|| {
            let line = Line { offset: start.offset - SETTLED_BEYOND * side_px - SETTLED_BEYOND_PX, ..start };
            Some(Side { line, ragged: SETTLED, deviation: SETTLED * side_px + SETTLED_PX })
        });
    }
    let [Some(a), Some(b), Some(c), Some(d)] = sides else { return None };
    Some([a, b, c, d])
}

/// The side whose edge the points are, seen near `start`.
fn along_edge(points: &[Weighted], start: &Line, side_px: f64) -> Option<Side> {
    if points.len() < LEAST_POINTS {
        return None;
    }
    let line = fit_line(points, *start, 0.05 * side_px + 1.0, 0.5)?;
    let mut off: Vec<f64> = points.iter().map(|p| line.distance(p.at).abs()).collect();
    let middle = off.len() / 2;
    let spread = 1.483 * *off.select_nth_unstable_by(middle, f64::total_cmp).1;
    let beyond = RAGGED_BEYOND * spread.min(MOST_RAGGED * side_px) + BLUR_BEYOND_PX - LESS_BEYOND * side_px;
    let line = Line { offset: line.offset - beyond, ..line };
    // Half the profiles without an edge: the others may be clutter's.
    let few = if points.len() < 2 * edges::PROFILES / 3 { 1.5 } else { 1.0 };
    let deviation = few * (EDGE * side_px).hypot(EDGE_PX).hypot(EDGE_RAGGED * spread);
    Some(Side { line, ragged: spread / side_px, deviation })
}

/// Deviation of a line's end beside its corner, in sides.
const END: f64 = 0.011;
/// How far ink reaches beyond the outermost corner, in sides: a corner, what the sides' raggedness adds, and a side that lies along the box.
/// And the deviation of that.
const INK: f64 = 0.009;
const INK_RAGGED: f64 = 0.5;
const INK_ALONG: f64 = 0.028;
const WALL: f64 = 0.018;
const WALL_PX: f64 = 0.5;

/// The corners from sides, lines and box.
fn together(corners: &[Point; 4], sides: &[Side; 4], arms: &Arms, map: &Homography, view: &View) -> Option<[Point; 4]> {
    let side_px = Quad(*corners).side_px();
    let mut pulls: [Vec<Pull>; 4] = Default::default();
    let b = view.bounds;
    let ragged = INK_RAGGED * (sides.iter().map(|s| s.ragged).sum::<f64>() / 4.0).min(MOST_RAGGED);
    for (k, side) in sides.iter().enumerate() {
        for corner in [k, (k + 1) % 4] {
            let [x, y] = corners[corner];
            let at = along(corners[corner], side.line.normal, -side.line.distance(corners[corner]));
            // An edge whose corner lies beyond the box is another thing's.
            let beyond = (b.x_min - x).max(x - b.x_max).max(b.y_min - y).max(y - b.y_max);
            let doubt = if beyond > MOST_BEYOND * side_px + 1.0 { 2.0 * beyond } else { 0.0 };
            pulls[corner].push(Pull { at, normal: side.line.normal, deviation: side.deviation.hypot(doubt) });
        }
    }
    for (k, end) in arms.ends.iter().enumerate() {
        let Some(off) = end else { continue };
        let (at, before) = arms::end_point(map, k, *off);
        let way = sub(at, before);
        let length = norm(way).max(1e-9);
        pulls[k].push(Pull { at, normal: [-way[1] / length, way[0] / length], deviation: END * side_px });
    }
    for (wall, (axis, sign, at)) in [(0, -1.0, b.x_min), (1, -1.0, b.y_min), (0, 1.0, b.x_max), (1, 1.0, b.y_max)].into_iter().enumerate() {
        // What touches the picture's border may have been cut there.
        if view.borders[wall] {
            continue;
        }
        let mut order = [0, 1, 2, 3];
        order.sort_by(|a: &usize, b| (sign * corners[*b][axis]).total_cmp(&(sign * corners[*a][axis])));
        let gap = (corners[order[0]][axis] - corners[order[1]][axis]).abs() / side_px;
        let ink = INK + ragged + (INK_ALONG - INK) * (1.0 - gap / 0.15).max(0.0);
        let (mut normal, mut place) = ([0.0; 2], corners[order[0]]);
        normal[axis] = 1.0;
        place[axis] = at - sign * ink * side_px;
        pulls[order[0]].push(Pull { at: place, normal, deviation: WALL * side_px + WALL_PX });
    }
    let found: Vec<fit::Corner> = corners.iter().zip(&pulls).map(|(at, pulls)| fit::corner(*at, pulls)).collect::<Option<_>>()?;
    Some(square::regular(found.try_into().ok()?, side_px, view.size))
}

/// What speaks for a T cross. The quality is the probability that logistic regression gives to these numbers.
#[derive(Debug, Clone, Copy)]
pub struct Evidence {
    /// Named in [`FEATURES`].
    pub features: [f64; FEATURES.len()],
    /// Of lines and fill, in square roots of light.
    pub contrast: f64,
    /// Stations that are not blown out, on the half diagonal where they are fewest.
    pub seen: usize,
}

/// Names of the evidence, in order.
pub const FEATURES: [&str; 19] = [
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
    "raggedness of the sides",
    "perspective",
    "the coarse view's stem is the same",
    "lead over the next stem",
    "lines meeting beside the middle",
    "fill deep inside",
    "weakest line, if faint",
    "cosine of the tilt",
];

impl Evidence {
    fn of(corners: &[Point; 4], arms: &Arms, settled: &Settled, agreement: f64, sides: &[Side; 4]) -> Self {
        let mut presence = arms.presence;
        presence.sort_by(f64::total_cmp);
        let ragged = sides.iter().map(|s| s.ragged).sum::<f64>() / 4.0;
        let sides = settled.score.sides.map(f64::from);
        let line = ((presence[1] * arms.strength).max(1e-3) / (arms.noise + 0.1)).ln().clamp(-3.0, 3.0);
        Self {
            contrast: arms.contrast,
            seen: arms.seen,
            features: [
                sides.iter().copied().fold(f64::MAX, f64::min),
                sides.iter().sum::<f64>() / 4.0,
                f64::from(settled.score.cross).clamp(-1.0, 2.0),
                line,
                (presence[1] - presence[0].max(-0.3)).min(1.5),
                arms.separation.clamp(-2.0, 8.0).max(0.0).sqrt(),
                arms.likeness.max(0.0),
                presence[1] / presence[3].max(1e-3),
                (arms.wobble / 0.01).min(3.0),
                arms.shown as f64 / (3 * arms::STATIONS) as f64,
                agreement,
                (ragged / 0.01).min(3.0),
                perspective(corners).min(1.5),
                f64::from(u8::from(settled.score.stem == arms.stem)),
                arms.lead.clamp(0.0, 1.5),
                (arms.beside / 0.05).min(3.0).powi(2),
                f64::from(settled.deep),
                line.min(1.0),
                square::cos_tilt(corners),
            ],
        }
    }

    /// Log odds of a right pose.
    fn logit(&self) -> f64 {
        WEIGHTS[0] + self.features.iter().zip(&WEIGHTS[1..]).map(|(f, w)| f * w).sum::<f64>()
    }

    fn quality(&self) -> f64 {
        1.0 / (1.0 + (-self.logit()).exp())
    }

    /// The reason to refuse, if any.
    fn check(&self, least: f64) -> Result<(), Refusal> {
        let [weakest, all, _, line, margin, separation, ..] = self.features;
        if self.contrast < LEAST_CONTRAST {
            return Err(Refusal::NoCross);
        }
        if margin < 0.12 || separation < 0.4 || self.seen < LEAST_SEEN {
            return Err(Refusal::Ambiguous);
        }
        if self.quality() >= least {
            return Ok(());
        }
        Err(if line < -0.5 || all < 0.0 {
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

/// A half diagonal of which fewer stations are seen may as well carry a line as not.
const LEAST_SEEN: usize = 8;

/// Lines that differ from the fill by less, in square roots of light, are none: rounding and compression reach so far.
const LEAST_CONTRAST: f64 = 0.012;

/// How unlike opposite sides are: the larger logarithm of their ratio.
fn perspective(c: &[Point; 4]) -> f64 {
    let length = |k: usize| distance(c[k], c[(k + 1) % 4]).max(1e-9);
    (0..2).map(|k| (length(k) / length(k + 2)).ln().abs()).fold(0.0, f64::max)
}

/// Bias and weights of [`FEATURES`], by `pose_study --fit` on drawn markers that are whole, hidden in part and cut by the border, and on photo
/// patches. Without the hidden ones a clear outline would decide nearly alone, and what is left of a hidden marker has one.
const WEIGHTS: [f64; FEATURES.len() + 1] = [
    -7.3685, 0.7349, 1.1336, 0.0985, 0.1059, -0.8703, -0.1977, -1.0444, -0.2429, -2.0729, 3.9297, 3.4463, -0.7486, -7.8605, -0.3885,
    0.2990, -0.8851, -1.1467, 1.5730, 2.7386,
];

fn pose(looked: &Looked) -> Result<Pose, Refusal> {
    let Looked { corners, arms, map, evidence, .. } = looked;
    let corners: [Point; 4] = std::array::from_fn(|k| corners[(arms.stem + k) % 4]);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_corner_whose_sides_are_unsure_is_drawn_to_where_a_square_has_it() {
        let square = square::tests::seen(1.0, 0.3, 0.7, 0.5, 10.0, 1000.0).map(|[x, y]| [x + 200.0, y + 200.0]);
        let [a, b, c, d] = square;
        // Two ragged sides meet too far out, away from the corner opposite.
        let off = along(c, sub(c, a), 12.0 / distance(a, c));
        let outlined = [a, b, off, d];
        let sides: [Side; 4] = std::array::from_fn(|k| Side {
            line: Line::through(outlined[k], outlined[(k + 1) % 4]).unwrap(),
            ragged: 0.0,
            deviation: if k == 1 || k == 2 { 10.0 } else { 1.0 },
        });
        let nothing = Arms {
            stem: 0,
            shown: 0,
            seen: 0,
            ends: [None; 4],
            meeting: [0.5; 2],
            presence: [0.0; 4],
            separation: 0.0,
            likeness: 0.0,
            contrast: 0.0,
            strength: 0.0,
            noise: 0.0,
            lead: 0.0,
            beside: 0.0,
            wobble: 0.0,
        };
        // A box that touches every border of the picture says nothing.
        let view = View { bounds: Quad(outlined).bounds(), borders: [true; 4], size: 1250.0 };
        let map = Homography::from_unit_square(&outlined).unwrap();
        let found = together(&outlined, &sides, &nothing, &map, &view).unwrap();
        let errors: Vec<f64> = found.iter().zip(&square).map(|(f, t)| distance(*f, *t)).collect();
        assert!(errors[2] < 10.0 && [0, 1, 3].iter().all(|k| errors[*k] < 4.0), "{errors:?}");
    }
}
