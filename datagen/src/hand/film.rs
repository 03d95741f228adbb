//! What lies over the background, as light sees it: each pixel lets a part of the background's light through and adds light of its own.
//! Every way of laying colour down, from a highlighter that filters to paint that hides, is such a film, and films stack.
use super::{drawing::Drawing, view::View};
use crate::{color::Linear, media::Nature, surface::Sheet};
use std::ops::Range;

/// Pixels a cell of the grid on which the sheet's coordinates are computed exactly; between its nodes they are interpolated.
const CELL: usize = 4;

/// The densities at which an ink's film is tabulated: steps of 1/32 up to 3.
const STEPS: usize = 96;

/// One colour laid down by one medium.
#[derive(Debug, Clone)]
pub struct Tint([(Linear, Linear); STEPS + 1]);

impl Tint {
    /// Up to one layer, density is the share of the surface that is covered, so that antialiased edges are exact in linear light; beyond one
    /// layer a translucent ink darkens as layers of filter do.
    #[must_use]
    pub fn new(color: Linear, nature: &Nature, opacity: f32) -> Self {
        Self(std::array::from_fn(|k| {
            let density = k as f32 * 3.0 / STEPS as f32;
            let (covered, layers) = (density.min(1.0), density.max(1.0));
            let through: Linear = std::array::from_fn(|c| {
                let filter = libm::powf(color[c].max(0.02), layers * nature.density);
                1.0 - covered + covered * filter * (1.0 - opacity)
            });
            (through, color.map(|v| v * covered * opacity))
        }))
    }

    #[inline]
    fn at(&self, density: f32) -> (Linear, Linear) {
        self.0[((density * (STEPS as f32 / 3.0) + 0.5) as usize).min(STEPS)]
    }
}

/// A film over a rectangle of pixels.
#[derive(Debug, Clone)]
pub struct Film {
    /// Columns of the image.
    pub x: Range<usize>,
    /// Rows of the image.
    pub y: Range<usize>,
    /// What part of the background's light comes through, then what light is added, red green blue each; row-major.
    pub planes: [Vec<f32>; 6],
    /// How much of each pixel is covered by the marker's ink, 0..1, before any blur.
    pub ink: Vec<f32>,
}

/// The light that falls on a sheet.
pub trait Light {
    /// Its strength at a pixel.
    fn level(&self, x: f32, y: f32) -> f32;
    /// Its colour.
    fn tone(&self) -> Linear;
}

/// What a film is made of.
#[derive(Debug, Clone, Copy)]
pub struct Layers<'a> {
    /// The ink.
    pub drawing: &'a Drawing,
    /// The fill's colour.
    pub fill: &'a Tint,
    /// The lines' colour.
    pub line: &'a Tint,
    /// The paper below.
    pub sheet: &'a Sheet,
    /// Half the width and half the height of the marker's rectangle, in sides.
    pub half: [f64; 2],
    /// A bright spot of reflected light: its place on the sheet, its radius in sides, its strength.
    pub glare: Option<([f32; 2], f32, f32)>,
}

impl Film {
    /// Looks at the layers through a view. `pad` is added around what is seen for later blur; `light` falls on the
    /// sheet. `None` where nothing of it is in the image.
    pub fn render(layers: &Layers, view: &View, size: (usize, usize), pad: usize, light: &impl Light) -> Option<Self> {
        let drawn = [layers.half[0] + super::drawing::MARGIN, layers.half[1] + super::drawing::MARGIN];
        let margins = layers.sheet.margins;
        let sheet = margins.map(|m| {
            let half = layers.half.map(|v| v as f32);
            [-half[0] - m[0], -half[1] - m[1], half[0] + m[2], half[1] + m[3]]
        });
        let reach = layers.sheet.cast.map_or(0.0, |c| f64::from(c.reach()));
        let extent = sheet.map_or([-drawn[0], -drawn[1], drawn[0], drawn[1]], |s| s.map(f64::from));
        let extent = [extent[0] - reach, extent[1] - reach, extent[2] + reach, extent[3] + reach];
        let (x, y) = bounds(view, extent, size)?;
        let (width, height) = (x.len(), y.len());
        let mut film = Self::clear(x, y);
        let (columns, rows) = (width.div_ceil(CELL), height.div_ceil(CELL));
        let node = |i: usize, j: usize| view.plane_from_image([(film.x.start + i * CELL) as f64, (film.y.start + j * CELL) as f64]);
        let line = |j: usize| (0..=columns).map(|i| node(i, j).map(|p| p.map(|v| v as f32))).collect::<Vec<_>>();
        let lines: Vec<Vec<Option<[f32; 2]>>> = (0..=rows).map(line).collect();
        let mut seen = [usize::MAX, usize::MAX, 0, 0];
        for j in 0..rows {
            for i in 0..columns {
                let (Some(a), Some(b), Some(c), Some(d)) = (lines[j][i], lines[j][i + 1], lines[j + 1][i + 1], lines[j + 1][i]) else {
                    continue;
                };
                let near = |k: usize, lo: f64, hi: f64| {
                    let (min, max) = (a[k].min(b[k]).min(c[k]).min(d[k]), a[k].max(b[k]).max(c[k]).max(d[k]));
                    f64::from(max) > lo && f64::from(min) < hi
                };
                if near(0, extent[0] - 0.05, extent[2] + 0.05) && near(1, extent[1] - 0.05, extent[3] + 0.05) {
                    let (x, y) = (i * CELL, j * CELL);
                    if film.cell(layers, sheet, (x, y), [a, b, c, d], light) {
                        seen = [seen[0].min(x), seen[1].min(y), seen[2].max(x + CELL), seen[3].max(y + CELL)];
                    }
                }
            }
        }
        // What is blurred and laid down later is as small as can be.
        let grown = |start: usize, lo: usize, hi: usize, size: usize| (start + lo).saturating_sub(pad)..(start + hi + pad).min(size);
        (seen[2] > 0).then(|| film.over(grown(film.x.start, seen[0], seen[2], size.0), grown(film.y.start, seen[1], seen[3], size.1)))
    }

