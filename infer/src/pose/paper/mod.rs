//! The paper's method, step by step: crop, hue histogram, hue filter, erosion, dilation, Gaussian, Otsu, Canny, Hough lines,
//! four clusters, centre, stem, corners.
//!
//! Mended without changing the method: the filtered picture is white where the hue fits (the paper keeps the hue itself as
//! grey level, so red markers vanish) and hue wraps; lines are in normal form and directions lie on a circle (the paper's
//! slope and intercept break at steep lines); the crop is scaled so that the marker is always as large as the kernels expect.
pub mod clusters;
pub mod hough;
mod morphology;

use super::{
    Config, Refusal,
    crop::{Colour, Picture},
    plane::Point,
    quad,
};
use clusters::Segment;
use hough::{Grey, Search};
use image::{Rgb, RgbImage};
use morphology::{Mask, morph};
use std::sync::LazyLock;
use tcross_dataset::{Homography, PixelBox, Pose, Quad, Rng, geom::quad::angle_deg};

/// Longer side of the box in the scaled crop, px.
const SIDE: f64 = 140.0;
/// Surroundings kept beside the box in the scaled crop, px.
const PADDING: f64 = 15.0;
/// Largest distance of a pixel's hue from the marker's, of 180.
const HUE_REACH: u8 = 4;
/// Half of the erosion's and the dilation's square: 11 and 9 px wide.
const ERODE: usize = 5;
const DILATE: usize = 4;
/// One deviation of the centre, in sides, measured over drawn markers.
const CENTER_DEVIATION: f64 = 0.02;

/// Quality of every pose: the method has no measure of its own.
const QUALITY: f64 = 0.5;

/// A picture of a step, with its name.
pub type Steps<'a> = Option<&'a mut dyn FnMut(&'static str, RgbImage)>;

/// Recovers the pose as the paper does; each step's picture goes to `steps` as Figures 24 to 29 show them.
///
/// # Errors
/// The reason for which no pose is claimed.
pub fn recover(image: &RgbImage, bounds: &PixelBox, config: &Config, mut steps: Steps) -> Result<Pose, Refusal> {
    let (picture, inside) = super::checked(image, bounds, config)?;
    let crop = scaled_crop(&picture, &inside);
    let (w, h) = (crop.rgb.width() as usize, crop.rgb.height() as usize);
    show(&mut steps, "1-crop", || crop.rgb.clone());
    let hues: Vec<u8> = crop.rgb.pixels().map(hue).collect();
    let peak = commonest_hue(&crop, &hues);
    let mut mask = hue_filter(&hues, w, h, peak);
    show(&mut steps, "2-hue-filter", || grey_picture(&to_grey(&mask)));
    morph(&mut mask, ERODE, false);
    show(&mut steps, "3-erosion", || grey_picture(&to_grey(&mask)));
    morph(&mut mask, DILATE, true);
    show(&mut steps, "4-dilation", || grey_picture(&to_grey(&mask)));
    let smooth = gaussian(&to_grey(&mask));
    show(&mut steps, "5-gaussian", || grey_picture(&smooth));
    let binary = otsu(&smooth);
    show(&mut steps, "6-otsu", || grey_picture(&binary));
    let edges = hough::canny(&binary, 50, 200);
    show(&mut steps, "7-canny", || grey_picture(&to_grey(&Mask { width: w, height: h, cells: edges.clone() })));
    let lines = adaptive_hough(&edges, w, h);
    show(&mut steps, "8-hough", || lines_picture(&crop.rgb, &lines));
    let clusters = clusters::four_clusters(lines).ok_or(Refusal::NoCross)?;
    let reading = clusters::read(&clusters).ok_or(Refusal::NoCross)?;
    // Erosion takes a pixel more than dilation gives back.
    let corners = reading.corners((ERODE - DILATE) as f64).ok_or(Refusal::NoOutline)?;
    if !quad::is_sound(&corners) {
        return Err(Refusal::NoOutline);
    }
    let corners = corners.map(|p| crop.to_source(p));
    if corners.iter().any(|c| !picture.holds(*c, -1.5)) {
        return Err(Refusal::CutByBorder);
    }
    if QUALITY < config.min_quality {
        return Err(Refusal::Unsure);
    }
    let center = crop.to_source(reading.center);
    let homography = Homography::from_unit_square(&corners).ok_or(Refusal::NoOutline)?;
    let variance = (CENTER_DEVIATION * Quad(corners).side_px()).powi(2);
    Ok(Pose {
        center,
        corners: Quad(corners),
        angle: angle_deg(corners[0][0] - center[0], corners[0][1] - center[1]),
        homography,
        covariance: [variance, 0.0, variance],
        quality: QUALITY,
        rotation: None,
        translation: None,
        reprojection_px: None,
        rival: None,
    })
}

fn show(steps: &mut Steps, name: &'static str, picture: impl FnOnce() -> RgbImage) {
    if let Some(sink) = steps {
        sink(name, picture());
    }
}

/// The padded box at a fixed scale.
struct Crop {
    rgb: RgbImage,
    /// The box inside the crop.
    bounds: PixelBox,
    origin: Point,
    step: f64,
}

impl Crop {
    fn to_source(&self, [x, y]: Point) -> Point {
        [self.origin[0] + x * self.step, self.origin[1] + y * self.step]
    }
}

/// What a cell of the scaled crop takes from pixels along one axis: where they begin, and each one's share.
struct Taps {
    first: usize,
    shares: Vec<f32>,
}

/// The mean of `samples` places a cell, each between two pixels; beyond the picture its border repeats.
fn taps(start: f64, step: f64, count: usize, samples: usize, limit: usize) -> Vec<Taps> {
    let last = limit - 1;
    let cell = |i: usize| {
        let place = |k: usize| {
            let at = start + step * (i as f64 + (k as f64 + 0.5) / samples as f64) - 0.5;
            at.clamp(0.0, last as f64)
        };
        let first = place(0) as usize;
        let mut shares = vec![0.0f32; (place(samples - 1) as usize + 1).min(last) - first + 1];
        for at in (0..samples).map(place) {
            let (j, part) = (at as usize, at.fract() as f32);
            shares[j - first] += (1.0 - part) / samples as f32;
            shares[(j + 1).min(last) - first] += part / samples as f32;
        }
        Taps { first, shares }
    };
    (0..count).map(cell).collect()
}

/// sRGB bytes of linear light, by its square root: the curve is nearly straight there, so a byte is off by one at most, and seldom.
static BYTES: LazyLock<[u8; 4096]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        let v = (i as f32 / 4095.0).powi(2);
        (255.0 * if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }).round() as u8
    })
});

