//! COCO's twelve numbers of two COCO files, as JSON: `cargo run --release --example coco_scores -- TRUTH.json RESULTS.json`.
//! `scripts/compare-coco.py` holds its output against pycocotools.
#![allow(clippy::print_stdout, reason = "a program whose result is its output")]
use std::time::Instant;
use tcross_eval::coco_json::{read_instances, read_results, score_instances};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let (Some(truth), Some(path)) = (args.next(), args.next()) else {
        return Err("usage: coco_scores TRUTH.json RESULTS.json".into());
    };
    let start = Instant::now();
    // As pycocotools does, what the instances lack is left out.
    let (truth, _) = read_instances(truth, true)?;
    let (results, _) = read_results(path, &truth, true)?;
    let loaded = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let scores = score_instances(&truth, &results);
    let scored = start.elapsed().as_secs_f64();
    println!("{}", serde_json::json!({"scores": scores, "load_s": loaded, "score_s": scored}));
    Ok(())
}