    /// A film that changes nothing.
    fn clear(x: Range<usize>, y: Range<usize>) -> Self {
        let pixels = x.len() * y.len();
        Self { x, y, planes: std::array::from_fn(|k| vec![if k < 3 { 1.0 } else { 0.0 }; pixels]), ink: vec![0.0; pixels] }
    }

    /// The same film over other pixels.
    fn over(&self, x: Range<usize>, y: Range<usize>) -> Self {
        let mut film = Self::clear(x, y);
        let (left, right) = (self.x.start.max(film.x.start), self.x.end.min(film.x.end));
        for y in self.y.start.max(film.y.start)..self.y.end.min(film.y.end) {
            let row = |f: &Self| (y - f.y.start) * f.x.len() + left - f.x.start..(y - f.y.start) * f.x.len() + right - f.x.start;
            let (from, to) = (row(self), row(&film));
            film.ink[to.clone()].copy_from_slice(&self.ink[from.clone()]);
            for (plane, source) in film.planes.iter_mut().zip(&self.planes) {
                plane[to.clone()].copy_from_slice(&source[from.clone()]);
            }
        }
        film
    }

    /// One cell of pixels; true where something of the layers is seen.
    fn cell(
        &mut self,
        layers: &Layers,
        sheet: Option<[f32; 4]>,
        (x0, y0): (usize, usize),
        nodes: [[f32; 2]; 4],
        light: &impl Light,
    ) -> bool {
        let (width, height) = (self.x.len(), self.y.len());
        let [a, b, c, d] = nodes;
        let ink = &layers.drawing.fill;
        let corners = nodes.map(|p| ink.cell(p));
        let lo = std::array::from_fn(|k| corners.iter().map(|p| p[k]).fold(f32::INFINITY, f32::min));
        let hi = std::array::from_fn(|k| corners.iter().map(|p| p[k]).fold(f32::NEG_INFINITY, f32::max));
        let bare = ink.is_bare(lo, hi) && layers.drawing.lines.is_bare(lo, hi);
        if bare && sheet.is_none() {
            return false;
        }
        let mut seen = false;
        let at = |u: f32, v: f32| -> [f32; 2] {
            std::array::from_fn(|k| {
                let (top, bottom) = (a[k] + (b[k] - a[k]) * u, d[k] + (c[k] - d[k]) * u);
                top + (bottom - top) * v
            })
        };
        // The size of a pixel on the sheet, for edges and rules.
        let across = |p: [f32; 2], q: [f32; 2]| ((p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2)).sqrt() / CELL as f32;
        let footprint = ((across(a, b) * across(a, d)).sqrt()).max(1e-5);
        // Samples a pixel, along x and along y, so that none steps over much more than a cell of ink.
        let samples = |step: f32| ((step * ink.scale / 1.4).ceil() as usize).clamp(1, 6);
        let (nx, ny) = (samples(across(a, b).max(across(d, c))), samples(across(a, d).max(across(b, c))));
        // Light changes slowly: over a cell it is a plane.
        let (px, py) = ((self.x.start + x0) as f32 + 0.5, (self.y.start + y0) as f32 + 0.5);
        let (level, tone) = (light.level(px, py), light.tone());
        let slope = [(light.level(px + CELL as f32, py) - level) / CELL as f32, (light.level(px, py + CELL as f32) - level) / CELL as f32];
        let weight = 1.0 / (nx * ny) as f32;
        let one = 1.0 / CELL as f32;
        for y in y0..(y0 + CELL).min(height) {
            for x in x0..(x0 + CELL).min(width) {
                let (u, v) = ((x - x0) as f32 * one, (y - y0) as f32 * one);
                let middle = at(u + one / 2.0, v + one / 2.0);
                let into = |p: [f32; 2]| {
                    sheet.map_or(-1.0, |[left, top, right, bottom]| (p[0] - left).min(right - p[0]).min(p[1] - top).min(bottom - p[1]))
                };
                let inside = into(middle);
                let paper = if layers.sheet.fade > 0.0 {
                    let t = (inside / layers.sheet.fade).clamp(0.0, 1.0);
                    t * t * (3.0 - 2.0 * t)
                } else {
                    (inside / footprint + 0.5).clamp(0.0, 1.0)
                };
                let shadow = layers.sheet.cast.filter(|_| paper < 1.0).map_or(0.0, |cast| {
                    let under = into([middle[0] - cast.shift[0], middle[1] - cast.shift[1]]);
                    cast.depth * (0.5 + under / (2.0 * cast.soft.max(footprint))).clamp(0.0, 1.0)
                });
                let (mut fill, mut line) = (0.0, 0.0);
                if !bare {
                    for j in 0..ny {
                        for i in 0..nx {
                            let p = at(u + one * (i as f32 + 0.5) / nx as f32, v + one * (j as f32 + 0.5) / ny as f32);
                            let [cx, cy] = ink.cell(p);
                            if let Some(spot) = ink.spot(cx, cy) {
                                fill += ink.at(&spot);
                                line += layers.drawing.lines.at(&spot);
                            }
                        }
                    }
                    fill *= weight;
                    line *= weight;
                }
                if paper <= 0.0 && fill <= 0.0 && line <= 0.0 && shadow <= 0.0 {
                    continue;
                }
                seen = true;
                let (fill_through, fill_own) = layers.fill.at(fill);
                let (line_through, line_own) = layers.line.at(line);
                let level = level + slope[0] * (x - x0) as f32 + slope[1] * (y - y0) as f32;
                let lit = [tone[0] * level, tone[1] * level, tone[2] * level];
                let base = if paper > 0.0 { layers.sheet.at(middle[0], middle[1], footprint) } else { [0.0; 3] };
                let shine = layers.glare.map_or(0.0, |(spot, radius, strength)| {
                    let r2 = ((middle[0] - spot[0]).powi(2) + (middle[1] - spot[1]).powi(2)) / (radius * radius);
                    strength * (1.0 - r2).max(0.0).powi(2)
                });
                let k = y * width + x;
                let mut hidden = 0.0;
                for channel in 0..3 {
                    let through = (1.0 - paper) * fill_through[channel] * line_through[channel];
                    let own =
                        (paper * base[channel] * fill_through[channel] + fill_own[channel]) * line_through[channel] + line_own[channel];
                    self.planes[channel][k] = through * (1.0 - shadow);
                    self.planes[3 + channel][k] = own * lit[channel];
                    hidden += (1.0 - through) / 3.0;
                }
                if shine > 0.0 {
                    (3..6).for_each(|channel| self.planes[channel][k] += shine * hidden);
                }
                self.ink[k] = fill.max(line).min(1.0);
            }
        }
        seen
    }
}

