//! A marker drawn on its sheet: where the hand puts the corners, how its strokes run, and the truth that follows from them.
use super::ink::{Ink, Touch};
use crate::{
    config::HandConfig,
    media::Nature,
    shapes::{Geometry, SQUARE, Shape},
};
use tcross_dataset::{Homography, Rng};

/// A marker drawn on a sheet. Places are in sides of the marker from the middle of its rectangle.
#[derive(Debug)]
pub struct Drawing {
    /// The fill.
    pub fill: Ink,
    /// The lines, above the fill.
    pub lines: Ink,
    /// The corners of the drawn outline, the stem's first, clockwise.
    pub corners: [[f64; 2]; 4],
    /// Where the lines meet.
    pub center: [f64; 2],
    /// How the hand drew.
    pub habits: Habits,
}

/// What was drawn from the config for one drawing, in its units.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Habits {
    /// How much strokes wander, in thousandths of the side.
    pub wobble: f64,
    /// How far corners stand from a rectangle's, in sides, for a hand that is as free as a pen.
    pub corner_error: f64,
    /// How far lines start and end from where they should, in sides.
    pub end_error: f64,
    /// Width of the lines in sides.
    pub line_width: f64,
    /// Whether the fill is hatched.
    pub hatched: bool,
    /// Distance of the hatching's strokes in nib widths, and its angle in degrees; `None` where the fill is not hatched.
    pub hatch: Option<[f64; 2]>,
    /// Whether an outline is drawn around the fill; `None` where there is no fill by hand.
    pub outlined: Option<bool>,
    /// Lines by hand, and how many of them are drawn twice.
    pub lines: Tally,
    /// Strokes by hand, and how many of them have a gap.
    pub strokes: Tally,
}

/// How many there are, and how many of them are of a kind that the config gives a share.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Tally {
    /// All of them.
    pub all: u32,
    /// Those of the kind.
    pub some: u32,
}

impl Tally {
    fn count(&mut self, of_the_kind: bool) {
        self.all += 1;
        self.some += u32::from(of_the_kind);
    }
}

/// What is to be drawn.
#[derive(Debug, Clone, Copy)]
pub struct Plan<'a> {
    /// The shape.
    pub shape: Shape,
    /// Half the width and half the height of the rectangle, in sides.
    pub half: [f64; 2],
    /// The fill's medium.
    pub fill: &'a Nature,
    /// The lines' medium.
    pub line: &'a Nature,
    /// Cells a side.
    pub scale: f32,
}

/// How far beyond the rectangle ink may reach, in sides.
pub const MARGIN: f64 = 0.16;

struct Hand<'a> {
    config: &'a HandConfig,
    /// Deviation of the middle of a stroke of one side, in sides.
    wobble: f64,
    end_error: f64,
    strokes: Tally,
    rng: Rng,
}

