//! Writes a canvas as PNG, lettered with the subset of Arimo in `assets/`.
use super::{
    canvas::{Anchor, Canvas, Color, Ink, Shape, text_width},
    text_outline::outline_text,
};
use image::ImageEncoder;
use tiny_skia::{FillRule, LineJoin, Paint, Path, PathBuilder, Pixmap, Stroke, StrokeDash, Transform};

impl Canvas {
    /// The page as a PNG file, `scale` pixels a point. A page of no size gives no bytes.
    #[must_use]
    pub fn png(&self, scale: f64) -> Vec<u8> {
        let size = |v: f64| (v * scale).ceil().max(0.0) as u32;
        let Some(mut pixels) = Pixmap::new(size(self.width), size(self.height)) else { return Vec::new() };
        pixels.fill(tiny_skia::Color::WHITE);
        let to_pixels = Transform::from_scale(scale as f32, scale as f32);
        for shape in &self.shapes {
            draw(&mut pixels, shape, to_pixels);
        }
        encode(&pixels).unwrap_or_default()
    }
}

/// The page is opaque, so its premultiplied colours are its colours.
fn encode(pixels: &Pixmap) -> Option<Vec<u8>> {
    let rgb: Vec<u8> = pixels.data().chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
    let mut out = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut out);
    encoder.write_image(&rgb, pixels.width(), pixels.height(), image::ExtendedColorType::Rgb8).ok()?;
    Some(out)
}

fn draw(pixels: &mut Pixmap, shape: &Shape, to_pixels: Transform) {
    match shape {
        Shape::Path { points, closed, ink, fill } => {
            let Some(path) = polyline(points, *closed) else { return };
            if let Some((color, opacity)) = fill {
                pixels.fill_path(&path, &paint(*color, *opacity), FillRule::Winding, to_pixels, None);
            }
            if let Some(ink) = ink {
                pixels.stroke_path(&path, &paint(ink.color, 1.0), &stroke(*ink), to_pixels, None);
            }
        }
        Shape::Dot { at: [x, y], radius, color } => {
            if let Some(path) = PathBuilder::from_circle(*x as f32, *y as f32, *radius as f32) {
                pixels.fill_path(&path, &paint(*color, 1.0), FillRule::Winding, to_pixels, None);
                let rim = Stroke { width: 0.5, ..Stroke::default() };
                pixels.stroke_path(&path, &paint(Color::WHITE, 1.0), &rim, to_pixels, None);
            }
        }
        Shape::Text { at: [x, y], text, size, anchor, upwards, color } => {
            let shift = match anchor {
                Anchor::Start => 0.0,
                Anchor::Middle => text_width(text, *size) / 2.0,
                Anchor::End => text_width(text, *size),
            };
            let turn = if *upwards { -90.0 } else { 0.0 };
            let place = Transform::from_translate(-shift as f32, 0.0)
                .post_concat(Transform::from_rotate(turn))
                .post_translate(*x as f32, *y as f32)
                .post_concat(to_pixels);
            if let Some(path) = outline_text(text, *size) {
                pixels.fill_path(&path, &paint(*color, 1.0), FillRule::Winding, place, None);
            }
        }
    }
}

fn polyline(points: &[[f64; 2]], closed: bool) -> Option<Path> {
    let mut path = PathBuilder::new();
    for (k, p) in points.iter().enumerate() {
        let (x, y) = (p[0] as f32, p[1] as f32);
        if k == 0 { path.move_to(x, y) } else { path.line_to(x, y) }
    }
    if closed {
        path.close();
    }
    path.finish()
}

fn paint(color: Color, opacity: f64) -> Paint<'static> {
    let [r, g, b] = color.0;
    let mut paint = Paint { anti_alias: true, ..Paint::default() };
    paint.set_color_rgba8(r, g, b, (opacity * 255.0).round() as u8);
    paint
}

fn stroke(ink: Ink) -> Stroke {
    let dash = if ink.dashed { StrokeDash::new(vec![3.0, 2.0], 0.0) } else { None };
    Stroke { width: ink.width as f32, line_join: LineJoin::Round, dash, ..Stroke::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_fills_and_letters_leave_ink() {
        let mut page = Canvas::new(60.0, 30.0);
        page.rect([1.0, 1.0], [11.0, 11.0], Color([200, 0, 0]), 1.0);
        page.text([20.0, 20.0], "Hm", 10.0, Anchor::Start, Color::BLACK);
        let image = image::load_from_memory(&page.png(2.0)).unwrap().into_rgb8();
        assert_eq!(image.dimensions(), (120, 60));
        assert_eq!(image.get_pixel(10, 10).0, [200, 0, 0]);
        // The stem of the H stands at the left of the letter, from the baseline up.
        let dark = |x0: u32, x1: u32, y0: u32, y1: u32| {
            (x0..x1).flat_map(|x| (y0..y1).map(move |y| (x, y))).filter(|&(x, y)| image.get_pixel(x, y).0[1] < 128).count()
        };
        assert!(dark(40, 75, 26, 40) > 60 && dark(40, 75, 41, 60) == 0 && dark(76, 120, 0, 60) == 0);
        assert!(Canvas::new(0.0, 0.0).png(2.0).is_empty());
    }
}
