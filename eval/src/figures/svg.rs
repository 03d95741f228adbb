//! Writes a canvas as SVG.
use super::canvas::{Anchor, Canvas, Ink, Shape};
use std::fmt::Write;

impl Canvas {
    /// The page as a self-contained SVG element: its size is in points, text stays text.
    #[must_use]
    pub fn svg(&self) -> String {
        let (w, h) = (number(self.width), number(self.height));
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}pt\" height=\"{h}pt\" viewBox=\"0 0 {w} {h}\" \
             font-family=\"Helvetica, Arial, 'Liberation Sans', sans-serif\">\n<rect width=\"{w}\" height=\"{h}\" fill=\"#fff\"/>\n"
        );
        for shape in &self.shapes {
            write_shape(&mut out, shape);
        }
        out.push_str("</svg>\n");
        out
    }
}

// Writing to a String cannot fail, so the results of `write!` are dropped here.
fn write_shape(out: &mut String, shape: &Shape) {
    let _ = match shape {
        Shape::Path { points, closed, ink, fill } => {
            let list: Vec<String> = points.iter().map(|p| format!("{},{}", number(p[0]), number(p[1]))).collect();
            let fill = fill.map_or("fill=\"none\"".into(), |(c, opacity)| match opacity {
                1.0 => format!("fill=\"{}\"", c.hex()),
                _ => format!("fill=\"{}\" fill-opacity=\"{}\"", c.hex(), number(opacity)),
            });
            let tag = if *closed { "polygon" } else { "polyline" };
            writeln!(out, "<{tag} points=\"{}\" {fill}{}/>", list.join(" "), ink.map_or(String::new(), stroke))
        }
        Shape::Dot { at: [x, y], radius, color } => writeln!(
            out,
            "<circle cx=\"{}\" cy=\"{}\" r=\"{}\" fill=\"{}\" stroke=\"#fff\" stroke-width=\"0.5\"/>",
            number(*x),
            number(*y),
            number(*radius),
            color.hex()
        ),
        Shape::Text { at: [x, y], text, size, anchor, upwards, color } => {
            let (x, y) = (number(*x), number(*y));
            let anchor = match anchor {
                Anchor::Start => "",
                Anchor::Middle => " text-anchor=\"middle\"",
                Anchor::End => " text-anchor=\"end\"",
            };
            let turn = if *upwards { format!(" transform=\"rotate(-90 {x} {y})\"") } else { String::new() };
            writeln!(
                out,
                "<text x=\"{x}\" y=\"{y}\" font-size=\"{}\" fill=\"{}\"{anchor}{turn}>{}</text>",
                number(*size),
                color.hex(),
                escape(text)
            )
        }
    };
}

fn stroke(ink: Ink) -> String {
    let dash = if ink.dashed { " stroke-dasharray=\"3 2\"" } else { "" };
    format!(" stroke=\"{}\" stroke-width=\"{}\" stroke-linejoin=\"round\"{dash}", ink.color.hex(), number(ink.width))
}

/// Two decimals at most: a fiftieth of a point is finer than any printer.
pub(super) fn number(v: f64) -> String {
    let rounded = (v * 100.0).round() / 100.0;
    format!("{}", if rounded == 0.0 { 0.0 } else { rounded })
}

/// Text made safe between tags and in attributes.
#[must_use]
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figures::Color;

    #[test]
    fn text_is_escaped_and_numbers_are_short() {
        let mut page = Canvas::new(10.0, 10.0);
        page.text([1.0 / 3.0, -0.001], "a<b & c", 7.0, Anchor::Middle, Color::BLACK);
        let svg = page.svg();
        assert!(svg.contains("x=\"0.33\" y=\"0\"") && svg.contains("a&lt;b &amp; c"), "{svg}");
    }
}
