//! Which cells of the coarse view belong to the marker: a colour model learnt from the box's middle against its
//! surroundings, so that any fill works (red as well as green, pale as well as saturated, lit or in shadow).
use super::crop::{Coarse, Colour};
use tcross_dataset::PixelBox;

/// Bins along the two colour differences and along brightness.
const CHROMA: usize = 24;
const LIGHT: usize = 8;
const BINS: usize = CHROMA * CHROMA * LIGHT;

/// A yes or no for every cell.
pub struct Mask {
    /// Cells a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row.
    pub cells: Vec<bool>,
}

impl Mask {
    /// Number of marked cells.
    #[must_use]
    pub fn count(&self) -> usize {
        self.cells.iter().filter(|c| **c).count()
    }

    /// Marked cells with an unmarked neighbour (or the view's edge) beside them.
    #[must_use]
    pub fn boundary(&self) -> Vec<(usize, usize)> {
        let (w, h) = (self.width, self.height);
        let mut out = Vec::new();
        for y in 0..h {
            for x in 0..w {
                let i = y * w + x;
                let inside = || self.cells[i - 1] && self.cells[i + 1] && self.cells[i - w] && self.cells[i + w];
                if self.cells[i] && (x == 0 || y == 0 || x + 1 == w || y + 1 == h || !inside()) {
                    out.push((x, y));
                }
            }
        }
        out
    }
}

/// The bin of a colour. Differences are stretched near grey, where a small step decides between a pale fill and paper.
fn bin([r, g, b]: Colour) -> u16 {
    let stretch = |d: f32| d.abs().sqrt().copysign(d);
    let place = |v: f32, n: usize| ((v * n as f32) as usize).min(n - 1);
    let red_green = place(0.5 + 0.5 * stretch(r - g), CHROMA);
    let yellow_blue = place(0.5 + 0.5 * stretch((r + g) / 2.0 - b), CHROMA);
    ((place((r + g + b) / 3.0, LIGHT) * CHROMA + red_green) * CHROMA + yellow_blue) as u16
}

/// Spreads every count over its neighbours (1 2 1) along all three axes.
fn smooth(counts: &mut [f32]) {
    for stride in [1, CHROMA, CHROMA * CHROMA] {
        let n = if stride == CHROMA * CHROMA { LIGHT } else { CHROMA };
        for start in 0..BINS {
            if (start / stride) % n != 0 {
                continue;
            }
            let mut before = counts[start];
            for k in 0..n {
                let i = start + k * stride;
                let here = counts[i];
                let after = if k + 1 < n { counts[i + stride] } else { here };
                counts[i] = 0.25 * before + 0.5 * here + 0.25 * after;
                before = here;
            }
        }
    }
}

/// How strongly each cell is taken for marker and for surroundings when the colours are learnt.
struct Roles {
    marker: Vec<f32>,
    around: Vec<f32>,
}

/// Posterior that a cell of each bin's colour is marker, both roles taken as equally likely.
fn learn(bins: &[u16], roles: &Roles) -> Vec<f32> {
    let histogram = |weights: &[f32]| {
        let mut counts = vec![0.0f32; BINS];
        for (bin, weight) in bins.iter().zip(weights) {
            counts[*bin as usize] += weight;
        }
        smooth(&mut counts);
        let total: f32 = weights.iter().sum::<f32>().max(1e-6);
        counts.iter_mut().for_each(|c| *c /= total);
        counts
    };
    let (marker, around) = (histogram(&roles.marker), histogram(&roles.around));
    // A colour seen nowhere says nothing.
    const UNSEEN: f32 = 2e-4;
    marker.iter().zip(&around).map(|(m, a)| (m + UNSEEN / 2.0) / (m + a + UNSEEN)).collect()
}

/// Cells are marker where posterior, nearness to the box and likeness to the fill multiply to more than this.
const LIKELY: f32 = 0.35;

/// The fill: mean colour around the bin that marker cells fill most and surroundings least.
fn commonest(view: &Coarse, bins: &[u16], table: &[f32], marker: &[f32]) -> Colour {
    let mut counts = vec![0.0f32; BINS];
    for (bin, weight) in bins.iter().zip(marker) {
        counts[*bin as usize] += weight * table[*bin as usize];
    }
    smooth(&mut counts);
    let peak = (0..BINS).max_by(|a, b| counts[*a].total_cmp(&counts[*b])).unwrap_or(0);
    // Mean over the bins beside the peak.
    let at = |bin: usize| [bin % CHROMA, bin / CHROMA % CHROMA, bin / (CHROMA * CHROMA)];
    let middle = at(peak);
    let (mut sum, mut total) = ([0.0f32; 3], 1e-6f32);
    for ((bin, weight), cell) in bins.iter().zip(marker).zip(&view.cells) {
        if *weight > 0.0 && at(*bin as usize).iter().zip(middle).all(|(a, b)| a.abs_diff(b) <= 1) {
            total += weight;
            (0..3).for_each(|k| sum[k] += weight * cell[k]);
        }
    }
    sum.map(|v| v / total)
}

