//! End to end on frames in memory, network and pose, with any model: frames a second, latency a stage, and whether memory grows.
//! `cargo run --release -p tcross-infer --example frames -- RUN IMAGES [--frames N] [--score S]`
#![allow(clippy::print_stdout)]
use std::time::Instant;
use tcross_infer::{Config, Detector, Source, pose, read_image, video::Times};

const USAGE: &str = "usage: frames MODEL IMAGES [--frames N] [--score S]\n\
    MODEL: a run's folder; IMAGES: a folder or a dataset, of which up to 64 images are held in memory and looked at in turn";

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let (Some(model), Some(images)) = (args.first(), args.get(1)) else { return Err(USAGE.into()) };
    let frames: usize = value("--frames").map_or(Ok(1000), |v| v.parse())?;
    let config = Config { score: value("--score").map_or(Ok(0.3), |v| v.parse())?, ..Config::default() };
    let mut detector = config.configure(Detector::load(model)?);
    let source = Source::open(&[images], None)?;
    let pictures = source.items.iter().take(64).map(|i| read_image(&i.path)).collect::<Result<Vec<_>, _>>()?;
    let (mut network, mut poses) = (Times::default(), Times::default());
    let (mut found, mut recovered) = (0, 0);
    let mut resident = Vec::new();
    let start = Instant::now();
    for frame in 0..frames {
        let image = &pictures[frame % pictures.len()];
        let from = Instant::now();
        let detections = detector.detect(image);
        let between = Instant::now();
        for detection in &detections {
            recovered += usize::from(pose::try_recover(image, &detection.bounds, &config.recovery).is_ok());
        }
        network.add((between - from).as_secs_f64() * 1e3);
        poses.add(between.elapsed().as_secs_f64() * 1e3);
        found += detections.len();
        if (frame + 1) % (frames / 10).max(1) == 0 {
            resident.extend(resident_mib());
        }
    }
    let seconds = start.elapsed().as_secs_f64();
    let input = detector.model().input;
    let (w, h) = pictures.first().map_or((0, 0), |p| p.dimensions());
    println!("{w}x{h} px, network input {}x{}, {} threads", input.width, input.height, rayon::current_num_threads());
    println!("{frames} frames in {seconds:.2} s: {:.1} frames/s; {found} detections, {recovered} poses", frames as f64 / seconds);
    for (name, times) in [("network", &network), ("pose", &poses)] {
        let at = |share| times.quantile(share).unwrap_or(0.0);
        println!("{name:8} median {:8.3} ms, p95 {:8.3} ms, p99 {:8.3} ms", at(0.5), at(0.95), at(0.99));
    }
    println!("resident memory at each tenth: {resident:.1?} MiB");
    Ok(())
}

/// Linux tells in pages of 4 KiB; elsewhere nothing is shown.
fn resident_mib() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/statm").ok()?;
    text.split_whitespace().nth(1)?.parse::<f64>().ok().map(|pages| pages / 256.0)
}
