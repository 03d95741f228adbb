//! Pictures as three planes of bytes: the form in which rows can be copied, mirrored and turned into floats at full speed.
use image::RgbImage;

/// Grey of what lies outside an image: Darknet's 0.5.
pub const GREY: u8 = 128;

/// A picture as planes R, G, B of `height` rows of `width` bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Planes {
    /// In pixels.
    pub width: usize,
    /// In pixels.
    pub height: usize,
    /// `[3, height, width]`.
    pub data: Vec<u8>,
}

impl Planes {
    /// A grey picture.
    #[must_use]
    pub fn grey(width: usize, height: usize) -> Self {
        Self { width, height, data: vec![GREY; 3 * width * height] }
    }

    /// The planes of an interleaved picture.
    #[must_use]
    pub fn from_rgb(image: &RgbImage) -> Self {
        let (width, height) = (image.width() as usize, image.height() as usize);
        let mut planes = Self { width, height, data: vec![0; 3 * width * height] };
        let (red, rest) = planes.data.split_at_mut(width * height);
        let (green, blue) = rest.split_at_mut(width * height);
        for (pixel, ((r, g), b)) in image.as_raw().chunks_exact(3).zip(red.iter_mut().zip(green).zip(blue)) {
            (*r, *g, *b) = (pixel[0], pixel[1], pixel[2]);
        }
        planes
    }

    /// Bytes of a plane.
    #[must_use]
    pub fn plane(&self, channel: usize) -> &[u8] {
        let area = self.width * self.height;
        &self.data[channel * area..(channel + 1) * area]
    }

    /// One row of a plane.
    #[must_use]
    pub fn row(&self, channel: usize, y: usize) -> &[u8] {
        &self.plane(channel)[y * self.width..(y + 1) * self.width]
    }

    /// One row of a plane, to be written.
    pub fn row_mut(&mut self, channel: usize, y: usize) -> &mut [u8] {
        let start = (channel * self.height + y) * self.width;
        &mut self.data[start..start + self.width]
    }
}
