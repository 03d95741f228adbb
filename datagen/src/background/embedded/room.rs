//! A room: floor, ceiling, back wall and side walls in perspective, windows, pictures, furniture.
use super::{Material, Scene, leaves::shadow, polygon};
use crate::color;
use tcross_dataset::{Homography, Rng};

type Quad = [[f32; 2]; 4];

/// Fills a quadrilateral with a material seen in perspective: `size` is what the quadrilateral measures in the material's units.
fn plane(scene: &mut Scene, quad: &Quad, material: &Material, size: [f32; 2], shade: [f32; 2]) {
    let Some(back) = Homography::from_unit_square(&quad.map(|p| p.map(f64::from))).and_then(|h| h.inverse()) else { return };
    let m = back.0.map(|v| v as f32);
    scene.fill_of(quad, material.clone(), move |x, y| {
        let w = 1.0 / (m[6] * x + m[7] * y + m[8]);
        let (u, v) = ((m[0] * x + m[1] * y + m[2]) * w, (m[3] * x + m[4] * y + m[5]) * w);
        ([u * size[0], v * size[1]], shade[0] + (shade[1] - shade[0]) * v)
    });
}

/// A smaller quadrilateral inside one, between fractions of its sides (bilinear: good enough for a picture on a wall).
fn inside(quad: &Quad, [u0, v0, u1, v1]: [f32; 4]) -> Quad {
    let at = |u: f32, v: f32| {
        std::array::from_fn(|k| {
            let top = quad[0][k] + (quad[1][k] - quad[0][k]) * u;
            let bottom = quad[3][k] + (quad[2][k] - quad[3][k]) * u;
            top + (bottom - top) * v
        })
    };
    [at(u0, v0), at(u1, v0), at(u1, v1), at(u0, v1)]
}

pub(super) fn paint(scene: &mut Scene, rng: &mut Rng) {
    let (w, h) = (scene.width as f32, scene.height as f32);
    // The back wall; its corners joined with the frame's far corners make the other four planes.
    let left = rng.uniform(0.02, 0.4) as f32 * w;
    let right = rng.uniform(0.6, 0.98) as f32 * w;
    let top = rng.uniform(-0.1, 0.3) as f32 * h;
    let bottom = rng.uniform(0.45, 0.85) as f32 * h;
    let (far_x, far_y) = (w * 0.6, h * 0.6);
    let wall = Material::of(color::from_hsv(rng.uniform(0.0, 360.0), rng.uniform(0.0, 0.4), rng.uniform(0.5, 1.0)), rng);
    let side = if rng.chance(0.7) { wall.clone() } else { Material::muted(rng) };
    let floor = Material::muted(rng);
    let back: Quad = [[left, top], [right, top], [right, bottom], [left, bottom]];
    let floor_quad: Quad = [[left, bottom], [right, bottom], [right + far_x, h + far_y], [left - far_x, h + far_y]];
    let left_quad: Quad = [[left - far_x, top - far_y], [left, top], [left, bottom], [left - far_x, bottom + far_y * 1.3]];
    let right_quad: Quad = [[right, top], [right + far_x, top - far_y], [right + far_x, bottom + far_y * 1.3], [right, bottom]];
    let ceiling: Quad = [[left - far_x, top - far_y], [right + far_x, top - far_y], [right, top], [left, top]];
    let size = [rng.uniform(150.0, 400.0) as f32, rng.uniform(150.0, 400.0) as f32];
    let shade = |rng: &mut Rng| rng.uniform(0.5, 1.1) as f32;
    plane(scene, &ceiling, &side.clone().plain(), size, [0.9, 1.0]);
    let (a, b, c, d) = (shade(rng), shade(rng), shade(rng), shade(rng));
    plane(scene, &left_quad, &side, size, [a, a]);
    plane(scene, &right_quad, &side, size, [b, b]);
    plane(scene, &back, &wall, size, [c, c * 0.9]);
    plane(scene, &floor_quad, &floor, [size[0] * 2.0, size[1] * 2.0], [d * 0.8, d]);
    for _ in 0..rng.int(1, 6) {
        let on = *rng.choose(&[back, back, left_quad, right_quad]);
        hang(scene, &on, rng);
    }
    for _ in 0..rng.int(1, 7) {
        stand(scene, bottom, rng);
    }
    if rng.chance(0.5) {
        // A rug, or light through a window.
        let (u, v) = (rng.uniform(0.1, 0.5) as f32, rng.uniform(0.1, 0.5) as f32);
        let rug = inside(&floor_quad, [u, v, u + 0.35, v + 0.3]);
        if rng.chance(0.5) {
            let material = if rng.chance(0.5) { Material::saturated(rng) } else { Material::muted(rng) };
            plane(scene, &rug, &material, [160.0, 160.0], [0.9, 1.0]);
        } else {
            scene.fill(&rug, move |_, _| ([1.0, 0.95, 0.8], 0.35));
        }
    }
}

