//! What the making of batches costs beside the steps that learn from them.
//!
//! `cargo run --release -p tcross-train --example pipeline -- DATA [WIDTH] [BATCH]`: YOLOv3 of that width (0.125) and batch (8) at 416, the standard
//! augmentation; for whole images and for windows of 224 px the time a batch takes one thread, with images decoded and from the cache, that of a
//! step on all threads, and the share: thread time of the batch over thread time of the step.
#![expect(clippy::print_stdout, reason = "an example prints its result")]
use std::{error::Error, sync::Arc, time::Instant};
use tcross_dataset::{Dataset, Split};
use tcross_kernels::allocator::Pool;
use tcross_train::{
    Accelerator, Config,
    augment::{Input, Labels, View},
    data::{BatchMaker, Order, Request, Samples},
    step::Trainer,
};
use tcross_yolo::{Architecture, ModelConfig, NetSize, Weights};

#[global_allocator]
static POOL: Pool = Pool::new();

const ROUNDS: u64 = 30;

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let data = words.first().ok_or("expected: DATA [WIDTH] [BATCH]")?;
    let (width, batch) = (words.get(1).map_or(Ok(0.125), |w| w.parse())?, words.get(2).map_or(Ok(8), |b| b.parse())?);
    let model = ModelConfig { width, ..ModelConfig::of(Architecture::YoloV3) };
    let weights = Weights::init(&model.graph()?, &model.fields(), &Default::default(), 0);
    let config = Config { batch, ..Config::default() };
    let mut trainer = Trainer::new(&config, &model, &weights, &Accelerator::Cpu)?;
    let dataset = Dataset::open(data)?;
    let threads = rayon::current_num_threads() as f64;
    println!("yolov3 x {width}, batch {batch}, {threads} threads; milliseconds, medians of {ROUNDS}");
    println!("{:<18} {:>14} {:>12} {:>8} {:>8}", "input", "batch, decoded", "from cache", "step", "share");
    for (name, net, view) in [("whole images", model.input, View::Whole), ("windows", NetSize::square(224), View::Window { focus: 0.8 })] {
        let samples = Samples::open(&dataset, Split::Train, model.input, &[], usize::MAX)?;
        let marked: Vec<bool> = (0..samples.count()).map(|k| !samples.labels(k).is_empty()).collect();
        let order = Order::new(0, &marked, None);
        let mut maker = BatchMaker { samples: Arc::new(samples), order, augment: config.augment.clone(), batch, keypoints: 0, seed: 0 };
        let (mut decoded, mut cached, mut steps) = (Vec::new(), Vec::new(), Vec::new());
        for step in 0..ROUNDS {
            let request = Request { step, input: Input { net, view, fraction: 0.0 } };
            let mut make = || {
                let start = Instant::now();
                (maker.make(request), start.elapsed().as_secs_f64())
            };
            decoded.push(make().1);
            let (made, taken) = make();
            cached.push(taken);
            let start = Instant::now();
            trainer.step(made, 1e-4, step)?;
            steps.push(start.elapsed().as_secs_f64());
        }
        let [decoded, cached, step] = [decoded, cached, steps].map(|mut times| {
            times.sort_by(f64::total_cmp);
            times[times.len() / 2]
        });
        let share = 100.0 * cached / (threads * step);
        println!("{name:<18} {:>14.1} {:>12.1} {:>8.1} {share:>7.1}%", 1e3 * decoded, 1e3 * cached, 1e3 * step);
    }
    Ok(())
}
