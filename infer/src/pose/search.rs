//! The first quadrilateral: every parallelogram that touches the four sides of the box, scored as a T cross; the best are nudged corner by
//! corner, and then each side is laid where the odds that what it encloses is marker add up to most.
use super::{
    evidence::{Maps, Score},
    plane::{Line, Point, along, distance},
    quad::{corners_of, is_sound, on_side},
};
use tcross_dataset::{PixelBox, Quad};

/// A quadrilateral in cells and how well it explains the view.
#[derive(Debug, Clone, Copy)]
pub struct Guess {
    /// Clockwise as seen.
    pub corners: [Point; 4],
    /// How well.
    pub score: Score,
}

/// Positions along a side of the box: so many, from one end to the other.
const PLACES: usize = 13;

/// The best `count` quadrilaterals for a box in cells, each different from the others, best first.
#[must_use]
pub fn guesses(maps: &Maps, bounds: &PixelBox, count: usize) -> Vec<Guess> {
    let ([cx, cy], w, h) = (bounds.center(), bounds.width() / 2.0, bounds.height() / 2.0);
    let mut all: Vec<Guess> = Vec::with_capacity(256);
    let mut consider = |p: Point, q: Point| {
        // Two half diagonals; clockwise as seen from p to q.
        if p[0] * q[1] - p[1] * q[0] < 0.22 {
            return;
        }
        let at = |[x, y]: Point, sign: f64| [cx + sign * x * w, cy + sign * y * h];
        let corners = [at(p, 1.0), at(q, 1.0), at(p, -1.0), at(q, -1.0)];
        all.extend(maps.score(&corners).map(|score| Guess { corners, score }));
    };
    let place = |i: usize, n: usize| 2.0 * i as f64 / (n - 1) as f64 - 1.0;
    for i in 0..PLACES {
        for j in 0..PLACES {
            // One diagonal ends on the left and right sides, the other on the upper and lower.
            consider([1.0, place(i, PLACES)], [place(j, PLACES), 1.0]);
        }
    }
    for sign in [1.0, -1.0] {
        for i in 1..8 {
            for j in 1..8 {
                // One diagonal is the box's own, the other lies anywhere inside.
                consider([1.0, sign], [place(i, 9), place(j, 9)]);
            }
        }
    }
    all.sort_by(|a, b| b.score.total().total_cmp(&a.score.total()));
    let mut kept: Vec<Guess> = Vec::with_capacity(count);
    for guess in all {
        if !kept.iter().any(|k| is_near(&k.corners, &guess.corners, 0.25)) {
            kept.push(guess);
            if kept.len() == count {
                break;
            }
        }
    }
    kept
}

/// Whether each corner of `b`, whichever it begins with, lies within `share` sides of one of `a`.
#[must_use]
pub fn is_near(a: &[Point; 4], b: &[Point; 4], share: f64) -> bool {
    let reach = share * Quad(*a).side_px();
    (0..4).any(|turn| (0..4).all(|i| distance(a[i], b[(i + turn) % 4]) < reach))
}

/// Moves corner after corner by a share of the side as long as that explains the view better.
#[must_use]
pub fn nudge(maps: &Maps, mut guess: Guess, steps: &[f64]) -> Guess {
    for step in steps {
        let size = step * Quad(guess.corners).side_px();
        for _ in 0..3 {
            let mut moved = false;
            for k in 0..4 {
                for [dx, dy] in [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]] {
                    let mut corners = guess.corners;
                    corners[k] = [corners[k][0] + dx * size, corners[k][1] + dy * size];
                    if !is_sound(&corners) {
                        continue;
                    }
                    if let Some(score) = maps.score(&corners).filter(|s| s.total() > guess.score.total() + 1e-4) {
                        guess = Guess { corners, score };
                        moved = true;
                    }
                }
            }
            if !moved {
                break;
            }
        }
    }
    guess
}

/// Profiles across a side, and samples in each, from inside to outside.
const PROFILES: usize = 16;
const SAMPLES: usize = 33;

/// Lays each side, within `reach` sides of where it is, so that the odds of what it encloses add up to most. `None` where no sound
/// quadrilateral is left.
#[must_use]
pub fn settle(maps: &Maps, corners: &[Point; 4], reach: f64) -> Option<[Point; 4]> {
    let reach = reach * Quad(*corners).side_px();
    let step = 2.0 * reach / (SAMPLES - 1) as f64;
    let mut sides = [None; 4];
    for k in 0..4 {
        let line = Line::through(corners[k], corners[(k + 1) % 4])?;
        // Odds summed from the inner end on.
        let mut sums = [[0.0f32; SAMPLES]; PROFILES];
        for (i, sums) in sums.iter_mut().enumerate() {
            let [x, y] = along(on_side(corners, k, place(i)), line.normal, -reach).map(|v| v as f32);
            let [dx, dy] = line.normal.map(|v| (step * v) as f32);
            let mut total = 0.0;
            for (j, sum) in sums.iter_mut().enumerate() {
                total += maps.odds_at([x + dx * j as f32, y + dy * j as f32]);
                *sum = total;
            }
        }
        let (a, b) = best_line(&sums);
        let offset = |v: f32| -reach + step * (f64::from(v) + 0.5);
        sides[k] = Line::through(along(corners[k], line.normal, offset(a)), along(corners[(k + 1) % 4], line.normal, offset(b)));
    }
    let [Some(a), Some(b), Some(c), Some(d)] = sides else { return None };
    corners_of(&[a, b, c, d]).filter(is_sound)
}

/// Where a profile stands along its side.
fn place(i: usize) -> f64 {
    0.05 + 0.90 * (i as f64 + 0.5) / PROFILES as f64
}

/// Sample numbers at the side's two ends between which the sums add up to most.
fn best_line(sums: &[[f32; SAMPLES]; PROFILES]) -> (f32, f32) {
    let middle = (SAMPLES - 1) as f32 / 2.0;
    let places: [f32; PROFILES] = std::array::from_fn(|i| place(i) as f32);
    let value = |a: f32, b: f32| {
        let mut total = 0.0;
        for (sums, place) in sums.iter().zip(&places) {
            let at = (a + (b - a) * place).clamp(0.0, (SAMPLES - 1) as f32);
            let j = (at as usize).min(SAMPLES - 2);
            total += sums[j] + (sums[j + 1] - sums[j]) * (at - j as f32);
        }
        // A side far from where it was wants a reason.
        total - 0.02 * PROFILES as f32 * ((a - middle).powi(2) + (b - middle).powi(2)) / middle
    };
    let mut best = (value(middle, middle), middle, middle);
    for step in [4.0f32, 2.0, 1.0, 0.5] {
        let (_, a0, b0) = best;
        let span: i32 = if step == 4.0 { 4 } else { 1 };
        for i in -span..=span {
            for j in -span..=span {
                let (a, b) = (a0 + i as f32 * step, b0 + j as f32 * step);
                if (0.0..SAMPLES as f32).contains(&a) && (0.0..SAMPLES as f32).contains(&b) {
                    let v = value(a, b);
                    if v > best.0 {
                        best = (v, a, b);
                    }
                }
            }
        }
    }
    (best.1, best.2)
}
