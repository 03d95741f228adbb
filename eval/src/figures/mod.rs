//! Figures in one style: drawn once on a [`Canvas`], written as SVG, PDF or PNG.
//!
//! A canvas is measured in points (1/72 inch) and made for one column of a paper (252 points), so that what is legible
//! here is legible in print. Colours are those of Okabe and Ito, which people with any colour vision tell apart.
//!
//! ```
//! use tcross_eval::figures::{Axis, LinePlot, Series};
//! let svg = LinePlot::new("Loss", Axis::linear("epoch"), Axis::log("loss per image"))
//!     .with(Series::line("train", vec![[1.0, 9.0], [2.0, 3.0], [3.0, 1.2]]))
//!     .svg();
//! assert!(svg.starts_with("<svg"));
//! ```
mod axis;
mod canvas;
mod dot_plot;
mod line_plot;
mod pdf;
mod png;
mod svg;
mod text_outline;

pub use axis::{Axis, Scale};
pub use canvas::{Anchor, Canvas, Color, Ink, Shape};
pub use dot_plot::{Dot, DotPlot};
pub use line_plot::{LinePlot, Series};
pub use svg::escape;

/// Width of a figure in points: one column.
pub const COLUMN_PT: f64 = 252.0;
