//! A picture in linear light, plane by plane.
use crate::color::{Linear, linear_table, stored_table};
use image::RgbImage;

/// Red, green and blue planes, row-major; 1 is white in full light, more is a light that the sensor will clip.
#[derive(Debug, Clone, PartialEq)]
pub struct Canvas {
    /// In pixels.
    pub width: usize,
    /// In pixels.
    pub height: usize,
    /// Red, green, blue.
    pub planes: [Vec<f32>; 3],
}

impl Canvas {
    /// All of one colour.
    #[must_use]
    pub fn filled(width: usize, height: usize, color: Linear) -> Self {
        Self { width, height, planes: color.map(|v| vec![v; width * height]) }
    }

    /// From a stored picture.
    #[must_use]
    pub fn from_image(image: &RgbImage) -> Self {
        let table = linear_table();
        let (width, height) = (image.width() as usize, image.height() as usize);
        let mut planes: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; width * height]);
        let [red, green, blue] = &mut planes;
        for (((pixel, r), g), b) in image.as_raw().as_chunks::<3>().0.iter().zip(red).zip(green).zip(blue) {
            (*r, *g, *b) = (table[pixel[0] as usize], table[pixel[1] as usize], table[pixel[2] as usize]);
        }
        Self { width, height, planes }
    }

    /// To stored numbers; light outside 0..1 is clipped.
    #[must_use]
    pub fn to_image(&self) -> RgbImage {
        let table = stored_table();
        let top = (table.len() - 1) as f32;
        let mut raw = vec![0u8; self.width * self.height * 3];
        let [red, green, blue] = &self.planes;
        for (((out, r), g), b) in raw.as_chunks_mut::<3>().0.iter_mut().zip(red).zip(green).zip(blue) {
            let stored = |v: f32| table[usize::from((v.clamp(0.0, 1.0) * top + 0.5) as u16)];
            *out = [stored(*r), stored(*g), stored(*b)];
        }
        RgbImage::from_raw(self.width as u32, self.height as u32, raw).unwrap_or_default()
    }

    /// The colour at a pixel.
    #[must_use]
    pub fn at(&self, x: usize, y: usize) -> Linear {
        let k = y * self.width + x;
        std::array::from_fn(|c| self.planes[c][k])
    }

    /// Sets a pixel.
    pub fn set(&mut self, x: usize, y: usize, color: Linear) {
        let k = y * self.width + x;
        for (plane, v) in self.planes.iter_mut().zip(color) {
            plane[k] = v;
        }
    }

    /// Multiplies every plane by its own gain.
    pub fn gain(&mut self, gains: Linear) {
        for (plane, gain) in self.planes.iter_mut().zip(gains) {
            plane.iter_mut().for_each(|v| *v *= gain);
        }
    }

    /// Mean luminance over a pixel rectangle (ends out), clipped to the picture; 0 where it is empty.
    #[must_use]
    pub fn mean(&self, x: std::ops::Range<usize>, y: std::ops::Range<usize>) -> Linear {
        let (x, y) = (x.start..x.end.min(self.width), y.start..y.end.min(self.height));
        let n = (x.len() * y.len()).max(1) as f32;
        std::array::from_fn(|c| y.clone().map(|row| self.planes[c][row * self.width..][x.clone()].iter().sum::<f32>()).sum::<f32>() / n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_survives_the_round_trip() {
        let image = RgbImage::from_fn(37, 11, |x, y| image::Rgb([(x * 7) as u8, (y * 23) as u8, (x * y) as u8]));
        assert_eq!(Canvas::from_image(&image).to_image(), image);
    }
}
