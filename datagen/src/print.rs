//! A marker to print, or to trace with a pen: SVG and PDF of one sheet, the T cross with the instructions for drawing it by hand, and PNG of the
//! marker alone.
use crate::{
    color::{self, Linear},
    error::DatagenError,
    shapes::{Shape, UnitPoint},
};
use image::{Rgb, RgbImage};
use std::{fmt::Write as _, path::Path};
use tcross_dataset::files;

/// What to print. Lengths are millimetres.
#[derive(Debug, Clone, PartialEq)]
pub struct MarkerSheet {
    /// The shape.
    pub shape: Shape,
    /// Colour of the fill.
    pub fill: Rgb<u8>,
    /// Colour of the lines.
    pub line: Rgb<u8>,
    /// Side of the marker.
    pub side_mm: f64,
    /// Width of the lines.
    pub line_mm: f64,
}

impl Default for MarkerSheet {
    fn default() -> Self {
        Self { shape: Shape::TCross, fill: Rgb([0, 200, 0]), line: Rgb([0, 0, 200]), side_mm: 100.0, line_mm: 8.0 }
    }
}

/// How to draw a T cross.
const INSTRUCTIONS: [&str; 4] = [
    "Fill a rectangle with one saturated colour; a highlighter or a felt tip will do.",
    "With another colour draw one whole diagonal, corner to corner.",
    "Draw half of the other diagonal, from the middle to one corner: this stem is the marker's direction.",
    "Leave the fourth corner empty. Lines about a twelfth of the side wide are found best.",
];

/// Width of the white border in millimetres, and the room for the words below.
const BORDER_MM: f64 = 10.0;
const WORDS_MM: f64 = 28.0;

