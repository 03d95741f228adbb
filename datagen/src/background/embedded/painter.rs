//! Fills polygons, antialiased, asking a shader for each pixel's colour: at once on a canvas, or later in a scene whose things hide one another.
use super::Material;
use crate::{canvas::Canvas, color::Linear};
use tcross_dataset::Rng;
use tcross_kernels::simd::{Portable, widest};

/// Rows of samples a pixel; along the row coverage is exact.
const ROWS: usize = 3;

/// A pixel that lets less than this part of the light of what is behind it through is closed: half a step of 8 bits.
const CLOSED: f32 = 1.0 / 512.0;

/// Fills a polygon (even-odd) with what `shader` says of each pixel's centre: a colour and its opacity.
pub(crate) fn fill(canvas: &mut Canvas, points: &[[f32; 2]], shader: impl Fn(f32, f32) -> (Linear, f32)) {
    let (width, height) = (canvas.width, canvas.height);
    scan(points, (width, height), |y, first, cover| {
        let at = y * width + first..y * width + first + cover.len();
        let [red, green, blue] = canvas.planes.each_mut().map(|plane| &mut plane[at.clone()]);
        for ((((k, covered), r), g), b) in cover.iter().enumerate().zip(red).zip(green).zip(blue) {
            if *covered > 0.0 {
                let (color, alpha) = shader((first + k) as f32 + 0.5, y as f32 + 0.5);
                let alpha = alpha * covered;
                *r += (color[0] - *r) * alpha;
                *g += (color[1] - *g) * alpha;
                *b += (color[2] - *b) * alpha;
            }
        }
    });
}

/// Things that hide one another, painted from the front once all of them are there, so that what is hidden costs nothing.
pub(super) struct Scene {
    /// In pixels.
    pub width: usize,
    /// In pixels.
    pub height: usize,
    layers: Vec<(Vec<[f32; 2]>, Box<dyn Shade>)>,
}

impl Scene {
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, layers: Vec::new() }
    }

    /// Fills a polygon in front of all that is there; otherwise as [`fill`].
    pub fn fill(&mut self, points: &[[f32; 2]], shader: impl Fn(f32, f32) -> (Linear, f32) + 'static) {
        self.layers.push((points.to_vec(), Box::new(shader)));
    }

    /// Fills a polygon with a material: `place` tells for each pixel's centre where on the material it lies and how much light falls there.
    pub fn fill_of(&mut self, points: &[[f32; 2]], material: Material, place: impl Fn(f32, f32) -> ([f32; 2], f32) + 'static) {
        self.layers.push((points.to_vec(), Box::new(Lit { material, place })));
    }

    /// The outline of all rows from `top` to `bottom`.
    pub fn rows(&self, top: f32, bottom: f32) -> [[f32; 2]; 4] {
        let width = self.width as f32;
        [[0.0, top], [width, top], [width, bottom], [0.0, bottom]]
    }

    /// The picture, with one colour behind everything.
    pub fn paint(self, behind: Linear) -> Canvas {
        let (width, height) = (self.width, self.height);
        let mut canvas = Canvas::filled(width, height, [0.0; 3]);
        let mut open = vec![1f32; width * height];
        for (points, shader) in self.layers.iter().rev() {
            scan(points, (width, height), |y, first, cover| {
                let at = y * width + first..y * width + first + cover.len();
                let planes = canvas.planes.each_mut().map(|plane| &mut plane[at.clone()]);
                shader.shade((first, y), cover, &mut open[at.clone()], planes);
            });
        }
        for (plane, color) in canvas.planes.iter_mut().zip(behind) {
            plane.iter_mut().zip(&open).for_each(|(v, open)| *v += color * open);
        }
        canvas
    }
}

/// A shader of a row: one call for many pixels.
trait Shade {
    /// Adds the light of the pixels from `(x, y)` on that are still open, and closes them by their opacity.
    fn shade(&self, at: (usize, usize), cover: &[f32], open: &mut [f32], planes: [&mut [f32]; 3]);
}

impl<F: Fn(f32, f32) -> (Linear, f32)> Shade for F {
    fn shade(&self, (x, y): (usize, usize), cover: &[f32], open: &mut [f32], [red, green, blue]: [&mut [f32]; 3]) {
        for (((((k, covered), open), r), g), b) in cover.iter().enumerate().zip(open).zip(red).zip(green).zip(blue) {
            if *covered > 0.0 && *open > 0.0 {
                let (color, alpha) = self((x + k) as f32 + 0.5, y as f32 + 0.5);
                let share = *open * alpha * covered;
                *r += color[0] * share;
                *g += color[1] * share;
                *b += color[2] * share;
                *open -= share;
                if *open < CLOSED {
                    *open = 0.0;
                }
            }
        }
    }
}

/// A material, the place of each pixel on it, and the light there.
struct Lit<F> {
    material: Material,
    place: F,
}

