//! The pose's marks over a dataset, from true boxes, by our method and the paper's, and the share of empty boxes that are refused:
//! `cargo run --release -p tcross-infer --example pose_study -- --help`.
#![allow(clippy::print_stdout)]
#[path = "support/marks.rs"]
mod marks;

use image::RgbImage;
use marks::{Marks, Trial};
use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    time::Instant,
};
use tcross_dataset::{Dataset, Detection, ImageDetections, PixelBox, PoseOutcome, Record, Rng, Split, detections, files};
use tcross_infer::{
    pose::{self, Config, Method, model::FEATURES},
    read_image,
};

const HELP: &str = "pose_study DATASET [--out DIR] [--method model|paper|both] [--jitter SHARE] [--threads N] [--min-quality Q]
pose_study --empty N --photos DIR [--method model|paper|both]
pose_study DATASET... --fit N --photos DIR [--dump FILE]

DATASET: a dataset's folder; all its splits are used. --out writes truth.jsonl and a detections file a method, for
`tcross eval DIR/truth.jsonl DIR/model.jsonl DIR/paper.jsonl --protocol pose --out DIR/eval`, which draws the curves.
Below the marks stands what other values of min_quality, from Q on, would give.
--jitter moves each side of a box by up to that share of its length. Times are good for something with --threads 1, the default.
--empty: N boxes of 24 to 400 px on photos without a marker.
--fit: the quality's weights, by logistic regression of right poses of the datasets against all else and against N empty boxes;
--dump keeps what was seen of each.";

type Failed = Box<dyn std::error::Error + Send + Sync>;

fn main() -> Result<(), Failed> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1)).cloned();
    let number = |name: &str, default: f64| value(name).map_or(Ok(default), |v| v.parse::<f64>());
    let methods = match value("--method").as_deref() {
        Some("model") => vec![Method::Model],
        Some("paper") => vec![Method::Paper],
        _ => vec![Method::Model, Method::Paper],
    };
    rayon::ThreadPoolBuilder::new().num_threads(number("--threads", 1.0)? as usize).build_global()?;
    if let (Some(photos), Some(_)) = (value("--photos"), value("--fit")) {
        let datasets: Vec<&Path> = args.iter().take_while(|a| !a.starts_with("--")).map(Path::new).collect();
        return fit(&datasets, Path::new(&photos), number("--fit", 2000.0)? as u64, value("--dump"));
    }
    if let Some(photos) = value("--photos") {
        return empty(Path::new(&photos), number("--empty", 2000.0)? as u64, &methods);
    }
    match args.first() {
        Some(dataset) if !dataset.starts_with("--") => {
            let least = number("--min-quality", Config::default().min_quality)?;
            study(Path::new(dataset), &methods, least, number("--jitter", 0.0)?, value("--out").map(PathBuf::from))
        }
        _ => {
            println!("{HELP}");
            Ok(())
        }
    }
}

fn configured(method: Method) -> Config {
    Config { method, ..Config::default() }
}

fn name(method: Method) -> &'static str {
    if method == Method::Model { "model" } else { "paper" }
}

fn study(dir: &Path, methods: &[Method], min_quality: f64, jitter: f64, out: Option<PathBuf>) -> Result<(), Failed> {
    let dataset = Dataset::open(dir)?;
    let records = records(dir, &dataset)?;
    let moved = |b: &PixelBox, rng: &mut Rng| -> PixelBox {
        let (w, h) = (jitter * b.width(), jitter * b.height());
        let mut by = |v: f64, size: f64| if jitter > 0.0 { v + size * rng.uniform(-1.0, 1.0) } else { v };
        [by(b.x_min, w), by(b.y_min, h), by(b.x_max, w), by(b.y_max, h)].into()
    };
    for method in methods {
        let config = Config { min_quality, ..configured(*method) };
        let looked: Vec<(ImageDetections, Vec<Trial>)> = records
            .par_iter()
            .enumerate()
            .map(|(index, record)| {
                let image = read_image(&dataset.image_path(record))?;
                let mut rng = Rng::for_item(14, "study/jitter", index as u64);
                let (mut found, mut trials) = (Vec::new(), Vec::new());
                for marker in &record.markers {
                    let bounds = moved(&marker.bounds, &mut rng);
                    let start = Instant::now();
                    let outcome = pose::recover(&image, &bounds, &config);
                    let ms = start.elapsed().as_secs_f64() * 1e3;
                    found.push(Detection { score: 1.0, class: 0, bounds: marker.bounds, pose: Some(outcome.clone()) });
                    trials.extend(Trial::new(marker, outcome, ms));
                }
                let (width, height) = (record.width, record.height);
                Ok((ImageDetections { image: record.image.clone(), width, height, detections: found, ms: None }, trials))
            })
            .collect::<Result<_, Failed>>()?;
        let trials: Vec<Trial> = looked.iter().flat_map(|l| l.1.clone()).collect();
        println!("{}\n{}", name(*method), Marks::of(&trials));
        if *method == Method::Model {
            thresholds(&trials, min_quality);
        }
        let mut reasons: BTreeMap<&str, usize> = BTreeMap::new();
        for trial in &trials {
            if let PoseOutcome::Refused { refused } = &trial.outcome {
                *reasons.entry(refused).or_default() += 1;
            }
        }
        println!("  refused                {reasons:?}");
        if let Some(out) = &out {
            files::create_dir(out)?;
            detections::write(out.join(format!("{}.jsonl", name(*method))), looked.iter().map(|l| &l.0))?;
        }
    }
    if let Some(out) = &out {
        files::write_jsonl(out.join("truth.jsonl"), &records)?;
    }
    Ok(())
}