impl MarkerSheet {
    fn instructions(&self) -> &'static [&'static str] {
        if self.shape == Shape::TCross { &INSTRUCTIONS } else { &[] }
    }

    /// Checks the lengths.
    ///
    /// # Errors
    /// If the side is not within 5 to 2000 mm, or the lines are not thinner than half of it.
    pub fn validate(&self) -> Result<(), DatagenError> {
        if !(5.0..=2000.0).contains(&self.side_mm) {
            return Err(DatagenError::config("side_mm", self.side_mm, "5 to 2000"));
        }
        if !(self.line_mm > 0.0 && self.line_mm < self.side_mm / 2.0) {
            return Err(DatagenError::config(
                "line_mm",
                self.line_mm,
                format!("above 0 and below half of the side, {}", self.side_mm / 2.0),
            ));
        }
        Ok(())
    }

    fn place(&self, [u, v]: UnitPoint) -> [f64; 2] {
        [BORDER_MM + u * self.side_mm, BORDER_MM + v * self.side_mm]
    }

    fn size_mm(&self) -> [f64; 2] {
        [(self.side_mm + 2.0 * BORDER_MM).max(110.0), self.side_mm + 2.0 * BORDER_MM + WORDS_MM]
    }

    /// The outline's sides, where they are drawn, and the lines.
    fn lines(&self) -> Vec<[UnitPoint; 2]> {
        let geometry = self.shape.geometry();
        let n = geometry.outline.len();
        let frame = (0..if geometry.framed { n } else { 0 }).map(|k| [geometry.outline[k], geometry.outline[(k + 1) % n]]);
        frame.chain(geometry.lines.iter().copied()).collect()
    }

    /// As SVG, in millimetres. Lines are clipped to the marker, so that they end in its corners.
    #[must_use]
    pub fn svg(&self) -> String {
        let [w, h] = self.size_mm();
        let mut out = format!("<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}mm\" height=\"{h}mm\" viewBox=\"0 0 {w} {h}\">\n");
        let hex = |c: Rgb<u8>| color::hex(color::linear(c));
        let path = |points: &[UnitPoint]| {
            let words: Vec<String> = points.iter().map(|p| self.place(*p)).map(|[x, y]| format!("{x},{y}")).collect();
            words.join(" ")
        };
        let outline = path(self.shape.geometry().outline);
        // Writing to a string cannot fail.
        let _ = writeln!(
            out,
            "<rect width=\"{w}\" height=\"{h}\" fill=\"#ffffff\"/>\n<clipPath id=\"marker\"><polygon points=\"{outline}\"/></clipPath>"
        );
        if self.shape.geometry().filled {
            let _ = writeln!(out, "<polygon points=\"{outline}\" fill=\"{}\"/>", hex(self.fill));
        }
        for ends in self.lines() {
            let [[x1, y1], [x2, y2]] = ends.map(|p| self.place(p));
            let style = format!("stroke=\"{}\" stroke-width=\"{}\" clip-path=\"url(#marker)\"", hex(self.line), self.line_mm);
            let _ = writeln!(out, "<line x1=\"{x1}\" y1=\"{y1}\" x2=\"{x2}\" y2=\"{y2}\" {style} stroke-linecap=\"round\"/>");
        }
        for (k, words) in self.instructions().iter().enumerate() {
            let y = self.side_mm + 2.0 * BORDER_MM + 5.0 * k as f64;
            let _ = writeln!(
                out,
                "<text x=\"{BORDER_MM}\" y=\"{y}\" font-family=\"sans-serif\" font-size=\"2.2\" fill=\"#444444\">{}. {words}</text>",
                k + 1
            );
        }
        out + "</svg>\n"
    }

    /// As PDF of one page.
    #[must_use]
    pub fn pdf(&self) -> Vec<u8> {
        const POINTS: f64 = 72.0 / 25.4;
        let [w, h] = self.size_mm().map(|v| v * POINTS);
        let at = |p: UnitPoint| {
            let [x, y] = self.place(p).map(|v| v * POINTS);
            format!("{x:.4} {:.4}", h - y)
        };
        let rgb = |Rgb(c): Rgb<u8>| c.map(|v| format!("{:.4}", f64::from(v) / 255.0)).join(" ");
        let outline = self.shape.geometry().outline;
        let mut path = format!("{} m", at(outline[0]));
        outline[1..].iter().for_each(|p| path += &format!(" {} l", at(*p)));
        let mut page = String::new();
        if self.shape.geometry().filled {
            page += &format!("{} rg {path} h f\n", rgb(self.fill));
        }
        page += &format!("q {path} h W n\n{} RG {:.4} w 1 J\n", rgb(self.line), self.line_mm * POINTS);
        self.lines().iter().for_each(|[a, b]| page += &format!("{} m {} l S\n", at(*a), at(*b)));
        page += "Q\nBT /F1 6.2 Tf 0.27 g\n";
        for (k, words) in self.instructions().iter().enumerate() {
            let y = h - (self.side_mm + 2.0 * BORDER_MM + 5.0 * k as f64) * POINTS;
            page += &format!("1 0 0 1 {:.4} {y:.4} Tm ({}. {words}) Tj\n", BORDER_MM * POINTS, k + 1);
        }
        page += "ET\n";
        let objects = [
            "<< /Type /Catalog /Pages 2 0 R >>".to_owned(),
            "<< /Type /Pages /Kids [3 0 R] /Count 1 >>".to_owned(),
            format!("<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {w:.4} {h:.4}] /Contents 4 0 R /Resources << /Font << /F1 5 0 R >> >> >>"),
            format!("<< /Length {} >>\nstream\n{page}endstream", page.len()),
            "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>".to_owned(),
        ];
        let mut out = String::from("%PDF-1.4\n");
        let mut starts = Vec::new();
        for (k, object) in objects.iter().enumerate() {
            starts.push(out.len());
            out += &format!("{} 0 obj\n{object}\nendobj\n", k + 1);
        }
        let table = out.len();
        out += &format!("xref\n0 {}\n0000000000 65535 f \n", objects.len() + 1);
        starts.iter().for_each(|s| out += &format!("{s:010} 00000 n \n"));
        out += &format!("trailer << /Size {} /Root 1 0 R >>\nstartxref\n{table}\n%%EOF\n", objects.len() + 1);
        out.into_bytes()
    }

    /// As a picture of `pixels` by `pixels` with a white border of a tenth, four samples a pixel each way.
    #[must_use]
    pub fn png(&self, pixels: u32) -> RgbImage {
        const FINE: u32 = 4;
        let big = pixels * FINE;
        let (margin, side) = (f64::from(big) * 0.1, f64::from(big) * 0.8);
        let mut image = RgbImage::from_pixel(big, big, Rgb([255; 3]));
        let geometry = self.shape.geometry();
        let inside = |x: f64, y: f64| crossings_odd(geometry.outline, [(x - margin) / side, (y - margin) / side]);
        let half = self.line_mm / self.side_mm / 2.0;
        let lines = self.lines();
        for (x, y, pixel) in image.enumerate_pixels_mut() {
            let (px, py) = (f64::from(x) + 0.5, f64::from(y) + 0.5);
            let p = [(px - margin) / side, (py - margin) / side];
            if geometry.filled && inside(px, py) {
                *pixel = self.fill;
            }
            if (inside(px, py) || !geometry.filled) && lines.iter().any(|l| distance(p, *l) <= half) {
                *pixel = self.line;
            }
        }
        let mut out = RgbImage::new(pixels, pixels);
        for (x, y, pixel) in out.enumerate_pixels_mut() {
            let mut sum: Linear = [0.0; 3];
            for k in 0..FINE * FINE {
                let light = color::linear(*image.get_pixel(x * FINE + k % FINE, y * FINE + k / FINE));
                (0..3).for_each(|c| sum[c] += light[c] / (FINE * FINE) as f32);
            }
            *pixel = Rgb(sum.map(color::stored));
        }
        out
    }

    /// Writes the sheet as what the name ends in: `.svg`, `.pdf` or `.png`.
    ///
    /// # Errors
    /// If the lengths cannot be, the ending is another, or the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), DatagenError> {
        let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        self.save_as(&ending, path)
    }

    /// Writes the sheet as `svg`, `pdf` or `png` (ten pixels a millimetre of the marker, 1600 pixels at most) under any name.
    ///
    /// # Errors
    /// If the lengths cannot be, the form is another, or the file cannot be written.
    pub fn save_as(&self, form: &str, path: &Path) -> Result<(), DatagenError> {
        self.validate()?;
        match form {
            "svg" => files::write_atomically(path, self.svg())?,
            "pdf" => files::write_atomically(path, self.pdf())?,
            "png" => {
                let mut bytes = std::io::Cursor::new(Vec::new());
                let pixels = ((self.side_mm * 12.5) as u32).clamp(64, 1600);
                let encoded = self.png(pixels).write_to(&mut bytes, image::ImageFormat::Png);
                encoded.map_err(|e| DatagenError::Encode { path: path.to_owned(), message: e.to_string() })?;
                files::write_atomically(path, bytes.into_inner())?;
            }
            other => return Err(DatagenError::config("marker file", format!("'.{other}'"), ".svg, .pdf or .png")),
        }
        Ok(())
    }
}