impl<F: Fn(f32, f32) -> ([f32; 2], f32)> Shade for Lit<F> {
    fn shade(&self, at: (usize, usize), cover: &[f32], open: &mut [f32], planes: [&mut [f32]; 3]) {
        widest(Row { shader: self, at, cover, open, planes });
    }
}

/// What [`Lit`] shades.
struct Row<'a, F> {
    shader: &'a Lit<F>,
    at: (usize, usize),
    cover: &'a [f32],
    open: &'a mut [f32],
    planes: [&'a mut [f32]; 3],
}

/// Pixels whose colours are computed side by side.
const LANES: usize = 16;

impl<F: Fn(f32, f32) -> ([f32; 2], f32)> Portable for Row<'_, F> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { shader: Lit { material, place }, at: (first, y), cover, open, planes: [red, green, blue] } = self;
        let parts = cover.chunks(LANES).zip(open.chunks_mut(LANES));
        let parts = parts.zip(red.chunks_mut(LANES)).zip(green.chunks_mut(LANES)).zip(blue.chunks_mut(LANES));
        for (part, ((((cover, open), red), green), blue)) in parts.enumerate() {
            if !cover.iter().zip(&*open).any(|(covered, open)| *covered > 0.0 && *open > 0.0) {
                continue;
            }
            let (mut u, mut v, mut light) = ([0f32; LANES], [0f32; LANES], [0f32; LANES]);
            for k in 0..LANES {
                ([u[k], v[k]], light[k]) = place((first + part * LANES + k) as f32 + 0.5, y as f32 + 0.5);
            }
            let colors = material.at_each(&u, &v);
            let mut shares = [0f32; LANES];
            for ((share, covered), open) in shares.iter_mut().zip(cover).zip(open) {
                *share = if *covered > 0.0 && *open > 0.0 { *open * covered } else { 0.0 };
                *open -= *share;
                *open = if *open < CLOSED { 0.0 } else { *open };
            }
            for (plane, color) in [red, green, blue].into_iter().zip(&colors) {
                for (((v, color), light), share) in plane.iter_mut().zip(color).zip(&light).zip(&shares) {
                    // Where nothing shows, the place may be none of the material's.
                    *v = if *share > 0.0 { *v + color * light * share } else { *v };
                }
            }
        }
    }
}

/// Walks over the rows of pixels that a polygon (even-odd) covers: `row` is told which row, the first pixel, and what share of each pixel from
/// there on is covered.
pub(crate) fn scan(points: &[[f32; 2]], (width, height): (usize, usize), mut row: impl FnMut(usize, usize, &[f32])) {
    let span = |k: usize, limit: usize| {
        let lo = points.iter().map(|p| p[k]).fold(f32::INFINITY, f32::min).floor().max(0.0);
        let hi = points.iter().map(|p| p[k]).fold(f32::NEG_INFINITY, f32::max).ceil().min(limit as f32);
        (lo as usize, hi.max(0.0) as usize)
    };
    let ((x_min, x_max), (y_min, y_max)) = (span(0, width), span(1, height));
    if x_min >= x_max || y_min >= y_max {
        return;
    }
    let mut cover = vec![0f32; x_max - x_min + 1];
    let mut crossings = Vec::with_capacity(8);
    for y in y_min..y_max {
        let (mut first, mut end) = (cover.len(), 0);
        for sample in 0..ROWS {
            let at = y as f32 + (sample as f32 + 0.5) / ROWS as f32;
            crossings.clear();
            for k in 0..points.len() {
                let (a, b) = (points[k], points[(k + 1) % points.len()]);
                if (a[1] <= at) != (b[1] <= at) {
                    let x = a[0] + (at - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);
                    crossings.push(x.clamp(x_min as f32, x_max as f32) - x_min as f32);
                }
            }
            crossings.sort_by(f32::total_cmp);
            for pair in crossings.as_chunks::<2>().0 {
                add_span(&mut cover, pair[0], pair[1]);
                (first, end) = (first.min(pair[0] as usize), end.max(pair[1] as usize + 1));
            }
        }
        // The last place is beyond the last pixel: a span that ends at the border touches it, and covers nothing of it.
        end = end.min(x_max - x_min);
        if first < end {
            cover[first..end].iter_mut().for_each(|c| *c = c.min(1.0));
            row(y, x_min + first, &cover[first..end]);
        }
        cover[first..].fill(0.0);
    }
}

fn add_span(cover: &mut [f32], from: f32, to: f32) {
    const WEIGHT: f32 = 1.0 / ROWS as f32;
    let (first, last) = (from as usize, to as usize);
    if first == last {
        cover[first] += (to - from) * WEIGHT;
        return;
    }
    cover[first] += (first as f32 + 1.0 - from) * WEIGHT;
    cover[first + 1..last].iter_mut().for_each(|c| *c += WEIGHT);
    cover[last] += (to - last as f32) * WEIGHT;
}

