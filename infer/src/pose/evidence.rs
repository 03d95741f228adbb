//! What the coarse view shows, cell by cell: how likely each cell is marker, and whether it differs from its neighbourhood as a drawn line
//! does; and how well a quadrilateral with a T cross in it explains both.
use super::{
    colour,
    crop::{Coarse, Colour},
    plane::{Point, along, between, sub},
};
use tcross_dataset::{PixelBox, Quad};

/// Odds of what lies beyond the view, where nothing is seen.
const BEYOND: f32 = -0.7;
/// Lines clearer than this make no quadrilateral better: bold lines must not outweigh sides in the wrong place.
const MOST_CROSS: f32 = 2.0;
/// Fill against surroundings, in log odds, beyond which a side is no better.
const MOST_SIDE: f32 = 4.5;
/// Stations along a side or along a half diagonal.
const STATIONS: usize = 8;

/// The coarse view's maps.
pub struct Maps<'a> {
    view: &'a Coarse,
    bins: Vec<u16>,
    /// Logarithm of the odds that a cell is marker, lightly blurred.
    odds: Vec<f32>,
    /// Colour less the neighbourhood's.
    lines: Vec<[f32; 4]>,
    /// Root mean square of `lines` inside the box.
    noise: f32,
    /// In cells.
    bounds: PixelBox,
}

/// How well a quadrilateral explains the maps.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Score {
    /// Fill against surroundings across each side, in log odds.
    pub sides: [f32; 4],
    /// How far the weakest of the three lines stands above the half diagonal without, in deviations of the neighbourhood.
    pub cross: f32,
    /// The stem's corner.
    pub stem: usize,
    /// How far its extent lies from the box's sides beyond what a detection's box errs, in sides.
    pub beside: f32,
}

impl Score {
    /// One number; more is better.
    #[must_use]
    pub fn total(&self) -> f32 {
        let least = self.sides.iter().copied().fold(f32::MAX, f32::min);
        0.25 * self.sides.iter().sum::<f32>() + 0.5 * least + 2.0 * self.cross.min(MOST_CROSS) - 12.0 * self.beside
    }
}

