//! Dead leaves: patches of all sizes (density of radius r as r^-3) that hide one another, the model that shares its statistics with
//! photographs of almost anything.
use super::{Material, Scene, polygon};
use tcross_dataset::Rng;

pub(super) fn paint(scene: &mut Scene, rng: &mut Rng) {
    let size = scene.width.max(scene.height) as f64;
    let ground = Material::muted(rng);
    cover(scene, ground);
    let (smallest, largest) = (size * rng.log_uniform(0.008, 0.03), size * rng.uniform(0.2, 0.45));
    let saturated = rng.uniform(0.05, 0.5);
    let corners = [4, 4, 5, 12, 16][rng.index(5)];
    let count = rng.int(60, 420);
    let palette: Vec<Material> =
        (0..12).map(|_| if rng.chance(saturated) { Material::saturated(rng) } else { Material::muted(rng) }).collect();
    for k in 0..count {
        // The inverse of the cumulative distribution of r^-3, large leaves first more often, so that small ones are not all hidden.
        let u = rng.unit();
        let r = 1.0 / ((1.0 - u) / (smallest * smallest) + u / (largest * largest)).sqrt();
        let r = if k < count / 12 { largest * rng.uniform(0.4, 1.0) } else { r };
        let center = [rng.uniform(-0.05, 1.05) as f32 * scene.width as f32, rng.uniform(-0.05, 1.05) as f32 * scene.height as f32];
        let stretch = rng.log_uniform(0.35, 1.0) as f32;
        let outline = polygon(center, r as f32, r as f32 * stretch, corners, rng.uniform(0.0, 0.25), rng);
        let material = rng.choose(&palette).clone();
        let shade = rng.uniform(0.6, 1.3) as f32;
        let slope = [rng.uniform(-0.4, 0.4) as f32 / r as f32, rng.uniform(-0.4, 0.4) as f32 / r as f32];
        shadow(scene, &outline, r as f32 * 0.12, rng);
        scene.fill_of(&outline, material, move |x, y| {
            ([x, y], shade * (1.0 + slope[0] * (x - center[0]) + slope[1] * (y - center[1])).max(0.2))
        });
    }
}

/// Covers everything with a material.
pub(super) fn cover(scene: &mut Scene, material: Material) {
    scene.fill_of(&scene.rows(0.0, scene.height as f32), material, |x, y| ([x, y], 1.0));
}

/// Darkens a moved copy of an outline.
pub(super) fn shadow(scene: &mut Scene, outline: &[[f32; 2]], offset: f32, rng: &mut Rng) {
    if rng.chance(0.5) {
        let moved: Vec<[f32; 2]> = outline.iter().map(|p| [p[0] + offset, p[1] + offset]).collect();
        scene.fill(&moved, |_, _| ([0.0; 3], 0.3));
    }
}
