//! Outdoors: sky, hills with the spectra of hills, houses with windows, trees, a ground in perspective.
use super::{Material, Scene, polygon};
use crate::{
    color,
    noise::{Spectrum, Tile},
};
use tcross_dataset::Rng;

pub(super) fn paint(scene: &mut Scene, rng: &mut Rng) {
    let (w, h) = (scene.width as f32, scene.height as f32);
    let horizon = rng.uniform(0.15, 0.7) as f32 * h;
    sky(scene, horizon, rng);
    for layer in 0..rng.int(0, 3) {
        hills(scene, horizon, layer as f32, rng);
    }
    ground(scene, horizon, rng);
    for _ in 0..[0, 3, 6][rng.index(3)] {
        house(scene, horizon, rng);
    }
    for _ in 0..rng.int(0, 7) {
        tree(scene, horizon, rng);
    }
    for _ in 0..rng.int(0, 6) {
        // Cars, bins, people, stones: blobs with a lit upper half.
        let foot = rng.uniform(f64::from(horizon), f64::from(h)) as f32;
        let near = (foot - horizon) / (h - horizon).max(1.0) + 0.15;
        let center = [rng.uniform(0.0, 1.0) as f32 * w, foot];
        let r = near * rng.uniform(0.03, 0.12) as f32 * w;
        let material = if rng.chance(0.5) { Material::saturated(rng) } else { Material::muted(rng) };
        let outline = polygon(center, r, r * rng.uniform(0.4, 1.6) as f32, [4, 6, 12][rng.index(3)], 0.15, rng);
        scene.fill_of(&outline, material, move |x, y| ([x, y], 1.0 - 0.5 * (y - center[1]) / r));
    }
}

fn sky(scene: &mut Scene, horizon: f32, rng: &mut Rng) {
    let zenith = color::from_hsv(rng.uniform(195.0, 230.0), rng.uniform(0.1, 0.7), rng.uniform(0.5, 1.0));
    let low = color::from_hsv(rng.uniform(0.0, 360.0), rng.uniform(0.0, 0.3), rng.uniform(0.7, 1.0));
    let clouds = rng.uniform(0.0, 0.6) as f32;
    let (ox, oy, scale) = (rng.uniform(0.0, 256.0) as f32, rng.uniform(0.0, 256.0) as f32, rng.uniform(0.1, 0.5) as f32);
    let tile = Tile::of(Spectrum::Soft);
    scene.fill(&scene.rows(0.0, horizon.floor() + 1.0), move |x, y| {
        let clear = color::mix(zenith, low, y / horizon.max(1.0));
        let cloud = (tile.smooth(ox + x * scale, oy + y * scale * 2.0) * 0.6).clamp(0.0, 1.0) * clouds;
        (color::mix(clear, [0.95; 3], cloud), 1.0)
    });
}

fn hills(scene: &mut Scene, horizon: f32, layer: f32, rng: &mut Rng) {
    let haze = color::from_hsv(210.0, 0.15, 0.85);
    let material = Material::of(color::from_hsv(rng.uniform(60.0, 150.0), rng.uniform(0.1, 0.5), rng.uniform(0.2, 0.6)), rng).plain();
    let (offset, rough, high) = (rng.uniform(0.0, 256.0) as f32, rng.uniform(0.2, 0.7) as f32, rng.uniform(0.05, 0.25) as f32);
    let tile = Tile::of(if rng.chance(0.5) { Spectrum::Soft } else { Spectrum::Pink });
    let width = scene.width as f32;
    let mut outline: Vec<[f32; 2]> = (0..=64)
        .map(|k| {
            let x = k as f32 / 64.0 * width;
            [x, horizon - scene.height as f32 * high * (0.4 + 0.3 * tile.smooth(offset + x * rough, layer * 31.0))]
        })
        .collect();
    outline.extend([[width, horizon + 20.0], [0.0, horizon + 20.0]]);
    scene.fill(&outline, move |x, y| (color::mix(material.at(x, y), haze, (0.6 - layer * 0.25).max(0.0)), 1.0));
}

