//! The stopwatch behind `scripts/bench-train.py`: builds a network and waits; each line on standard input makes it take one training step
//! (forward, loss, backward, optimiser) on a fixed batch of random images and answer with the step's seconds.
//!
//! `bench_step ARCHITECTURE WIDTH BATCH [composite]`, 416 x 416, 80 classes, SGD with momentum.
#![allow(clippy::print_stdout)]
use std::{
    error::Error,
    io::{BufRead, Write},
    time::Instant,
};
use tcross_dataset::Rng;
use tcross_kernels::allocator::Pool;
use tcross_train::{
    Accelerator, Config,
    augment::{Input, View},
    config::{Optimizer, OptimizerKind},
    data::{Batch, Request},
    step::Trainer,
};
use tcross_yolo::{Architecture, ModelConfig, NetSize, NormBox, Truth, Weights};

#[global_allocator]
static POOL: Pool = Pool::new();

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [architecture, width, batch, rest @ ..] = words.as_slice() else {
        return Err("expected: ARCHITECTURE WIDTH BATCH [composite]".into());
    };
    let architecture = if architecture == "yolov3-tiny" { Architecture::YoloV3Tiny } else { Architecture::YoloV3 };
    let batch: usize = batch.parse()?;
    let model = ModelConfig { width: width.parse()?, classes: 80, ..ModelConfig::of(architecture) };
    let weights = Weights::init(&model.graph()?, &model.fields(), &Default::default(), 0);
    let optimizer = Optimizer { kind: OptimizerKind::Sgd, rate: 1e-4, decay: 5e-4, ..Default::default() };
    let config = Config { optimizer, fused: !rest.iter().any(|w| w == "composite"), ..Default::default() };
    let mut trainer = Trainer::new(&config, &model, &weights, &Accelerator::Cpu)?;
    let mut rng = Rng::for_item(0, "bench/step", 0);
    let net = NetSize::square(416);
    let images: Vec<f32> = (0..batch * 3 * 416 * 416).map(|_| rng.unit() as f32).collect();
    let truth = |rng: &mut Rng| {
        let [x, y] = [0, 1].map(|_| rng.uniform(0.2, 0.8) as f32);
        let [w, h] = [0, 1].map(|_| rng.uniform(0.05, 0.4) as f32);
        Truth { bounds: NormBox { x, y, w, h }, class: rng.index(80) as u32, weight: 1.0, keypoints: Vec::new() }
    };
    let truths: Vec<Vec<Truth>> = (0..batch).map(|_| (0..6).map(|_| truth(&mut rng)).collect()).collect();
    println!("ready {}", tcross_yolo::model::info(&model)?.iter().map(|l| l.flops).sum::<u64>());
    for (step, line) in std::io::stdin().lock().lines().enumerate() {
        if line?.trim() == "end" {
            break;
        }
        let input = Input { net, view: View::Whole, fraction: 0.0 };
        let request = Request { step: step as u64, input };
        let made = Batch { request, sources: Vec::new(), images: images.clone(), truths: truths.clone() };
        let start = Instant::now();
        trainer.step(made, 1e-4, step as u64)?;
        println!("{:.6}", start.elapsed().as_secs_f64());
        std::io::stdout().flush()?;
    }
    Ok(())
}
