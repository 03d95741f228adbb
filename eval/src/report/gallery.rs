//! Pictures of a report: whole images and crops, with true and detected boxes drawn on them.
use crate::{
    compare::{Comparison, Disagreement},
    evaluation::Evaluation,
    failures::{Failure, Kind, claimed_box},
    matching::by_falling_score,
    truth::Truth,
};
use image::{Rgb, RgbImage, codecs::jpeg::JpegEncoder, imageops};
use rayon::prelude::*;
use tcross_dataset::{PixelBox, Rng};

/// A finished picture.
#[derive(Debug, Clone)]
pub struct Picture {
    /// JPEG.
    pub jpeg: Vec<u8>,
    /// In pixels.
    pub width: u32,
    /// In pixels.
    pub height: u32,
    /// Below the picture.
    pub caption: String,
    /// File name without ending, made of its rank and its image.
    pub name: String,
}

/// Pictures under one heading.
#[derive(Debug, Clone)]
pub struct Gallery {
    /// As a folder's name.
    pub key: String,
    /// The heading.
    pub title: String,
    /// How many there would be without the limit.
    pub of: usize,
    /// In order.
    pub pictures: Vec<Picture>,
}

/// True boxes: blue. Detected boxes: vermilion. Both within white, so that they show on any ground.
const TRUE: [u8; 3] = [0, 114, 178];
const CLAIMED: [u8; 3] = [213, 94, 0];
/// Longest side of a whole image in the report, in pixels.
const WHOLE_PX: u32 = 416;
/// Between two images side by side, in pixels.
const GAP_PX: u32 = 8;
/// Side of a crop in the report, in pixels.
const CROP_PX: u32 = 192;

/// Some images of the truth with all that is true and all that is claimed; drawn by lot, in order of the truth.
#[must_use]
pub fn samples(truth: &Truth, evaluation: &Evaluation, count: usize) -> Gallery {
    let n = truth.records.len();
    let mut indices: Vec<usize> = (0..n).collect();
    Rng::for_item(evaluation.config.seed, "eval/samples", 0).shuffle(&mut indices);
    indices.truncate(count);
    indices.sort_unstable();
    let pictures = indices.par_iter().filter_map(|&i| sample(truth, evaluation, i)).collect();
    Gallery { key: "samples".into(), title: "Test images drawn by lot".into(), of: n, pictures }
}

fn sample(truth: &Truth, evaluation: &Evaluation, index: usize) -> Option<Picture> {
    let (image, scores) = whole(truth, evaluation, index)?;
    let name = &truth.records[index].image;
    picture(&image, format!("{name}: {scores}"), stem(index, name))
}

/// The images on which two runs disagree, those first on which they differ in most boxes: each with the first run's boxes on the left and the
/// second's on the right.
#[must_use]
pub fn disagreements(truth: &Truth, [a, b]: [&Evaluation; 2], comparison: &Comparison, count: usize) -> Gallery {
    let mut all: Vec<&Disagreement> = comparison.disagreements.iter().collect();
    all.sort_by_key(|d| std::cmp::Reverse(d.found[0].abs_diff(d.found[1]) + d.fp[0].abs_diff(d.fp[1])));
    let pictures = all.par_iter().take(count).filter_map(|d| {
        let ((left, first), (right, second)) = (whole(truth, a, d.index)?, whole(truth, b, d.index)?);
        let mut both = RgbImage::from_pixel(left.width() + GAP_PX + right.width(), left.height(), Rgb([255; 3]));
        imageops::replace(&mut both, &left, 0, 0);
        imageops::replace(&mut both, &right, i64::from(left.width() + GAP_PX), 0);
        picture(&both, format!("{}: {}: {first}; {}: {second}", d.image, a.name, b.name), stem(d.index, &d.image))
    });
    let title = format!("{} (left) and {} (right) disagree", comparison.first, comparison.second);
    Gallery { key: "disagreements".into(), title, of: all.len(), pictures: pictures.collect() }
}

