//! Pixels to a network's input: Darknet's letterbox.
//!
//! Bilinear with aligned corners (`source = i (in - 1) / (out - 1)`), no antialiasing, first x, then y, in float32 on 0..1; grey 0.5
//! around it. An image that already has the network's size only changes its form.
use crate::config::NetSize;
use image::{Rgb, RgbImage};
use tcross_dataset::Letterbox;

/// Grey of the letterbox's border, 0..1.
pub const GREY: f32 = 0.5;

/// Writes an image into a network's input: three planes (R, G, B) of `net.height` rows of `net.width`, 0..1.
///
/// # Panics
/// If `out` is not `3 * width * height` long, or the image has no pixels.
pub fn prepare(image: &RgbImage, net: NetSize, out: &mut [f32]) -> Letterbox {
    let plane = net.width * net.height;
    assert_eq!(out.len(), 3 * plane, "three planes of {net}");
    let letterbox = letterbox_of(image, net);
    let (left, top) = letterbox.offset_px();
    if letterbox.scaled != letterbox.net {
        out.fill(GREY);
    }
    let (red, rest) = out.split_at_mut(plane);
    let (green, blue) = rest.split_at_mut(plane);
    each_row(image, letterbox.scaled, |row, values| {
        let start = (top + row) * net.width + left;
        let range = start..start + letterbox.scaled.0;
        let planes = red[range.clone()].iter_mut().zip(&mut green[range.clone()]).zip(&mut blue[range]);
        for (((r, g), b), pixel) in planes.zip(values.chunks_exact(3)) {
            (*r, *g, *b) = (pixel[0], pixel[1], pixel[2]);
        }
    });
    letterbox
}

/// The letterboxed image with 8 bits a channel, rounded: what training keeps in memory.
///
/// # Panics
/// If the image has no pixels.
#[must_use]
pub fn letterboxed(image: &RgbImage, net: NetSize) -> (RgbImage, Letterbox) {
    let letterbox = letterbox_of(image, net);
    if letterbox.source == letterbox.net {
        return (image.clone(), letterbox);
    }
    let (left, top) = letterbox.offset_px();
    let mut out = RgbImage::from_pixel(net.width as u32, net.height as u32, Rgb([128; 3]));
    each_row(image, letterbox.scaled, |row, values| {
        let start = 3 * ((top + row) * net.width + left);
        for (byte, value) in out.as_mut()[start..start + values.len()].iter_mut().zip(values) {
            *byte = (value * 255.0 + 0.5) as u8;
        }
    });
    (out, letterbox)
}

fn letterbox_of(image: &RgbImage, net: NetSize) -> Letterbox {
    assert!(image.width() > 0 && image.height() > 0, "an image without pixels");
    Letterbox::new((image.width() as usize, image.height() as usize), (net.width, net.height))
}

/// Calls `write` with each row of the scaled image: interleaved RGB, 0..1.
fn each_row(image: &RgbImage, (width, height): (usize, usize), mut write: impl FnMut(usize, &[f32])) {
    let unit: [f32; 256] = std::array::from_fn(|v| (v as f64 / 255.0) as f32);
    let (source_width, source_height) = (image.width() as usize, image.height() as usize);
    let source_row = |y: usize| &image.as_raw()[3 * y * source_width..3 * (y + 1) * source_width];
    let mut row = vec![0.0; 3 * width];
    if (width, height) == (source_width, source_height) {
        for y in 0..height {
            row.iter_mut().zip(source_row(y)).for_each(|(to, from)| *to = unit[usize::from(*from)]);
            write(y, &row);
        }
        return;
    }

    let (columns, rows) = (taps(width, source_width), taps(height, source_height));
    let scale_row = |y: usize, out: &mut [f32]| {
        let source = source_row(y);
        for (out, tap) in out.chunks_exact_mut(3).zip(&columns) {
            for channel in 0..3 {
                let at = |x: usize| unit[usize::from(source[3 * x + channel])];
                out[channel] = tap.mix(at(tap.first), at(tap.second));
            }
        }
    };
    // Two neighbouring source rows at a time, each scaled once.
    let mut upper = (usize::MAX, vec![0.0; 3 * width]);
    let mut lower = (usize::MAX, vec![0.0; 3 * width]);
    for (y, tap) in rows.iter().enumerate() {
        if upper.0 != tap.first {
            if lower.0 == tap.first {
                std::mem::swap(&mut upper, &mut lower);
            } else {
                scale_row(tap.first, &mut upper.1);
                upper.0 = tap.first;
            }
        }
        if lower.0 != tap.second {
            scale_row(tap.second, &mut lower.1);
            lower.0 = tap.second;
        }
        for ((to, a), b) in row.iter_mut().zip(&upper.1).zip(&lower.1) {
            *to = tap.mix(*a, *b);
        }
        write(y, &row);
    }
}