impl Plan<'_> {
    /// Draws it. `rng` is the marker's own stream for drawing.
    #[must_use]
    pub fn draw(&self, config: &HandConfig, mut rng: Rng) -> Drawing {
        let steady = self.fill.hand.max(self.line.hand).min(1.0);
        let mut habits = Habits { corner_error: config.corner_error.sample(&mut rng), ..Default::default() };
        let corner_error = habits.corner_error * steady;
        let [w, h] = self.half;
        let corners = SQUARE.iter().map(|p| {
            let mut off = || (rng.normal() * corner_error * 0.5).clamp(-0.08, 0.08);
            [(p[0] * 2.0 - 1.0) * w + off(), (p[1] * 2.0 - 1.0) * h + off()]
        });
        let corners: Vec<[f64; 2]> = corners.collect();
        let corners = [corners[0], corners[1], corners[2], corners[3]];
        let straight = Homography([2.0 * w, 0.0, -w, 0.0, 2.0 * h, -h, 0.0, 0.0, 1.0]);
        let plane_from_unit = Homography::from_unit_square(&corners).unwrap_or(straight);
        let geometry = self.shape.geometry();
        habits.wobble = config.wobble.sample(&mut rng);
        habits.end_error = config.end_error.sample(&mut rng);
        let mut hand = Hand { config, wobble: habits.wobble / 1000.0, end_error: habits.end_error, strokes: Tally::default(), rng };
        let reach = [(w + MARGIN) as f32, (h + MARGIN) as f32];
        let (mut fill, mut lines) = (Ink::bare(reach, self.scale), Ink::bare(reach, self.scale));
        if geometry.filled {
            self.lay_fill(&mut fill, &geometry, &plane_from_unit, &mut hand, &mut habits);
        }
        let center = self.lay_lines(&mut lines, &geometry, &plane_from_unit, &mut hand, &mut habits);
        habits.strokes = hand.strokes;
        let mut offset = || [hand.rng.uniform(0.0, 256.0) as f32, hand.rng.uniform(0.0, 256.0) as f32];
        fill.weather(self.fill, offset());
        lines.weather(self.line, offset());
        Drawing { fill, lines, corners, center, habits }
    }

    /// Lays the fill and notes how.
    fn lay_fill(&self, ink: &mut Ink, geometry: &Geometry, map: &Homography, hand: &mut Hand, habits: &mut Habits) {
        let outline: Vec<[f64; 2]> = geometry.outline.iter().map(|p| map.apply(*p)).collect();
        let nature = self.fill;
        habits.hatched = hand.rng.chance(hand.config.hatched) && nature.hand > 0.0;
        let nib = hand.rng.log_uniform(nature.nib[0], nature.nib[1]) * 0.5;
        let offset = [hand.rng.uniform(0.0, 256.0) as f32, hand.rng.uniform(0.0, 256.0) as f32];
        if !habits.hatched {
            let flat: Vec<[f32; 2]> = outline.iter().map(|p| p.map(|v| v as f32)).collect();
            ink.flood(&flat, 1.0);
        } else {
            let (degrees, apart) = (hand.config.hatch_deg.sample(&mut hand.rng), hand.config.hatch_spacing.sample(&mut hand.rng));
            habits.hatch = Some([apart, degrees]);
            let (angle, spacing) = (degrees.to_radians(), 2.0 * nib * apart);
            let sloppy = hand.rng.uniform(0.0, 1.0);
            let zigzag = hand.rng.chance(0.5);
            let (c, s) = (libm::cos(angle), libm::sin(angle));
            let across = |p: &[f64; 2]| p[1] * c - p[0] * s;
            let lo = outline.iter().map(across).fold(f64::INFINITY, f64::min) + nib * 0.7;
            let hi = outline.iter().map(across).fold(f64::NEG_INFINITY, f64::max) - nib * 0.7;
            let mut row = lo + hand.rng.uniform(0.0, 0.3) * spacing;
            let mut forth = true;
            let mut rows = Vec::new();
            while row < hi + 0.3 * spacing {
                if let Some((from, to)) = chord(&outline, [c, s], row.min(hi)) {
                    let shrink = nib * 0.8;
                    let error = |rng: &mut Rng| (rng.normal() * (0.3 * nib + 0.02) * sloppy).clamp(-0.07, 0.06);
                    let (from, to) = (from + shrink + error(&mut hand.rng), to - shrink + error(&mut hand.rng));
                    if to > from {
                        let lean = hand.rng.normal() * 0.12 * spacing;
                        let at = |along: f64, off: f64| [along * c - (row.min(hi) + off) * s, along * s + (row.min(hi) + off) * c];
                        let (a, b) = (at(from, -lean), at(to, lean));
                        rows.push(if forth { (a, b) } else { (b, a) });
                    }
                }
                row += spacing * hand.rng.uniform(0.85, 1.15);
                forth = !forth;
            }
            if zigzag {
                // The pen stays down: rows are joined at their ends and do not darken each other.
                let mut touches = Vec::new();
                for (a, b) in rows {
                    touches.extend(hand.stroke(a, b, nib, nature));
                }
                ink.stroke(&touches, nature, offset);
            } else {
                for (a, b) in rows {
                    let touches = hand.stroke(a, b, nib, nature);
                    ink.stroke(&touches, nature, offset);
                }
            }
        }
        let outlined = hand.rng.chance(hand.config.outlined) && nature.hand > 0.0;
        habits.outlined = (nature.hand > 0.0).then_some(outlined);
        if outlined {
            // The outer edge of the rim follows the corners: the pen runs half a nib inside them.
            let rim = nib.min(0.04);
            let middle = outline.iter().fold([0.0, 0.0], |m, p| [m[0] + p[0] / outline.len() as f64, m[1] + p[1] / outline.len() as f64]);
            let inner: Vec<[f64; 2]> = outline
                .iter()
                .map(|p| {
                    let d = [middle[0] - p[0], middle[1] - p[1]];
                    let n = (d[0] * d[0] + d[1] * d[1]).sqrt().max(1e-9);
                    [p[0] + d[0] / n * rim * 1.3, p[1] + d[1] / n * rim * 1.3]
                })
                .collect();
            for k in 0..inner.len() {
                let touches = hand.stroke(inner[k], inner[(k + 1) % inner.len()], rim, nature);
                ink.stroke(&touches, nature, offset);
            }
        }
    }

    /// Lays the lines, notes how, and returns where they meet.
    fn lay_lines(&self, ink: &mut Ink, geometry: &Geometry, map: &Homography, hand: &mut Hand, habits: &mut Habits) -> [f64; 2] {
        let nature = self.line;
        let width = hand.config.line_width.sample(&mut hand.rng);
        habits.line_width = width;
        let radius = width * 0.5;
        let offset = [hand.rng.uniform(0.0, 256.0) as f32, hand.rng.uniform(0.0, 256.0) as f32];
        let meeting = map.apply([0.5, 0.5]);
        let mut axes: Vec<Vec<Touch>> = Vec::new();
        if geometry.framed {
            for k in 0..geometry.outline.len() {
                let (a, b) = (map.apply(geometry.outline[k]), map.apply(geometry.outline[(k + 1) % geometry.outline.len()]));
                let touches = hand.stroke(a, b, radius, nature);
                ink.stroke(&touches, nature, offset);
            }
        }
        for [from, to] in geometry.lines {
            let (a, b) = (map.apply(*from), map.apply(*to));
            let length = ((b[0] - a[0]).powi(2) + (b[1] - a[1]).powi(2)).sqrt().max(1e-9);
            let unit = [(b[0] - a[0]) / length, (b[1] - a[1]) / length];
            let error = hand.end_error * nature.hand;
            let mut off = || (hand.rng.normal() * error).clamp(-0.06, 0.06).min(0.3 * length);
            let (start, end) = (off(), off());
            // Lines end inside the corner, by about their own half width, and a little before or behind it.
            let inset = radius * 0.8;
            let begin = if *from == [0.5, 0.5] { start } else { start + inset };
            let a = [a[0] + unit[0] * begin, a[1] + unit[1] * begin];
            let b = [b[0] - unit[0] * (end + inset), b[1] - unit[1] * (end + inset)];
            let touches = hand.stroke(a, b, radius, nature);
            ink.stroke(&touches, nature, offset);
            let retraced = hand.rng.chance(hand.config.retraced) && nature.hand > 0.0;
            if nature.hand > 0.0 {
                habits.lines.count(retraced);
            }
            if retraced {
                let again = hand.stroke(a, b, radius * 0.9, nature);
                ink.stroke(&again, nature, offset);
            }
            axes.push(touches);
        }
        if self.shape == Shape::TCross { crossing(&axes[0], &axes[1]).unwrap_or(meeting) } else { meeting }
    }
}