/// A whole image with what is true and what is claimed, and the scores in words.
fn whole(truth: &Truth, evaluation: &Evaluation, index: usize) -> Option<(RgbImage, String)> {
    let record = &truth.records[index];
    let extra = truth.boxes.extra();
    let full = open(truth, index)?;
    let scale = (f64::from(WHOLE_PX) / f64::from(full.width().max(full.height()))).min(1.0);
    let (w, h) = ((f64::from(full.width()) * scale).round().max(1.0) as u32, (f64::from(full.height()) * scale).round().max(1.0) as u32);
    let mut image = if scale < 1.0 { imageops::thumbnail(&full, w, h) } else { full };
    let detections: Vec<_> = evaluation.located.detections(index).into_iter().filter(|d| d.score >= evaluation.config.threshold).collect();
    record.markers.iter().for_each(|m| outline(&mut image, &m.bounds, [0.0, 0.0], scale, extra, TRUE));
    detections.iter().for_each(|d| outline(&mut image, &d.bounds, [0.0, 0.0], scale, extra, CLAIMED));
    let scores: Vec<String> = by_falling_score(&detections).iter().map(|&k| format!("{:.2}", detections[k].score)).collect();
    let scores = if scores.is_empty() { "no detection".into() } else { format!("score {}", scores.join(", ")) };
    Some((image, scores))
}

/// Crops of the gravest errors of each kind.
#[must_use]
pub fn of_failures(truth: &Truth, evaluation: &Evaluation, failures: &[Failure], count: usize) -> Vec<Gallery> {
    let gallery = |kind: Kind| {
        let all: Vec<&Failure> = failures.iter().filter(|f| f.kind == kind).collect();
        let pictures = all.par_iter().take(count).enumerate().filter_map(|(rank, f)| crop(truth, evaluation, f, rank)).collect();
        Gallery { key: kind.key().into(), title: kind.title().into(), of: all.len(), pictures }
    };
    Kind::ALL.into_iter().map(gallery).filter(|g| g.of > 0).collect()
}

fn crop(truth: &Truth, evaluation: &Evaluation, failure: &Failure, rank: usize) -> Option<Picture> {
    let extra = truth.boxes.extra();
    let claimed = claimed_box(evaluation, failure);
    let around = match (failure.truth, claimed) {
        (Some(a), Some(b)) => {
            PixelBox { x_min: a.x_min.min(b.x_min), y_min: a.y_min.min(b.y_min), x_max: a.x_max.max(b.x_max), y_max: a.y_max.max(b.y_max) }
        }
        (a, b) => a.or(b)?,
    };
    let full = open(truth, failure.image)?;
    // As much surrounding on each side as the box is long, at least 24 px, within the image.
    let (fw, fh) = (f64::from(full.width()), f64::from(full.height()));
    let long = around.width().max(around.height()) + extra;
    let side = (2.4 * long).max(long + 48.0).min(fw.min(fh)).max(1.0);
    let center = [(around.x_min + around.x_max + extra) / 2.0, (around.y_min + around.y_max + extra) / 2.0];
    let from = |c: f64, all: f64| (c - side / 2.0).clamp(0.0, all - side).floor();
    let (x, y, side) = (from(center[0], fw), from(center[1], fh), side.floor());
    let part = imageops::crop_imm(&full, x as u32, y as u32, side as u32, side as u32).to_image();
    let filter = if side < f64::from(CROP_PX) { imageops::FilterType::CatmullRom } else { imageops::FilterType::Triangle };
    let mut image = imageops::resize(&part, CROP_PX, CROP_PX, filter);
    let scale = f64::from(CROP_PX) / side;
    if let Some(b) = failure.truth {
        outline(&mut image, &b, [x, y], scale, extra, TRUE);
    }
    if let Some(b) = claimed {
        outline(&mut image, &b, [x, y], scale, extra, CLAIMED);
    }
    let record = &truth.records[failure.image];
    let px = |b: PixelBox| format!("{:.0} x {:.0} px", b.width() + extra, b.height() + extra);
    let words = match (failure.kind, failure.truth, claimed) {
        (Kind::Missed, Some(b), _) => px(b),
        (Kind::Background, _, Some(b)) => format!("score {:.2}, {}", failure.score.unwrap_or(0.0), px(b)),
        _ => format!("score {:.2}, IoU {:.2}", failure.score.unwrap_or(0.0), failure.iou),
    };
    picture(&image, format!("{}: {words}", record.image), format!("{rank:03}-{}", stem(failure.image, &record.image)))
}

