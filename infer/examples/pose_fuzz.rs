//! Random pictures and random boxes for the pose: no panic, no number that is not one, no growing memory.
//! `cargo run --release -p tcross-infer --example pose_fuzz -- MINUTES [IMAGES]`: IMAGES is a folder or a dataset whose pictures are
//! cropped, stretched, greyed, blackened and cut besides those made up.
#![allow(clippy::print_stdout)]
#[path = "../tests/integration/scene.rs"]
#[allow(clippy::expect_used, reason = "a helper of tests")]
#[allow(dead_code)]
mod scene;

use image::{Rgb, RgbImage};
use std::{
    collections::BTreeMap,
    panic::{AssertUnwindSafe, catch_unwind},
    time::{Duration, Instant},
};
use tcross_dataset::{PixelBox, Pose, PoseOutcome, Rng};
use tcross_infer::{
    Camera, Source,
    pose::{self, Config, Method},
    read_image,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let minutes: f64 = args.first().map_or(Ok(10.0), |v| v.parse())?;
    let pictures = match args.get(1) {
        Some(dir) => Source::open(&[dir], None)?.items.iter().take(40).map(|i| read_image(&i.path)).collect::<Result<Vec<_>, _>>()?,
        None => Vec::new(),
    };
    let end = Instant::now() + Duration::from_secs_f64(60.0 * minutes);
    let mut answers: BTreeMap<String, u64> = BTreeMap::new();
    let mut faults = 0;
    let mut tries = 0u64;
    while Instant::now() < end && faults < 10 {
        let mut rng = Rng::for_item(14, "fuzz/pose", tries);
        tries += 1;
        let image = picture(&pictures, &mut rng);
        for _ in 0..4 {
            let bounds = bounds(&image, &mut rng);
            for method in [Method::Model, Method::Paper] {
                let answer = catch_unwind(AssertUnwindSafe(|| pose::recover(&image, &bounds, &Config { method, ..Config::default() })));
                let word = match answer {
                    Ok(PoseOutcome::Found(pose)) if is_sound(&pose) => "a pose".to_owned(),
                    Ok(PoseOutcome::Refused { refused }) => refused,
                    Ok(PoseOutcome::Found(pose)) => format!("FAULT: a number that is none in {pose:?}"),
                    Err(_) => "FAULT: a panic".to_owned(),
                };
                if word.starts_with("FAULT") {
                    faults += 1;
                    println!("try {tries}: {word}: {}x{} px, {bounds:?}, {method:?}", image.width(), image.height());
                }
                *answers.entry(word).or_default() += 1;
            }
        }
    }
    println!("{tries} pictures, {} answers, {faults} faults", answers.values().sum::<u64>());
    for (answer, count) in &answers {
        println!("{count:9}  {answer}");
    }
    if faults == 0 { Ok(()) } else { Err("the pose has faults".into()) }
}

/// Every number finite, the quality a share, the covariance positive definite, and a camera's answer finite too.
fn is_sound(pose: &Pose) -> bool {
    let mut pose = pose.clone();
    if let Ok(camera) = Camera::from_field_of_view(60.0, 640, 480) {
        camera.locate(&mut pose, 1.0);
    }
    let [xx, xy, yy] = pose.covariance;
    let space = pose.rotation.iter().flatten().chain(pose.translation.iter().flatten());
    let mut numbers = pose.corners.0.iter().flatten().chain(&pose.center).chain(&pose.homography.0).chain(&pose.covariance).chain(space);
    numbers.all(|v| v.is_finite())
        && (0.0..=1.0).contains(&pose.quality)
        && (0.0..360.0).contains(&pose.angle)
        && xx > 0.0
        && xx * yy > xy * xy
}

/// A picture of any size up to 300 px: one of those given, drawn, noise, or of one colour.
fn picture(pictures: &[RgbImage], rng: &mut Rng) -> RgbImage {
    let (w, h) = (rng.log_uniform(1.0, 300.0) as u32, rng.log_uniform(1.0, 300.0) as u32);
    match rng.index(if pictures.is_empty() { 4 } else { 8 }) {
        0 => RgbImage::from_pixel(w, h, Rgb(std::array::from_fn(|_| rng.int(0, 255) as u8))),
        1 => RgbImage::from_fn(w, h, |_, _| Rgb(std::array::from_fn(|_| rng.int(0, 255) as u8))),
        2 => scene::clutter(w, h, rng),
        3 => {
            let mut image = scene::clutter(w.max(60), h.max(60), rng);
            scene::draw(&mut image, &scene::Style { width_px: (12.0, 300.0), tilt_deg: (0.0, 80.0), ..scene::Style::default() }, rng);
            image
        }
        kind => {
            let from = rng.choose(pictures);
            let (x, y) = (rng.index(from.width() as usize) as u32, rng.index(from.height() as usize) as u32);
            let mut crop = image::imageops::crop_imm(from, x, y, w, h).to_image();
            if kind == 5 {
                crop = image::DynamicImage::from(image::DynamicImage::from(crop).into_luma8()).into_rgb8();
            } else if kind == 6 {
                let black = rng.unit();
                crop.pixels_mut().for_each(|p| p.0 = p.0.map(|v| (f64::from(v) * black) as u8));
            }
            crop
        }
    }
}

/// A box: sensible, of no area, of one pixel, outside, huge, reversed, or not of numbers.
fn bounds(image: &RgbImage, rng: &mut Rng) -> PixelBox {
    let (w, h) = (f64::from(image.width()), f64::from(image.height()));
    let mut within = || {
        let (a, b) = (rng.uniform(-0.3, 1.3), rng.uniform(-0.3, 1.3));
        (a.min(b), a.max(b))
    };
    let ((x0, x1), (y0, y1)) = (within(), within());
    let sensible = [x0 * w, y0 * h, x1 * w, y1 * h];
    match rng.index(12) {
        0 => [x0 * w, y0 * h, x0 * w, y1 * h].into(),
        1 => [x0 * w, y0 * h, x0 * w + 1.0, y0 * h + 1.0].into(),
        2 => [x0 * w + 1e4, y0 * h, x1 * w + 1e4, y1 * h].into(),
        3 => [-1e300, -1e300, 1e300, 1e300].into(),
        4 => [x1 * w, y1 * h, x0 * w, y0 * h].into(),
        5 => [f64::NAN, y0 * h, x1 * w, f64::INFINITY].into(),
        6 => [0.0, 0.0, w, h].into(),
        _ => sensible.into(),
    }
}