/// Which two source pixels a target pixel lies between.
struct Tap {
    first: usize,
    second: usize,
    fraction: f32,
}

impl Tap {
    fn mix(&self, a: f32, b: f32) -> f32 {
        (1.0 - self.fraction) * a + self.fraction * b
    }
}

fn taps(length: usize, source: usize) -> Vec<Tap> {
    let last = source - 1;
    let step = last as f32 / (length.max(2) - 1) as f32;
    let tap = |i: usize| {
        if i + 1 == length || source == 1 {
            return Tap { first: last, second: last, fraction: 0.0 };
        }
        let at = i as f32 * step;
        let first = (at as usize).min(last);
        Tap { first, second: (first + 1).min(last), fraction: at - first as f32 }
    };
    (0..length).map(tap).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use tcross_dataset::Rng;

    fn noise(width: u32, height: u32) -> RgbImage {
        let mut rng = Rng::for_item(2, "test/input", u64::from(width));
        RgbImage::from_fn(width, height, |_, _| Rgb([0; 3].map(|_: u8| rng.int(0, 255) as u8)))
    }

    /// The naive twin: each output pixel from its four source pixels, in f64.
    fn naive(image: &RgbImage, net: NetSize, channel: usize, x: usize, y: usize) -> f64 {
        let l = letterbox_of(image, net);
        let (left, top) = l.offset_px();
        if x < left || y < top || x >= left + l.scaled.0 || y >= top + l.scaled.1 {
            return 0.5;
        }
        let place =
            |i: usize, n: usize, source: usize| if n == 1 { (source - 1) as f64 } else { i as f64 * (source - 1) as f64 / (n - 1) as f64 };
        let (sx, sy) = (place(x - left, l.scaled.0, l.source.0), place(y - top, l.scaled.1, l.source.1));
        let at = |x: usize, y: usize| {
            let (x, y) = (x.min(l.source.0 - 1), y.min(l.source.1 - 1));
            f64::from(image.get_pixel(x as u32, y as u32)[channel]) / 255.0
        };
        let (fx, fy) = (sx.fract(), sy.fract());
        let (x, y) = (sx as usize, sy as usize);
        (1.0 - fy) * ((1.0 - fx) * at(x, y) + fx * at(x + 1, y)) + fy * ((1.0 - fx) * at(x, y + 1) + fx * at(x + 1, y + 1))
    }

    #[test]
    fn equals_its_naive_twin() {
        for (w, h, net) in
            [(37, 91, [64, 64]), (91, 37, [96, 64]), (5, 4, [32, 32]), (1, 7, [32, 32]), (1, 1, [32, 64]), (64, 64, [64, 64])]
        {
            let (image, net) = (noise(w, h), NetSize::from(net));
            let mut out = vec![0.0; 3 * net.width * net.height];
            prepare(&image, net, &mut out);
            for (index, value) in out.iter().enumerate() {
                let (channel, y, x) = (index / (net.width * net.height), index / net.width % net.height, index % net.width);
                let wanted = naive(&image, net, channel, x, y);
                assert!((f64::from(*value) - wanted).abs() < 2e-5, "{w}x{h} {channel} {x} {y}: {value} {wanted}");
            }
        }
    }

    #[test]
    fn bytes_are_the_rounded_floats() {
        let (image, net) = (noise(50, 30), NetSize::square(64));
        let mut floats = vec![0.0; 3 * 64 * 64];
        prepare(&image, net, &mut floats);
        let (bytes, letterbox) = letterboxed(&image, net);
        assert_eq!(letterbox.scaled, (64, 38));
        for (x, y, pixel) in bytes.enumerate_pixels() {
            for channel in 0..3 {
                let float = floats[channel * 64 * 64 + y as usize * 64 + x as usize];
                assert!((float * 255.0 - f32::from(pixel[channel])).abs() <= 0.501);
            }
        }
    }
}
