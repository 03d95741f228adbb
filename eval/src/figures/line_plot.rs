//! Curves with bands, marks and labels.
use super::{
    COLUMN_PT,
    axis::{Axis, Fitted},
    canvas::{Anchor, Canvas, Color, Ink, text_width},
};

/// One curve of a plot.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Its name in the legend; empty for none.
    pub label: String,
    /// In the order in which they are joined. Points that are not finite interrupt the curve.
    pub points: Vec<[f64; 2]>,
    /// An uncertainty: `[x, low, high]` along the curve.
    pub band: Vec<[f64; 3]>,
    /// Texts at points of the curve (index, text); what finds no free place is left out.
    pub notes: Vec<(usize, String)>,
    /// True for a line through the points.
    pub joined: bool,
    /// True for a disc at each point.
    pub marked: bool,
    /// True for a dashed line.
    pub dashed: bool,
    /// Its colour; without, the next of the palette.
    pub color: Option<Color>,
}

impl Series {
    /// A curve.
    #[must_use]
    pub fn line(label: impl Into<String>, points: Vec<[f64; 2]>) -> Self {
        Self { label: label.into(), points, band: Vec::new(), notes: Vec::new(), joined: true, marked: false, dashed: false, color: None }
    }

    /// Points that are not joined.
    #[must_use]
    pub fn dots(label: impl Into<String>, points: Vec<[f64; 2]>) -> Self {
        Self { joined: false, marked: true, ..Self::line(label, points) }
    }

    /// The same curve with a disc at each point.
    #[must_use]
    pub fn marked(mut self) -> Self {
        self.marked = true;
        self
    }

    /// The same curve, dashed.
    #[must_use]
    pub fn dashed(mut self) -> Self {
        self.dashed = true;
        self
    }

    /// The same curve in a colour of its own.
    #[must_use]
    pub fn colored(mut self, color: Color) -> Self {
        self.color = Some(color);
        self
    }

    /// The same curve within a band of `[x, low, high]`.
    #[must_use]
    pub fn within(mut self, band: Vec<[f64; 3]>) -> Self {
        self.band = band;
        self
    }
}

/// A plot of one or more curves.
#[derive(Debug, Clone, PartialEq)]
pub struct LinePlot {
    /// Above the plot; empty for none.
    pub title: String,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// From the lowest to the topmost.
    pub series: Vec<Series>,
    /// A sentence below the plot; wrapped.
    pub caption: String,
    /// Of the whole figure, in points.
    pub width: f64,
    /// Of the area between the axes, in points.
    pub plot_height: f64,
}

const FONT: f64 = 7.5;
const LINE: f64 = 10.0;

impl LinePlot {
    /// An empty plot, one column wide.
    #[must_use]
    pub fn new(title: impl Into<String>, x: Axis, y: Axis) -> Self {
        Self { title: title.into(), x, y, series: Vec::new(), caption: String::new(), width: COLUMN_PT, plot_height: 135.0 }
    }