fn ground(scene: &mut Scene, horizon: f32, rng: &mut Rng) {
    let grass = rng.chance(0.4);
    let base =
        if grass { color::from_hsv(rng.uniform(60.0, 130.0), rng.uniform(0.3, 0.8), rng.uniform(0.3, 0.7)) } else { color::muted(rng) };
    let material = Material::of(base, rng);
    let height = scene.height as f32;
    let middle = scene.width as f32 * rng.uniform(0.2, 0.8) as f32;
    scene.fill_of(&scene.rows(horizon.floor(), height), material, move |x, y| {
        // A plane below the eye: depth runs as one over the distance from the horizon.
        let depth = height * 0.35 / (y - horizon + 2.0);
        ([(x - middle) * depth, depth * 160.0], 1.0)
    });
}

fn house(scene: &mut Scene, horizon: f32, rng: &mut Rng) {
    let (w, h) = (scene.width as f32, scene.height as f32);
    let (x, wide, high) = (rng.uniform(-0.2, 1.0) as f32 * w, rng.uniform(0.1, 0.45) as f32 * w, rng.uniform(0.1, 0.6) as f32 * h);
    let foot = horizon + rng.uniform(0.0, 0.1) as f32 * h;
    let (left, right) = (foot - high, foot - high * rng.uniform(0.8, 1.2) as f32);
    let material = if rng.chance(0.25) { Material::saturated(rng) } else { Material::muted(rng) };
    scene.fill_of(&[[x, left], [x + wide, right], [x + wide, foot], [x, foot]], material, move |px, py| ([px - x, py], 1.0));
    if rng.chance(0.5) {
        let roof = Material::of(color::from_hsv(rng.uniform(0.0, 40.0), rng.uniform(0.2, 0.8), rng.uniform(0.2, 0.6)), rng).plain();
        scene.fill_of(&[[x, left], [x + wide / 2.0, left - high * 0.3], [x + wide, right]], roof, |px, py| ([px, py], 1.0));
    }
    let (columns, rows) = (rng.int(2, 7) as f32, rng.int(1, 6) as f32);
    let pane = color::from_hsv(rng.uniform(0.0, 360.0), rng.uniform(0.0, 0.4), rng.uniform(0.1, 0.9));
    let share = rng.uniform(0.35, 0.7) as f32;
    for i in 0..columns as i32 {
        for j in 0..rows as i32 {
            let (u, v) = ((i as f32 + 0.5) / columns, (j as f32 + 0.5) / rows);
            let (cx, cy) = (x + u * wide, left + (right - left) * u + v * high);
            let (rx, ry) = (wide / columns * share / 2.0, high / rows * share / 2.0);
            let tone = rng.uniform(0.5, 1.2) as f32;
            scene.fill(&[[cx - rx, cy - ry], [cx + rx, cy - ry], [cx + rx, cy + ry], [cx - rx, cy + ry]], move |_, _| {
                (color::scaled(pane, tone), 0.9)
            });
        }
    }
}

fn tree(scene: &mut Scene, horizon: f32, rng: &mut Rng) {
    let (w, h) = (scene.width as f32, scene.height as f32);
    let foot = horizon + rng.uniform(0.0, 0.5) as f32 * (h - horizon);
    let near = (foot - horizon) / (h - horizon).max(1.0) + 0.3;
    let (x, crown) = (rng.uniform(0.0, 1.0) as f32 * w, near * rng.uniform(0.08, 0.3) as f32 * w);
    let bark = Material::of(color::from_hsv(30.0, 0.3, 0.3), rng).plain();
    let thick = crown * 0.08;
    let trunk = [[x - thick, foot - crown], [x + thick, foot - crown], [x + thick, foot], [x - thick, foot]];
    scene.fill_of(&trunk, bark, |px, py| ([px, py], 1.0));
    let leaf = color::from_hsv(rng.uniform(40.0, 140.0), rng.uniform(0.3, 0.8), rng.uniform(0.2, 0.6));
    let tile = Tile::of(Spectrum::Rough);
    for _ in 0..rng.int(4, 12) {
        let center = [x + rng.uniform(-0.6, 0.6) as f32 * crown, foot - crown * rng.uniform(1.0, 2.0) as f32];
        let r = crown * rng.uniform(0.2, 0.5) as f32;
        let shade = rng.uniform(0.5, 1.4) as f32;
        let outline = polygon(center, r, r, 13, 0.35, rng);
        scene.fill(&outline, move |px, py| (color::scaled(leaf, (shade * (1.0 + 0.5 * tile.nearest(px * 2.0, py * 2.0))).max(0.1)), 1.0));
    }
}
