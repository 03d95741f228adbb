//! Ink on a sheet: strokes laid down one after another on a fine grid of densities.
use crate::{
    background::embedded::scan,
    media::Nature,
    noise::{Spectrum, Tile},
};
use std::ops::Range;
use tcross_kernels::simd::{Portable, widest};

/// A point of a stroke's axis, in sides of the marker.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Touch {
    /// Place.
    pub at: [f32; 2],
    /// Half the width of the stroke there.
    pub radius: f32,
    /// How much comes out there; 1 is ordinary, 0 a gap.
    pub flow: f32,
}

/// A grid of densities of one ink over a part of the sheet. 0 is bare, 1 one full layer, more where strokes overlap.
#[derive(Debug, Clone)]
pub struct Ink {
    /// Cells a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Cells a side of the marker.
    pub scale: f32,
    /// The sheet's place of the grid's first corner, in sides.
    pub origin: [f32; 2],
    /// Row-major.
    pub density: Vec<f32>,
    /// For each block of cells, whether there is ink in it or beside it: most of a sheet is bare and is asked for often.
    inked: Vec<bool>,
}

/// Side of a block in cells.
const BLOCK: usize = 8;

impl Ink {
    /// A bare grid that reaches over `half` sides to both ways of the middle.
    #[must_use]
    pub fn bare(half: [f32; 2], scale: f32) -> Self {
        let cells = |half: f32| (half * 2.0 * scale).ceil() as usize + 2;
        let (width, height) = (cells(half[0]), cells(half[1]));
        let origin = [-(width as f32) / scale / 2.0, -(height as f32) / scale / 2.0];
        let inked = vec![false; width.div_ceil(BLOCK) * height.div_ceil(BLOCK)];
        Self { width, height, scale, origin, density: vec![0.0; width * height], inked }
    }

    /// The cell coordinates of a place of the sheet.
    #[must_use]
    #[inline]
    pub fn cell(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        [(x - self.origin[0]) * self.scale, (y - self.origin[1]) * self.scale]
    }

    /// Lays one stroke over what is there. Within a stroke segments do not darken each other: each cell belongs to the part of the stroke that
    /// is nearest to it, in radii. Over earlier strokes the density adds up.
    pub fn stroke(&mut self, touches: &[Touch], nature: &Nature, offset: [f32; 2]) {
        let segments = self.segments(touches);
        let reach = |s: &Segment| s.reach(nature.soft);
        let low = |k: usize| segments.iter().map(|s| s.from[k].min(s.to(k)) - reach(s)).fold(f32::INFINITY, f32::min).max(0.0) as usize;
        let high = |k: usize, limit: usize| {
            (segments.iter().map(|s| s.from[k].max(s.to(k)) + reach(s)).fold(0.0, f32::max).ceil() as usize + 1).min(limit)
        };
        let (x0, y0, x1, y1) = (low(0), low(1), high(0, self.width), high(1, self.height));
        if x0 >= x1 || y0 >= y1 {
            return;
        }
        let (w, h) = (x1 - x0, y1 - y0);
        let part = Part { x: x0, y: y0, width: w, height: h };
        for s in segments.iter().filter(|s| s.flow != [0.0, 0.0]) {
            let (columns, rows) = s.span(&part, reach(s));
            if !columns.is_empty() && !rows.is_empty() {
                self.mark((x0 + columns.start, x0 + columns.end), (y0 + rows.start, y0 + rows.end));
            }
        }
        let (nearest, places) = widest(Nearest { segments: &segments, part, soft: nature.soft });
        let streaks = Tile::of(Spectrum::Pink);
        for j in 0..h {
            let row = &mut self.density[(y0 + j) * self.width + x0..][..w];
            for (i, ((ink, near), place)) in row.iter_mut().zip(&nearest[j * w..]).zip(&places[j * w..]).enumerate() {
                if *near == f32::INFINITY {
                    continue;
                }
                let k = (*place as usize).min(segments.len() - 1);
                let (s, t) = (&segments[k], *place - k as f32);
                let radius = s.radius[0] + (s.radius[1] - s.radius[0]) * t;
                // How far from the rim, in cells; a soft medium fades over a part of the radius, all others over one cell.
                let cover = ((radius - near.sqrt() * radius) / (1.0 + nature.soft * radius) + 0.5).clamp(0.0, 1.0);
                if cover <= 0.0 {
                    continue;
                }
                let flow = (s.flow[0] + (s.flow[1] - s.flow[0]) * t) * (1.0 + nature.rim * (near.min(1.0) - 0.35));
                let streak = if nature.streaks > 0.0 {
                    // Streaks follow the stroke: fine across it, long along it.
                    let (px, py) = ((x0 + i) as f32 + 0.5 - s.from[0], (y0 + j) as f32 + 0.5 - s.from[1]);
                    let side = (px * s.d[1] - py * s.d[0]) / s.length;
                    let (u, v) = (side / self.scale * 900.0 + offset[0], (s.walked + t * s.length) / self.scale * 60.0 + offset[1]);
                    1.0 - nature.streaks * 0.5 * (1.0 + streaks.nearest(u, v)).clamp(0.0, 1.5)
                } else {
                    1.0
                };
                *ink += cover * (flow * streak).max(0.0);
            }
        }
    }

