//! The paper's method, step by step: crop, hue histogram, hue filter, erosion, dilation, Gaussian, Otsu, Canny, Hough lines,
//! four clusters, centre, stem, corners.
//!
//! Mended without changing the method: the filtered picture is white where the hue fits (the paper keeps the hue itself as
//! grey level, so red markers vanish) and hue wraps; lines are in normal form and directions lie on a circle (the paper's
//! slope and intercept break at steep lines); the crop is scaled so that the marker is always as large as the kernels expect.
pub mod clusters;
pub mod hough;
mod morphology;

use super::{Config, Refusal, crop::Picture, plane::Point, quad};
use clusters::Segment;
use hough::{Grey, Search};
use image::{Rgb, RgbImage};
use morphology::{Mask, morph};
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

fn scaled_crop(picture: &Picture, b: &PixelBox) -> Crop {
    let step = b.width().max(b.height()) / SIDE;
    let origin = [b.x_min - PADDING * step, b.y_min - PADDING * step];
    let size = |extent: f64| (extent / step + 2.0 * PADDING).ceil().max(1.0) as u32;
    let samples = (step.ceil() as u32).clamp(1, 3);
    let byte = |v: f32| (255.0 * if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }).round() as u8;
    let rgb = RgbImage::from_fn(size(b.width()), size(b.height()), |x, y| {
        let mut sum = [0.0f32; 3];
        for s in 0..samples * samples {
            let at = |v: u32, k: u32| f64::from(v) + (f64::from(k) + 0.5) / f64::from(samples);
            let c = picture.at([origin[0] + step * at(x, s % samples), origin[1] + step * at(y, s / samples)]);
            (0..3).for_each(|k| sum[k] += c[k] / (samples * samples) as f32);
        }
        Rgb(sum.map(byte))
    });
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
    ((30.0 * sextant).round().rem_euclid(180.0)) as u8 % 180
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
    let (w, h) = (grey.width, grey.height);
    let mut kernel: [f32; 11] = std::array::from_fn(|k| (-((k as f32 - 5.0) / 2.0).powi(2) / 2.0).exp());
    let sum: f32 = kernel.iter().sum();
    kernel.iter_mut().for_each(|k| *k /= sum);
    let near = |v: usize, k: usize, limit: usize| (v + k).saturating_sub(5).min(limit - 1);
    let mut rows = vec![0.0f32; w * h];
    let mut out = vec![0u8; w * h];
    for (i, v) in rows.iter_mut().enumerate() {
        let (x, y) = (i % w, i / w);
        *v = (0..11).map(|k| kernel[k] * f32::from(grey.pixels[y * w + near(x, k, w)])).sum();
    }
    for (i, v) in out.iter_mut().enumerate() {
        let (x, y) = (i % w, i / w);
        *v = (0..11).map(|k| kernel[k] * rows[near(y, k, h) * w + x]).sum::<f32>().round() as u8;
    }
    Grey { width: w, height: h, pixels: out }
}

fn otsu(grey: &Grey) -> Grey {
    let level = image::GrayImage::from_raw(grey.width as u32, grey.height as u32, grey.pixels.clone())
        .map_or(127, |picture| imageproc::contrast::otsu_level(&picture));
    Grey { pixels: grey.pixels.iter().map(|p| if *p > level { 255 } else { 0 }).collect(), ..*grey }
}

/// Raises the threshold from 20 by 5 (by 1 after seven tries) until more than 10 and fewer than 40 lines are found; after 20
/// tries the last answer stands.
fn adaptive_hough(edges: &[bool], w: usize, h: usize) -> Vec<Segment> {
    let mut threshold = 20;
    let mut lines = Vec::new();
    let mut rising = true;
    for attempt in 0..20u64 {
        let search = Search { threshold, min_length: 15.0, max_gap: 50 };
        lines = hough::segments(edges, w, h, search, &mut Rng::for_item(0, "infer/hough", attempt));
        let few = lines.len() <= 10;
        if !few && lines.len() < 40 {
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
    fn red_is_near_red_on_both_sides() {
        let mask = hue_filter(&[178, 2, 7, 90], 4, 1, 0);
        assert_eq!(mask.cells, [true, true, false, false]);
    }
}
