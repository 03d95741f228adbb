//! Ink on a sheet: strokes laid down one after another on a fine grid of densities.
use crate::{
    media::Nature,
    noise::{Spectrum, Tile},
};

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

    /// Lays one stroke over what is there. Within a stroke segments do not darken each other; over earlier strokes the density adds up.
    pub fn stroke(&mut self, touches: &[Touch], nature: &Nature, offset: [f32; 2]) {
        let reach = |t: &Touch| t.radius * self.scale + 1.0;
        let cells: Vec<[f32; 2]> = touches.iter().map(|t| self.cell(t.at)).collect();
        let low = |k: usize| cells.iter().zip(touches).map(|(c, t)| c[k] - reach(t)).fold(f32::INFINITY, f32::min).max(0.0) as usize;
        let high = |k: usize, limit: usize| {
            (cells.iter().zip(touches).map(|(c, t)| c[k] + reach(t)).fold(0.0, f32::max).ceil() as usize + 1).min(limit)
        };
        let (x0, y0, x1, y1) = (low(0), low(1), high(0, self.width), high(1, self.height));
        if x0 >= x1 || y0 >= y1 {
            return;
        }
        let (w, h) = (x1 - x0, y1 - y0);
        let mut layer = vec![0f32; w * h];
        let mut walked = 0.0;
        for k in 1..touches.len() {
            let (a, b) = (cells[k - 1], cells[k]);
            let (ra, rb) = (touches[k - 1].radius * self.scale, touches[k].radius * self.scale);
            let (fa, fb) = (touches[k - 1].flow, touches[k].flow);
            let d = [b[0] - a[0], b[1] - a[1]];
            let length2 = (d[0] * d[0] + d[1] * d[1]).max(1e-9);
            let length = length2.sqrt();
            let r = ra.max(rb) + 1.0;
            let span = |lo: f32, hi: f32, first: usize, n: usize| {
                ((lo - r - first as f32).max(0.0) as usize, (((hi + r - first as f32).ceil().max(0.0)) as usize + 1).min(n))
            };
            let ((i0, i1), (j0, j1)) = (span(a[0].min(b[0]), a[0].max(b[0]), x0, w), span(a[1].min(b[1]), a[1].max(b[1]), y0, h));
            let inverse = 1.0 / length2;
            if i0 < i1 && j0 < j1 {
                self.mark((x0 + i0, x0 + i1), (y0 + j0, y0 + j1));
            }
            for j in j0..j1 {
                let py = (y0 + j) as f32 + 0.5 - a[1];
                for i in i0..i1 {
                    let px = (x0 + i) as f32 + 0.5 - a[0];
                    let t = ((px * d[0] + py * d[1]) * inverse).clamp(0.0, 1.0);
                    let (ex, ey) = (px - t * d[0], py - t * d[1]);
                    let distance2 = ex * ex + ey * ey;
                    let radius = ra + (rb - ra) * t;
                    if distance2 > (radius + 1.0) * (radius + 1.0) {
                        continue;
                    }
                    // How far from the rim, in cells; a soft medium fades over a part of the radius, all others over one cell.
                    let fade = 1.0 + nature.soft * radius;
                    let full = radius - 0.5 * fade;
                    let cover = if full > 0.0 && distance2 < full * full {
                        1.0
                    } else {
                        ((radius - distance2.sqrt()) / fade + 0.5).clamp(0.0, 1.0)
                    };
                    let from_middle2 = (distance2 / (radius * radius).max(0.01)).min(1.0);
                    let flow = (fa + (fb - fa) * t) * (1.0 + nature.rim * (from_middle2 - 0.35));
                    let cell = &mut layer[j * w + i];
                    if cover * flow <= *cell {
                        continue;
                    }
                    let streak = if nature.streaks > 0.0 {
                        // Streaks follow the stroke: fine across it, long along it.
                        let side = (px * d[1] - py * d[0]) / length;
                        let (u, v) = (side / self.scale * 900.0 + offset[0], (walked + t * length) / self.scale * 60.0 + offset[1]);
                        1.0 - nature.streaks * 0.5 * (1.0 + Tile::of(Spectrum::Pink).nearest(u, v)).clamp(0.0, 1.5)
                    } else {
                        1.0
                    };
                    *cell = cell.max(cover * (flow * streak).max(0.0));
                }
            }
            walked += length;
        }
        for j in 0..h {
            let row = &mut self.density[(y0 + j) * self.width + x0..][..w];
            for (ink, laid) in row.iter_mut().zip(&layer[j * w..]) {
                *ink += laid;
            }
        }
    }

    /// Covers a convex polygon, in sides, with one even layer.
    pub fn flood(&mut self, outline: &[[f32; 2]], flow: f32) {
        let cells: Vec<[f32; 2]> = outline.iter().map(|p| self.cell(*p)).collect();
        let mut canvas = crate::canvas::Canvas::filled(self.width, self.height, [0.0; 3]);
        crate::background::embedded::fill(&mut canvas, &cells, |_, _| ([flow; 3], 1.0));
        for (ink, laid) in self.density.iter_mut().zip(&canvas.planes[0]) {
            *ink += laid;
        }
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
        for y in 0..self.height {
            for (x, ink) in self.density[y * self.width..][..self.width].iter_mut().enumerate() {
                if *ink > 0.0 {
                    let (x, y) = (x as f32, y as f32);
                    let bare = (rough.smooth(x * fine + offset[0], y * fine + offset[1]) + 2.2 * nature.grain - 1.6).clamp(0.0, 1.0);
                    let depth = 1.0 + nature.uneven * slow.smooth(x * broad + offset[1], y * broad + offset[0]).clamp(-1.5, 1.5);
                    *ink *= (1.0 - bare * nature.grain.min(0.9) * 1.1).max(0.0) * depth.max(0.2);
                }
            }
        }
    }

    /// Density at a place in cells, bilinear; 0 outside.
    #[must_use]
    #[inline]
    pub fn at(&self, x: f32, y: f32) -> f32 {
        let (x, y) = (x - 0.5, y - 0.5);
        if x < 0.0 || y < 0.0 || x >= (self.width - 1) as f32 || y >= (self.height - 1) as f32 {
            return 0.0;
        }
        let (i, j) = (x as usize, y as usize);
        if !self.inked[j / BLOCK * self.width.div_ceil(BLOCK) + i / BLOCK] {
            return 0.0;
        }
        let (u, v) = (x - i as f32, y - j as f32);
        let row = &self.density[j * self.width + i..];
        let (a, b, c, d) = (row[0], row[1], row[self.width], row[self.width + 1]);
        let (top, bottom) = (a + (b - a) * u, c + (d - c) * u);
        top + (bottom - top) * v
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::media::Medium;

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
                let seen = ink.at(x as f32 + 0.5, y as f32 + 0.5);
                assert!((seen - ink.density[y * ink.width + x]).abs() < 1e-6, "{x} {y}");
                let between = ink.at(x as f32 + 1.0, y as f32 + 1.0);
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
        assert!((ink.at(middle[0], middle[1]) - 2.0).abs() < 1e-5);
    }
}