/// How well a colour passes for the fill in another light: 1 for the same, falling with the angle between the two colours
/// and, more slowly, with the ratio of their brightness.
fn likeness(colour: Colour, fill: Colour) -> f32 {
    let product = |a: Colour, b: Colour| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let (a, b) = (product(colour, colour).sqrt().max(0.02), product(fill, fill).sqrt().max(0.02));
    let turn = (2.0 * (1.0 - (product(colour, fill) / (a * b)).min(1.0))).sqrt();
    // Noise turns dark colours further.
    let reach = 0.11 + 0.02 / a.min(b);
    let light = (a / b).ln();
    1.0 / (1.0 + (turn / reach).powi(4) + (light / 0.42).powi(4))
}

/// Sliding maximum (or minimum) over `2 * radius + 1` cells along one axis, cells outside counting as unmarked.
fn slide(cells: &mut [bool], lines: usize, length: usize, line_step: usize, step: usize, radius: usize, grow: bool) {
    let mut line = vec![false; length];
    for l in 0..lines {
        for (k, v) in line.iter_mut().enumerate() {
            *v = cells[l * line_step + k * step];
        }
        // Distance since the last cell that decides (marked when growing, unmarked when shrinking), forwards then backwards.
        for reverse in [false, true] {
            let mut since = if grow { radius + 1 } else { 0 };
            for k in 0..length {
                let k = if reverse { length - 1 - k } else { k };
                since = if line[k] == grow { 0 } else { since + 1 };
                if since <= radius {
                    cells[l * line_step + k * step] = grow;
                }
                if !grow && !reverse && k < radius {
                    cells[l * line_step + k * step] = false;
                }
                if !grow && reverse && k + radius >= length {
                    cells[l * line_step + k * step] = false;
                }
            }
        }
    }
}

/// Grows (dilates) or shrinks (erodes) a mask by a square of `2 * radius + 1` cells.
pub(super) fn morph(mask: &mut Mask, radius: usize, grow: bool) {
    let (w, h) = (mask.width, mask.height);
    slide(&mut mask.cells, h, w, w, 1, radius, grow);
    slide(&mut mask.cells, w, h, 1, w, radius, grow);
}

/// Closes gaps up to `2 * radius` cells (the arms, hatching) without moving the outline; cells beyond the view do not eat
/// into the marker.
fn close(mask: &mut Mask, radius: usize) {
    let (w, h) = (mask.width, mask.height);
    let mut wide = Mask { width: w + 2 * radius, height: h + 2 * radius, cells: vec![false; (w + 2 * radius) * (h + 2 * radius)] };
    for y in 0..h {
        let at = (y + radius) * wide.width + radius;
        wide.cells[at..at + w].copy_from_slice(&mask.cells[y * w..(y + 1) * w]);
    }
    morph(&mut wide, radius, true);
    morph(&mut wide, radius, false);
    for y in 0..h {
        let at = (y + radius) * wide.width + radius;
        mask.cells[y * w..(y + 1) * w].copy_from_slice(&wide.cells[at..at + w]);
    }
}

