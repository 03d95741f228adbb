//! Changes of colour: one affine map of red, green and blue an image, or hue, saturation and value pixel by pixel.
use super::planes::Planes;
use crate::config::{Augment, ColorSpace};
use tcross_dataset::Rng;

/// What is done to the colours of one image, drawn beforehand.
#[derive(Debug, Clone, PartialEq)]
pub enum Color {
    /// `out = matrix * (r, g, b, 1)`, each 0..1, clamped.
    Linear([[f32; 4]; 3]),
    /// Shift of the brightness (0..1), turn of the hue (degrees), factors of saturation and value.
    Hsv {
        /// Added to red, green and blue.
        shift: f32,
        /// Degrees.
        hue_deg: f32,
        /// Factor.
        saturation: f32,
        /// Factor.
        value: f32,
    },
}

/// Luminance of red, green and blue (Rec. 601).
const LUMA: [f64; 3] = [0.299, 0.587, 0.114];

impl Color {
    /// Nothing changes.
    pub const NONE: Self = Self::Linear([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);

    /// Draws the changes of one image. Always the same number of draws, so that one amount does not shift the others.
    #[must_use]
    pub fn sample(config: &Augment, rng: &mut Rng) -> Self {
        let mut amount = |range: f64| {
            let (on, value) = (rng.chance(config.color_probability), rng.uniform(-range, range));
            if on { value } else { 0.0 }
        };
        let (gain, shift) = (amount(config.gain), amount(config.shift));
        let (saturation, hue_deg) = (amount(config.saturation), amount(config.hue_deg));
        match config.color {
            ColorSpace::Linear => Self::linear(1.0 + gain, shift, 1.0 + saturation, hue_deg),
            ColorSpace::Hsv => Self::Hsv {
                shift: shift as f32,
                hue_deg: hue_deg as f32,
                saturation: (1.0 + saturation) as f32,
                value: (1.0 + gain) as f32,
            },
        }
    }

    /// Gain and shift of all channels, saturation about the luminance, and a turn of the hue about the grey axis.
    #[must_use]
    pub fn linear(gain: f64, shift: f64, saturation: f64, hue_deg: f64) -> Self {
        let (sin, cos) = hue_deg.to_radians().sin_cos();
        let mut matrix = [[0.0; 4]; 3];
        for (row, line) in matrix.iter_mut().enumerate() {
            for column in 0..3 {
                // Rodrigues' rotation about (1, 1, 1) / sqrt(3).
                let cross = match (3 + column - row) % 3 {
                    0 => 0.0,
                    1 => -1.0,
                    _ => 1.0,
                } / 3f64.sqrt();
                let same = if row == column { 1.0 } else { 0.0 };
                let turn = |r: f64, c: f64| cos * r + sin * c + (1.0 - cos) / 3.0;
                let turned = turn(same, cross);
                line[column] = (gain * (saturation * turned + (1.0 - saturation) * LUMA[column])) as f32;
            }
            line[3] = shift as f32;
        }
        Self::Linear(matrix)
    }

    /// Writes the picture as floats 0..1, `[3, height, width]`, added with `weight` to what `out` holds if `add`, else set.
    pub fn write(&self, image: &Planes, weight: f32, add: bool, out: &mut [f32]) {
        let area = image.width * image.height;
        let (red, rest) = out.split_at_mut(area);
        let (green, blue) = rest.split_at_mut(area);
        let planes = image.plane(0).iter().zip(image.plane(1)).zip(image.plane(2));
        let targets = red.iter_mut().zip(green).zip(blue);
        let put = |out: &mut f32, value: f32| *out = if add { *out + weight * value } else { weight * value };
        match self {
            Self::Linear(m) => {
                let m = m.map(|row| [row[0] / 255.0, row[1] / 255.0, row[2] / 255.0, row[3]]);
                for (((r, g), b), ((x, y), z)) in planes.zip(targets) {
                    let (r, g, b) = (f32::from(*r), f32::from(*g), f32::from(*b));
                    let channel = |m: &[f32; 4]| (m[0] * r + m[1] * g + m[2] * b + m[3]).clamp(0.0, 1.0);
                    put(x, channel(&m[0]));
                    put(y, channel(&m[1]));
                    put(z, channel(&m[2]));
                }
            }
            Self::Hsv { shift, hue_deg, saturation, value } => {
                for (((r, g), b), ((x, y), z)) in planes.zip(targets) {
                    let lit = [r, g, b].map(|v| (f32::from(*v) / 255.0 + shift).clamp(0.0, 1.0));
                    let [h, s, v] = hsv_from_rgb(lit);
                    let changed = rgb_from_hsv([h + hue_deg, (s * saturation).clamp(0.0, 1.0), (v * value).clamp(0.0, 1.0)]);
                    put(x, changed[0]);
                    put(y, changed[1]);
                    put(z, changed[2]);
                }
            }
        }
    }
}

/// Hue in degrees, saturation and value 0..1, of channels 0..1.
fn hsv_from_rgb([r, g, b]: [f32; 3]) -> [f32; 3] {
    let (high, low) = (r.max(g).max(b), r.min(g).min(b));
    let range = high - low;
    let sector = if range == 0.0 {
        0.0
    } else if high == r {
        (g - b) / range
    } else if high == g {
        2.0 + (b - r) / range
    } else {
        4.0 + (r - g) / range
    };
    [60.0 * sector, if high > 0.0 { range / high } else { 0.0 }, high]
}

fn rgb_from_hsv([h, s, v]: [f32; 3]) -> [f32; 3] {
    let channel = |n: f32| {
        let k = (n + h / 60.0).rem_euclid(6.0);
        v - v * s * k.min(4.0 - k).clamp(0.0, 1.0)
    };
    [channel(5.0), channel(3.0), channel(1.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn apply(color: &Color, rgb: [u8; 3]) -> [f32; 3] {
        let image = Planes { width: 1, height: 1, data: rgb.to_vec() };
        let mut out = [0.0; 3];
        color.write(&image, 1.0, false, &mut out);
        out
    }

    fn close(a: [f32; 3], b: [f32; 3]) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < 2e-3)
    }

    #[test]
    fn no_change_is_a_plain_conversion() {
        for rgb in [[0, 128, 255], [7, 200, 31]] {
            let want = rgb.map(|v| f32::from(v) / 255.0);
            assert!(close(apply(&Color::NONE, rgb), want));
            assert!(close(apply(&Color::linear(1.0, 0.0, 1.0, 0.0), rgb), want));
            assert!(close(apply(&Color::Hsv { shift: 0.0, hue_deg: 0.0, saturation: 1.0, value: 1.0 }, rgb), want));
        }
    }

    #[test]
    fn turning_the_hue_by_a_third_permutes_the_channels() {
        let rgb = [204, 51, 102];
        let want = [0.4, 0.8, 0.2]; // red becomes green becomes blue
        assert!(close(apply(&Color::linear(1.0, 0.0, 1.0, 120.0), rgb), want), "{:?}", apply(&Color::linear(1.0, 0.0, 1.0, 120.0), rgb));
        assert!(close(apply(&Color::Hsv { shift: 0.0, hue_deg: 120.0, saturation: 1.0, value: 1.0 }, rgb), want));
    }

    #[test]
    fn grey_has_no_hue_and_no_saturation() {
        for color in [Color::linear(1.0, 0.0, 0.2, 77.0), Color::Hsv { shift: 0.0, hue_deg: 77.0, saturation: 0.2, value: 1.0 }] {
            assert!(close(apply(&color, [100; 3]), [100.0 / 255.0; 3]));
        }
    }

    #[test]
    fn values_are_clamped_and_mixed_by_weight() {
        let color = Color::linear(3.0, 0.1, 1.0, 0.0);
        assert!(close(apply(&color, [255, 10, 0]), [1.0, 0.1 + 30.0 / 255.0, 0.1]));
        let image = Planes { width: 1, height: 1, data: vec![255, 0, 51] };
        let mut out = [1.0, 1.0, 1.0];
        Color::NONE.write(&image, 0.25, true, &mut out);
        assert!(close(out, [1.25, 1.0, 1.05]));
    }
}