fn scaled_crop(picture: &Picture, b: &PixelBox) -> Crop {
    let step = b.width().max(b.height()) / SIDE;
    let origin = [b.x_min - PADDING * step, b.y_min - PADDING * step];
    let size = |extent: f64| (extent / step + 2.0 * PADDING).ceil().max(1.0) as usize;
    let (w, h) = (size(b.width()), size(b.height()));
    let samples = (step.ceil() as usize).clamp(1, 3);
    let columns = taps(origin[0], step, w, samples, picture.width);
    let rows = taps(origin[1], step, h, samples, picture.height);
    // Rows of the picture scaled along x, as far as the cells' rows want them.
    let top = rows[0].first;
    let bottom = rows.last().map_or(top, |r| r.first + r.shares.len());
    let mut lines: Vec<Colour> = Vec::with_capacity((bottom - top) * w);
    for y in top..bottom {
        lines.extend(columns.iter().map(|taps| {
            let mut sum = [0.0f32; 3];
            for (k, share) in taps.shares.iter().enumerate() {
                let pixel = picture.pixel(taps.first + k, y);
                (0..3).for_each(|c| sum[c] += share * pixel[c]);
            }
            sum
        }));
    }
    let bytes: &[u8; 4096] = &BYTES;
    let mut raw = Vec::with_capacity(3 * w * h);
    let mut sums: Vec<Colour> = vec![[0.0; 3]; w];
    for taps in &rows {
        sums.fill([0.0; 3]);
        for (k, share) in taps.shares.iter().enumerate() {
            let from = (taps.first + k - top) * w;
            for (sum, v) in sums.iter_mut().zip(&lines[from..from + w]) {
                (0..3).for_each(|c| sum[c] += share * v[c]);
            }
        }
        raw.extend(sums.iter().flatten().map(|v| bytes[((4095.0 * v.sqrt() + 0.5) as usize).min(4095)]));
    }
    let rgb = RgbImage::from_raw(w as u32, h as u32, raw).unwrap_or_default();
    let bounds = PixelBox::from([PADDING, PADDING, PADDING + b.width() / step, PADDING + b.height() / step]);
    Crop { rgb, bounds, origin, step }
}

