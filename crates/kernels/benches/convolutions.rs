//! `cargo bench -p tcross-kernels --bench convolutions`: every convolution of YOLOv3 x 0.25 (or `-- WIDTH BATCH`), forward, gradient of the
//! input and of the weights, in GFLOP/s and as a share of the multiply-add peak measured in the same run.
#![allow(clippy::print_stdout)]
use std::{hint::black_box, time::Instant};
use tcross_kernels::{ConvShape, Isa, conv, pack, simd, weight_gradient::weight_gradient};

/// The best of a few runs, in seconds: the machine's noise only ever adds.
fn best(mut f: impl FnMut()) -> f64 {
    f();
    let start = Instant::now();
    let mut least = f64::INFINITY;
    let mut runs = 0;
    while runs < 5 || (start.elapsed().as_secs_f64() < 0.4 && runs < 50) {
        let t = Instant::now();
        f();
        least = least.min(t.elapsed().as_secs_f64());
        runs += 1;
    }
    least
}

fn main() {
    let args: Vec<f64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let (width, batch) = (args.first().copied().unwrap_or(0.25), args.get(1).map_or(8, |b| *b as usize));
    let isa = Isa::detect();
    let peak = simd::measured_peak(isa) / 1e9;
    println!("{isa:?}, {} threads, multiply-add peak {peak:.0} GFLOP/s; YOLOv3 x {width}, batch {batch}", rayon::current_num_threads());
    println!(
        "{:<34} {:>5} | {:>7} {:>7} | {:>7} {:>7} | {:>7} {:>7}",
        "layer", "count", "fwd ms", "share", "dX ms", "share", "dW ms", "share"
    );
    // (size, in, out, kernel, stride, how often) at 416, without the heads.
    let layers: [(usize, usize, usize, usize, usize, usize); 19] = [
        (416, 3, 32, 3, 1, 1),
        (416, 32, 64, 3, 2, 1),
        (208, 64, 32, 1, 1, 1),
        (208, 32, 64, 3, 1, 1),
        (208, 64, 128, 3, 2, 1),
        (104, 128, 64, 1, 1, 2),
        (104, 64, 128, 3, 1, 2),
        (104, 128, 256, 3, 2, 1),
        (52, 256, 128, 1, 1, 10),
        (52, 128, 256, 3, 1, 11),
        (52, 256, 512, 3, 2, 1),
        (26, 512, 256, 1, 1, 10),
        (26, 256, 512, 3, 1, 11),
        (26, 512, 1024, 3, 2, 1),
        (13, 1024, 512, 1, 1, 7),
        (13, 512, 1024, 3, 1, 7),
        (26, 768, 256, 1, 1, 1),
        (52, 384, 128, 1, 1, 1),
        (13, 512, 256, 1, 1, 1),
    ];
    let mut totals = [0f64; 4];
    for (size, cin, cout, kernel, stride, count) in layers {
        let scaled = |c: usize| if c == 3 { 3 } else { ((c as f64 * width) as usize).max(8) };
        let shape = ConvShape { batch, height: size, width: size, in_channels: scaled(cin), out_channels: scaled(cout), kernel, stride };
        let noise = |n: usize| (0..n).map(|i| ((i * 7919) % 101) as f32 / 101.0 - 0.5).collect::<Vec<f32>>();
        let (x, w, dz) = (noise(shape.input_len()), noise(shape.weight_len()), noise(shape.output_len()));
        let (mut out, mut dx) = (vec![0f32; shape.output_len()], vec![0f32; shape.input_len()]);
        let forward = best(|| {
            let packed = pack::forward(isa, &shape, &w);
            black_box(conv::forward_with_statistics(&shape, &x, None, &packed, &mut out));
        });
        let input = if cin == 3 { 0.0 } else { best(|| conv::input_gradient(isa, &shape, &dz, &w, false, &mut dx)) };
        let weights = best(|| {
            black_box(weight_gradient(isa, &shape, &x, None, &dz));
        });
        let share = |t: f64| if t > 0.0 { 100.0 * shape.flops() / t / 1e9 / peak } else { 0.0 };
        println!(
            "{:<34} {count:>5} | {:>7.2} {:>6.0}% | {:>7.2} {:>6.0}% | {:>7.2} {:>6.0}%",
            format!("{}x{} {kernel}/{stride} {} -> {}", size, size, shape.in_channels, shape.out_channels),
            forward * 1e3,
            share(forward),
            input * 1e3,
            share(input),
            weights * 1e3,
            share(weights)
        );
        for (total, t) in totals.iter_mut().zip([forward, input, weights]) {
            *total += t * count as f64;
        }
        totals[3] += shape.flops() * count as f64;
    }
    let floor = totals[3] / peak / 1e9;
    println!(
        "sums: forward {:.0} ms, dX {:.0} ms, dW {:.0} ms; floor of each {:.0} ms",
        totals[0] * 1e3,
        totals[1] * 1e3,
        totals[2] * 1e3,
        floor * 1e3
    );
}
