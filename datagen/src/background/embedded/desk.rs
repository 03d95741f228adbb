//! A table from above: wood or cloth, papers with writing, books, pens, cups, saturated things.
use super::{
    Material, Scene,
    leaves::{cover, shadow},
    polygon,
};
use crate::color;
use tcross_dataset::Rng;

pub(super) fn paint(scene: &mut Scene, rng: &mut Rng) {
    let table = Material::muted(rng);
    cover(scene, table);
    for _ in 0..rng.int(3, 14) {
        match rng.index(5) {
            0 | 1 => paper(scene, rng),
            2 => book(scene, rng),
            3 => pen(scene, rng),
            _ => round(scene, rng),
        }
    }
}

/// A rectangle somewhere, turned: its corners, its centre, and its half sides.
fn rectangle(scene: &Scene, short: f64, long: f64, rng: &mut Rng) -> ([[f32; 2]; 4], [f32; 2], [f32; 2], [f32; 2]) {
    let (w, h) = (scene.width as f32, scene.height as f32);
    let center = [rng.uniform(-0.05, 1.05) as f32 * w, rng.uniform(-0.05, 1.05) as f32 * h];
    let (a, b) = (long as f32 * w, short as f32 * w);
    let turn = rng.uniform(0.0, std::f64::consts::TAU);
    let (c, s) = (libm::cos(turn) as f32, libm::sin(turn) as f32);
    let corner = |u: f32, v: f32| [center[0] + u * a * c - v * b * s, center[1] + u * a * s + v * b * c];
    ([corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)], center, [a * c, a * s], [-b * s, b * c])
}

fn paper(scene: &mut Scene, rng: &mut Rng) {
    let long = rng.uniform(0.1, 0.35);
    let (outline, center, along, across) = rectangle(scene, long * rng.uniform(0.6, 0.9), long, rng);
    shadow(scene, &outline, 4.0, rng);
    let sheet = Material::of(color::from_hsv(rng.uniform(0.0, 360.0), rng.uniform(0.0, 0.15), rng.uniform(0.75, 1.0)), rng).plain();
    scene.fill_of(&outline, sheet, |x, y| ([x, y], 1.0));
    // Lines of writing.
    let ink = color::from_hsv(rng.uniform(200.0, 260.0), rng.uniform(0.0, 0.9), rng.uniform(0.05, 0.4));
    let rows = rng.int(0, 14);
    for row in 0..rows {
        let v = -0.85 + 1.7 * row as f32 / rows as f32;
        let mut u = -0.85f32;
        let end = rng.uniform(0.1, 0.9) as f32;
        while u < end {
            let word = rng.uniform(0.04, 0.25) as f32;
            let high = 0.35 / rows as f32;
            let at = |u: f32, v: f32| [center[0] + along[0] * u + across[0] * v, center[1] + along[1] * u + across[1] * v];
            let quad = [at(u, v - high), at(u + word, v - high), at(u + word, v + high), at(u, v + high)];
            scene.fill(&quad, move |_, _| (ink, 0.6));
            u += word + 0.05;
        }
    }
}

fn book(scene: &mut Scene, rng: &mut Rng) {
    let long = rng.uniform(0.08, 0.3);
    let (outline, center, along, across) = rectangle(scene, long * rng.uniform(0.5, 0.9), long, rng);
    shadow(scene, &outline, 8.0, rng);
    let cloth = if rng.chance(0.7) { Material::saturated(rng) } else { Material::muted(rng) };
    scene.fill_of(&outline, cloth, |x, y| ([x, y], 1.0));
    let at = |u: f32, v: f32| [center[0] + along[0] * u + across[0] * v, center[1] + along[1] * u + across[1] * v];
    for _ in 0..rng.int(0, 3) {
        let (u, v) = (rng.uniform(-0.8, 0.3) as f32, rng.uniform(-0.8, 0.3) as f32);
        let (a, b) = (rng.uniform(0.1, 0.7) as f32, rng.uniform(0.05, 0.5) as f32);
        let ink = if rng.chance(0.5) { color::saturated(rng) } else { [0.85; 3] };
        scene.fill(&[at(u, v), at(u + a, v), at(u + a, v + b), at(u, v + b)], move |_, _| (ink, 0.9));
    }
}

fn pen(scene: &mut Scene, rng: &mut Rng) {
    let (outline, center, along, across) = rectangle(scene, rng.uniform(0.005, 0.02), rng.uniform(0.1, 0.3), rng);
    shadow(scene, &outline, 4.0, rng);
    let body = color::saturated(rng);
    let wide = (across[0] * across[0] + across[1] * across[1]).sqrt().max(1e-3);
    scene.fill(&outline, move |x, y| {
        let off = ((x - center[0]) * across[0] + (y - center[1]) * across[1]) / (wide * wide);
        (color::scaled(body, 1.1 - 0.7 * off.abs()), 1.0)
    });
    let tip = |t: f32, v: f32| [center[0] + along[0] * t + across[0] * v, center[1] + along[1] * t + across[1] * v];
    let cap = color::muted(rng);
    scene.fill(&[tip(0.75, -1.0), tip(1.1, -0.2), tip(1.1, 0.2), tip(0.75, 1.0)], move |_, _| (cap, 1.0));
}

fn round(scene: &mut Scene, rng: &mut Rng) {
    let (w, h) = (scene.width as f32, scene.height as f32);
    let center = [rng.uniform(0.0, 1.0) as f32 * w, rng.uniform(0.0, 1.0) as f32 * h];
    let r = rng.uniform(0.02, 0.14) as f32 * w;
    let material = if rng.chance(0.5) { Material::saturated(rng) } else { Material::muted(rng) };
    let squash = rng.uniform(0.6, 1.0) as f32;
    let outer = polygon(center, r, r * squash, 24, 0.0, rng);
    shadow(scene, &outer, r * 0.2, rng);
    scene.fill_of(&outer, material, move |x, y| ([x, y], 1.1 - 0.5 * (y - center[1]) / r));
    if rng.chance(0.5) {
        let inner = color::muted(rng);
        let outline = polygon(center, r * 0.8, r * 0.8 * squash, 24, 0.0, rng);
        scene.fill(&outline, move |_, y| (color::scaled(inner, 1.0 + 0.3 * (y - center[1]) / r), 1.0));
    }
}
