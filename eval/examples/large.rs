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
    let clock = Clock::start();
    let lines = BufReader::with_capacity(1 << 20, std::fs::File::open(&path)?).split(b'\n').count();
    let reading = clock.passed();
    let clock = Clock::start();
    let truth = Truth::new(records, BoxConvention::Continuous, None);
    let evaluation = evaluate(&truth, "large", path.as_path().into(), &Config::default(), false)?;
    let scored = clock.passed();
    let report =
        Report { title: "Large".into(), runs: vec![Run::new(&truth, &evaluation)], sweeps: vec![], extras: vec![], provenance: vec![] }
            .build();
    let built = clock.passed();
    std::fs::remove_file(&path)?;
    let threads = rayon::current_num_threads();
    println!("{lines} lines, {:.2} GB, {threads} threads; seconds by the clock, and of all cores together", bytes as f64 / 1e9);
    for (what, [wall, cpu]) in [("reading the lines", reading), ("until scored", scored), ("until reported", built)] {
        println!("{what:18} {wall:7.2} {cpu:7.2}   {:5.1} x, {:5.1} x the reading", wall / reading[0], cpu / reading[1]);
    }
    println!("{} tables, peak memory {}", report.tables.len(), peak_memory());
    Ok(())
}

fn record(k: usize) -> Result<Record, serde_json::Error> {
    let mut rng = Rng::for_item(0, "eval/large/truth", k as u64);
    let (x, y, s) = (rng.uniform(0.0, 360.0), rng.uniform(0.0, 360.0), rng.uniform(8.0, 56.0));
    serde_json::from_value(serde_json::json!({"image": format!("{k}.jpg"), "width": 416, "height": 416,
        "markers": [{"shape": "t_cross", "box": [x, y, x + s, y + s]}]}))
}

/// Time by the clock, and of all cores together: the second says what an idle machine would need, even on a busy one.
struct Clock(Instant, f64);

impl Clock {
    fn start() -> Self {
        Self(Instant::now(), cpu_seconds())
    }

    fn passed(&self) -> [f64; 2] {
        [self.0.elapsed().as_secs_f64(), cpu_seconds() - self.1]
    }
}

/// User and system time of this process, in the hundredths of a second in which Linux tells it.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = stat.rsplit_once(')').map_or("", |(_, rest)| rest);
    after_name.split_whitespace().skip(11).take(2).filter_map(|v| v.parse::<f64>().ok()).sum::<f64>() / 100.0
}

/// As Linux tells it.
fn peak_memory() -> String {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    status.lines().find_map(|l| l.strip_prefix("VmHWM:")).map_or("unknown".into(), |v| v.trim().to_owned())
}