/// Hue of a pixel as OpenCV counts it, 0..179; 0 for grey.
fn hue(Rgb([r, g, b]): &Rgb<u8>) -> u8 {
    let [r, g, b] = [r, g, b].map(|v| f32::from(*v));
    let most = r.max(g).max(b);
    let range = most - r.min(g).min(b);
    if range <= 0.0 {
        return 0;
    }
    let sextant = if most == r {
        (g - b) / range
    } else if most == g {
        2.0 + (b - r) / range
    } else {
        4.0 + (r - g) / range
    };
    // Rounded, and below zero from the other end of the circle.
    ((30.0 * sextant + 180.5) as u32 % 180) as u8
}

/// The hue that most pixels inside the box's inscribed diamond have.
fn commonest_hue(crop: &Crop, hues: &[u8]) -> u8 {
    let ([cx, cy], b) = (crop.bounds.center(), &crop.bounds);
    let mut counts = [0usize; 180];
    for (i, hue) in hues.iter().enumerate() {
        let (x, y) = (i % crop.rgb.width() as usize, i / crop.rgb.width() as usize);
        let inside = 2.0 * (x as f64 + 0.5 - cx).abs() / b.width() + 2.0 * (y as f64 + 0.5 - cy).abs() / b.height();
        if inside < 1.0 {
            counts[*hue as usize] += 1;
        }
    }
    (0..180).max_by_key(|h| counts[*h]).unwrap_or(0) as u8
}

fn hue_filter(hues: &[u8], width: usize, height: usize, peak: u8) -> Mask {
    let near = |h: &u8| {
        let apart = h.abs_diff(peak);
        apart.min(180 - apart) <= HUE_REACH
    };
    Mask { width, height, cells: hues.iter().map(near).collect() }
}

fn to_grey(mask: &Mask) -> Grey {
    Grey { width: mask.width, height: mask.height, pixels: mask.cells.iter().map(|c| if *c { 255 } else { 0 }).collect() }
}

/// 11x11, sigma 2; the border repeats.
fn gaussian(grey: &Grey) -> Grey {
    const REACH: usize = 5;
    let (w, h) = (grey.width, grey.height);
    let mut kernel: [f32; 2 * REACH + 1] = std::array::from_fn(|k| (-((k as f32 - REACH as f32) / 2.0).powi(2) / 2.0).exp());
    let sum: f32 = kernel.iter().sum();
    kernel.iter_mut().for_each(|k| *k /= sum);
    let mut rows: Vec<f32> = Vec::with_capacity(w * h);
    let mut wide: Vec<f32> = Vec::with_capacity(w + 2 * REACH);
    for row in grey.pixels.chunks_exact(w) {
        // The row with its ends repeated.
        wide.clear();
        wide.extend((0..w + 2 * REACH).map(|x| f32::from(row[x.saturating_sub(REACH).min(w - 1)])));
        rows.extend(wide.windows(kernel.len()).map(|v| kernel.iter().zip(v).map(|(k, v)| k * v).sum::<f32>()));
    }
    let mut pixels = Vec::with_capacity(w * h);
    let mut sums = vec![0.0f32; w];
    for y in 0..h {
        sums.fill(0.0);
        for (k, share) in kernel.iter().enumerate() {
            let from = (y + k).saturating_sub(REACH).min(h - 1) * w;
            sums.iter_mut().zip(&rows[from..from + w]).for_each(|(s, v)| *s += share * v);
        }
        // Rounded: all are positive.
        pixels.extend(sums.iter().map(|v| (v + 0.5) as u8));
    }
    Grey { width: w, height: h, pixels }
}