/// Something on a wall: a window, a picture, a shelf, a poster.
fn hang(scene: &mut Scene, wall: &Quad, rng: &mut Rng) {
    let (u, v) = (rng.uniform(0.05, 0.75) as f32, rng.uniform(0.1, 0.6) as f32);
    let size = [rng.uniform(0.08, 0.4) as f32, rng.uniform(0.08, 0.4) as f32];
    let rect = [u, v, u + size[0], v + size[1]];
    let frame = Material::muted(rng).plain();
    plane(scene, &inside(wall, rect), &frame, [60.0, 60.0], [1.0, 0.8]);
    let edge = rng.uniform(0.03, 0.1) as f32;
    let inner = [u + size[0] * edge, v + size[1] * edge, u + size[0] * (1.0 - edge), v + size[1] * (1.0 - edge)];
    match rng.index(4) {
        0 => {
            // A window: bright, with a cross of bars.
            let sky = Material::of(color::from_hsv(rng.uniform(190.0, 230.0), rng.uniform(0.0, 0.5), 1.0), rng).plain();
            let glow = rng.uniform(1.0, 2.5) as f32;
            plane(scene, &inside(wall, inner), &sky, [40.0, 40.0], [glow, glow * 0.8]);
            let bar = 0.02 + 0.03 * size[0];
            for k in 1..rng.int(2, 4) {
                let at = u + size[0] * k as f32 / 3.0;
                plane(scene, &inside(wall, [at, v, at + bar * 0.3, v + size[1]]), &frame, [9.0, 90.0], [1.0, 0.9]);
            }
        }
        1 => {
            let picture = Material::saturated(rng);
            plane(scene, &inside(wall, inner), &picture, [80.0, 80.0], [1.0, 0.9]);
        }
        2 => {
            // A shelf with books.
            let mut at = inner[0];
            while at < inner[2] {
                let thick = size[0] * rng.uniform(0.03, 0.12) as f32;
                let spine = if rng.chance(0.5) { Material::saturated(rng) } else { Material::muted(rng) };
                let high = inner[1] + (inner[3] - inner[1]) * rng.uniform(0.0, 0.4) as f32;
                plane(scene, &inside(wall, [at, high, (at + thick).min(inner[2]), inner[3]]), &spine, [12.0, 60.0], [1.0, 0.8]);
                at += thick * 1.05;
            }
        }
        _ => {
            let poster = Material::muted(rng);
            plane(scene, &inside(wall, inner), &poster, [80.0, 80.0], [1.0, 0.9]);
            let picture = inside(wall, inner);
            for _ in 0..rng.int(1, 4) {
                let (a, b) = (rng.uniform(0.05, 0.6) as f32, rng.uniform(0.05, 0.6) as f32);
                let material = Material::saturated(rng).plain();
                let part = inside(&picture, [a, b, a + rng.uniform(0.1, 0.35) as f32, b + rng.uniform(0.1, 0.35) as f32]);
                plane(scene, &part, &material, [30.0, 30.0], [1.0, 1.0]);
            }
        }
    }
}

/// A piece of furniture: a box with three visible sides, a blob (a plant, a lamp, a person), or a column.
fn stand(scene: &mut Scene, horizon: f32, rng: &mut Rng) {
    let (w, h) = (scene.width as f32, scene.height as f32);
    let foot = rng.uniform(f64::from(horizon), f64::from(h) * 1.1) as f32;
    let near = ((foot - horizon) / (h - horizon) + 0.4).max(0.3);
    let (x, wide, high) =
        (rng.uniform(-0.1, 1.0) as f32 * w, rng.uniform(0.08, 0.35) as f32 * w * near, rng.uniform(0.08, 0.45) as f32 * h * near);
    let material = if rng.chance(0.35) { Material::saturated(rng) } else { Material::muted(rng) };
    if rng.chance(0.3) {
        let outline = polygon([x, foot - high / 2.0], wide / 2.0, high / 2.0, 14, 0.2, rng);
        shadow(scene, &outline, wide * 0.1, rng);
        scene.fill_of(&outline, material, move |px, py| ([px, py], 0.7 + 0.6 * (px - x + wide) / (2.0 * wide)));
        return;
    }
    let deep = rng.uniform(-0.5, 0.5) as f32 * wide;
    let rise = rng.uniform(0.02, 0.25) as f32 * high;
    let front: Quad = [[x, foot - high], [x + wide, foot - high], [x + wide, foot], [x, foot]];
    let top: Quad = [[x + deep, foot - high - rise], [x + wide + deep, foot - high - rise], [x + wide, foot - high], [x, foot - high]];
    let edge = if deep > 0.0 { x + wide } else { x };
    let side: Quad = [[edge, foot - high], [edge + deep, foot - high - rise], [edge + deep, foot - rise], [edge, foot]];
    shadow(scene, &front, wide * 0.08, rng);
    plane(scene, &front, &material, [wide, high], [1.0, 0.7]);
    plane(scene, &top, &material, [wide, wide], [1.15, 1.2]);
    plane(scene, &side, &material, [wide, high], [0.7, 0.5]);
    if rng.chance(0.5) {
        for k in 0..rng.int(1, 4) {
            let v = 0.08 + 0.3 * k as f32;
            scene.fill(&inside(&front, [0.08, v, 0.92, v + 0.02]), move |_, _| ([0.02; 3], 0.6));
        }
    }
}