/// What more demanding values of `min_quality` would give.
fn thresholds(trials: &[Trial], from: f64) {
    for least in [0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7].into_iter().filter(|q| *q > from) {
        let kept: Vec<&Trial> = trials.iter().filter(|t| matches!(&t.outcome, PoseOutcome::Found(p) if p.quality >= least)).collect();
        let percent = |n: usize, of: usize| 100.0 * n as f64 / of.max(1) as f64;
        let wrong = kept.iter().filter(|t| t.angle_deg > 45.0).count();
        let corners = marks::quantile(kept.iter().map(|t| t.corner_percent).collect(), 0.95);
        let (recovered, wrong) = (percent(kept.len(), trials.len()), percent(wrong, kept.len()));
        println!("  min_quality {least:4.2}       recovered {recovered:6.2} %, wrong {wrong:5.2} %, corners p95 {corners:6.2} %");
    }
}

/// All splits: no method learns from any of them.
fn records(dir: &Path, dataset: &Dataset) -> Result<Vec<Record>, Failed> {
    let mut records: Vec<Record> = Vec::new();
    for split in Split::ALL {
        if dir.join(format!("{split}.jsonl")).is_file() {
            records.extend(dataset.records(split)?);
        }
    }
    Ok(records)
}

/// Calls `look` with boxes on photos without a marker: what a detector that errs would hand over. Other boxes for every `purpose`.
fn on_photos<T: Send>(photos: &Path, boxes: u64, purpose: &str, look: impl Fn(&RgbImage, &PixelBox) -> T + Sync) -> Result<Vec<T>, Failed> {
    let mut paths = Vec::new();
    let mut folders = vec![photos.to_owned()];
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
    if paths.is_empty() {
        return Err(format!("{}: no .jpg below", photos.display()).into());
    }
    let each = boxes.div_ceil(paths.len() as u64);
    let looked: Vec<Vec<T>> = paths
        .par_iter()
        .enumerate()
        .map(|(k, path)| {
            let image: RgbImage = image::open(path)?.resize_to_fill(1280, 720, image::imageops::FilterType::Triangle).to_rgb8();
            let first = k as u64 * each;
            let boxes = (first..(first + each).min(boxes)).map(|index| {
                let mut rng = Rng::for_item(14, purpose, index);
                let (w, h) = (rng.log_uniform(24.0, 400.0), rng.log_uniform(24.0, 400.0));
                let (w, h) = (w.max(h / 2.5), h.max(w / 2.5));
                let (x, y) = (rng.uniform(0.0, 1280.0 - w), rng.uniform(0.0, 720.0 - h));
                look(&image, &[x, y, x + w, y + h].into())
            });
            Ok(boxes.collect())
        })
        .collect::<Result<_, Failed>>()?;
    Ok(looked.into_iter().flatten().collect())
}

fn empty(photos: &Path, boxes: u64, methods: &[Method]) -> Result<(), Failed> {
    let looked = on_photos(photos, boxes, "study/empty", |image, b| {
        methods.iter().map(|m| pose::recover(image, b, &configured(*m))).collect::<Vec<_>>()
    })?;
    for (k, method) in methods.iter().enumerate() {
        let mut claimed: Vec<f64> =
            looked.iter().filter_map(|answers| if let PoseOutcome::Found(p) = &answers[k] { Some(p.quality) } else { None }).collect();
        claimed.sort_by(f64::total_cmp);
        let refused = looked.len() - claimed.len();
        let percent = 100.0 * refused as f64 / looked.len().max(1) as f64;
        println!(
            "{}: {refused} of {} empty boxes refused ({percent:.2} %); qualities of the others {claimed:.2?}",
            name(*method),
            looked.len()
        );
    }
    Ok(())
}