fn open(truth: &Truth, index: usize) -> Option<RgbImage> {
    tcross_dataset::picture::read(truth.image_path(index)?).ok()
}

fn stem(index: usize, image: &str) -> String {
    let name = image.rsplit('/').next().unwrap_or(image);
    let name = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    let safe: String = name.chars().map(|c| if c.is_ascii_alphanumeric() || c == '-' || c == '_' { c } else { '_' }).collect();
    format!("{index:05}-{safe}")
}

fn picture(image: &RgbImage, caption: String, name: String) -> Option<Picture> {
    let mut jpeg = Vec::new();
    JpegEncoder::new_with_quality(&mut jpeg, 88).encode_image(image).ok()?;
    Some(Picture { jpeg, width: image.width(), height: image.height(), caption, name })
}

/// Draws a box that is given in pixels of the source, on an image that starts at `origin` there and is scaled.
fn outline(image: &mut RgbImage, b: &PixelBox, origin: [f64; 2], scale: f64, extra: f64, color: [u8; 3]) {
    let at = |v: f64, o: f64| ((v - o) * scale).round() as i64;
    let (x0, y0) = (at(b.x_min, origin[0]), at(b.y_min, origin[1]));
    let (x1, y1) = (at(b.x_max + extra, origin[0]), at(b.y_max + extra, origin[1]));
    for (grow, color) in [(2, [255; 3]), (1, color), (0, color)] {
        frame(image, [x0 - grow, y0 - grow, x1 - 1 + grow, y1 - 1 + grow], Rgb(color));
    }
}

/// One-pixel frame; both ends in.
fn frame(image: &mut RgbImage, [x0, y0, x1, y1]: [i64; 4], color: Rgb<u8>) {
    let (w, h) = (i64::from(image.width()), i64::from(image.height()));
    let mut put = |x: i64, y: i64| {
        if (0..w).contains(&x) && (0..h).contains(&y) {
            image.put_pixel(x as u32, y as u32, color);
        }
    };
    for x in x0.max(0)..=x1.min(w - 1) {
        put(x, y0);
        put(x, y1);
    }
    for y in y0.max(0)..=y1.min(h - 1) {
        put(x0, y);
        put(x1, y);
    }
}

/// Base64 of bytes, as a page holds pictures.
#[must_use]
pub fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let word = (0..3).fold(0u32, |w, k| w << 8 | u32::from(chunk.get(k).copied().unwrap_or(0)));
        for k in 0..4 {
            let digit = DIGITS[(word >> (18 - 6 * k) & 63) as usize];
            out.push(if k <= chunk.len() { digit as char } else { '=' });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_of_the_standard() {
        for (bytes, text) in [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")] {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
    }

    #[test]
    fn a_box_is_framed_around_its_pixels() {
        let mut image = RgbImage::new(20, 20);
        outline(&mut image, &[5.0, 5.0, 10.0, 10.0].into(), [0.0; 2], 1.0, 0.0, TRUE);
        assert_eq!((image.get_pixel(5, 7).0, image.get_pixel(4, 7).0, image.get_pixel(3, 7).0), (TRUE, TRUE, [255; 3]));
        assert_eq!((image.get_pixel(9, 7).0, image.get_pixel(7, 7).0), (TRUE, [0; 3]));
        outline(&mut image, &[-50.0, -50.0, 500.0, 500.0].into(), [0.0; 2], 3.0, 1.0, TRUE);
    }
}
