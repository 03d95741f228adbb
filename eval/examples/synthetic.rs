//! Scores a made-up detector on made-up images and writes the whole report: `cargo run --release --example synthetic -- OUT [IMAGES [compare]]`.
//! Shows how the library is used, and what a report looks like.
use image::{Rgb, RgbImage};
use std::{path::Path, time::Instant};
use tcross_dataset::{
    Detection, Homography, ImageDetections, Marker, PixelBox, Pose, PoseOutcome, Quad, Record, Rng, dataset::BoxConvention,
    geom::quad::angle_deg,
};
use tcross_eval::{Config, Protocol, Report, Run, Truth, config::PaperRef, evaluate};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let out = std::env::args().nth(1).unwrap_or_else(|| "synthetic-report".into());
    let images: usize = std::env::args().nth(2).map_or(Ok(1079), |n| n.parse())?;
    let dir = Path::new(&out).join("data");
    std::fs::create_dir_all(dir.join("test"))?;
    let (records, detections): (Vec<_>, Vec<_>) = (0..images).map(|k| scene(k as u64)).unzip();
    for record in &records {
        if !dir.join(&record.image).is_file() {
            picture(record).save(dir.join(&record.image))?;
        }
    }
    tcross_dataset::files::write_jsonl(dir.join("test.jsonl"), &records)?;
    tcross_dataset::detections::write(dir.join("detections.jsonl"), &detections)?;
    let start = Instant::now();
    let truth = Truth::new(records, BoxConvention::Continuous, Some(dir.clone()));
    let config = Config {
        protocols: vec![Protocol::Paper, Protocol::Coco, Protocol::Pose],
        paper: Some(PaperRef { table: 5, row: "T cross of random thickness".into() }),
        ..Config::default()
    };
    let evaluation = evaluate(&truth, "synthetic", dir.join("detections.jsonl").as_path().into(), &config, false)?;
    let provenance = vec![("Detector".to_owned(), "none: boxes drawn by lot around the truth".to_owned()), ("Seed".into(), "0".into())];
    // The same detector with its least certain half thrown away: a second run on one truth is compared pair by pair.
    let timid: Vec<ImageDetections> = detections.iter().map(|d| without_below(d, 0.5)).collect();
    let timid = evaluate(&truth, "timid", timid.into(), &config, false)?;
    let compared = std::env::args().nth(3).is_some();
    let runs = [&evaluation, &timid].into_iter().take(1 + usize::from(compared)).map(|e| Run::new(&truth, e)).collect();
    let report = Report { title: "A made-up detector".into(), runs, sweeps: vec![], extras: vec![], provenance };
    report.build().write(&out)?;
    eprintln!("{images} images scored and reported in {:.2} s", start.elapsed().as_secs_f64());
    Ok(())
}

fn without_below(row: &ImageDetections, score: f64) -> ImageDetections {
    let detections = row.detections.iter().filter(|d| d.score >= score).cloned().collect();
    ImageDetections { detections, ..row.clone() }
}