/// What was seen of a quadrilateral, and whether it is right.
type Row = ([f64; FEATURES.len()], bool, String);

/// Everything considered for the markers of a dataset.
fn considered(dir: &Path) -> Result<Vec<Row>, Failed> {
    let config = configured(Method::Model);
    let dataset = Dataset::open(dir)?;
    let markers: Vec<Vec<Row>> = records(dir, &dataset)?
        .par_iter()
        .enumerate()
        .map(|(k, record)| {
            let image = read_image(&dataset.image_path(record))?;
            // Each box as it is, and as a detector would place it.
            let mut rng = Rng::for_item(14, "study/fit", k as u64);
            let mut moved = |v: f64, size: f64| v + 0.06 * size * rng.uniform(-1.0, 1.0);
            let mut rows: Vec<Row> = Vec::new();
            for marker in &record.markers {
                let (b, w, h) = (&marker.bounds, marker.bounds.width(), marker.bounds.height());
                let beside = PixelBox::from([moved(b.x_min, w), moved(b.y_min, h), moved(b.x_max, w), moved(b.y_max, h)]);
                for (name, bounds) in [("as it is", b), ("moved", &beside)] {
                    for seen in pose::model::considered(&image, bounds, &config) {
                        let Some(trial) = Trial::new(marker, PoseOutcome::Found(Box::new(seen.pose.clone())), 0.0) else { continue };
                        let right = trial.center_percent < 6.0 && trial.corner_percent < 10.0;
                        let text = format!(
                            "{{\"image\": {:?}, \"box\": {name:?}, \"right\": {right}, \"angle_off\": {}, \"features\": {:?}, \"pose\": {}, \"marker\": {}}}\n",
                            record.image,
                            trial.angle_deg,
                            seen.evidence.features,
                            serde_json::to_string(&seen.pose)?,
                            serde_json::to_string(marker)?,
                        );
                        rows.push((seen.evidence.features, right, text));
                    }
                }
            }
            Ok(rows)
        })
        .collect::<Result<_, Failed>>()?;
    Ok(markers.into_iter().flatten().collect())
}

/// Fits the quality: right poses (centre within 6 %, corners within 10 %) against wrong ones and empty boxes.
fn fit(datasets: &[&Path], photos: &Path, boxes: u64, dump: Option<String>) -> Result<(), Failed> {
    let mut rows: Vec<Row> = Vec::new();
    for dir in datasets {
        rows.extend(considered(dir)?);
    }
    let config = configured(Method::Model);
    let patches = on_photos(photos, boxes, "study/fit-empty", |image, b| {
        let row = |seen: pose::model::Considered| {
            let text = format!("{{\"image\": \"\", \"right\": false, \"features\": {:?}}}\n", seen.evidence.features);
            (seen.evidence.features, false, text)
        };
        pose::model::considered(image, b, &config).into_iter().map(row).collect::<Vec<_>>()
    })?;
    rows.extend(patches.into_iter().flatten());
    if let Some(path) = dump {
        std::fs::write(path, rows.iter().map(|r| r.2.as_str()).collect::<String>())?;
    }
    let weights = logistic(&rows);
    println!("{} rows, {} right", rows.len(), rows.iter().filter(|r| r.1).count());
    println!("{:9.4}  bias", weights[0]);
    for (name, weight) in FEATURES.iter().zip(&weights[1..]) {
        println!("{weight:9.4}  {name}");
    }
    Ok(())
}

/// Logistic regression by Newton's method with a slight pull towards zero.
fn logistic(rows: &[Row]) -> Vec<f64> {
    const N: usize = FEATURES.len() + 1;
    let mut weights = SVector::<f64, N>::zeros();
    for _ in 0..30 {
        let mut normal = SMatrix::<f64, N, N>::identity() * 0.5;
        let mut right = -weights * 0.5;
        for (features, is_right, _) in rows {
            let x = SVector::<f64, N>::from_fn(|i, _| if i == 0 { 1.0 } else { features[i - 1] });
            let p = 1.0 / (1.0 + (-weights.dot(&x)).exp());
            right += x * (f64::from(u8::from(*is_right)) - p);
            normal += x * x.transpose() * (p * (1.0 - p)).max(1e-6);
        }
        let Some(step) = normal.cholesky().map(|c| c.solve(&right)) else { break };
        weights += step;
        if step.norm() < 1e-6 {
            break;
        }
    }
    weights.iter().copied().collect()
}