    /// The plot with one more curve.
    #[must_use]
    pub fn with(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// The plot with a sentence below it.
    #[must_use]
    pub fn caption(mut self, text: impl Into<String>) -> Self {
        self.caption = text.into();
        self
    }

    /// The plot as SVG.
    #[must_use]
    pub fn svg(&self) -> String {
        self.draw().svg()
    }

    /// Lays the plot out: title, legend, axes, bands, curves, notes, caption, none over another.
    #[must_use]
    pub fn draw(&self) -> Canvas {
        let x = self.x.fit(self.series.iter().flat_map(|s| s.points.iter().map(|p| p[0])));
        let values = |s: &Series| s.points.iter().map(|p| p[1]).chain(s.band.iter().flat_map(|b| [b[1], b[2]])).collect::<Vec<_>>();
        let y = self.y.fit(self.series.iter().flat_map(values));
        let legend = self.legend_rows();
        let caption = wrap(&self.caption, FONT - 0.5, self.width - 8.0);
        let widest = y.ticks.iter().map(|t| text_width(&t.1, FONT)).fold(0.0, f64::max);
        let left = widest + LINE + 12.0;
        let mut top = 5.0 + LINE * legend.len() as f64;
        if !self.title.is_empty() {
            top += LINE + 3.0;
        }
        let last = x.ticks.last().map_or(0.0, |t| text_width(&t.1, FONT) / 2.0);
        let area = Area { left, top, right: self.width - last.max(6.0) - 2.0, bottom: top + self.plot_height };
        let height = area.bottom + 2.0 * LINE + 8.0 + (LINE - 1.5) * caption.len() as f64;
        let mut page = Canvas::new(self.width, height);
        if !self.title.is_empty() {
            page.text([area.left, LINE], &self.title, FONT + 1.0, Anchor::Start, Color::BLACK);
        }
        draw_legend(&mut page, &legend, area.left, if self.title.is_empty() { 2.0 } else { LINE + 5.0 });
        self.draw_axes(&mut page, &area, &x, &y);
        let mut notes = Vec::new();
        let mut taken = Vec::new();
        for (k, series) in self.series.iter().enumerate() {
            let color = series.color.unwrap_or(Color::series(k));
            self.draw_series(&mut page, &area, (&x, &y), series, color);
            let place = |p: [f64; 2]| self.shows(p).then(|| area.place(&x, &y, p));
            taken.extend(series.points.iter().filter_map(|p| place(*p)));
            if series.joined {
                taken.extend(series.points.windows(2).filter_map(|w| Some((place(w[0])?, place(w[1])?))).flat_map(between));
            }
            notes.extend(series.notes.iter().filter_map(|(i, text)| Some((place(*series.points.get(*i)?)?, text.clone(), color))));
        }
        draw_notes(&mut page, &area, notes, &taken);
        for (k, line) in caption.iter().enumerate() {
            let y = area.bottom + 2.0 * LINE + 12.0 + (LINE - 1.5) * k as f64;
            page.text([4.0, y], line, FONT - 0.5, Anchor::Start, Color::GREY);
        }
        page
    }

    fn shows(&self, p: [f64; 2]) -> bool {
        self.x.shows(p[0]) && self.y.shows(p[1])
    }

    fn draw_axes(&self, page: &mut Canvas, area: &Area, x: &Fitted, y: &Fitted) {
        for (v, text) in &y.ticks {
            let at = area.bottom - y.place(*v) * (area.bottom - area.top);
            page.line([area.left, at], [area.right, at], Ink::solid(Color::LIGHT, 0.5));
            page.text([area.left - 4.0, at + FONT * 0.35], text, FONT, Anchor::End, Color::BLACK);
        }
        for (v, text) in &x.ticks {
            let at = area.left + x.place(*v) * (area.right - area.left);
            page.line([at, area.top], [at, area.bottom], Ink::solid(Color::LIGHT, 0.5));
            page.text([at, area.bottom + LINE], text, FONT, Anchor::Middle, Color::BLACK);
        }
        let axis = Ink::solid(Color::BLACK, 0.7);
        page.line([area.left, area.top], [area.left, area.bottom], axis);
        page.line([area.left, area.bottom], [area.right, area.bottom], axis);
        let middle = [(area.left + area.right) / 2.0, (area.top + area.bottom) / 2.0];
        page.text([middle[0], area.bottom + 2.0 * LINE + 1.0], &self.x.label, FONT, Anchor::Middle, Color::BLACK);
        page.text_upwards([LINE - 1.0, middle[1]], &self.y.label, FONT, Anchor::Middle, Color::BLACK);
    }

    fn draw_series(&self, page: &mut Canvas, area: &Area, (x, y): (&Fitted, &Fitted), series: &Series, color: Color) {
        let place = |p: [f64; 2]| area.place(x, y, p);
        let band: Vec<_> = series.band.iter().filter(|b| self.shows([b[0], b[1]]) && self.shows([b[0], b[2]])).collect();
        let outline = band.iter().map(|b| place([b[0], b[1]])).chain(band.iter().rev().map(|b| place([b[0], b[2]])));
        page.polygon(outline.collect(), color, 0.18);
        if series.joined {
            for run in series.points.split(|p| !self.shows(*p)) {
                page.polyline(run.iter().map(|p| place(*p)).collect(), Ink { color, width: 1.3, dashed: series.dashed });
            }
        }
        // A lone point has no line to be seen by.
        if series.marked || series.points.len() == 1 {
            for p in series.points.iter().filter(|p| self.shows(**p)) {
                page.dot(place(*p), 2.2, color);
            }
        }
    }

    /// Legend entries broken into rows that fit the width.
    fn legend_rows(&self) -> Vec<Vec<(&Series, Color)>> {
        let mut rows: Vec<Vec<(&Series, Color)>> = Vec::new();
        let mut used = f64::INFINITY;
        for (k, series) in self.series.iter().enumerate().filter(|(_, s)| !s.label.is_empty()) {
            let width = entry_width(series);
            if used + width > self.width - 40.0 {
                rows.push(Vec::new());
                used = 0.0;
            }
            used += width;
            if let Some(row) = rows.last_mut() {
                row.push((series, series.color.unwrap_or(Color::series(k))));
            }
        }
        rows
    }
}

fn entry_width(series: &Series) -> f64 {
    text_width(&series.label, FONT) + 26.0
}

fn draw_legend(page: &mut Canvas, rows: &[Vec<(&Series, Color)>], left: f64, top: f64) {
    for (r, row) in rows.iter().enumerate() {
        let (mut x, y) = (left, top + LINE * (r as f64 + 0.5));
        for (series, color) in row {
            if series.joined {
                page.line([x, y], [x + 13.0, y], Ink { color: *color, width: 1.3, dashed: series.dashed });
            }
            if series.marked {
                page.dot([x + 6.5, y], 2.2, *color);
            }
            page.text([x + 16.0, y + FONT * 0.35], &series.label, FONT, Anchor::Start, Color::BLACK);
            x += entry_width(series);
        }
    }
}

/// The rectangle between the axes.
struct Area {
    left: f64,
    top: f64,
    right: f64,
    bottom: f64,
}

impl Area {
    fn place(&self, x: &Fitted, y: &Fitted, p: [f64; 2]) -> [f64; 2] {
        [self.left + x.place(p[0]) * (self.right - self.left), self.bottom - y.place(p[1]) * (self.bottom - self.top)]
    }
}

/// Points along a segment, three points apart.
fn between((a, b): ([f64; 2], [f64; 2])) -> impl Iterator<Item = [f64; 2]> {
    let steps = ((b[0] - a[0]).hypot(b[1] - a[1]) / 3.0).ceil().max(1.0);
    (1..steps as usize).map(move |k| {
        let t = k as f64 / steps;
        [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])]
    })
}