    /// The straight pieces of a stroke, in cells: as long as they differ from the touches by less than anyone sees.
    fn segments(&self, touches: &[Touch]) -> Vec<Segment> {
        const PLACE: f32 = 0.04;
        const FLOW: f32 = 0.02;
        let straight = |from: usize, to: usize| {
            let (a, b) = (&touches[from], &touches[to]);
            (from + 1..to).all(|k| {
                let (m, t) = (&touches[k], (k - from) as f32 / (to - from) as f32);
                let off = |a: f32, b: f32, m: f32| (a + (b - a) * t - m).abs();
                let place = off(a.at[0], b.at[0], m.at[0]).max(off(a.at[1], b.at[1], m.at[1])).max(off(a.radius, b.radius, m.radius));
                place * self.scale < PLACE && off(a.flow, b.flow, m.flow) < FLOW
            })
        };
        let (mut segments, mut from, mut walked) = (Vec::new(), 0, 0.0);
        while from + 1 < touches.len() {
            let to = (from + 2..touches.len()).take_while(|to| straight(from, *to)).last().unwrap_or(from + 1);
            let (a, b) = (&touches[from], &touches[to]);
            let (start, end) = (self.cell(a.at), self.cell(b.at));
            let d = [end[0] - start[0], end[1] - start[1]];
            let length = (d[0] * d[0] + d[1] * d[1]).max(1e-9).sqrt();
            let radius = [a, b].map(|t| (t.radius * self.scale).max(0.1));
            segments.push(Segment { from: start, d, length, walked, radius, flow: [a.flow, b.flow] });
            walked += length;
            from = to;
        }
        segments
    }

    /// Covers a polygon, in sides, with one even layer.
    pub fn flood(&mut self, outline: &[[f32; 2]], flow: f32) {
        let cells: Vec<[f32; 2]> = outline.iter().map(|p| self.cell(*p)).collect();
        let width = self.width;
        scan(&cells, (width, self.height), |y, x, cover| {
            self.density[y * width + x..].iter_mut().zip(cover).for_each(|(ink, covered)| *ink += flow * covered);
        });
        let span = |k: usize| {
            let lo = cells.iter().map(|c| c[k]).fold(f32::INFINITY, f32::min).max(0.0);
            (lo as usize, cells.iter().map(|c| c[k]).fold(0.0, f32::max).ceil() as usize)
        };
        self.mark(span(0), span(1));
    }

    /// Notes that cells of a rectangle (ends out) may hold ink now.
    fn mark(&mut self, (x0, x1): (usize, usize), (y0, y1): (usize, usize)) {
        let columns = self.width.div_ceil(BLOCK);
        let blocks = |from: usize, to: usize, cells: usize| from.saturating_sub(1) / BLOCK..(to.min(cells - 1) / BLOCK + 1);
        for j in blocks(y0, y1, self.height) {
            self.inked[j * columns..][blocks(x0, x1, self.width)].fill(true);
        }
    }

    /// Leaves the surface's grain bare and makes the colour uneven, as the medium does.
    pub fn weather(&mut self, nature: &Nature, offset: [f32; 2]) {
        if nature.grain <= 0.0 && nature.uneven <= 0.0 {
            return;
        }
        let (rough, slow) = (Tile::of(Spectrum::Rough), Tile::of(Spectrum::Pink));
        let fine = 1.0 / (nature.grain_size * self.scale) * 3.0;
        let broad = 40.0 / self.scale;
        let kept = nature.grain.min(0.9) * 1.1;
        for (y, row) in self.density.chunks_exact_mut(self.width).enumerate() {
            if row.iter().all(|ink| *ink <= 0.0) {
                continue;
            }
            let (rough, slow) = (rough.row(y as f32 * fine + offset[1]), slow.row(y as f32 * broad + offset[0]));
            for (x, ink) in row.iter_mut().enumerate().filter(|(_, ink)| **ink > 0.0) {
                let bare = (rough.smooth(x as f32 * fine + offset[0]) + 2.2 * nature.grain - 1.6).clamp(0.0, 1.0);
                let depth = 1.0 + nature.uneven * slow.smooth(x as f32 * broad + offset[1]).clamp(-1.5, 1.5);
                *ink *= (1.0 - bare * kept).max(0.0) * depth.max(0.2);
            }
        }
    }

