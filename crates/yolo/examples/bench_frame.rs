//! The stopwatch behind `scripts/bench-infer.py`: folds a network and waits; each line on standard input makes it run one image and answer
//! with the seconds it took.
//!
//! `bench_frame ARCHITECTURE WIDTH`, 416 x 416, 80 classes, random weights.
#![allow(clippy::print_stdout)]
use std::{
    error::Error,
    io::{BufRead, Write},
    time::Instant,
};
use tcross_dataset::Rng;
use tcross_kernels::allocator::Pool;
use tcross_yolo::{Architecture, InferenceNet, ModelConfig, NetSize, Weights};

#[global_allocator]
static POOL: Pool = Pool::new();

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [architecture, width] = words.as_slice() else { return Err("expected: ARCHITECTURE WIDTH".into()) };
    let architecture = if architecture == "yolov3-tiny" { Architecture::YoloV3Tiny } else { Architecture::YoloV3 };
    let model = ModelConfig { width: width.parse()?, classes: 80, ..ModelConfig::of(architecture) };
    let weights = Weights::init(&model.graph()?, &model.fields(), &Default::default(), 0);
    let mut network = InferenceNet::new(&model, &weights)?;
    let mut rng = Rng::for_item(0, "bench/frame", 0);
    let image: Vec<f32> = (0..3 * 416 * 416).map(|_| rng.unit() as f32).collect();
    println!("ready {}", tcross_yolo::model::info(&model)?.iter().map(|l| l.flops).sum::<u64>());
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
