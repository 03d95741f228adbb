//! What the coarse view shows, cell by cell: how likely each cell is marker, and whether it differs from its neighbourhood as a drawn line
//! does; and how well a quadrilateral with a T cross in it explains both.
use super::{
    colour::Palette,
    crop::{Coarse, Colour},
    plane::{Point, between, sub},
    quad::on_side,
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
/// The first station on a side as a share of it, as far from one corner as the last is from the other.
const FIRST_ON_SIDE: f64 = 0.1325;
/// Odds are compared so far inside and outside of a side, as a share of the way to the centre.
const BESIDE: f64 = 0.15;
/// First and last station on a half diagonal, clear of the other lines and of the outline.
const FIRST_ON_ARM: f64 = 0.2225;
const LAST_ON_ARM: f64 = 0.8175;

/// Stations of [`Maps::deep`] lie so far from a side, as a share of the way to the centre.
const DEEP: f64 = 0.45;

/// The coarse view's maps.
pub struct Maps<'a> {
    view: &'a Coarse,
    palette: Palette,
    /// Logarithm of the odds that a cell is marker, lightly blurred, with a rim of one cell of [`BEYOND`].
    odds: Vec<f32>,
    /// The same as learnt from the box alone.
    first_odds: Vec<f32>,
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

/// The stations in a row from one point to another.
fn row(from: Point, to: Point) -> impl Iterator<Item = [f32; 2]> {
    let ([x, y], [dx, dy]) = (from.map(|v| v as f32), sub(to, from).map(|v| v as f32 / (STATIONS - 1) as f32));
    (0..STATIONS).map(move |i| [x + dx * i as f32, y + dy * i as f32])
}

fn product(a: &[f32; 4], b: &[f32; 4]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Mean over a square of `2 * radius + 1` cells; cells beyond the view are left out. Sums slide along the rows, then down the columns.
fn box_mean(values: &[[f32; 4]], w: usize, h: usize, radius: usize) -> Vec<[f32; 4]> {
    let add = |sum: &mut [f32; 4], v: &[f32; 4]| (0..4).for_each(|c| sum[c] += v[c]);
    let take = |sum: &mut [f32; 4], v: &[f32; 4]| (0..4).for_each(|c| sum[c] -= v[c]);
    // One over how many of `length` places lie within reach of each.
    let scales = |length: usize| -> Vec<f32> {
        (0..length).map(|k| 1.0 / ((k + radius).min(length - 1) - k.saturating_sub(radius) + 1) as f32).collect()
    };
    let mut rows = Vec::with_capacity(w * h);
    let across = scales(w);
    for row in values.chunks_exact(w) {
        let mut sum = [0.0f32; 4];
        row.iter().take(radius).for_each(|v| add(&mut sum, v));
        for (k, scale) in across.iter().enumerate() {
            if let Some(next) = row.get(k + radius) {
                add(&mut sum, next);
            }
            if k > radius {
                take(&mut sum, &row[k - radius - 1]);
            }
            rows.push(sum.map(|v| v * scale));
        }
    }
    let mut out = Vec::with_capacity(w * h);
    let mut sums = vec![[0.0f32; 4]; w];
    let row = |y: usize| &rows[y * w..(y + 1) * w];
    (0..radius.min(h)).for_each(|y| sums.iter_mut().zip(row(y)).for_each(|(s, v)| add(s, v)));
    for (y, scale) in scales(h).into_iter().enumerate() {
        if y + radius < h {
            sums.iter_mut().zip(row(y + radius)).for_each(|(s, v)| add(s, v));
        }
        if y > radius {
            sums.iter_mut().zip(row(y - radius - 1)).for_each(|(s, v)| take(s, v));
        }
        out.extend(sums.iter().map(|s| s.map(|v| v * scale)));
    }
    out
}

impl<'a> Maps<'a> {
    /// Learns from a box in source pixels: its inner diamond is mostly marker, what lies beyond it is not.
    #[must_use]
    pub fn new(view: &'a Coarse, bounds: &PixelBox) -> Self {
        let (w, h) = (view.width, view.height);
        let palette = Palette::new(&view.cells);
        let ([cx, cy], half) = (bounds.center(), [bounds.width() / 2.0, bounds.height() / 2.0]);
        let columns: Vec<f32> = (0..w).map(|x| ((view.middle(x, 0)[0] - cx) / half[0]).abs() as f32).collect();
        let rows: Vec<f32> = (0..h).map(|y| ((view.middle(0, y)[1] - cy) / half[1]).abs() as f32).collect();
        let mut marker: Vec<f32> = Vec::with_capacity(w * h);
        let mut counts = palette.no_counts();
        for (v, colours) in rows.iter().zip(palette.colours.chunks_exact(w)) {
            for (u, colour) in columns.iter().zip(colours) {
                // Any quadrilateral that touches all four sides of its box covers most of the diamond between their middles.
                let m = (1.15 - u - v).clamp(0.0, 0.5);
                marker.push(m);
                let count = &mut counts[*colour as usize];
                count[0] += m;
                count[1] += if u.max(*v) > 1.04 { 1.0 } else { 0.0 };
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
        let mut maps = Self { view, palette, odds: Vec::new(), first_odds: Vec::new(), lines, noise, bounds: view.to_cells(bounds) };
        maps.learn(&counts);
        maps.first_odds.clone_from(&maps.odds);
        maps
    }

    /// Learns anew from a quadrilateral in cells; nothing is learnt from what lies nearer to its outline than `gap` of the way to its centre.
    pub fn relearn(&mut self, corners: &[Point; 4], gap: f32) {
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
        let mut counts = self.palette.no_counts();
        // Every other row tells enough.
        for (y, colours) in self.palette.colours.chunks_exact(self.view.width).enumerate().step_by(2) {
            let row = planes.map(|p| (p[0], p[1] * (y as f32 + 0.5) + p[2]));
            for (x, colour) in colours.iter().enumerate() {
                let px = x as f32 + 0.5;
                let [a, b, c, d] = row.map(|(slope, start)| slope * px + start);
                let depth = a.min(b).min(c.min(d));
                if depth.abs() > gap {
                    counts[*colour as usize][usize::from(depth < 0.0)] += 1.0;
                }
            }
        }
        self.learn(&counts);
    }

    /// Goes back to what was learnt from the box.
    pub fn forget(&mut self) {
        self.odds.clone_from(&self.first_odds);
    }

    /// Odds from the counts `[marker, surroundings]` of every colour.
    fn learn(&mut self, counts: &[[f32; 2]]) {
        let table = self.palette.log_odds(counts);
        let odds: Vec<f32> = self.palette.colours.iter().map(|c| table[*c as usize]).collect();
        self.odds = blur(&odds, self.view.width, self.view.height);
    }

    /// The cell of [`Maps::lines`] at a point, or the nearest. Through `i32`: a conversion to `usize` costs several times as much.
    fn cell(&self, [x, y]: [f32; 2]) -> usize {
        let (w, h) = (self.view.width, self.view.height);
        let place = |v: f32, n: usize| v.clamp(0.0, (n - 1) as f32) as i32 as usize;
        place(y, h) * w + place(x, w)
    }

    fn odds_near(&self, [x, y]: [f32; 2]) -> f32 {
        let (w, h) = (self.view.width, self.view.height);
        let place = |v: f32, n: usize| (v + 1.0).clamp(0.0, (n + 1) as f32) as i32 as usize;
        self.odds[place(y, h) * (w + 2) + place(x, w)]
    }

    /// The odds at a point in cells, bilinear.
    #[must_use]
    pub fn odds_at(&self, [x, y]: [f32; 2]) -> f32 {
        let (w, h) = (self.view.width, self.view.height);
        // Between the middles of cells; the rim is a cell wide.
        let (x, y) = ((x + 0.5).clamp(0.0, w as f32), (y + 0.5).clamp(0.0, h as f32));
        let (i, j) = (x as i32, y as i32);
        let (fx, fy) = (x - i as f32, y - j as f32);
        let at = j as usize * (w + 2) + i as usize;
        let (up, low) = (&self.odds[at..at + 2], &self.odds[at + w + 2..at + w + 4]);
        let (top, bottom) = (up[0] + (up[1] - up[0]) * fx, low[0] + (low[1] - low[0]) * fx);
        top + (bottom - top) * fy
    }

    /// The longest run of cells that look like marker along those borders of the view (left, upper, right, lower) that are named, in cells.
    #[must_use]
    pub fn run_along(&self, borders: [bool; 4]) -> usize {
        let (w, h) = (self.view.width, self.view.height);
        let longest = |cells: &mut dyn Iterator<Item = (usize, usize)>| {
            let (mut run, mut most) = (0, 0);
            for (x, y) in cells {
                run = if self.odds[(y + 1) * (w + 2) + x + 1] > 1.0 { run + 1 } else { 0 };
                most = most.max(run);
            }
            most
        };
        let runs = [
            longest(&mut (0..h).map(|y| (0, y))),
            longest(&mut (0..w).map(|x| (x, 0))),
            longest(&mut (0..h).map(|y| (w - 1, y))),
            longest(&mut (0..w).map(|x| (x, h - 1))),
        ];
        (0..4).filter(|k| borders[*k]).map(|k| runs[k]).max().unwrap_or(0)
    }

    /// How much like marker it looks well inside the side where it does so least, in log odds: what the sides'
    /// odds are to be measured by.
    #[must_use]
    pub fn deep(&self, corners: &[Point; 4]) -> f32 {
        let Some(center) = Quad(*corners).diagonal_crossing() else { return 0.0 };
        let inside = |k: usize| -> f32 {
            let [from, to] = [0.2, 0.8].map(|t| between(on_side(corners, k, t), center, DEEP));
            row(from, to).map(|p| self.odds_near(p)).sum()
        };
        (0..4).map(inside).fold(f32::MAX, f32::min) / STATIONS as f32
    }

    /// How well a convex quadrilateral in cells, clockwise as seen, explains the maps; `None` for one without a middle.
    #[must_use]
    pub fn score(&self, corners: &[Point; 4]) -> Option<Score> {
        let center = Quad(*corners).diagonal_crossing()?;
        let mut score = Score::default();
        for k in 0..4 {
            let [from, to] = [FIRST_ON_SIDE, 1.0 - FIRST_ON_SIDE].map(|t| on_side(corners, k, t));
            let odds = |inwards: f64| -> f32 {
                row(between(from, center, inwards), between(to, center, inwards)).map(|p| self.odds_near(p)).sum()
            };
            score.sides[k] = ((odds(BESIDE) - odds(-BESIDE)) / STATIONS as f32).clamp(-2.0, MOST_SIDE);
        }
        let mut arms = [[0.0f32; 4]; 4];
        for (arm, corner) in arms.iter_mut().zip(corners) {
            for p in row(between(center, *corner, FIRST_ON_ARM), between(center, *corner, LAST_ON_ARM)) {
                let line = &self.lines[self.cell(p)];
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

/// Mean of each cell's 3x3 neighbourhood, weighted 1 2 1 both ways; the view's edge repeats. With a rim of one cell of [`BEYOND`].
fn blur(values: &[f32], w: usize, h: usize) -> Vec<f32> {
    let mut rows = Vec::with_capacity(w * h);
    for row in values.chunks_exact(w) {
        let end = |k: usize| 0.25 * row[k.saturating_sub(1)] + 0.5 * row[k] + 0.25 * row[(k + 1).min(w - 1)];
        rows.push(end(0));
        rows.extend(row.windows(3).map(|v| 0.25 * v[0] + 0.5 * v[1] + 0.25 * v[2]));
        if w > 1 {
            rows.push(end(w - 1));
        }
    }
    let mut out = vec![BEYOND; (w + 2) * (h + 2)];
    for (y, out) in out.chunks_exact_mut(w + 2).skip(1).take(h).enumerate() {
        let row = |y: usize| &rows[y * w..(y + 1) * w];
        let (up, here, down) = (row(y.saturating_sub(1)), row(y), row((y + 1).min(h - 1)));
        for (((out, a), b), c) in out[1..=w].iter_mut().zip(up).zip(here).zip(down) {
            *out = 0.25 * a + 0.5 * b + 0.25 * c;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sliding_sums_equal_looking_at_every_neighbour() {
        let mut rng = tcross_dataset::Rng::for_item(3, "test/box-mean", 0);
        for (w, h, radius) in [(1, 1, 2), (2, 7, 2), (13, 9, 3), (5, 20, 8)] {
            let values: Vec<[f32; 4]> = (0..w * h).map(|_| std::array::from_fn(|_| rng.uniform(0.0, 1.0) as f32)).collect();
            let means = box_mean(&values, w, h, radius);
            for (i, mean) in means.iter().enumerate() {
                let near = |v: usize, n: usize| v.saturating_sub(radius)..(v + radius + 1).min(n);
                let around: Vec<usize> = near(i / w, h).flat_map(|y| near(i % w, w).map(move |x| y * w + x)).collect();
                for c in 0..4 {
                    let want = around.iter().map(|j| values[*j][c]).sum::<f32>() / around.len() as f32;
                    assert!((mean[c] - want).abs() < 1e-4, "{w}x{h} radius {radius}: {} not {want}", mean[c]);
                }
            }
        }
    }

    #[test]
    fn blurring_repeats_the_edge_and_adds_a_rim() {
        for (w, h) in [(1, 1), (1, 3), (4, 2)] {
            let odds = blur(&vec![0.5; w * h], w, h);
            for (i, v) in odds.iter().enumerate() {
                let inside = (1..=w).contains(&(i % (w + 2))) && (1..=h).contains(&(i / (w + 2)));
                assert!((v - if inside { 0.5 } else { BEYOND }).abs() < 1e-6, "{w}x{h} cell {i}: {v}");
            }
        }
    }
}