    /// Whether there is no ink between two places in cells.
    #[must_use]
    pub fn is_bare(&self, lo: [f32; 2], hi: [f32; 2]) -> bool {
        let columns = self.width.div_ceil(BLOCK);
        let blocks = |k: usize, cells: usize| {
            let block = |v: f32| (v.max(0.0) as usize).min(cells - 1) / BLOCK;
            block(lo[k] - 0.5)..=block(hi[k] - 0.5)
        };
        blocks(1, self.height).all(|j| self.inked[j * columns..][blocks(0, self.width)].iter().all(|inked| !inked))
    }

    /// Where a place in cells is on this grid and all of its size; `None` outside.
    #[must_use]
    #[inline]
    pub fn spot(&self, x: f32, y: f32) -> Option<Spot> {
        let (x, y) = (x - 0.5, y - 0.5);
        if x < 0.0 || y < 0.0 || x >= (self.width - 1) as f32 || y >= (self.height - 1) as f32 {
            return None;
        }
        let (i, j) = (x as usize, y as usize);
        let block = j / BLOCK * self.width.div_ceil(BLOCK) + i / BLOCK;
        Some(Spot { cell: j * self.width + i, block, share: [x - i as f32, y - j as f32] })
    }

    /// Density at a spot, bilinear.
    #[must_use]
    #[inline]
    pub fn at(&self, spot: &Spot) -> f32 {
        if !self.inked[spot.block] {
            return 0.0;
        }
        let (row, [u, v]) = (&self.density[spot.cell..], spot.share);
        let (a, b, c, d) = (row[0], row[1], row[self.width], row[self.width + 1]);
        let (top, bottom) = (a + (b - a) * u, c + (d - c) * u);
        top + (bottom - top) * v
    }
}

/// A place on a grid of cells.
#[derive(Debug, Clone, Copy)]
pub struct Spot {
    cell: usize,
    block: usize,
    share: [f32; 2],
}

/// A straight piece of a stroke, in cells: its start, the way to its end, what was drawn of the stroke before it, radius and flow at both ends.
struct Segment {
    from: [f32; 2],
    d: [f32; 2],
    length: f32,
    walked: f32,
    radius: [f32; 2],
    flow: [f32; 2],
}

impl Segment {
    #[inline(always)]
    fn to(&self, k: usize) -> f32 {
        self.from[k] + self.d[k]
    }

    /// How far from its axis it may leave ink.
    #[inline(always)]
    fn reach(&self, soft: f32) -> f32 {
        self.radius[0].max(self.radius[1]) * (1.0 + 0.5 * soft) + 1.0
    }

    /// Columns and rows of a part of the grid that it may touch; an end may lie before its start.
    #[inline(always)]
    fn span(&self, part: &Part, reach: f32) -> (Range<usize>, Range<usize>) {
        let span = |axis: usize, first: usize, n: usize| {
            let (a, b) = (self.from[axis], self.to(axis));
            let (lo, hi) = (a.min(b) - reach - first as f32, a.max(b) + reach - first as f32);
            lo.max(0.0) as usize..(hi.max(0.0).ceil() as usize + 1).min(n)
        };
        (span(0, part.x, part.width), span(1, part.y, part.height))
    }
}

/// A rectangle of a grid's cells.
#[derive(Clone, Copy)]
struct Part {
    x: usize,
    y: usize,
    width: usize,
    height: usize,
}

/// For each cell of a part the segment nearest to it: the squared distance in radii (infinite where none reaches it), and where on the stroke,
/// as the segment's number and how far along it.
struct Nearest<'a> {
    segments: &'a [Segment],
    part: Part,
    soft: f32,
}

