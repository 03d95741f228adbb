//! Saturated clutter that is no marker: stickers, stripes, signs, flags and words, in any place and any colours.
use crate::{
    background::embedded::{Material, fill, polygon},
    canvas::Canvas,
    color::{self, Linear},
};
use tcross_dataset::Rng;

/// Puts one somewhere on the picture.
pub fn paint(canvas: &mut Canvas, rng: &mut Rng) {
    let (w, h) = (canvas.width as f32, canvas.height as f32);
    let center = [rng.uniform(0.0, 1.0) as f32 * w, rng.uniform(0.0, 1.0) as f32 * h];
    let r = rng.log_uniform(5.0, f64::from(w) * 0.22) as f32;
    let ry = r * rng.log_uniform(0.3, 1.2) as f32;
    let corners = [3, 4, 4, 4, 4, 8, 20][rng.index(7)];
    let outline = polygon(center, r, ry, corners, rng.uniform(0.0, 0.12), rng);
    let (first, second) = (color::saturated(rng), if rng.chance(0.6) { color::saturated(rng) } else { color::muted(rng) });
    let light = light_of(canvas, center);
    let angle = rng.uniform(0.0, std::f64::consts::TAU);
    let (c, s) = (libm::cos(angle) as f32, libm::sin(angle) as f32);
    let along = move |x: f32, y: f32| [((x - center[0]) * c + (y - center[1]) * s) / r, ((y - center[1]) * c - (x - center[0]) * s) / r];
    let lit = move |color: Linear| std::array::from_fn(|k| color[k] * light[k]);
    match rng.index(6) {
        0 => {
            let material = Material::saturated(rng);
            fill(canvas, &outline, |x, y| (lit(material.at(x, y)), 1.0));
        }
        1 => {
            // Two or more bands.
            let bands = rng.uniform(0.7, 4.0) as f32;
            fill(canvas, &outline, |x, y| (lit(if (along(x, y)[0] * bands).rem_euclid(1.0) < 0.5 { first } else { second }), 1.0));
        }
        2 => {
            // A frame or a ring around another colour.
            fill(canvas, &outline, |_, _| (lit(first), 1.0));
            let shrink = rng.uniform(0.4, 0.85) as f32;
            let inner: Vec<[f32; 2]> =
                outline.iter().map(|p| [center[0] + (p[0] - center[0]) * shrink, center[1] + (p[1] - center[1]) * shrink]).collect();
            fill(canvas, &inner, |_, _| (lit(second), 1.0));
        }
        3 => {
            // One line or a plus through it, but never three arms to three corners.
            fill(canvas, &outline, |_, _| (lit(first), 1.0));
            let (thick, both) = (rng.uniform(0.08, 0.25) as f32, rng.chance(0.5));
            fill(canvas, &outline, |x, y| {
                let [u, v] = along(x, y);
                (lit(second), f32::from(u8::from(u.abs() < thick || (both && v.abs() < thick))))
            });
        }
        4 => words(canvas, center, r, lit(second), [c, s], rng),
        _ => {
            // Another part of the picture itself, its colours made saturated: a poster, a screen, a cushion.
            let from = [rng.uniform(0.0, 1.0) as f32 * (w - 1.0), rng.uniform(0.0, 1.0) as f32 * (h - 1.0)];
            let (more, tint) = (rng.uniform(1.5, 4.0) as f32, rng.uniform(0.0, 0.5) as f32);
            let part = canvas.clone();
            fill(canvas, &outline, |x, y| {
                let at = |k: usize, v: f32, limit: f32| (from[k] + v - center[k]).rem_euclid(2.0 * limit);
                let mirror = |v: f32, limit: f32| if v < limit { v } else { 2.0 * limit - v };
                let (i, j) = (mirror(at(0, x, w - 1.0), w - 1.0), mirror(at(1, y, h - 1.0), h - 1.0));
                let color = part.at(i as usize, j as usize);
                let level = color::luminance(color);
                let vivid = color.map(|v| (level + (v - level) * more).max(0.0));
                (color::mix(vivid, color::scaled(first, level * 2.0), tint), 1.0)
            });
        }
    }
}

/// What light falls on a white thing at a place: the brightness of its surroundings, kept within reason.
fn light_of(canvas: &Canvas, center: [f32; 2]) -> Linear {
    let range = |v: f32, limit: usize| {
        let at = (v.max(0.0) as usize).min(limit - 1);
        at.saturating_sub(24)..(at + 24).min(limit)
    };
    let mean = canvas.mean(range(center[0], canvas.width), range(center[1], canvas.height));
    let level = color::luminance(mean).clamp(0.04, 0.6) * 1.6 + 0.15;
    [level; 3]
}

/// Marks like letters: short strokes in a row.
fn words(canvas: &mut Canvas, center: [f32; 2], size: f32, ink: Linear, [c, s]: [f32; 2], rng: &mut Rng) {
    let letter = size * 0.25;
    let thick = letter * rng.uniform(0.08, 0.2) as f32;
    for k in 0..rng.int(2, 8) {
        let left = (k as f32 - 3.0) * letter * 1.2;
        for _ in 0..rng.int(2, 4) {
            let mut end = || [left + rng.index(3) as f32 * letter * 0.5, (rng.index(3) as f32 - 1.0) * letter];
            let (a, b) = (end(), end());
            let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
            let length = (dx * dx + dy * dy).sqrt().max(1e-3);
            let (nx, ny) = (-dy / length * thick, dx / length * thick);
            let quad = [[a[0] + nx, a[1] + ny], [b[0] + nx, b[1] + ny], [b[0] - nx, b[1] - ny], [a[0] - nx, a[1] - ny]];
            let turned = quad.map(|p| [center[0] + p[0] * c - p[1] * s, center[1] + p[0] * s + p[1] * c]);
            fill(canvas, &turned, |_, _| (ink, 0.95));
        }
    }
}
