//! sRGB on disk, linear light inside: colours are mixed as light is, never as stored numbers.
use image::Rgb;
use std::sync::OnceLock;
use tcross_dataset::Rng;

/// Red, green, blue in linear light, 0..1 (1 is a white sheet in full light).
pub type Linear = [f32; 3];

const STEPS: usize = 1 << 14;

struct Tables {
    linear: [f32; 256],
    stored: Vec<u8>,
}

fn tables() -> &'static Tables {
    static TABLES: OnceLock<Tables> = OnceLock::new();
    TABLES.get_or_init(|| {
        let decode = |v: f64| if v <= 0.04045 { v / 12.92 } else { libm::pow((v + 0.055) / 1.055, 2.4) };
        let encode = |v: f64| if v <= 0.003_130_8 { v * 12.92 } else { 1.055 * libm::pow(v, 1.0 / 2.4) - 0.055 };
        Tables {
            linear: std::array::from_fn(|k| decode(k as f64 / 255.0) as f32),
            stored: (0..=STEPS).map(|k| (encode(k as f64 / STEPS as f64) * 255.0).round() as u8).collect(),
        }
    })
}

/// The light of a stored value.
#[must_use]
pub fn linear_table() -> &'static [f32; 256] {
    &tables().linear
}

/// The stored value of light at `k / 16384`, for k in 0..=16384.
#[must_use]
pub fn stored_table() -> &'static [u8] {
    &tables().stored
}

/// The stored value of some light; clamped to 0..1.
#[must_use]
pub fn stored(light: f32) -> u8 {
    tables().stored[(light.clamp(0.0, 1.0) * STEPS as f32 + 0.5) as usize]
}

/// From stored numbers.
#[must_use]
pub fn linear(Rgb(rgb): Rgb<u8>) -> Linear {
    rgb.map(|v| tables().linear[v as usize])
}

/// From hue in degrees, saturation and value (0..1) of the stored numbers.
#[must_use]
pub fn from_hsv(hue: f64, saturation: f64, value: f64) -> Linear {
    let channel = |n: f64| {
        let k = (n + hue.rem_euclid(360.0) / 60.0) % 6.0;
        let v = value - value * saturation * k.min(4.0 - k).clamp(0.0, 1.0);
        tables().linear[(v * 255.0).round().clamp(0.0, 255.0) as usize]
    };
    [channel(5.0), channel(3.0), channel(1.0)]
}

/// `#rrggbb`.
#[must_use]
pub fn hex(color: Linear) -> String {
    let [r, g, b] = color.map(stored);
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// Colours by name: those that highlighters and felt tips come in.
const NAMES: [(&str, [u8; 3]); 13] = [
    ("red", [230, 20, 30]),
    ("orange", [255, 130, 0]),
    ("yellow", [255, 225, 0]),
    ("lime", [150, 230, 0]),
    ("green", [0, 200, 0]),
    ("turquoise", [0, 200, 190]),
    ("cyan", [0, 180, 240]),
    ("blue", [0, 0, 200]),
    ("violet", [120, 30, 200]),
    ("magenta", [220, 0, 180]),
    ("pink", [255, 80, 150]),
    ("black", [0, 0, 0]),
    ("white", [255, 255, 255]),
];

/// A colour as people write it: `#rrggbb` or one of a dozen names.
///
/// # Errors
/// Says what is allowed.
pub fn parse(text: &str) -> Result<Rgb<u8>, String> {
    if let Some((_, rgb)) = NAMES.iter().find(|(name, _)| text.eq_ignore_ascii_case(name)) {
        return Ok(Rgb(*rgb));
    }
    let digits = text
        .strip_prefix('#')
        .filter(|d| d.len() == 6 && d.bytes().all(|b| b.is_ascii_hexdigit()))
        .and_then(|d| u32::from_str_radix(d, 16).ok());
    digits
        .map(|v| Rgb([16, 8, 0].map(|shift| (v >> shift & 255) as u8)))
        .ok_or_else(|| format!("expected #rrggbb or one of {}", NAMES.map(|n| n.0).join(", ")))
}

/// Relative luminance, 0..1.
#[must_use]
pub fn luminance(c: Linear) -> f32 {
    0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]
}

/// Between two colours: `a` at 0, `b` at 1.
#[must_use]
pub fn mix(a: Linear, b: Linear, t: f32) -> Linear {
    std::array::from_fn(|k| a[k] + (b[k] - a[k]) * t)
}

/// A colour times a number.
#[must_use]
pub fn scaled(c: Linear, by: f32) -> Linear {
    c.map(|v| v * by)
}

/// Any saturated colour.
pub fn saturated(rng: &mut Rng) -> Linear {
    from_hsv(rng.uniform(0.0, 360.0), rng.uniform(0.6, 1.0), rng.uniform(0.5, 1.0))
}

/// A muted colour of the kind walls, wood, stone, cloth and leaves have.
pub fn muted(rng: &mut Rng) -> Linear {
    let hue = if rng.chance(0.6) { rng.uniform(15.0, 60.0) } else { rng.uniform(0.0, 360.0) };
    from_hsv(hue, rng.uniform(0.0, 0.5), rng.uniform(0.15, 0.95))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stored_values_survive_the_round_trip() {
        for v in 0..=255u8 {
            assert_eq!(stored(linear_table()[v as usize]), v);
        }
    }

    #[test]
    fn colours_are_read_as_people_write_them() {
        assert_eq!(parse("#12aBff").unwrap(), Rgb([0x12, 0xab, 0xff]));
        assert_eq!(parse("Green").unwrap(), Rgb([0, 200, 0]));
        assert!(["", "#12", "12abff", "#1234567", "#+12345", "gren"].iter().all(|t| parse(t).is_err()));
    }

    #[test]
    fn hues_are_where_they_should_be() {
        for (hue, want) in [(0.0, "#ff0000"), (60.0, "#ffff00"), (120.0, "#00ff00"), (240.0, "#0000ff"), (300.0, "#ff00ff")] {
            assert_eq!(hex(from_hsv(hue, 1.0, 1.0)), want);
        }
    }
}
