//! Values of named things: a row each, with dots and their intervals.
use super::{
    COLUMN_PT,
    canvas::{Anchor, Canvas, Color, Ink, text_width},
    line_plot::wrap,
};

/// One quantity in one row: its value and, where there is one, its interval.
pub type Dot = (f64, Option<[f64; 2]>);

/// Rows of dots on a common axis from 0 to 1.
#[derive(Debug, Clone, PartialEq)]
pub struct DotPlot {
    /// Below the axis.
    pub label: String,
    /// Names of the quantities, in the order of each row's dots.
    pub quantities: Vec<String>,
    /// From the top: name, count, a dot a quantity.
    pub rows: Vec<(String, u64, Vec<Dot>)>,
    /// A sentence below the plot; wrapped.
    pub caption: String,
}

const FONT: f64 = 7.5;
const ROW: f64 = 14.0;

impl DotPlot {
    /// Lays the plot out.
    #[must_use]
    pub fn draw(&self) -> Canvas {
        let width_of = |texts: &mut dyn Iterator<Item = String>| texts.map(|t| text_width(&t, FONT)).fold(0.0, f64::max);
        let names = width_of(&mut self.rows.iter().map(|r| shortened(&r.0)));
        let counts = width_of(&mut self.rows.iter().map(|r| format!("n={}", r.1)));
        let (left, right) = (names + 10.0, COLUMN_PT - counts - 10.0);
        let top = 18.0;
        let bottom = top + ROW * self.rows.len() as f64;
        let caption = wrap(&self.caption, FONT - 0.5, COLUMN_PT - 8.0);
        let mut page = Canvas::new(COLUMN_PT, bottom + 28.0 + 8.5 * caption.len() as f64);
        let place = |v: f64| left + v.clamp(0.0, 1.0) * (right - left);
        self.draw_legend(&mut page, left);
        for v in [0.0, 0.25, 0.5, 0.75, 1.0] {
            page.line([place(v), top], [place(v), bottom], Ink::solid(Color::LIGHT, 0.5));
            page.text([place(v), bottom + 10.0], if v == 0.0 { "0".into() } else { format!("{v:.2}") }, FONT, Anchor::Middle, Color::BLACK);
        }
        page.line([left, bottom], [right, bottom], Ink::solid(Color::BLACK, 0.7));
        for (k, (name, count, dots)) in self.rows.iter().enumerate() {
            let y = top + ROW * (k as f64 + 0.5);
            page.text([left - 5.0, y + FONT * 0.35], shortened(name), FONT, Anchor::End, Color::BLACK);
            page.text([right + 8.0, y + FONT * 0.35], format!("n={count}"), FONT, Anchor::Start, Color::GREY);
            for (q, (value, interval)) in dots.iter().enumerate() {
                // Quantities of one row stand a little apart, so that no interval hides another.
                let y = y + (q as f64 - (dots.len() as f64 - 1.0) / 2.0) * 4.0;
                if let Some([lo, hi]) = interval {
                    page.line([place(*lo), y], [place(*hi), y], Ink::solid(Color::series(q), 1.0));
                }
                page.dot([place(*value), y], 2.2, Color::series(q));
            }
        }
        page.text([(left + right) / 2.0, bottom + 21.0], &self.label, FONT, Anchor::Middle, Color::BLACK);
        for (k, line) in caption.iter().enumerate() {
            page.text([4.0, bottom + 32.0 + 8.5 * k as f64], line, FONT - 0.5, Anchor::Start, Color::GREY);
        }
        page
    }

    fn draw_legend(&self, page: &mut Canvas, left: f64) {
        let total: f64 = self.quantities.iter().map(|q| text_width(q, FONT) + 18.0).sum();
        let mut x = left.min(COLUMN_PT - total).max(2.0);
        for (k, name) in self.quantities.iter().enumerate() {
            page.dot([x + 3.0, 8.0], 2.2, Color::series(k));
            page.text([x + 8.0, 8.0 + FONT * 0.35], name, FONT, Anchor::Start, Color::BLACK);
            x += text_width(name, FONT) + 18.0;
        }
    }
}

/// A name's last part where it is too long for its margin.
fn shortened(name: &str) -> String {
    const LONGEST: usize = 24;
    let length = name.chars().count();
    if length <= LONGEST { name.to_owned() } else { format!("...{}", name.chars().skip(length + 3 - LONGEST).collect::<String>()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figures::Shape;

    #[test]
    fn rows_have_their_names_and_dots() {
        let rows = vec![("crayon".to_owned(), 12, vec![(0.5, Some([0.4, 0.6])), (0.3, None)]), ("x".repeat(60), 3, vec![(1.0, None)])];
        let plot = DotPlot { label: "fraction".into(), quantities: vec!["recall".into(), "IoU".into()], rows, caption: "One.".into() };
        let page = plot.draw();
        let dots = page.shapes.iter().filter(|s| matches!(s, Shape::Dot { .. })).count();
        assert_eq!(dots, 3 + 2);
        let inside = |s: &Shape| match s {
            Shape::Text { at, text, size, anchor, .. } => {
                let w = text_width(text, *size);
                let left = at[0]
                    - match anchor {
                        Anchor::Start => 0.0,
                        Anchor::Middle => w / 2.0,
                        Anchor::End => w,
                    };
                left >= 0.0 && left + w <= page.width && at[1] <= page.height
            }
            _ => true,
        };
        assert!(page.shapes.iter().all(inside));
    }
}
