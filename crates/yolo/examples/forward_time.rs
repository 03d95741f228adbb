//! How long a forward pass and a loss take, with random parameters: medians of some runs.
//!
//! `cargo run --release -p tcross-yolo --example forward_time -- [yolov3|yolov3-tiny] [WIDTH] [SIDE] [BATCH]`
#![expect(clippy::print_stdout, reason = "an example prints its result")]
use burn::tensor::{Device, Tensor};
use std::{error::Error, time::Instant};
use tcross_dataset::PixelBox;
use tcross_yolo::{Architecture, Loss, LossKind, ModelConfig, NetSize, Truth, Weights, Yolo, network::read_logits};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let architecture = match arguments.next().as_deref() {
        Some("yolov3-tiny") => Architecture::YoloV3Tiny,
        _ => Architecture::YoloV3,
    };
    let width: f64 = arguments.next().map_or(Ok(0.125), |w| w.parse())?;
    let net = NetSize::square(arguments.next().map_or(Ok(416), |s| s.parse())?);
    let batch: usize = arguments.next().map_or(Ok(1), |b| b.parse())?;
    let config = ModelConfig { width, input: net, ..ModelConfig::of(architecture) };
    let graph = config.graph()?;
    let weights = Weights::init(&graph, &config.fields(), &Default::default(), 1);
    let device = Device::flex();
    let network = Yolo::new(&config, &weights, &device)?;
    let images = Tensor::<4>::ones([batch, 3, net.height, net.width], &device) * 0.5;
    let truths = vec![vec![Truth::from_net_box(&PixelBox::from([90.0, 80.0, 130.0, 125.0]), 0, net)]; batch];
    let loss = Loss::new(LossKind::Darknet, 0.6);
    let (mut forward, mut evaluate) = (Vec::new(), Vec::new());
    for _ in 0..9 {
        let start = Instant::now();
        let logits: Vec<Vec<f32>> = network.forward(images.clone()).iter().map(read_logits).collect();
        forward.push(start.elapsed().as_secs_f64());
        let start = Instant::now();
        let _ = loss.evaluate(&config.geometry(net), &logits, &truths)?;
        evaluate.push(start.elapsed().as_secs_f64());
    }
    let median = |times: &mut Vec<f64>| {
        times.sort_by(f64::total_cmp);
        1e3 * times[times.len() / 2]
    };
    let gflop = batch as f64 * graph.flops(net) as f64 / 1e9;
    let (forward, evaluate) = (median(&mut forward), median(&mut evaluate));
    let rate = gflop / forward * 1e3;
    println!(
        "{architecture:?} x{width} {net} batch {batch}: forward {forward:.1} ms ({gflop:.2} GFLOP, {rate:.0} GFLOP/s), loss {evaluate:.2} ms"
    );
    Ok(())
}
