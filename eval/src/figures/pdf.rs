//! Writes a canvas as PDF 1.4, one page of its size. Text stays text, in Helvetica, which every reader has.
use super::{
    canvas::{Anchor, Canvas, Color, Ink, Shape, text_width},
    svg::number,
};
use std::fmt::Write;

impl Canvas {
    /// The page as a PDF file.
    #[must_use]
    pub fn pdf(&self) -> Vec<u8> {
        let mut opacities: Vec<f64> = Vec::new();
        let content = self.content(&mut opacities);
        let states: String = opacities.iter().enumerate().map(|(k, o)| format!("/G{k} << /ca {} >> ", number(*o))).collect();
        let (w, h) = (number(self.width), number(self.height));
        let objects = [
            "<< /Type /Catalog /Pages 2 0 R >>".to_owned(),
            "<< /Type /Pages /Kids [3 0 R] /Count 1 >>".into(),
            format!(
                "<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {w} {h}] /Contents 5 0 R \
                 /Resources << /Font << /F 4 0 R >> /ExtGState << {states}>> >> >>"
            ),
            "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>".into(),
        ];
        let mut out: Vec<u8> = b"%PDF-1.4\n".to_vec();
        let mut offsets = Vec::new();
        let mut object = |out: &mut Vec<u8>, body: &[u8]| {
            offsets.push(out.len());
            out.extend(format!("{} 0 obj\n", offsets.len()).bytes());
            out.extend(body);
            out.extend(b"\nendobj\n");
        };
        objects.iter().for_each(|body| object(&mut out, body.as_bytes()));
        let mut stream = format!("<< /Length {} >>\nstream\n", content.len()).into_bytes();
        stream.extend(&content);
        stream.extend(b"\nendstream");
        object(&mut out, &stream);
        let start = out.len();
        let mut tail = format!("xref\n0 {}\n0000000000 65535 f \n", offsets.len() + 1);
        offsets.iter().for_each(|o| tail += &format!("{o:010} 00000 n \n"));
        tail += &format!("trailer\n<< /Size {} /Root 1 0 R >>\nstartxref\n{start}\n%%EOF\n", offsets.len() + 1);
        out.extend(tail.bytes());
        out
    }

    /// Drawing operators, one byte a character (Latin-1).
    fn content(&self, opacities: &mut Vec<f64>) -> Vec<u8> {
        // PDF's y grows upwards; text is turned back by its own matrix.
        let mut out = format!("1 0 0 -1 0 {} cm 1 j\n", number(self.height));
        for shape in &self.shapes {
            match shape {
                Shape::Path { points, closed, ink, fill } => {
                    if let Some((color, opacity)) = fill {
                        let _ = writeln!(out, "q /G{} gs {} rg {} f Q", state(opacities, *opacity), rgb(*color), path(points, true));
                    }
                    if let Some(ink) = ink {
                        let _ = writeln!(out, "{} {} S", pen(*ink), path(points, *closed));
                    }
                }
                Shape::Dot { at, radius, color } => {
                    let _ = writeln!(out, "{} rg 1 1 1 RG 0.5 w [] 0 d {} B", rgb(*color), circle(*at, *radius));
                }
                Shape::Text { at: [x, y], text, size, anchor, upwards, color } => {
                    let shift = match anchor {
                        Anchor::Start => 0.0,
                        Anchor::Middle => text_width(text, *size) / 2.0,
                        Anchor::End => text_width(text, *size),
                    };
                    let (turn, x, y) = if *upwards { ("0 -1 -1 0", *x, y + shift) } else { ("1 0 0 -1", x - shift, *y) };
                    let (size, x, y) = (number(*size), number(x), number(y));
                    let _ = writeln!(out, "BT {} rg /F {size} Tf {turn} {x} {y} Tm ({}) Tj ET", rgb(*color), literal(text));
                }
            }
        }
        out.chars().map(|c| u8::try_from(c).unwrap_or(b'?')).collect()
    }
}

fn state(opacities: &mut Vec<f64>, opacity: f64) -> usize {
    opacities.iter().position(|o| *o == opacity).unwrap_or_else(|| {
        opacities.push(opacity);
        opacities.len() - 1
    })
}

fn rgb(color: Color) -> String {
    color.0.map(|c| format!("{:.3}", f64::from(c) / 255.0)).join(" ")
}

fn pen(ink: Ink) -> String {
    format!("{} RG {} w {} 0 d", rgb(ink.color), number(ink.width), if ink.dashed { "[3 2]" } else { "[]" })
}

fn path(points: &[[f64; 2]], closed: bool) -> String {
    let mut out = String::new();
    for (k, p) in points.iter().enumerate() {
        let _ = write!(out, "{} {} {} ", number(p[0]), number(p[1]), if k == 0 { "m" } else { "l" });
    }
    out + if closed { "h" } else { "" }
}

/// Four Bezier arcs.
fn circle([x, y]: [f64; 2], r: f64) -> String {
    let k = 0.552_284_75 * r;
    let n = |v: f64| number(v);
    let arc = |a: [f64; 6]| a.map(n).join(" ") + " c ";
    format!("{} {} m ", n(x + r), n(y))
        + &arc([x + r, y + k, x + k, y + r, x, y + r])
        + &arc([x - k, y + r, x - r, y + k, x - r, y])
        + &arc([x - r, y - k, x - k, y - r, x, y - r])
        + &arc([x + k, y - r, x + r, y - k, x + r, y])
        + "h"
}

fn literal(text: &str) -> String {
    text.replace('\\', "\\\\").replace('(', "\\(").replace(')', "\\)")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offsets_point_at_their_objects() {
        let mut page = Canvas::new(100.0, 50.0);
        page.rect([0.0, 0.0], [10.0, 10.0], Color::GREY, 0.2);
        page.dot([5.0, 5.0], 2.0, Color::BLACK);
        page.text([5.0, 5.0], "a (b) \\ 5\u{b0}", 7.0, Anchor::End, Color::BLACK);
        let pdf = page.pdf();
        let text: String = pdf.iter().map(|b| char::from(*b)).collect();
        assert!(text.contains("(a \\(b\\) \\\\ 5\u{b0}) Tj"));
        let table = text.split("xref\n").nth(1).unwrap();
        for (k, line) in table.lines().skip(2).take(5).enumerate() {
            let offset: usize = line[..10].parse().unwrap();
            assert!(text[text.char_indices().nth(offset).unwrap().0..].starts_with(&format!("{} 0 obj", k + 1)));
        }
        let start: usize = text.split("startxref\n").nth(1).unwrap().lines().next().unwrap().parse().unwrap();
        assert_eq!(&pdf[start..start + 4], b"xref");
    }
}