/// Puts each note beside its point where it covers neither a point nor another note, or leaves it out.
fn draw_notes(page: &mut Canvas, area: &Area, notes: Vec<([f64; 2], String, Color)>, taken: &[[f64; 2]]) {
    let mut placed: Vec<[f64; 4]> = Vec::new();
    for ([x, y], text, color) in notes {
        let (w, h) = (text_width(&text, FONT - 1.0), FONT - 1.0);
        let spots =
            [[x + 4.0, y + 2.5], [x + 4.0, y + h + 2.0], [x - w - 4.0, y + 2.5], [x - w / 2.0, y - 4.5], [x - w / 2.0, y + h + 4.0]];
        let free = spots.into_iter().find(|[left, base]| {
            let me = [*left - 0.5, *base - h, *left + w + 0.5, *base + 1.0];
            let inside = me[0] >= area.left && me[2] <= area.right + 4.0 && me[1] >= area.top - 2.0 && me[3] <= area.bottom;
            let clear = |b: &[f64; 4]| me[0] > b[2] || b[0] > me[2] || me[1] > b[3] || b[1] > me[3];
            inside && placed.iter().all(clear) && taken.iter().all(|p| clear(&[p[0] - 1.5, p[1] - 1.5, p[0] + 1.5, p[1] + 1.5]))
        });
        if let Some([left, base]) = free {
            placed.push([left - 0.5, base - h, left + w + 0.5, base + 1.0]);
            page.text([left, base], text, h, Anchor::Start, color);
        }
    }
}

/// Breaks a text into lines no wider than `width`.
pub(super) fn wrap(text: &str, size: f64, width: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if text_width(line, size) + text_width(word, size) + text_width(" ", size) <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figures::Shape;

    fn plot() -> LinePlot {
        let mut series = Series::line("recall", (0..14).map(|k| [f64::from(k * k), f64::from(k) / 14.0]).collect()).marked();
        series.notes = (0..14).map(|k| (k, format!("0.{k:02}"))).collect();
        LinePlot::new("A plot", Axis::linear("false positives"), Axis::linear("rate").from_to(0.0, 1.0))
            .with(series)
            .caption("word ".repeat(40))
    }

    /// Boxes of every upright text of a page.
    fn text_boxes(page: &Canvas) -> Vec<[f64; 4]> {
        let of = |shape: &Shape| match shape {
            Shape::Text { at, text, size, anchor, upwards: false, .. } => {
                let w = text_width(text, *size);
                let left = match anchor {
                    Anchor::Start => at[0],
                    Anchor::Middle => at[0] - w / 2.0,
                    Anchor::End => at[0] - w,
                };
                Some([left, at[1] - 0.7 * size, left + w, at[1]])
            }
            _ => None,
        };
        page.shapes.iter().filter_map(of).collect()
    }

    #[test]
    fn no_text_covers_another_or_leaves_the_page() {
        let page = plot().draw();
        let boxes = text_boxes(&page);
        assert!(boxes.len() > 15);
        for (i, a) in boxes.iter().enumerate() {
            assert!(a[0] >= 0.0 && a[1] >= 0.0 && a[2] <= page.width && a[3] <= page.height, "{a:?}");
            for b in &boxes[..i] {
                assert!(a[0] >= b[2] || b[0] >= a[2] || a[1] >= b[3] || b[1] >= a[3], "{a:?} over {b:?}");
            }
        }
    }

    #[test]
    fn gaps_interrupt_a_curve() {
        let points = vec![[0.0, 0.0], [1.0, 1.0], [2.0, f64::NAN], [3.0, 1.0], [4.0, 0.0]];
        let page = LinePlot::new("", Axis::linear("x"), Axis::linear("y")).with(Series::line("", points)).draw();
        let curves = page.shapes.iter().filter(|s| matches!(s, Shape::Path { ink: Some(ink), .. } if ink.width == 1.3)).count();
        assert_eq!(curves, 2);
    }
}
