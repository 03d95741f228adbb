//! Letters as outlines, for pictures made of pixels.
use super::canvas::advance;
use tiny_skia::{Path, PathBuilder, Transform};
use ttf_parser::{Face, OutlineBuilder};

const FONT: &[u8] = include_bytes!("../../assets/Arimo-subset.ttf");

/// The outlines of a text whose baseline starts at (0, 0), in points; `None` for one that leaves no ink. A character that the
/// font lacks leaves a gap of its width.
pub(super) fn outline_text(text: &str, size: f64) -> Option<Path> {
    let face = Face::parse(FONT, 0).ok()?;
    let scale = (size / f64::from(face.units_per_em())) as f32;
    let mut all = PathBuilder::new();
    let mut x = 0.0;
    for c in text.chars() {
        let mut glyph = Glyph(PathBuilder::new());
        if let Some(id) = face.glyph_index(c) {
            face.outline_glyph(id, &mut glyph);
        }
        let place = Transform::from_row(scale, 0.0, 0.0, -scale, x, 0.0);
        if let Some(path) = glyph.0.finish().and_then(|p| p.transform(place)) {
            all.push_path(&path);
        }
        x += (f64::from(advance(c)) * size / 1000.0) as f32;
    }
    all.finish()
}

struct Glyph(PathBuilder);

impl OutlineBuilder for Glyph {
    fn move_to(&mut self, x: f32, y: f32) {
        self.0.move_to(x, y);
    }

    fn line_to(&mut self, x: f32, y: f32) {
        self.0.line_to(x, y);
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        self.0.quad_to(x1, y1, x, y);
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        self.0.cubic_to(x1, y1, x2, y2, x, y);
    }

    fn close(&mut self) {
        self.0.close();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_of_advances_is_the_fonts() {
        let face = Face::parse(FONT, 0).unwrap();
        for c in (' '..='~').chain(['\u{b0}']) {
            let units = face.glyph_hor_advance(face.glyph_index(c).unwrap()).unwrap();
            let thousandths = f64::from(units) * 1000.0 / f64::from(face.units_per_em());
            assert!((thousandths - f64::from(advance(c))).abs() < 1.0, "{c:?}: {thousandths}");
        }
    }
}
