//! Times a training step without an optimiser: `cargo run --release -p tcross-yolo --example train_step -- WIDTH BATCH STEPS [composite|tiny]`.
//!
//! Forward, a gradient at the heads, backward, on random images at 416; prints the median and images a second.
#![expect(clippy::print_stdout, reason = "an example prints its result")]
use burn::tensor::{Device, Tensor, TensorData};
use std::time::Instant;
use tcross_kernels::{
    allocator::{Pool, keep},
    ops::Path,
};
use tcross_yolo::{Architecture, ModelConfig, Weights, Yolo};

#[global_allocator]
static POOL: Pool = Pool::new();

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let _kept = keep();
    let words: Vec<String> = std::env::args().skip(1).collect();
    let number = |k: usize, default: f64| words.get(k).and_then(|w| w.parse().ok()).unwrap_or(default);
    let (width, batch, steps) = (number(0, 0.25), number(1, 8.0) as usize, number(2, 7.0) as usize);
    let has = |word: &str| words.iter().any(|w| w == word);
    let architecture = if has("tiny") { Architecture::YoloV3Tiny } else { Architecture::YoloV3 };
    let config = ModelConfig { width, ..ModelConfig::of(architecture) };
    let weights = Weights::init(&config.graph()?, &config.fields(), &Default::default(), 7);
    let device = Device::flex().autodiff();
    let path = if has("composite") { Path::Composite } else { Path::Fused };
    let network = Yolo::new(&config, &weights, &device)?.with_path(path);
    let pixels: Vec<f32> = (0..batch * 3 * 416 * 416).map(|i| ((i * 7919) % 255) as f32 / 255.0).collect();
    let mut times = Vec::new();
    for step in 0..=steps {
        let start = Instant::now();
        let images = Tensor::<4>::from_data(TensorData::new(pixels.clone(), [batch, 3, 416, 416]), &device);
        let heads = network.forward(images);
        let forward = start.elapsed().as_secs_f64();
        let loss = heads.into_iter().map(|h| (h.clone() * h.detach()).sum()).reduce(|a, b| a + b).ok_or("no head")?;
        let gradients = loss.backward();
        let total = start.elapsed().as_secs_f64();
        drop(gradients);
        eprintln!("step {step}: forward {forward:.3} s, total {total:.3} s");
        if step > 0 {
            times.push(total);
        }
    }
    times.sort_by(f64::total_cmp);
    let median = times[times.len() / 2];
    println!("{architecture:?} x {width}, batch {batch}, {path:?}: {median:.3} s a step, {:.2} images/s", batch as f64 / median);
    Ok(())
}