/// Keeps the connected part that weighs most.
fn keep_heaviest(mask: &mut Mask, weights: &[f32]) {
    let (w, h) = (mask.width, mask.height);
    let mut label = vec![0u32; w * h];
    let (mut best, mut best_weight, mut next) = (0u32, 0.0f32, 0u32);
    let mut stack = Vec::new();
    for seed in 0..w * h {
        if !mask.cells[seed] || label[seed] != 0 {
            continue;
        }
        next += 1;
        label[seed] = next;
        stack.push(seed);
        let mut weight = 0.0;
        while let Some(i) = stack.pop() {
            weight += weights[i];
            let (x, y) = (i % w, i / w);
            let mut visit = |j: usize| {
                if mask.cells[j] && label[j] == 0 {
                    label[j] = next;
                    stack.push(j);
                }
            };
            if x > 0 {
                visit(i - 1);
            }
            if x + 1 < w {
                visit(i + 1);
            }
            if y > 0 {
                visit(i - w);
            }
            if y + 1 < h {
                visit(i + w);
            }
        }
        if weight > best_weight {
            (best, best_weight) = (next, weight);
        }
    }
    for (cell, l) in mask.cells.iter_mut().zip(&label) {
        *cell = best != 0 && *l == best;
    }
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

/// The marker's cells: fill and lines, gaps closed, one connected part. `bounds` is the detection's box in source pixels.
#[must_use]
pub fn segment(view: &Coarse, bounds: &PixelBox) -> Mask {
    let (w, h) = (view.width, view.height);
    let bins: Vec<u16> = view.cells.iter().map(|c| bin(*c)).collect();
    let ([cx, cy], half) = (bounds.center(), [bounds.width() / 2.0, bounds.height() / 2.0]);
    // Position in the box: 0 in the middle, 1 on the sides.
    let place = |i: usize| {
        let [x, y] = view.middle(i % w, i / w);
        [((x - cx) / half[0]).abs() as f32, ((y - cy) / half[1]).abs() as f32]
    };
    let places: Vec<[f32; 2]> = (0..w * h).map(place).collect();
    // Any quadrilateral that touches all four sides of its box covers most of the diamond between their middles.
    let diamond: Vec<f32> = places.iter().map(|[u, v]| (1.15 - u - v).clamp(0.0, 0.5) * 2.0).collect();
    let outside: Vec<f32> = places.iter().map(|[u, v]| if u.max(*v) > 1.04 { 1.0 } else { 0.0 }).collect();
    // A detection's box is nearly right: what lies beyond it needs a clearer colour.
    let belief: Vec<f32> = places.iter().map(|[u, v]| (1.0 - 1.6 * (u.max(*v) - 1.08).max(0.0)).max(0.3)).collect();
    let gap = ((w.min(h) as f32) * 0.045).round().max(1.0) as usize;
    let mut roles = Roles { marker: diamond.clone(), around: outside.clone() };
    let mut mask = Mask { width: w, height: h, cells: vec![false; w * h] };
    for round in 0..2 {
        let table = learn(&bins, &roles);
        let fill = commonest(view, &bins, &table, &roles.marker);
        let odds: Vec<f32> = (0..w * h).map(|i| table[bins[i] as usize] * belief[i] * likeness(view.cells[i], fill)).collect();
        mask.cells = blur(&odds, w, h).into_iter().map(|v| v > LIKELY).collect();
        close(&mut mask, gap);
        morph(&mut mask, 1, false);
        keep_heaviest(&mut mask, &diamond);
        morph(&mut mask, 1, true);
        if round == 0 {
            for i in 0..w * h {
                roles.marker[i] = if mask.cells[i] { 0.3 + diamond[i] } else { 0.0 };
                roles.around[i] = if mask.cells[i] { 0.0 } else { 0.5 + 0.5 * outside[i] };
            }
        }
    }
    mask
}

#[cfg(test)]
mod tests {
    use super::*;

    fn naive_morph(mask: &Mask, radius: i64, grow: bool) -> Vec<bool> {
        let at = |x: i64, y: i64| {
            x >= 0 && y >= 0 && x < mask.width as i64 && y < mask.height as i64 && mask.cells[y as usize * mask.width + x as usize]
        };
        let mut out = Vec::new();
        for y in 0..mask.height as i64 {
            for x in 0..mask.width as i64 {
                let mut near = (-radius..=radius).flat_map(|dy| (-radius..=radius).map(move |dx| (dx, dy)));
                out.push(if grow { near.any(|(dx, dy)| at(x + dx, y + dy)) } else { near.all(|(dx, dy)| at(x + dx, y + dy)) });
            }
        }
        out
    }

    #[test]
    fn growing_and_shrinking_equal_looking_at_every_neighbour() {
        let mut rng = tcross_dataset::Rng::for_item(3, "test/morph", 0);
        for (w, h) in [(1, 1), (2, 7), (13, 9), (20, 20)] {
            for radius in 0..4 {
                for grow in [false, true] {
                    let p = if grow { 0.1 } else { 0.9 };
                    let mut mask = Mask { width: w, height: h, cells: (0..w * h).map(|_| rng.chance(p)).collect() };
                    let naive = naive_morph(&mask, radius as i64, grow);
                    morph(&mut mask, radius, grow);
                    assert_eq!(mask.cells, naive, "{w}x{h} radius {radius} grow {grow}");
                }
            }
        }
    }

    #[test]
    fn smoothing_keeps_the_total() {
        let mut counts = vec![0.0; BINS];
        counts[CHROMA * CHROMA * 3 + CHROMA * 5 + 7] = 64.0;
        smooth(&mut counts);
        assert!((counts.iter().sum::<f32>() - 64.0).abs() < 1e-3);
        assert!((counts[CHROMA * CHROMA * 3 + CHROMA * 5 + 7] - 8.0).abs() < 1e-4);
    }

    #[test]
    fn the_heaviest_part_stays() {
        let mut mask = Mask { width: 5, height: 1, cells: vec![true, true, false, true, false] };
        keep_heaviest(&mut mask, &[0.1, 0.1, 0.0, 3.0, 0.0]);
        assert_eq!(mask.cells, [false, false, false, true, false]);
    }
}