/// The pixels over which a rectangle of the sheet reaches.
fn bounds(view: &View, [left, top, right, bottom]: [f64; 4], (width, height): (usize, usize)) -> Option<(Range<usize>, Range<usize>)> {
    let (mut lo, mut hi) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for k in 0..=8 {
        let t = f64::from(k) / 8.0;
        let (x, y) = (left + (right - left) * t, top + (bottom - top) * t);
        for p in [[x, top], [x, bottom], [left, y], [right, y]] {
            match view.image_from_plane(p) {
                Some(q) => (0..2).for_each(|c| (lo[c], hi[c]) = (lo[c].min(q[c]), hi[c].max(q[c]))),
                // A part of the sheet is behind the camera: it may reach anywhere.
                None => (lo, hi) = ([0.0; 2], [width as f64, height as f64]),
            }
        }
    }
    let range = |lo: f64, hi: f64, size: usize| (lo - 1.0).max(0.0) as usize..((hi.max(0.0) + 2.0) as usize).min(size);
    let (x, y) = (range(lo[0], hi[0], width), range(lo[1], hi[1], height));
    (!x.is_empty() && !y.is_empty()).then_some((x, y))
}

/// How strongly a medium hides what is below on a sheet of this brightness: nothing translucent shows on the dark.
#[must_use]
pub fn opacity_on(nature: &Nature, brightness: f32) -> f32 {
    let need = ((0.45 - brightness) / 0.3).clamp(0.0, 1.0) * 0.92;
    nature.opacity.max(need)
}