/// An image's truth, and claims that get worse as the marker gets smaller and more blurred.
fn scene(k: u64) -> (Record, ImageDetections) {
    let mut rng = Rng::for_item(0, "eval/example", k);
    let (width, height, name) = (416, 416, format!("test/{k:05}.png"));
    let claim = |score: f64, b: PixelBox| Detection { score: score.clamp(0.0, 1.0), class: 0, bounds: b, pose: None };
    let mut detections = Vec::new();
    let mut markers = Vec::new();
    if !rng.chance(0.1) {
        let side = rng.log_uniform(8.0, 120.0);
        let (w, h) = (side * rng.uniform(0.8, 1.2), side);
        let (x, y) = (rng.uniform(0.0, 416.0 - w), rng.uniform(0.0, 416.0 - h));
        let b = PixelBox::from([x, y, x + w, y + h]);
        let blur = side * rng.uniform(0.0, 0.4);
        let fill = *rng.choose(&["#c83214", "#14b432", "#1e3cc8", "#e6c81e"]);
        let medium = *rng.choose(&["felt tip", "crayon", "paint", "highlighter"]);
        let tilt = rng.uniform(0.0, 70.0);
        let skill = 1.0 / (1.0 + (1.2 + 4.0 * blur / side + tilt / 60.0 - side / 9.0).exp());
        if rng.chance(skill) {
            let jitter = 0.06 * side / skill;
            let mut edge = |v: f64| v + jitter * rng.normal();
            let bounds = PixelBox::from([edge(b.x_min), edge(b.y_min), edge(b.x_max).max(b.x_min + 1.0), edge(b.y_max).max(b.y_min + 1.0)]);
            if bounds.is_valid() {
                let mut first = claim(skill - 0.12 * rng.unit(), bounds);
                first.pose = Some(pose(&b, &mut rng));
                detections.push(first);
                if rng.chance(0.05) {
                    detections.push(claim(0.4 * skill, bounds));
                }
            }
        }
        let mut marker = Marker::from_box("t_cross", b);
        marker.corners = Some(Quad(corners(&b)));
        (marker.blur_px, marker.tilt_deg, marker.fill, marker.medium) = (Some(blur), Some(tilt), Some(fill.into()), Some(medium.into()));
        markers.push(marker);
    }
    while rng.chance(0.12) {
        let (x, y, s) = (rng.uniform(0.0, 380.0), rng.uniform(0.0, 380.0), rng.uniform(8.0, 36.0));
        detections.push(claim(rng.unit() * rng.unit(), PixelBox::from([x, y, x + s, y + s])));
    }
    detections.sort_by(|a, b| b.score.total_cmp(&a.score));
    let background = Some(rng.choose(&["embedded/room", "embedded/leaves", "embedded/stripes"]).to_string());
    let effects = serde_json::Map::from_iter([("noise".to_owned(), serde_json::json!(rng.int(0, 4) as f64 * 5.0))]);
    let record = Record {
        image: name.clone(),
        width,
        height,
        background,
        markers,
        confusers: Vec::new(),
        intrinsics: None,
        distortion: None,
        effects,
    };
    (record, ImageDetections { image: name, width, height, detections, ms: None })
}

fn corners(b: &PixelBox) -> [[f64; 2]; 4] {
    [[b.x_min, b.y_min], [b.x_max, b.y_min], [b.x_max, b.y_max], [b.x_min, b.y_max]]
}

/// Corners moved by a pixel or so, now and then turned by a quarter; some are refused.
fn pose(b: &PixelBox, rng: &mut Rng) -> PoseOutcome {
    if rng.chance(0.05) {
        return PoseOutcome::Refused { refused: "too few lines".into() };
    }
    let mut seen = corners(b).map(|p| p.map(|v| v + 0.7 * rng.normal()));
    seen.rotate_left(usize::from(rng.chance(0.03)));
    let quad = Quad(seen);
    let center = quad.diagonal_crossing().unwrap_or(seen[0]);
    let angle = angle_deg(seen[0][0] - center[0], seen[0][1] - center[1]);
    let Some(homography) = Homography::from_unit_square(&seen) else {
        return PoseOutcome::Refused { refused: "corners on a line".into() };
    };
    let covariance = [0.25, 0.0, 0.25];
    PoseOutcome::Found(Box::new(Pose {
        center,
        corners: quad,
        angle,
        homography,
        covariance,
        quality: 0.9,
        rotation: None,
        translation: None,
        reprojection_px: None,
        rival: None,
    }))
}

/// Stripes with each marker as a filled rectangle: enough to see what the boxes mean.
fn picture(record: &Record) -> RgbImage {
    let mut image =
        RgbImage::from_fn(record.width, record.height, |x, y| Rgb([(90 + (x / 3 + y) % 90) as u8, 120, (80 + (x + 2 * y) % 120) as u8]));
    for marker in &record.markers {
        let fill = marker.fill.as_deref().unwrap_or("#ffffff");
        let channel = |k: usize| u8::from_str_radix(&fill[2 * k + 1..2 * k + 3], 16).unwrap_or(0);
        let b = marker.bounds;
        for y in b.y_min as u32..b.y_max as u32 {
            for x in b.x_min as u32..b.x_max as u32 {
                let (u, v) = ((f64::from(x) - b.x_min) / b.width(), (f64::from(y) - b.y_min) / b.height());
                let on_line = (u - v).abs() < 0.08 || ((u + v - 1.0).abs() < 0.08 && u > 0.5);
                image.put_pixel(x, y, if on_line { Rgb([250, 250, 250]) } else { Rgb([channel(0), channel(1), channel(2)]) });
            }
        }
    }
    image
}