fn product(a: &[f32; 4], b: &[f32; 4]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Mean over a square of `2 * radius + 1` cells; cells beyond the view are left out.
fn box_mean(values: &[[f32; 4]], w: usize, h: usize, radius: usize) -> Vec<[f32; 4]> {
    let mut rows = vec![[0.0f32; 4]; w * h];
    let mut out = vec![[0.0f32; 4]; w * h];
    let pass = |from: &[[f32; 4]], to: &mut [[f32; 4]], lines: usize, length: usize, line_step: usize, step: usize| {
        for l in 0..lines {
            let at = |k: usize| l * line_step + k * step;
            let mut sum = [0.0f32; 4];
            for k in 0..radius.min(length) {
                (0..4).for_each(|c| sum[c] += from[at(k)][c]);
            }
            for k in 0..length {
                if k + radius < length {
                    (0..4).for_each(|c| sum[c] += from[at(k + radius)][c]);
                }
                if k > radius {
                    (0..4).for_each(|c| sum[c] -= from[at(k - radius - 1)][c]);
                }
                let count = (k + radius).min(length - 1) - k.saturating_sub(radius) + 1;
                let scale = 1.0 / count as f32;
                to[at(k)] = sum.map(|v| v * scale);
            }
        }
    };
    pass(values, &mut rows, h, w, w, 1);
    pass(&rows, &mut out, w, h, 1, w);
    out
}

impl<'a> Maps<'a> {
    /// Learns from a box in source pixels: its inner diamond is mostly marker, what lies beyond it is not.
    #[must_use]
    pub fn new(view: &'a Coarse, bounds: &PixelBox) -> Self {
        let (w, h) = (view.width, view.height);
        let bins: Vec<u16> = view.cells.iter().map(|c| colour::bin(*c)).collect();
        let ([cx, cy], half) = (bounds.center(), [bounds.width() / 2.0, bounds.height() / 2.0]);
        let columns: Vec<f32> = (0..w).map(|x| ((view.middle(x, 0)[0] - cx) / half[0]).abs() as f32).collect();
        let rows: Vec<f32> = (0..h).map(|y| ((view.middle(0, y)[1] - cy) / half[1]).abs() as f32).collect();
        let (mut marker, mut around) = (Vec::with_capacity(w * h), Vec::with_capacity(w * h));
        for v in &rows {
            for u in &columns {
                // Any quadrilateral that touches all four sides of its box covers most of the diamond between their middles.
                marker.push((1.15 - u - v).clamp(0.0, 0.5));
                around.push(if u.max(*v) > 1.04 { 1.0 } else { 0.0 });
            }
        }
        let cells: Vec<[f32; 4]> = view.cells.iter().map(|[r, g, b]: &Colour| [*r, *g, *b, 0.0]).collect();
        let side = (bounds.width() * bounds.height()).sqrt() / view.step;
        let wide = box_mean(&cells, w, h, (0.09 * side).round().max(2.0) as usize);
        let lines: Vec<[f32; 4]> = cells.iter().zip(&wide).map(|(c, m)| std::array::from_fn(|k| c[k] - m[k])).collect();
        let (mut sum, mut count) = (0.0f32, 1e-6f32);
        for (line, m) in lines.iter().zip(&marker) {
            sum += m * product(line, line);
            count += m;
        }
        let noise = (sum / count).sqrt().max(0.004);
        let mut maps = Self { view, bins, odds: Vec::new(), lines, noise, bounds: view.to_cells(bounds) };
        maps.learn(&marker, &around);
        maps
    }

    /// Learns anew from a quadrilateral in cells; nothing is learnt from what lies nearer to its outline than `gap` of the way to its centre.
    pub fn relearn(&mut self, corners: &[Point; 4], gap: f32) {
        let (w, h) = (self.view.width, self.view.height);
        let mut marker = vec![0.0f32; w * h];
        let mut around = vec![0.0f32; w * h];
        let Some(center) = Quad(*corners).diagonal_crossing() else { return };
        // Signed distance from each side as a share of the centre's: 0 on the outline, 1 in the centre, negative outside.
        let mut planes = [[0.0f32; 3]; 4];
        for k in 0..4 {
            let (a, b) = (corners[k], corners[(k + 1) % 4]);
            let normal = [-(b[1] - a[1]), b[0] - a[0]];
            let depth = normal[0] * (center[0] - a[0]) + normal[1] * (center[1] - a[1]);
            let scale = 1.0 / depth;
            planes[k] = [(normal[0] * scale) as f32, (normal[1] * scale) as f32, (-(normal[0] * a[0] + normal[1] * a[1]) * scale) as f32];
        }
        for y in 0..h {
            for x in 0..w {
                let (px, py) = (x as f32 + 0.5, y as f32 + 0.5);
                let depth = planes.iter().map(|p| p[0] * px + p[1] * py + p[2]).fold(f32::MAX, f32::min);
                let i = y * w + x;
                marker[i] = if depth > gap { 1.0 } else { 0.0 };
                around[i] = if depth < -gap { 1.0 } else { 0.0 };
            }
        }
        self.learn(&marker, &around);
    }

    fn learn(&mut self, marker: &[f32], around: &[f32]) {
        let (w, h) = (self.view.width, self.view.height);
        let table = colour::log_odds(&self.bins, marker, around);
        let odds: Vec<f32> = self.bins.iter().map(|b| table[*b as usize]).collect();
        self.odds = blur(&odds, w, h);
    }

    fn cell(&self, [x, y]: Point) -> usize {
        let (w, h) = (self.view.width, self.view.height);
        let column = (x.max(0.0) as usize).min(w - 1);
        let row = (y.max(0.0) as usize).min(h - 1);
        row * w + column
    }

    fn odds_near(&self, p: Point) -> f32 {
        if self.is_beyond(p) { BEYOND } else { self.odds[self.cell(p)] }
    }

    fn is_beyond(&self, [x, y]: Point) -> bool {
        !(x >= 0.0 && y >= 0.0 && x <= self.view.width as f64 && y <= self.view.height as f64)
    }

    /// The odds at a point in cells, bilinear.
    #[must_use]
    pub fn odds_at(&self, [x, y]: Point) -> f32 {
        if self.is_beyond([x, y]) {
            return BEYOND;
        }
        let (w, h) = (self.view.width, self.view.height);
        let (x, y) = ((x - 0.5).clamp(0.0, (w - 1) as f64) as f32, (y - 0.5).clamp(0.0, (h - 1) as f64) as f32);
        let (i, j) = (x as usize, y as usize);
        let (fx, fy) = (x - i as f32, y - j as f32);
        let (right, down) = (usize::from(i + 1 < w), if j + 1 < h { w } else { 0 });
        let at = j * w + i;
        let (a, b, c, d) = (self.odds[at], self.odds[at + right], self.odds[at + down], self.odds[at + right + down]);
        let (top, bottom) = (a + (b - a) * fx, c + (d - c) * fx);
        top + (bottom - top) * fy
    }

    /// The longest run of cells that look like marker along those borders of the view (left, upper, right, lower) that are named, in cells.
    #[must_use]
    pub fn run_along(&self, borders: [bool; 4]) -> usize {
        let (w, h) = (self.view.width, self.view.height);
        let longest = |cells: &mut dyn Iterator<Item = usize>| {
            let (mut run, mut most) = (0, 0);
            for cell in cells {
                run = if self.odds[cell] > 1.0 { run + 1 } else { 0 };
                most = most.max(run);
            }
            most
        };
        let runs = [
            longest(&mut (0..h).map(|y| y * w)),
            longest(&mut (0..w)),
            longest(&mut (0..h).map(|y| y * w + w - 1)),
            longest(&mut ((h - 1) * w..h * w)),
        ];
        (0..4).filter(|k| borders[*k]).map(|k| runs[k]).max().unwrap_or(0)
    }

    /// How well a convex quadrilateral in cells, clockwise as seen, explains the maps; `None` for one without a middle.
    #[must_use]
    pub fn score(&self, corners: &[Point; 4]) -> Option<Score> {
        let center = Quad(*corners).diagonal_crossing()?;
        let mut score = Score::default();
        for k in 0..4 {
            let (mut inside, mut outside) = (0.0, 0.0);
            for i in 0..STATIONS {
                let t = 0.08 + 0.84 * (i as f64 + 0.5) / STATIONS as f64;
                let foot = between(corners[k], corners[(k + 1) % 4], t);
                let inwards = sub(center, foot);
                inside += self.odds_near(along(foot, inwards, 0.15));
                outside += self.odds_near(along(foot, inwards, -0.15));
            }
            score.sides[k] = ((inside - outside) / STATIONS as f32).clamp(-2.0, MOST_SIDE);
        }
        let mut arms = [[0.0f32; 4]; 4];
        for (arm, corner) in arms.iter_mut().zip(corners) {
            for i in 0..STATIONS {
                let line = &self.lines[self.cell(between(center, *corner, 0.18 + 0.68 * (i as f64 + 0.5) / STATIONS as f64))];
                (0..3).for_each(|c| arm[c] += line[c] / STATIONS as f32);
            }
        }
        (score.cross, score.stem) = cross(&arms);
        score.cross /= self.noise;
        let (extent, b) = (Quad(*corners).bounds(), &self.bounds);
        let slack = 0.04 * (b.width() + b.height()) / 2.0;
        let beyond = |a: f64, b: f64| ((a - b).abs() - slack).max(0.0);
        let off =
            beyond(extent.x_min, b.x_min) + beyond(extent.x_max, b.x_max) + beyond(extent.y_min, b.y_min) + beyond(extent.y_max, b.y_max);
        score.beside = (2.0 * off / (b.width() + b.height())) as f32;
        Some(score)
    }
}

/// How clearly three of four half diagonals carry a line of one colour and the fourth does not, and the corner opposite of that one.
fn cross(arms: &[[f32; 4]; 4]) -> (f32, usize) {
    let mut best = (f32::MIN, 0);
    for without in 0..4 {
        let sum: [f32; 4] = std::array::from_fn(|c| (0..4).filter(|k| *k != without).map(|k| arms[k][c]).sum());
        let length = product(&sum, &sum).sqrt().max(1e-6);
        let on = |k: usize| product(&arms[k], &sum) / length;
        let (mut least, mut mean) = (f32::MAX, 0.0);
        for k in (0..4).filter(|k| *k != without) {
            least = least.min(on(k));
            mean += on(k) / 3.0;
        }
        let value = 0.5 * (least + mean) - on(without).max(0.0);
        if value > best.0 {
            best = (value, (without + 2) % 4);
        }
    }
    best
}

/// Mean of each cell's 3x3 neighbourhood, weighted 1 2 1 both ways; the view's edge repeats.
fn blur(values: &[f32], w: usize, h: usize) -> Vec<f32> {
    let mut rows = vec![0.0; w * h];
    for y in 0..h {
        let row = &values[y * w..(y + 1) * w];
        for x in 0..w {
            rows[y * w + x] = 0.25 * row[x.saturating_sub(1)] + 0.5 * row[x] + 0.25 * row[(x + 1).min(w - 1)];
        }
    }
    let mut out = vec![0.0; w * h];
    for y in 0..h {
        let (up, down) = (y.saturating_sub(1) * w, (y + 1).min(h - 1) * w);
        for x in 0..w {
            out[y * w + x] = 0.25 * rows[up + x] + 0.5 * rows[y * w + x] + 0.25 * rows[down + x];
        }
    }
    out
}
