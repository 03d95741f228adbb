//! Fills polygons on a canvas, antialiased, asking a shader for each pixel's colour.
use crate::{canvas::Canvas, color::Linear};
use tcross_dataset::Rng;

/// Rows of samples a pixel; along the row coverage is exact.
const ROWS: usize = 3;

/// Fills a polygon (even-odd) with what `shader` says of each pixel's centre: a colour and its opacity.
pub(crate) fn fill(canvas: &mut Canvas, points: &[[f32; 2]], mut shader: impl FnMut(f32, f32) -> (Linear, f32)) {
    let (width, height) = (canvas.width, canvas.height);
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
        cover.fill(0.0);
        for sample in 0..ROWS {
            let row = y as f32 + (sample as f32 + 0.5) / ROWS as f32;
            crossings.clear();
            for k in 0..points.len() {
                let (a, b) = (points[k], points[(k + 1) % points.len()]);
                if (a[1] <= row) != (b[1] <= row) {
                    crossings.push(a[0] + (row - a[1]) / (b[1] - a[1]) * (b[0] - a[0]));
                }
            }
            crossings.sort_by(f32::total_cmp);
            for pair in crossings.as_chunks::<2>().0 {
                add_span(
                    &mut cover,
                    pair[0].clamp(x_min as f32, x_max as f32) - x_min as f32,
                    pair[1].clamp(x_min as f32, x_max as f32) - x_min as f32,
                );
            }
        }
        for (k, covered) in cover[..x_max - x_min].iter().enumerate() {
            if *covered > 0.0 {
                let x = x_min + k;
                let (color, alpha) = shader(x as f32 + 0.5, y as f32 + 0.5);
                canvas.blend(x, y, color, alpha * covered.min(1.0));
            }
        }
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
    fn what_lies_outside_is_clipped() {
        let mut canvas = Canvas::filled(8, 8, [0.0; 3]);
        fill(&mut canvas, &[[-50.0, -50.0], [80.0, -50.0], [80.0, 80.0], [-50.0, 80.0]], |_, _| ([1.0; 3], 1.0));
        assert!(canvas.planes[0].iter().all(|v| (*v - 1.0).abs() < 1e-5));
        fill(&mut canvas, &[[20.0, 20.0], [30.0, 20.0], [30.0, 30.0]], |_, _| ([9.0; 3], 1.0));
        assert!(canvas.planes[0].iter().all(|v| *v < 2.0));
    }
}
