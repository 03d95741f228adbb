//! The pose's marks over many drawn markers at 1280x720: `cargo run --release -p tcross-infer --example pose_study -- --help`.
#![allow(clippy::print_stdout)]
#[path = "support/marks.rs"]
mod marks;
#[path = "../tests/integration/scene.rs"]
#[allow(dead_code)]
mod scene;

use image::RgbImage;
use marks::{Marks, Trial};
use scene::Style;
use std::{path::PathBuf, time::Instant};
use tcross_dataset::{PoseOutcome, Rng};
use tcross_infer::pose::{self, Config, Method};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1)).cloned();
    if args.iter().any(|a| a == "--help") {
        println!("pose_study [--images N] [--backgrounds DIR] [--jitter SHARE] [--method model|paper|both] [--failures DIR] [--empty N]");
        return Ok(());
    }
    let images: u64 = value("--images").map_or(Ok(300), |v| v.parse())?;
    let jitter: f64 = value("--jitter").map_or(Ok(0.0), |v| v.parse())?;
    let wanted = value("--method").unwrap_or_else(|| "both".into());
    let failures = value("--failures").map(PathBuf::from);
    let photos = value("--backgrounds").map(photos).transpose()?.unwrap_or_default();
    let methods: Vec<Method> = match wanted.as_str() {
        "model" => vec![Method::Model],
        "paper" => vec![Method::Paper],
        _ => vec![Method::Model, Method::Paper],
    };
    let mut trials: Vec<Vec<Trial>> = vec![Vec::new(); methods.len()];
    for index in 0..images {
        let mut rng = Rng::for_item(14, "study/pose", index);
        let mut image = background(&photos, &mut rng);
        let drawn = scene::draw(&mut image, &Style::default(), &mut rng);
        let mut bounds = drawn.bounds;
        if jitter > 0.0 {
            let (w, h) = (bounds.width(), bounds.height());
            bounds.x_min += jitter * w * rng.uniform(-1.0, 1.0);
            bounds.x_max += jitter * w * rng.uniform(-1.0, 1.0);
            bounds.y_min += jitter * h * rng.uniform(-1.0, 1.0);
            bounds.y_max += jitter * h * rng.uniform(-1.0, 1.0);
        }
        for (method, trials) in methods.iter().zip(&mut trials) {
            let config = Config { method: *method, ..Config::default() };
            let start = Instant::now();
            let outcome = pose::recover(&image, &bounds, &config);
            let ms = start.elapsed().as_secs_f64() * 1e3;
            let trial = Trial::new(&drawn.corners, drawn.bounds.width(), drawn.tilt_deg, drawn.blur_px, outcome, ms);
            if let (Some(dir), true) = (&failures, trial.is_bad()) {
                std::fs::create_dir_all(dir)?;
                let pad = 0.3 * bounds.width().max(bounds.height());
                let b = &bounds;
                let (x, y) = ((b.x_min - pad).max(0.0) as u32, (b.y_min - pad).max(0.0) as u32);
                let crop = image::imageops::crop_imm(&image, x, y, (b.width() + 2.0 * pad) as u32, (b.height() + 2.0 * pad) as u32);
                crop.to_image().save(dir.join(format!("{index:05}-{method:?}.png")))?;
                match &trial.outcome {
                    PoseOutcome::Refused { refused } => println!(
                        "{index} {method:?}: {refused}; width {:.0} tilt {:.0} blur {:.1}",
                        trial.width_px, trial.tilt_deg, trial.blur_px
                    ),
                    PoseOutcome::Found(p) => println!(
                        "{index} {method:?}: wrong by {:.1} deg, corners {:.1} %, quality {:.2}; width {:.0} tilt {:.0} blur {:.1}",
                        trial.angle_deg, trial.corner_percent, p.quality, trial.width_px, trial.tilt_deg, trial.blur_px
                    ),
                }
            }
            trials.push(trial);
        }
    }
    let empty: u64 = value("--empty").map_or(Ok(0), |v| v.parse())?;
    for method in methods.iter().filter(|_| empty > 0) {
        let config = Config { method: *method, ..Config::default() };
        let mut refused = 0;
        let mut qualities = Vec::new();
        for index in 0..empty {
            let mut rng = Rng::for_item(14, "study/empty", index);
            let image = background(&photos, &mut rng);
            let (w, h) = (rng.log_uniform(24.0, 400.0), rng.log_uniform(24.0, 400.0));
            let (w, h) = (w.max(h / 2.5), h.max(w / 2.5));
            let (x, y) = (rng.uniform(0.0, 1280.0 - w), rng.uniform(0.0, 720.0 - h));
            match pose::recover(&image, &[x, y, x + w, y + h].into(), &config) {
                PoseOutcome::Refused { .. } => refused += 1,
                PoseOutcome::Found(p) => qualities.push(p.quality),
            }
        }
        qualities.sort_by(f64::total_cmp);
        println!("{method:?}: {refused} of {empty} boxes without a marker refused; qualities of the others {qualities:.2?}");
    }
    for (method, trials) in methods.iter().zip(&trials) {
        println!("{method:?}\n{}", Marks::of(trials));
    }
    Ok(())
}

fn photos(dir: String) -> Result<Vec<RgbImage>, Box<dyn std::error::Error>> {
    let mut paths = Vec::new();
    let mut folders = vec![PathBuf::from(dir)];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder)? {
            let path = entry?.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "jpg") {
                paths.push(path);
            }
        }
    }
    paths.sort();
    let every = (paths.len() / 60).max(1);
    let open = |p: &PathBuf| Ok(image::open(p)?.resize_to_fill(1280, 720, image::imageops::FilterType::Triangle).to_rgb8());
    paths.iter().step_by(every).map(open).collect()
}

fn background(photos: &[RgbImage], rng: &mut Rng) -> RgbImage {
    if photos.is_empty() { scene::clutter(1280, 720, rng) } else { rng.choose(photos).clone() }
}