fn distance(p: UnitPoint, [a, b]: [UnitPoint; 2]) -> f64 {
    let d = [b[0] - a[0], b[1] - a[1]];
    let t = (((p[0] - a[0]) * d[0] + (p[1] - a[1]) * d[1]) / (d[0] * d[0] + d[1] * d[1]).max(1e-12)).clamp(0.0, 1.0);
    ((p[0] - a[0] - t * d[0]).powi(2) + (p[1] - a[1] - t * d[1]).powi(2)).sqrt()
}

fn crossings_odd(outline: &[UnitPoint], p: UnitPoint) -> bool {
    (0..outline.len()).fold(false, |inside, k| {
        let (a, b) = (outline[k], outline[(k + 1) % outline.len()]);
        let crossed = (a[1] <= p[1]) != (b[1] <= p[1]) && p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);
        inside != crossed
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_picture_has_three_arms() {
        let image = MarkerSheet::default().png(200);
        let at = |u: f64, v: f64| image.get_pixel((20.0 + u * 160.0) as u32, (20.0 + v * 160.0) as u32).0;
        assert_eq!(at(0.5, 0.5), [0, 0, 200]);
        assert_eq!([at(0.25, 0.25), at(0.75, 0.25), at(0.25, 0.75)], [[0, 0, 200]; 3]);
        assert_eq!([at(0.75, 0.75), at(0.5, 0.1)], [[0, 200, 0]; 2]);
        assert_eq!(at(-0.05, 0.5), [255; 3]);
    }

    #[test]
    fn every_form_is_written_and_others_refused() {
        let dir = tempfile::tempdir().unwrap();
        let sheet = MarkerSheet { side_mm: 20.0, line_mm: 2.0, ..Default::default() };
        for (name, start) in [("m.svg", &b"<svg"[..]), ("m.pdf", b"%PDF-1.4"), ("m.png", b"\x89PNG")] {
            let path = dir.path().join(name);
            sheet.save(&path).unwrap();
            assert!(std::fs::read(path).unwrap().starts_with(start));
        }
        let text = String::from_utf8(sheet.pdf()).unwrap();
        let table: usize = text.rsplit("startxref\n").next().unwrap().lines().next().unwrap().parse().unwrap();
        assert!(text[table..].starts_with("xref"));
        assert!(sheet.save(&dir.path().join("m.gif")).unwrap_err().to_string().contains(".svg, .pdf or .png"));
        assert!(MarkerSheet { side_mm: 1.0, ..sheet }.validate().is_err());
    }
}