fn otsu(grey: &Grey) -> Grey {
    let level = image::GrayImage::from_raw(grey.width as u32, grey.height as u32, grey.pixels.clone())
        .map_or(127, |picture| imageproc::contrast::otsu_level(&picture));
    Grey { pixels: grey.pixels.iter().map(|p| if *p > level { 255 } else { 0 }).collect(), ..*grey }
}

/// Tries at a threshold, and so many lines are too many.
const TRIES: u64 = 20;
const TOO_MANY: usize = 40;

/// Raises the threshold from 20 by 5 (by 1 after seven tries) until more than 10 and fewer than 40 lines are found; after 20
/// tries the last answer stands.
fn adaptive_hough(edges: &[bool], w: usize, h: usize) -> Vec<Segment> {
    let mut threshold = 20;
    let mut lines = Vec::new();
    let mut rising = true;
    for attempt in 0..TRIES {
        // Forty are too many, however many more there are, as long as another try follows.
        let enough = if attempt + 1 < TRIES { TOO_MANY } else { usize::MAX };
        let search = Search { threshold, min_length: 15.0, max_gap: 50, enough };
        lines = hough::segments(edges, w, h, search, &mut Rng::for_item(0, "infer/hough", attempt));
        let few = lines.len() <= 10;
        if !few && lines.len() < TOO_MANY {
            break;
        }
        // Too few already at the lowest threshold: go down instead.
        rising = if attempt == 0 { !few } else { rising };
        let step = if attempt < 7 && rising { 5 } else { 1 };
        threshold += if few { -step } else { step };
        if threshold < 8 {
            break;
        }
    }
    lines.into_iter().filter_map(Segment::new).collect()
}

fn grey_picture(grey: &Grey) -> RgbImage {
    RgbImage::from_fn(grey.width as u32, grey.height as u32, |x, y| Rgb([grey.pixels[y as usize * grey.width + x as usize]; 3]))
}

fn lines_picture(crop: &RgbImage, lines: &[Segment]) -> RgbImage {
    let mut out = crop.clone();
    for line in lines {
        let [a, b] = line.ends.map(|p| (p[0] as f32 - 0.5, p[1] as f32 - 0.5));
        imageproc::drawing::draw_line_segment_mut(&mut out, a, b, Rgb([255, 0, 80]));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hues_as_opencv_counts_them() {
        for (rgb, want) in
            [([255, 0, 0], 0), ([255, 255, 0], 30), ([0, 255, 0], 60), ([0, 0, 255], 120), ([255, 0, 10], 179), ([7, 7, 7], 0)]
        {
            assert_eq!(hue(&Rgb(rgb)), want, "{rgb:?}");
        }
    }

    #[test]
    fn the_crop_equals_single_samples_between_pixels() {
        let mut rng = Rng::for_item(3, "test/crop", 0);
        let image = RgbImage::from_fn(230, 190, |_, _| Rgb(std::array::from_fn(|_| rng.uniform(0.0, 255.9) as u8)));
        let picture = Picture::new(&image).unwrap();
        // Enlarged, reduced, and beyond the picture's border.
        for b in [[60.0, 50.0, 100.5, 95.0], [20.3, 10.2, 200.1, 170.0], [-5.0, 3.0, 228.0, 189.5]].map(PixelBox::from) {
            let crop = scaled_crop(&picture, &b);
            let samples = (crop.step.ceil() as u32).clamp(1, 3);
            for (x, y, Rgb(pixel)) in crop.rgb.enumerate_pixels() {
                let mut sum = [0.0f32; 3];
                for s in 0..samples * samples {
                    let at = |v: u32, k: u32| f64::from(v) + (f64::from(k) + 0.5) / f64::from(samples);
                    let c = picture.at(crop.to_source([at(x, s % samples), at(y, s / samples)]));
                    (0..3).for_each(|k| sum[k] += c[k] / (samples * samples) as f32);
                }
                for (v, got) in sum.iter().zip(pixel) {
                    let want = 255.0 * if *v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
                    assert!((want - f32::from(*got)).abs() < 1.0, "{x} {y}: {got} not {want}");
                }
            }
        }
    }

    #[test]
    fn red_is_near_red_on_both_sides() {
        let mask = hue_filter(&[178, 2, 7, 90], 4, 1, 0);
        assert_eq!(mask.cells, [true, true, false, false]);
    }
}
