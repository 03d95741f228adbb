//! A page of shapes, in points; (0, 0) is the upper left corner, y grows downwards.

/// An opaque colour, `[red, green, blue]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Color(pub [u8; 3]);

impl Color {
    /// Text and axes.
    pub const BLACK: Self = Self([34, 34, 34]);
    /// Secondary text.
    pub const GREY: Self = Self([110, 110, 110]);
    /// Grid lines.
    pub const LIGHT: Self = Self([225, 225, 225]);
    /// The page.
    pub const WHITE: Self = Self([255, 255, 255]);

    /// The colours of series 0, 1, ... (Okabe and Ito, without the yellow that is too light for lines).
    #[must_use]
    pub fn series(index: usize) -> Self {
        const PALETTE: [[u8; 3]; 7] =
            [[0, 114, 178], [213, 94, 0], [0, 158, 115], [204, 121, 167], [230, 159, 0], [86, 180, 233], [34, 34, 34]];
        Self(PALETTE[index % PALETTE.len()])
    }

    /// `#rrggbb`.
    #[must_use]
    pub fn hex(self) -> String {
        let [r, g, b] = self.0;
        format!("#{r:02x}{g:02x}{b:02x}")
    }
}

/// A line drawn along a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ink {
    /// Its colour.
    pub color: Color,
    /// Its width in points.
    pub width: f64,
    /// True for a dashed line.
    pub dashed: bool,
}

impl Ink {
    /// A solid line.
    #[must_use]
    pub fn solid(color: Color, width: f64) -> Self {
        Self { color, width, dashed: false }
    }
}

/// Which part of a text stands at its point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Anchor {
    /// Its left end.
    Start,
    /// Its middle.
    Middle,
    /// Its right end.
    End,
}

/// What a canvas can hold.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    /// A polyline, or a polygon.
    Path {
        /// In order, in points.
        points: Vec<[f64; 2]>,
        /// True if the last point joins the first.
        closed: bool,
        /// The line along it.
        ink: Option<Ink>,
        /// What fills it, and how opaque (0..1).
        fill: Option<(Color, f64)>,
    },
    /// A disc, with a white rim that sets it off from lines below.
    Dot {
        /// Its centre.
        at: [f64; 2],
        /// In points.
        radius: f64,
        /// Its colour.
        color: Color,
    },
    /// One line of text.
    Text {
        /// Where the anchor stands; y is the baseline.
        at: [f64; 2],
        /// What it says.
        text: String,
        /// Height of the font in points.
        size: f64,
        /// Which part stands at `at`.
        anchor: Anchor,
        /// True for text that reads upwards.
        upwards: bool,
        /// Its colour.
        color: Color,
    },
}

/// Shapes on a white page, in the order in which they are laid down.
#[derive(Debug, Clone, PartialEq)]
pub struct Canvas {
    /// In points.
    pub width: f64,
    /// In points.
    pub height: f64,
    /// From the lowest to the topmost.
    pub shapes: Vec<Shape>,
}

impl Canvas {
    /// An empty page.
    #[must_use]
    pub fn new(width: f64, height: f64) -> Self {
        Self { width, height, shapes: Vec::new() }
    }

    /// A straight line.
    pub fn line(&mut self, from: [f64; 2], to: [f64; 2], ink: Ink) {
        self.polyline(vec![from, to], ink);
    }

    /// A line through points; fewer than two draw nothing.
    pub fn polyline(&mut self, points: Vec<[f64; 2]>, ink: Ink) {
        if points.len() > 1 {
            self.shapes.push(Shape::Path { points, closed: false, ink: Some(ink), fill: None });
        }
    }

    /// A filled polygon without an outline.
    pub fn polygon(&mut self, points: Vec<[f64; 2]>, color: Color, opacity: f64) {
        if points.len() > 2 {
            self.shapes.push(Shape::Path { points, closed: true, ink: None, fill: Some((color, opacity)) });
        }
    }

    /// A filled rectangle between two corners.
    pub fn rect(&mut self, [x0, y0]: [f64; 2], [x1, y1]: [f64; 2], color: Color, opacity: f64) {
        self.polygon(vec![[x0, y0], [x1, y0], [x1, y1], [x0, y1]], color, opacity);
    }

    /// A disc.
    pub fn dot(&mut self, at: [f64; 2], radius: f64, color: Color) {
        self.shapes.push(Shape::Dot { at, radius, color });
    }

    /// One line of text.
    pub fn text(&mut self, at: [f64; 2], text: impl Into<String>, size: f64, anchor: Anchor, color: Color) {
        self.shapes.push(Shape::Text { at, text: text.into(), size, anchor, upwards: false, color });
    }

    /// One line of text that reads upwards.
    pub fn text_upwards(&mut self, at: [f64; 2], text: impl Into<String>, size: f64, anchor: Anchor, color: Color) {
        self.shapes.push(Shape::Text { at, text: text.into(), size, anchor, upwards: true, color });
    }
}

/// Width of a text in points. The advances are Helvetica's, which Arial and Liberation Sans share.
#[must_use]
pub fn text_width(text: &str, size: f64) -> f64 {
    text.chars().map(|c| f64::from(advance(c))).sum::<f64>() * size / 1000.0
}

/// Advance of a character in thousandths of the font's height.
pub(super) fn advance(c: char) -> u16 {
    const WIDTHS: [u16; 95] = [
        278, 278, 355, 556, 556, 889, 667, 191, 333, 333, 389, 584, 278, 333, 278, 278, 556, 556, 556, 556, 556, 556, 556, 556, 556, 556,
        278, 278, 584, 584, 584, 556, 1015, 667, 667, 722, 722, 667, 611, 778, 722, 278, 500, 667, 556, 833, 722, 778, 667, 778, 722, 667,
        611, 722, 667, 944, 667, 667, 611, 278, 278, 278, 469, 556, 333, 556, 556, 500, 556, 556, 278, 556, 556, 222, 222, 500, 222, 833,
        556, 556, 556, 556, 333, 500, 278, 556, 500, 722, 500, 500, 500, 334, 260, 334, 584,
    ];
    match c {
        ' '..='~' => WIDTHS[c as usize - 32],
        '\u{b0}' => 400,
        _ => 584,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn widths_are_helveticas() {
        assert!((text_width("Wij ", 10.0) - (9.44 + 2.22 + 2.22 + 2.78)).abs() < 1e-9);
        assert_eq!(text_width("", 10.0), 0.0);
    }
}
