//! `cargo bench -p tcross-kernels --bench operations`: a convolution with batch norm and leaky unit, forward and backward, on burn's tensors: the
//! fused operation and burn's composition of the same, taking turns, for the layers of YOLOv3 x 0.25 at batch 8 (or `-- WIDTH BATCH`).
#![allow(clippy::print_stdout)]
use burn::tensor::{Device, Tensor, TensorData};
use std::time::Instant;
use tcross_kernels::{
    ConvShape, Isa,
    ops::{self, ConvNorm, NormSettings, Path},
    simd,
};

fn noise<const D: usize>(shape: [usize; D], device: &Device) -> Tensor<D> {
    let values: Vec<f32> = (0..shape.iter().product()).map(|i: usize| ((i * 7919) % 101) as f32 / 101.0 - 0.5).collect();
    Tensor::from_data(TensorData::new(values, shape), device)
}

/// Seconds of one forward and backward pass.
fn step(path: Path, shape: &ConvShape, device: &Device) -> f64 {
    let channels = shape.out_channels;
    let x = noise([shape.batch, shape.height, shape.width, shape.in_channels], device).require_grad();
    let conv = ConvNorm {
        weight: noise([channels, shape.in_channels, shape.kernel, shape.kernel], device).require_grad(),
        gamma: noise([channels], device).require_grad(),
        beta: noise([channels], device).require_grad(),
        mean: noise([channels], device),
        variance: noise([channels], device),
    };
    let settings = NormSettings { stride: shape.stride, epsilon: 1e-5, slope: 0.1, batch_statistics: true };
    let gradient = noise([shape.batch, shape.out_height(), shape.out_width(), channels], device);
    let start = Instant::now();
    let (y, _) = ops::conv_norm(path, x, conv, settings);
    let _ = ops::seed(path, y, gradient).backward();
    start.elapsed().as_secs_f64()
}

fn main() {
    let args: Vec<f64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let (width, batch) = (args.first().copied().unwrap_or(0.25), args.get(1).map_or(8, |b| *b as usize));
    let device = Device::flex().autodiff();
    let peak = simd::measured_peak(Isa::detect());
    println!("multiply-add peak {:.0} GFLOP/s; YOLOv3 x {width}, batch {batch}; forward and both gradients", peak / 1e9);
    println!("{:<34} {:>9} {:>7} {:>7} | {:>12} | {:>7}", "layer", "fused ms", "GFLOP/s", "share", "composite ms", "ratio");
    // (size, in, out, kernel, stride) at 416: one layer of each kind.
    for (size, cin, cout, kernel, stride) in [
        (416, 3, 32, 3, 1),
        (416, 32, 64, 3, 2),
        (208, 64, 32, 1, 1),
        (208, 32, 64, 3, 1),
        (104, 64, 128, 3, 1),
        (52, 256, 128, 1, 1),
        (52, 128, 256, 3, 1),
        (52, 256, 512, 3, 2),
        (26, 256, 512, 3, 1),
        (13, 512, 1024, 3, 1),
    ] {
        let scaled = |c: usize| if c == 3 { 3 } else { ((c as f64 * width) as usize).max(8) };
        let shape = ConvShape { batch, height: size, width: size, in_channels: scaled(cin), out_channels: scaled(cout), kernel, stride };
        let mut best = [f64::INFINITY; 2];
        for round in 0..4 {
            for (least, path) in best.iter_mut().zip([Path::Fused, Path::Composite]) {
                let taken = step(path, &shape, &device);
                // The first round fetches memory.
                *least = if round == 0 { *least } else { least.min(taken) };
            }
        }
        let rate = 3.0 * shape.flops() / best[0];
        println!(
            "{:<34} {:>9.2} {:>7.0} {:>6.0}% | {:>12.2} | {:>6.2}x",
            format!("{size}x{size} {kernel}/{stride} {} -> {}", shape.in_channels, shape.out_channels),
            best[0] * 1e3,
            rate / 1e9,
            100.0 * rate / peak,
            best[1] * 1e3,
            best[1] / best[0]
        );
    }
}