impl Hand<'_> {
    /// A stroke from `a` to `b`: correlated wobble that vanishes at its ends, tremor, a nib that thins where the hand is fast, ink that pools
    /// where it stops, and now and then a gap.
    fn stroke(&mut self, a: [f64; 2], b: [f64; 2], radius: f64, nature: &Nature) -> Vec<Touch> {
        let rng = &mut self.rng;
        let d = [b[0] - a[0], b[1] - a[1]];
        let length = (d[0] * d[0] + d[1] * d[1]).sqrt().max(1e-9);
        let normal = [-d[1] / length, d[0] / length];
        let hand = nature.hand * self.wobble * length;
        let waves: [(f64, f64); 4] = std::array::from_fn(|k| (rng.normal() / (k + 1) as f64, rng.uniform(-0.4, 0.4)));
        let tremor = (rng.normal() * 0.08, rng.uniform(9.0, 16.0), rng.uniform(0.0, std::f64::consts::TAU));
        let (thin, pool) = (rng.uniform(0.0, 0.22) * nature.hand, rng.uniform(0.0, 0.3) * nature.hand);
        let uneven = f64::from(nature.uneven);
        let strength = (1.0 + uneven * rng.normal() * 0.5).clamp(0.6, 1.4);
        let gap = (rng.chance(self.config.gaps) && nature.hand > 0.0).then(|| (rng.uniform(0.2, 0.8), rng.uniform(0.01, 0.06)));
        if nature.hand > 0.0 {
            self.strokes.count(gap.is_some());
        }
        // Segments about as long as the nib is wide: shorter ones would not show.
        let steps = ((length / (0.7 * radius + 0.012)).ceil() as usize).clamp(2, 64);
        (0..=steps)
            .map(|k| {
                let t = k as f64 / steps as f64;
                let pi = std::f64::consts::PI;
                let window = libm::sin(pi * t);
                let wave: f64 = waves
                    .iter()
                    .enumerate()
                    .map(|(n, (size, bend))| size * libm::sin(pi * (n + 1) as f64 * (t + bend * t * (1.0 - t))))
                    .sum();
                let shake = tremor.0 * libm::sin(tremor.1 * t * std::f64::consts::TAU + tremor.2) * window.min(1.0);
                let off = hand * (wave + shake);
                let speed = window.max(0.0).sqrt();
                let gap_here = gap.is_some_and(|(at, wide)| (t - at).abs() < wide);
                Touch {
                    at: [(a[0] + d[0] * t + normal[0] * off) as f32, (a[1] + d[1] * t + normal[1] * off) as f32],
                    radius: (radius * (1.0 - thin * speed)) as f32,
                    flow: if gap_here { 0.0 } else { (strength * (1.0 + pool * (0.5 - speed))) as f32 },
                }
            })
            .collect()
    }
}

