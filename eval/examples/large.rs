//! Scores a large file of made-up detections and tells time and memory: `cargo run --release --example large -- IMAGES EACH`.
#![allow(clippy::print_stdout, reason = "a program whose result is its output")]
use std::{
    io::{BufRead, BufReader, BufWriter, Write},
    time::Instant,
};
use tcross_dataset::{Record, Rng, dataset::BoxConvention};
use tcross_eval::{Config, Report, Run, Truth, evaluate};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let number = |k: usize, default: usize| std::env::args().nth(k).map_or(Ok(default), |n| n.parse());
    let (images, each) = (number(1, 100_000)?, number(2, 300)?);
    let path = std::env::temp_dir().join(format!("tcross-large-{images}-{each}.jsonl"));
    let records: Vec<Record> = (0..images).map(record).collect::<Result<_, _>>()?;
    let mut file = BufWriter::new(std::fs::File::create(&path)?);
    for k in 0..images {
        let mut rng = Rng::for_item(1, "eval/large", k as u64);
        let mut score = 1.0;
        write!(file, r#"{{"image":"{k}.jpg","width":416,"height":416,"detections":["#)?;
        for d in 0..each {
            score *= 1.0 - rng.unit() * 0.05;
            let (x, y, s) = (rng.uniform(0.0, 360.0), rng.uniform(0.0, 360.0), rng.uniform(8.0, 56.0));
            let comma = if d > 0 { "," } else { "" };
            write!(file, r#"{comma}{{"score":{score:.6},"class":0,"box":[{x:.2},{y:.2},{:.2},{:.2}]}}"#, x + s, y + s)?;
        }
        writeln!(file, "]}}")?;
    }
    drop(file);
    let bytes = std::fs::metadata(&path)?.len();
    let start = Instant::now();
    let lines = BufReader::with_capacity(1 << 20, std::fs::File::open(&path)?).split(b'\n').count();
    let reading = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let truth = Truth::new(records, BoxConvention::Continuous, None);
    let evaluation = evaluate(&truth, "large", path.as_path().into(), &Config::default(), false)?;
    let scored = start.elapsed().as_secs_f64();
    let report =
        Report { title: "Large".into(), runs: vec![Run::new(&truth, &evaluation)], sweeps: vec![], extras: vec![], provenance: vec![] }
            .build();
    let built = start.elapsed().as_secs_f64();
    std::fs::remove_file(&path)?;
    println!("{lines} lines, {:.2} GB: reading {reading:.2} s, scored after {scored:.2} s, report after {built:.2} s", bytes as f64 / 1e9);
    println!("{} tables, peak memory {}", report.tables.len(), peak_memory());
    Ok(())
}

fn record(k: usize) -> Result<Record, serde_json::Error> {
    let mut rng = Rng::for_item(0, "eval/large/truth", k as u64);
    let (x, y, s) = (rng.uniform(0.0, 360.0), rng.uniform(0.0, 360.0), rng.uniform(8.0, 56.0));
    serde_json::from_value(serde_json::json!({"image": format!("{k}.jpg"), "width": 416, "height": 416,
        "markers": [{"shape": "t_cross", "box": [x, y, x + s, y + s]}]}))
}

/// As Linux tells it.
fn peak_memory() -> String {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    status.lines().find_map(|l| l.strip_prefix("VmHWM:")).map_or("unknown".into(), |v| v.trim().to_owned())
}
