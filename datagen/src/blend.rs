//! How a marker is put into a picture. Real images have no seam; composited ones do, and a network that has seen one kind of seam only learns
//! to look for it. So the way of blending is a declared mixture (Dwibedi et al., "Cut, Paste and Learn", 2017).
use crate::{canvas::Canvas, color, effects, hand::film::Film, noise};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tcross_dataset::Rng;

/// A way of blending. All work in linear light, and none moves an edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Blend {
    /// As sharp as the photo, with the photo's noise.
    Matched,
    /// Antialiased only, with the photo's noise: sharper than the photo.
    Sharp,
    /// Softer than the photo by a pixel, with the photo's noise.
    Feathered,
    /// As sharp as the photo; the relief of what lies below shows through, as on plaster, cloth or wood.
    Embossed,
    /// As sharp as the photo, without noise, as after a phone's noise reduction.
    Smooth,
}

/// Deviation of the blur that shows the light and dark of the surface below without its relief, in pixels.
const RELIEF_PX: f32 = 4.0;

impl Blend {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Matched, Self::Sharp, Self::Feathered, Self::Embossed, Self::Smooth];

    /// The word used in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Matched => "matched",
            Self::Sharp => "sharp",
            Self::Feathered => "feathered",
            Self::Embossed => "embossed",
            Self::Smooth => "smooth",
        }
    }

    /// Deviation of the blur of a marker's edges in pixels, where the photo's is `matched`.
    #[must_use]
    pub fn softness(self, matched: f64) -> f64 {
        match self {
            Self::Sharp => 0.0,
            Self::Feathered => matched.hypot(1.0),
            Self::Matched | Self::Embossed | Self::Smooth => matched,
        }
    }

    /// Lays a film over the picture. `grain` is the deviation of the photo's noise, `seed` that of the noise added.
    pub fn lay(self, canvas: &mut Canvas, film: &Film, grain: f32, seed: u64) {
        let normals = noise::normals();
        let width = film.x.len();
        let grain = if self == Self::Smooth { 0.0 } else { grain };
        let relief = (self == Self::Embossed).then(|| relief(canvas, film));
        let mut rng = Rng::for_item(seed, "datagen/film-grain", film.y.start as u64 * 65_536 + film.x.start as u64);
        let mut shade = vec![1.0; width];
        for (j, y) in film.y.clone().enumerate() {
            let start = (rng.bits() & 0x7fff) as usize;
            if let Some(relief) = &relief {
                shade.copy_from_slice(&relief[j * width..][..width]);
            }
            for c in 0..3 {
                let row = &mut canvas.planes[c][y * canvas.width + film.x.start..][..width];
                let (through, own) = (&film.planes[c][j * width..][..width], &film.planes[3 + c][j * width..][..width]);
                let normals = &normals[start + c * 64..][..width.min(1 << 15)];
                for ((((v, t), o), n), s) in row.iter_mut().zip(through).zip(own).zip(normals).zip(&shade) {
                    *v = *v * t + o * s + grain * n * (1.0 - t);
                }
            }
        }
    }
}

/// The relief of what lies below a film: how much lighter each pixel is than its surroundings, within reason.
fn relief(canvas: &Canvas, film: &Film) -> Vec<f32> {
    let (width, height) = (film.x.len(), film.y.len());
    let light: Vec<f32> =
        film.y.clone().flat_map(|y| film.x.clone().map(move |x| (x, y))).map(|(x, y)| color::luminance(canvas.at(x, y)) + 0.02).collect();
    let mut around = light.clone();
    effects::soften(&mut around, width, height, RELIEF_PX);
    light.iter().zip(&around).map(|(l, a)| (l / a.max(0.01)).clamp(0.6, 1.5).sqrt()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn film(width: usize, height: usize) -> Film {
        let half = |k: usize| if k < 3 { 0.25 } else { 0.3 };
        Film { x: 3..3 + width, y: 2..2 + height, planes: std::array::from_fn(|k| vec![half(k); width * height]), ink: vec![] }
    }

    #[test]
    fn a_film_filters_and_adds() {
        for blend in Blend::ALL {
            let mut canvas = Canvas::filled(20, 12, [0.4; 3]);
            blend.lay(&mut canvas, &film(9, 7), 0.0, 1);
            assert!((canvas.at(5, 5)[1] - 0.4).abs() < 1e-5, "{blend:?}");
            assert_eq!(canvas.at(1, 1), [0.4; 3]);
        }
    }

    #[test]
    fn relief_shows_through_only_where_it_is_asked_for() {
        for blend in Blend::ALL {
            let mut canvas = Canvas::filled(20, 12, [0.4; 3]);
            canvas.set(6, 5, [0.6; 3]);
            blend.lay(&mut canvas, &film(9, 7), 0.0, 1);
            let rise = canvas.at(6, 5)[0] - canvas.at(10, 5)[0];
            assert_eq!(rise > 0.06, blend == Blend::Embossed, "{blend:?} {rise}");
        }
    }
}