/// A closed outline around a centre: `n` points at radius 1 with a random unevenness, scaled by `rx`, `ry` and turned.
pub(crate) fn polygon(center: [f32; 2], rx: f32, ry: f32, n: usize, uneven: f64, rng: &mut Rng) -> Vec<[f32; 2]> {
    let turn = rng.uniform(0.0, std::f64::consts::TAU);
    let (c, s) = (libm::cos(turn) as f32, libm::sin(turn) as f32);
    (0..n)
        .map(|k| {
            let angle = (k as f64 + rng.uniform(-0.4, 0.4) * uneven) / n as f64 * std::f64::consts::TAU;
            let r = 1.0 + (rng.uniform(-1.0, 1.0) * uneven) as f32;
            let (x, y) = (rx * r * libm::cos(angle) as f32, ry * r * libm::sin(angle) as f32);
            [center[0] + x * c - y * s, center[1] + x * s + y * c]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coverage_adds_up_to_the_area() {
        let mut canvas = Canvas::filled(40, 40, [0.0; 3]);
        let points = [[3.3, 4.2], [30.7, 8.9], [22.5, 33.1]];
        fill(&mut canvas, &points, |_, _| ([1.0; 3], 1.0));
        let sum: f32 = canvas.planes[0].iter().sum();
        let area = tcross_dataset::geom::quad::polygon_area(&points.map(|p| p.map(f64::from))) as f32;
        assert!((sum - area).abs() < 0.005 * area, "{sum} {area}");
    }

    #[test]
    fn a_scene_painted_from_the_front_equals_one_painted_from_behind() {
        let mut rng = Rng::for_item(0, "test/painter", 0);
        let mut canvas = Canvas::filled(50, 40, [0.3, 0.2, 0.1]);
        let mut scene = Scene::new(50, 40);
        for _ in 0..60 {
            let center = [rng.uniform(-5.0, 55.0) as f32, rng.uniform(-5.0, 45.0) as f32];
            let points = polygon(center, rng.uniform(1.0, 20.0) as f32, rng.uniform(1.0, 20.0) as f32, 7, 0.3, &mut rng);
            let (level, alpha) = (rng.unit() as f32, [0.3, 1.0][rng.index(2)]);
            let shader = move |x: f32, y: f32| ([level, x / 50.0, y / 40.0], alpha);
            fill(&mut canvas, &points, shader);
            scene.fill(&points, shader);
        }
        let front = scene.paint([0.3, 0.2, 0.1]);
        for (a, b) in canvas.planes.iter().zip(&front.planes) {
            assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 2.0 * CLOSED));
        }
    }

    /// Patterns, both ways of asking for noise, cut rows, and places beyond the vectors' end.
    #[test]
    fn a_material_is_the_same_side_by_side_and_pixel_by_pixel() {
        let mut rng = Rng::for_item(0, "test/painter", 1);
        let (mut together, mut single) = (Scene::new(75, 40), Scene::new(75, 40));
        for _ in 0..60 {
            let center = [rng.uniform(-5.0, 80.0) as f32, rng.uniform(-5.0, 45.0) as f32];
            let points = polygon(center, rng.uniform(1.0, 20.0) as f32, rng.uniform(1.0, 20.0) as f32, 7, 0.3, &mut rng);
            let (material, slope) = (Material::saturated(&mut rng), rng.unit() as f32);
            let place = move |x: f32, y: f32| ([x * slope - y, y / (x - 30.5)], 0.5 + slope * x / 75.0);
            together.fill_of(&points, material.clone(), place);
            single.fill(&points, move |x, y| {
                let ([u, v], light) = place(x, y);
                (crate::color::scaled(material.at(u, v), light), 1.0)
            });
        }
        let sky = |scene: &mut Scene| scene.fill(&[[3.0, 2.0], [60.0, 5.0], [70.0, 39.0]], |_, _| ([0.2, 0.4, 0.9], 0.4));
        sky(&mut together);
        sky(&mut single);
        // The same bits, also where a division by zero has no place.
        let bits = |canvas: Canvas| canvas.planes.map(|plane| plane.into_iter().map(f32::to_bits).collect::<Vec<u32>>());
        assert!(bits(together.paint([0.3, 0.2, 0.1])) == bits(single.paint([0.3, 0.2, 0.1])));
    }

    #[test]
    fn what_lies_outside_is_clipped() {
        let mut canvas = Canvas::filled(8, 8, [0.0; 3]);
        fill(&mut canvas, &[[-50.0, -50.0], [80.0, -50.0], [80.0, 80.0], [-50.0, 80.0]], |_, _| ([1.0; 3], 1.0));
        assert!(canvas.planes[0].iter().all(|v| (*v - 1.0).abs() < 1e-5));
        fill(&mut canvas, &[[20.0, 20.0], [30.0, 20.0], [30.0, 30.0]], |_, _| ([9.0; 3], 1.0));
        assert!(canvas.planes[0].iter().all(|v| *v < 2.0));
    }
}
