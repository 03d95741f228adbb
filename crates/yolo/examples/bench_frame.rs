//! The stopwatch behind `scripts/bench-infer.py`: folds a network and waits; each line on standard input makes it run one image and answer
//! with the seconds it took. First it writes the network to a file, loads it three times and says the best time, and that of reading the
//! file alone: `ready FLOPS LOAD READ`, in seconds.
//!
//! `bench_frame ARCHITECTURE WIDTH`, 416 x 416, 80 classes, random weights.
#![allow(clippy::print_stdout)]
use std::{
    error::Error,
    io::{BufRead, Write},
    time::Instant,
};
use tcross_dataset::Rng;
use tcross_yolo::{Architecture, InferenceNet, Model, ModelConfig, NetSize, Weights};

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [architecture, width] = words.as_slice() else { return Err("expected: ARCHITECTURE WIDTH".into()) };
    let architecture = if architecture == "yolov3-tiny" { Architecture::YoloV3Tiny } else { Architecture::YoloV3 };
    let model = ModelConfig { width: width.parse()?, classes: 80, ..ModelConfig::of(architecture) };
    let weights = Weights::init(&model.graph()?, &model.fields(), &Default::default(), 0);
    let folder = std::env::temp_dir().join(format!("tcross-bench-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    let file = folder.join("model.safetensors");
    let flops = tcross_yolo::model::info(&model)?.iter().map(|l| l.flops).sum::<u64>();
    Model { config: model, weights }.save(&file)?;
    let mut best = [f64::INFINITY; 2];
    let mut network = None;
    for _ in 0..3 {
        let start = Instant::now();
        let loaded = Model::load(&file)?;
        network = Some(InferenceNet::new(&loaded.config, &loaded.weights)?);
        best[0] = best[0].min(start.elapsed().as_secs_f64());
        let start = Instant::now();
        std::hint::black_box(std::fs::read(&file)?);
        best[1] = best[1].min(start.elapsed().as_secs_f64());
    }
    std::fs::remove_dir_all(&folder)?;
    let mut network = network.ok_or("not loaded")?;
    let mut rng = Rng::for_item(0, "bench/frame", 0);
    let image: Vec<f32> = (0..3 * 416 * 416).map(|_| rng.unit() as f32).collect();
    println!("ready {flops} {:.4} {:.4}", best[0], best[1]);
    for line in std::io::stdin().lock().lines() {
        if line?.trim() == "end" {
            break;
        }
        let start = Instant::now();
        std::hint::black_box(network.run(&image, NetSize::square(416)));
        println!("{:.6}", start.elapsed().as_secs_f64());
        std::io::stdout().flush()?;
    }
    Ok(())
}
