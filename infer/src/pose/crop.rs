//! Looking at the picture in linear light: single points between pixels, and the coarse view of a box's surroundings.
use super::plane::Point;
use image::RgbImage;
use std::sync::LazyLock;
use tcross_dataset::PixelBox;

/// A colour in linear light, 0..1 a channel.
pub type Colour = [f32; 3];

static LINEAR: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        let v = i as f32 / 255.0;
        if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
    })
});

/// A picture read in linear light, where blur and coverage are averages.
pub struct Picture<'a> {
    bytes: &'a [u8],
    linear: &'static [f32; 256],
    /// Width in pixels, at least 1.
    pub width: usize,
    /// Height in pixels, at least 1.
    pub height: usize,
}

impl<'a> Picture<'a> {
    /// `None` for a picture without pixels.
    #[must_use]
    pub fn new(image: &'a RgbImage) -> Option<Self> {
        let (width, height) = (image.width() as usize, image.height() as usize);
        (width > 0 && height > 0).then(|| Self { bytes: image.as_raw(), linear: &LINEAR, width, height })
    }

    /// The pixel in column `x` and row `y`, both inside the picture.
    #[must_use]
    pub fn pixel(&self, x: usize, y: usize) -> Colour {
        let at = (y * self.width + x) * 3;
        // One check of bounds instead of three.
        let bytes = &self.bytes[at..at + 3];
        std::array::from_fn(|c| self.linear[bytes[c] as usize])
    }

    /// Bilinear between pixel centres; points outside take the nearest pixel.
    #[must_use]
    pub fn at(&self, [x, y]: Point) -> Colour {
        let (x, y) = ((x - 0.5).clamp(0.0, (self.width - 1) as f64), (y - 0.5).clamp(0.0, (self.height - 1) as f64));
        let (x0, y0) = (x as usize, y as usize);
        let (x1, y1) = ((x0 + 1).min(self.width - 1), (y0 + 1).min(self.height - 1));
        let (fx, fy) = ((x - x0 as f64) as f32, (y - y0 as f64) as f32);
        let (a, b, c, d) = (self.pixel(x0, y0), self.pixel(x1, y0), self.pixel(x0, y1), self.pixel(x1, y1));
        std::array::from_fn(|k| (a[k] * (1.0 - fx) + b[k] * fx) * (1.0 - fy) + (c[k] * (1.0 - fx) + d[k] * fx) * fy)
    }

    /// True within `margin` pixels inside the frame (a negative margin reaches beyond it).
    #[must_use]
    pub fn holds(&self, [x, y]: Point, margin: f64) -> bool {
        x >= margin && y >= margin && x <= self.width as f64 - margin && y <= self.height as f64 - margin
    }
}

/// The surroundings of a box, scaled down to a bounded number of cells so that the search costs the same at every size.
pub struct Coarse {
    /// Cells a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Source pixels a cell, the same in both directions.
    pub step: f64,
    /// Source position of the first cell's outer corner.
    pub origin: Point,
    /// Mean colour of each cell, each channel's square root taken: near enough to equal steps for the eye.
    pub cells: Vec<Colour>,
}

/// Longer side of the coarse view in cells.
const CELLS: f64 = 64.0;
/// At most so many source pixels a side are averaged into a cell.
const SAMPLES: usize = 2;

impl Coarse {
    /// The view of `window`, which lies inside the picture. `None` where it holds fewer than 4 pixels a side.
    #[must_use]
    pub fn new(picture: &Picture, window: &PixelBox) -> Option<Self> {
        let (x0, y0) = (window.x_min.floor().max(0.0), window.y_min.floor().max(0.0));
        let (w, h) =
            ((window.x_max.ceil() - x0).min(picture.width as f64 - x0), (window.y_max.ceil() - y0).min(picture.height as f64 - y0));
        if w < 4.0 || h < 4.0 {
            return None;
        }
        let step = (w.max(h) / CELLS).max(1.0);
        let (width, height) = (((w / step) as usize).max(1), ((h / step) as usize).max(1));
        let samples = (step.ceil() as usize).min(SAMPLES);
        // Source columns and rows that each cell averages.
        let places = |start: f64, count: usize, limit: usize| -> Vec<usize> {
            let place = |i: usize| (start + (i as f64 + 0.5) * step / samples as f64) as usize;
            (0..count * samples).map(|i| place(i).min(limit - 1)).collect()
        };
        let (columns, rows) = (places(x0, width, picture.width), places(y0, height, picture.height));
        let scale = 1.0 / (samples * samples) as f32;
        let mut cells = Vec::with_capacity(width * height);
        for row in rows.chunks_exact(samples) {
            for column in columns.chunks_exact(samples) {
                let mut sum = [0.0f32; 3];
                for &y in row {
                    for &x in column {
                        let c = picture.pixel(x, y);
                        for k in 0..3 {
                            sum[k] += c[k];
                        }
                    }
                }
                cells.push(sum.map(|v| (v * scale).sqrt()));
            }
        }
        Some(Self { width, height, step, origin: [x0, y0], cells })
    }

    /// A position in cells as a position in the source picture.
    #[must_use]
    pub fn to_source(&self, [x, y]: Point) -> Point {
        [self.origin[0] + x * self.step, self.origin[1] + y * self.step]
    }

    /// A box in source pixels as one in cells.
    #[must_use]
    pub fn to_cells(&self, b: &PixelBox) -> PixelBox {
        let [x, y] = self.origin;
        [(b.x_min - x) / self.step, (b.y_min - y) / self.step, (b.x_max - x) / self.step, (b.y_max - y) / self.step].into()
    }

    /// The source position of a cell's middle.
    #[must_use]
    pub fn middle(&self, column: usize, row: usize) -> Point {
        self.to_source([column as f64 + 0.5, row as f64 + 0.5])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixel_centres_lie_at_halves() {
        let image = RgbImage::from_fn(3, 2, |x, y| image::Rgb([(x * 100) as u8, (y * 200) as u8, 7]));
        let picture = Picture::new(&image).unwrap();
        assert_eq!(picture.at([1.5, 0.5]), picture.pixel(1, 0));
        assert_eq!(picture.at([-9.0, 99.0]), picture.pixel(0, 1));
        let half = picture.at([1.0, 0.5])[0];
        assert!((half - (picture.pixel(0, 0)[0] + picture.pixel(1, 0)[0]) / 2.0).abs() < 1e-6);
        assert!(Picture::new(&RgbImage::new(0, 5)).is_none());
    }

    #[test]
    fn the_coarse_view_is_bounded_and_averages() {
        let image = RgbImage::from_fn(640, 480, |x, _| image::Rgb([if x < 320 { 0 } else { 255 }; 3]));
        let picture = Picture::new(&image).unwrap();
        let coarse = Coarse::new(&picture, &PixelBox::from([0.0, 0.0, 640.0, 480.0])).unwrap();
        assert_eq!((coarse.width, coarse.height), (64, 48));
        assert_eq!(coarse.cells[10], [0.0; 3]);
        assert_eq!(coarse.cells[60], [1.0; 3]);
        assert!(Coarse::new(&picture, &PixelBox::from([5.0, 5.0, 6.0, 6.0])).is_none());
    }
}
