//! Pictures for people: batches with their boxes after augmentation, and the worst validation images.
use crate::{augment::planes::Planes, data::Batch};
use image::{Rgb, RgbImage, imageops};
use tcross_dataset::PixelBox;

/// Colour of what is true.
pub const TRUTH: Rgb<u8> = Rgb([0, 158, 115]);
/// Colour of what is claimed.
pub const CLAIM: Rgb<u8> = Rgb([230, 110, 0]);

/// All images of a batch with the boxes to be learned. A box of a mixed image is fainter by its weight.
#[must_use]
pub fn batch(batch: &Batch) -> RgbImage {
    let (width, height) = (batch.request.input.net.width, batch.request.input.net.height);
    let area = width * height;
    let picture = |(values, truths): (&[f32], &Vec<tcross_yolo::Truth>)| {
        let mut image = RgbImage::from_fn(width as u32, height as u32, |x, y| {
            let at = y as usize * width + x as usize;
            Rgb([0, 1, 2].map(|channel| (values[channel * area + at].clamp(0.0, 1.0) * 255.0 + 0.5) as u8))
        });
        for truth in truths {
            let b = truth.bounds;
            let [cx, cy, w, h] = [(b.x, width), (b.y, height), (b.w, width), (b.h, height)].map(|(v, side)| f64::from(v) * side as f64);
            let color = Rgb(TRUTH.0.map(|v| (f32::from(v) * truth.weight) as u8));
            outline(&mut image, &PixelBox::from_center(cx, cy, w, h), color);
        }
        image
    };
    let images: Vec<RgbImage> = batch.images.chunks_exact(3 * area).zip(&batch.truths).map(picture).collect();
    sheet(&images)
}

/// An image in the network's input with true and claimed boxes, in its pixels.
#[must_use]
pub fn claims(image: &Planes, truths: &[PixelBox], claimed: &[PixelBox]) -> RgbImage {
    let mut picture = RgbImage::from_fn(image.width as u32, image.height as u32, |x, y| {
        Rgb([0, 1, 2].map(|channel| image.row(channel, y as usize)[x as usize]))
    });
    truths.iter().for_each(|b| outline(&mut picture, b, TRUTH));
    claimed.iter().for_each(|b| outline(&mut picture, b, CLAIM));
    picture
}

/// Images side by side in a nearly square sheet, the first 16 at most.
#[must_use]
pub fn sheet(images: &[RgbImage]) -> RgbImage {
    let images = &images[..images.len().min(16)];
    let columns = (images.len() as f64).sqrt().ceil().max(1.0) as u32;
    let (width, height) = images.iter().fold((1, 1), |(w, h), image| (w.max(image.width()), h.max(image.height())));
    let rows = (images.len() as u32).div_ceil(columns).max(1);
    let gap = 4;
    let mut sheet = RgbImage::from_pixel(columns * (width + gap) - gap, rows * (height + gap) - gap, Rgb([255; 3]));
    for (k, image) in images.iter().enumerate() {
        let (column, row) = (k as u32 % columns, k as u32 / columns);
        imageops::replace(&mut sheet, image, i64::from(column * (width + gap)), i64::from(row * (height + gap)));
    }
    sheet
}

/// A frame of two pixels just around a box, with a thin dark line outside it so that it shows on any ground.
fn outline(image: &mut RgbImage, b: &PixelBox, color: Rgb<u8>) {
    let (width, height) = (i64::from(image.width()), i64::from(image.height()));
    for (distance, color) in [(3, Rgb([20; 3])), (2, color), (1, color)] {
        let (x0, y0) = (b.x_min.round() as i64 - distance, b.y_min.round() as i64 - distance);
        let (x1, y1) = (b.x_max.round() as i64 + distance - 1, b.y_max.round() as i64 + distance - 1);
        let mut put = |x: i64, y: i64| {
            if (0..width).contains(&x) && (0..height).contains(&y) {
                image.put_pixel(x as u32, y as u32, color);
            }
        };
        (x0..=x1).for_each(|x| [y0, y1].into_iter().for_each(|y| put(x, y)));
        (y0..=y1).for_each(|y| [x0, x1].into_iter().for_each(|x| put(x, y)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_stand_outside_their_boxes() {
        let image = Planes::grey(20, 20);
        let picture = claims(&image, &[PixelBox::from([5.0, 6.0, 10.0, 12.0])], &[]);
        assert_eq!(*picture.get_pixel(4, 5), TRUTH);
        assert_eq!(*picture.get_pixel(10, 12), TRUTH);
        assert_eq!(*picture.get_pixel(5, 6), Rgb([128; 3]));
        assert_eq!(sheet(&[picture.clone(), picture.clone(), picture]).dimensions(), (44, 44));
    }
}