/// Where a line along `[c, s]` at distance `row` from the origin enters and leaves a convex outline, measured along it.
fn chord(outline: &[[f64; 2]], [c, s]: [f64; 2], row: f64) -> Option<(f64, f64)> {
    let mut hits = Vec::new();
    for k in 0..outline.len() {
        let (p, q) = (outline[k], outline[(k + 1) % outline.len()]);
        let (a, b) = (p[1] * c - p[0] * s - row, q[1] * c - q[0] * s - row);
        if (a <= 0.0) != (b <= 0.0) {
            let t = a / (a - b);
            let at = [p[0] + (q[0] - p[0]) * t, p[1] + (q[1] - p[1]) * t];
            hits.push(at[0] * c + at[1] * s);
        }
    }
    let (lo, hi) = (hits.iter().copied().fold(f64::INFINITY, f64::min), hits.iter().copied().fold(f64::NEG_INFINITY, f64::max));
    (hi > lo).then_some((lo, hi))
}

/// Where the second stroke, extended backwards from its start if need be, meets the first.
fn crossing(first: &[Touch], second: &[Touch]) -> Option<[f64; 2]> {
    let (p, q) = (second.first()?.at.map(f64::from), second.get(2)?.at.map(f64::from));
    let d = [q[0] - p[0], q[1] - p[1]];
    let side = |t: &Touch| (f64::from(t.at[0]) - p[0]) * d[1] - (f64::from(t.at[1]) - p[1]) * d[0];
    let pair = first.windows(2).find(|w| (side(&w[0]) <= 0.0) != (side(&w[1]) <= 0.0))?;
    let (a, b) = (side(&pair[0]), side(&pair[1]));
    let t = a / (a - b);
    Some(std::array::from_fn(|k| f64::from(pair[0].at[k]) + (f64::from(pair[1].at[k]) - f64::from(pair[0].at[k])) * t))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{dist::Dist, media::Medium};

    #[test]
    fn a_ruler_draws_the_ideal() {
        let print = Medium::Print.nature();
        let plan = Plan { shape: Shape::TCross, half: [0.5, 0.5], fill: &print, line: &print, scale: 100.0 };
        let drawing = plan.draw(&HandConfig::default(), Rng::for_item(0, "test/drawing", 0));
        assert_eq!(drawing.corners, [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]);
        assert!(drawing.center.iter().all(|v| v.abs() < 1e-6), "{:?}", drawing.center);
        let area: f32 = drawing.fill.density.iter().sum();
        assert!((area / 10_000.0 - 1.0).abs() < 0.01, "{area}");
    }

    #[test]
    fn lines_meet_where_the_truth_says() {
        // The stem's first touch lies on the diagonal's axis within the configured error; the truth is where they cross.
        let nature = Medium::FeltTip.nature();
        for index in 0..50 {
            let plan = Plan { shape: Shape::TCross, half: [0.5, 0.5], fill: &nature, line: &nature, scale: 60.0 };
            let config = HandConfig { corner_error: Dist::constant(0.04), ..Default::default() };
            let drawing = plan.draw(&config, Rng::for_item(1, "test/drawing", index));
            let middle = tcross_dataset::Quad(drawing.corners).diagonal_crossing().unwrap();
            let off = ((drawing.center[0] - middle[0]).powi(2) + (drawing.center[1] - middle[1]).powi(2)).sqrt();
            assert!(off < 0.1, "{off}");
        }
    }
}