impl Portable for Nearest<'_> {
    type Output = (Vec<f32>, Vec<f32>);

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Part { x: x0, y: y0, width: w, height: h } = self.part;
        let (mut nearest, mut places) = (vec![f32::INFINITY; w * h], vec![0f32; w * h]);
        for (k, s) in self.segments.iter().enumerate().filter(|(_, s)| s.flow != [0.0, 0.0]) {
            let (d, r) = (s.d, s.reach(self.soft));
            let (columns, rows) = s.span(&self.part, r);
            if columns.is_empty() {
                continue;
            }
            let inverse = 1.0 / (s.length * s.length);
            let grows = s.radius[1] - s.radius[0];
            for j in rows {
                let py = (y0 + j) as f32 + 0.5 - s.from[1];
                // No cell farther from the segment's line than its reach belongs to it.
                let (mut left, mut right) = (columns.start, columns.end);
                if d[1].abs() > 1e-3 {
                    let (middle, half) = (py * d[0] / d[1] + s.from[0] - x0 as f32, r * s.length / d[1].abs());
                    left = left.max((middle - half - 1.0).max(0.0) as usize);
                    right = right.min((middle + half + 1.0).max(0.0) as usize);
                }
                let row = j * w + left.min(right)..j * w + right;
                let first = (x0 + left) as f32 + 0.5 - s.from[0];
                for (i, (near, place)) in nearest[row.clone()].iter_mut().zip(&mut places[row]).enumerate() {
                    let px = first + i as f32;
                    let t = ((px * d[0] + py * d[1]) * inverse).clamp(0.0, 1.0);
                    let (ex, ey) = (px - t * d[0], py - t * d[1]);
                    let radius = s.radius[0] + grows * t;
                    let distance2 = (ex * ex + ey * ey) / (radius * radius);
                    *place = if distance2 < *near { k as f32 + t } else { *place };
                    *near = near.min(distance2);
                }
            }
        }
        (nearest, places)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::media::Medium;

    fn at(ink: &Ink, x: f32, y: f32) -> f32 {
        ink.spot(x, y).map_or(0.0, |spot| ink.at(&spot))
    }

    #[test]
    fn a_stroke_covers_its_area_and_its_middle_is_its_axis() {
        let mut ink = Ink::bare([0.5, 0.5], 200.0);
        let touch = |x: f32, y: f32| Touch { at: [x, y], radius: 0.05, flow: 1.0 };
        let plain = crate::media::Nature { streaks: 0.0, rim: 0.0, soft: 0.0, ..Medium::Print.nature() };
        ink.stroke(&[touch(-0.3, 0.013), touch(0.0, 0.013), touch(0.3, 0.013)], &plain, [0.0; 2]);
        let sum: f32 = ink.density.iter().sum();
        let want = (0.6 * 0.1 + std::f32::consts::PI * 0.05 * 0.05) * 200.0 * 200.0;
        assert!((sum / want - 1.0).abs() < 0.01, "{sum} {want}");
        let mean_y: f32 = ink.density.iter().enumerate().map(|(k, d)| ((k / ink.width) as f32 + 0.5) * d).sum::<f32>() / sum;
        assert!((mean_y / 200.0 + ink.origin[1] - 0.013).abs() < 1e-4);
    }

    #[test]
    fn every_inked_cell_is_seen() {
        let mut ink = Ink::bare([0.5, 0.4], 77.0);
        let touch = |x: f32, y: f32| Touch { at: [x, y], radius: 0.03, flow: 1.0 };
        ink.stroke(&[touch(-0.45, -0.3), touch(0.1, 0.05), touch(0.48, 0.38)], &Medium::FeltTip.nature(), [3.0, 5.0]);
        ink.flood(&[[-0.3, 0.1], [-0.1, 0.1], [-0.2, 0.3]], 1.0);
        for y in 1..ink.height - 1 {
            for x in 1..ink.width - 1 {
                let seen = at(&ink, x as f32 + 0.5, y as f32 + 0.5);
                assert!((seen - ink.density[y * ink.width + x]).abs() < 1e-6, "{x} {y}");
                let between = at(&ink, x as f32 + 1.0, y as f32 + 1.0);
                let four = [0, 1, ink.width, ink.width + 1].map(|k| ink.density[y * ink.width + x + k]).iter().sum::<f32>() / 4.0;
                assert!((between - four).abs() < 1e-5, "{x} {y}");
            }
        }
    }

    #[test]
    fn a_second_stroke_darkens_the_first() {
        let mut ink = Ink::bare([0.5, 0.5], 100.0);
        let line = [Touch { at: [-0.2, 0.0], radius: 0.1, flow: 1.0 }, Touch { at: [0.2, 0.0], radius: 0.1, flow: 1.0 }];
        let plain = crate::media::Nature { streaks: 0.0, rim: 0.0, soft: 0.0, ..Medium::Print.nature() };
        ink.stroke(&line, &plain, [0.0; 2]);
        ink.stroke(&line, &plain, [0.0; 2]);
        let middle = ink.cell([0.0, 0.0]);
        assert!((at(&ink, middle[0], middle[1]) - 2.0).abs() < 1e-5);
    }
}
