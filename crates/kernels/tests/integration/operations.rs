//! The fused operations against burn's composition of the same: outputs, statistics and every gradient.
use burn::tensor::{Device, Tensor, TensorData};
use proptest::{prelude::*, test_runner::RngSeed};
use tcross_kernels::ops::{self, ConvNorm, NormSettings, Path};

fn noise<const D: usize>(shape: [usize; D], seed: u64, low: f32, high: f32, device: &Device) -> Tensor<D> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let values: Vec<f32> = (0..shape.iter().product())
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            low + (high - low) * ((state >> 40) as f32 / (1u64 << 24) as f32)
        })
        .collect();
    Tensor::from_data(TensorData::new(values, shape), device)
}

fn parameters(cin: usize, cout: usize, kernel: usize, seed: u64, device: &Device) -> ConvNorm {
    let tracked = |t: Tensor<1>| if device.is_autodiff() { t.require_grad() } else { t };
    let weight = noise([cout, cin, kernel, kernel], seed, -0.5, 0.5, device);
    ConvNorm {
        weight: if device.is_autodiff() { weight.require_grad() } else { weight },
        gamma: tracked(noise([cout], seed + 1, 0.5, 1.5, device)),
        beta: tracked(noise([cout], seed + 2, -0.5, 0.5, device)),
        mean: noise([cout], seed + 3, -0.2, 0.2, device),
        variance: noise([cout], seed + 4, 0.5, 1.5, device),
    }
}

fn same<const D: usize>(a: Tensor<D>, b: Tensor<D>, what: &str) {
    assert_eq!(a.dims(), b.dims(), "{what}");
    let (a, b): (Vec<f32>, Vec<f32>) = (a.into_data().try_into_vec().unwrap(), b.into_data().try_into_vec().unwrap());
    let scale = b.iter().fold(1e-2f32, |m, v| m.max(v.abs()));
    for (i, (x, y)) in a.iter().zip(&b).enumerate() {
        // Batch norm makes gradients cancel, so both sides round: burn's own to about 1e-4 of the largest.
        assert!((x - y).abs() <= 5e-4 * scale, "{what}[{i}]: {x} instead of {y} (largest {scale})");
    }
}

/// Runs `f` on both paths from equal inputs and compares the outputs and the gradients of `leaves`.
fn both(f: impl Fn(Path) -> (Tensor<4>, Vec<Tensor<1>>, Vec<Tensor<1>>, Vec<Tensor<4>>), device: &Device) {
    let run = |path| {
        let (y, extra, vectors, kernels) = f(path);
        let weights = noise(y.dims(), 77, -1.0, 1.0, device);
        let grads = (y.clone() * weights).sum().backward();
        let vectors: Vec<_> = vectors.iter().map(|v| v.grad(&grads).unwrap()).collect();
        let kernels: Vec<_> = kernels.iter().map(|k| k.grad(&grads).unwrap()).collect();
        (y.inner(), extra, vectors, kernels)
    };
    let (fused, composite) = (run(Path::Fused), run(Path::Composite));
    same(fused.0, composite.0, "output");
    for (k, (a, b)) in fused.1.into_iter().zip(composite.1).enumerate() {
        same(a.inner(), b.inner(), &format!("statistics {k}"));
    }
    for (k, (a, b)) in fused.2.into_iter().zip(composite.2).enumerate() {
        same(a, b, &format!("gradient of vector {k}"));
    }
    for (k, (a, b)) in fused.3.into_iter().zip(composite.3).enumerate() {
        same(a, b, &format!("gradient of tensor {k}"));
    }
}

fn settings(stride: usize, batch_statistics: bool) -> NormSettings {
    NormSettings { stride, epsilon: 1e-5, slope: 0.1, batch_statistics }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..Default::default() })]
    #[test]
    fn convolution_with_norm(n in 1usize..3, h in 3usize..12, w in 3usize..12, cin in 1usize..20, cout in 1usize..36, kind in 0usize..3, batch in any::<bool>(), seed in 0u64..99) {
        let device = Device::flex().autodiff();
        let (kernel, stride) = [(1, 1), (3, 1), (3, 2)][kind];
        both(|path| {
            let x = noise([n, h, w, cin], seed + 50, -1.0, 1.0, &device).require_grad();
            let p = parameters(cin, cout, kernel, seed, &device);
            let (y, s) = ops::conv_norm(path, x.clone(), p.clone(), settings(stride, batch));
            (y, vec![s.mean, s.variance], vec![p.gamma, p.beta], vec![x, p.weight])
        }, &device);
    }

    #[test]
    fn residual_unit(n in 1usize..3, h in 2usize..9, w in 2usize..9, narrow in 1usize..12, wide in 1usize..24, batch in any::<bool>(), seed in 0u64..99) {
        let device = Device::flex().autodiff();
        both(|path| {
            let x = noise([n, h, w, wide], seed + 50, -1.0, 1.0, &device).require_grad();
            let (p, q) = (parameters(wide, narrow, 1, seed, &device), parameters(narrow, wide, 3, seed + 9, &device));
            let (y, [s, t]) = ops::residual(path, x.clone(), p.clone(), q.clone(), settings(1, batch));
            (y, vec![s.mean, s.variance, t.mean, t.variance], vec![p.gamma, p.beta, q.gamma, q.beta], vec![x, p.weight, q.weight])
        }, &device);
    }

    #[test]
    fn head_upsample_and_pools(n in 1usize..3, h in 1usize..9, w in 1usize..9, cin in 1usize..20, cout in 1usize..20, seed in 0u64..99) {
        let device = Device::flex().autodiff();
        both(|path| {
            let x = noise([n, h, w, cin], seed, -1.0, 1.0, &device).require_grad();
            let weight = noise([cout, cin, 1, 1], seed + 1, -1.0, 1.0, &device).require_grad();
            let bias = noise([cout], seed + 2, -1.0, 1.0, &device).require_grad();
            let y = ops::upsample(path, ops::conv_bias(path, x.clone(), weight.clone(), bias.clone()));
            (ops::max_pool(path, ops::max_pool(path, y, 1), 2), vec![], vec![bias], vec![x, weight])
        }, &device);
    }
}

#[test]
fn without_gradients_the_norm_is_folded() {
    let device = Device::flex();
    for (kernel, stride) in [(1, 1), (3, 1), (3, 2)] {
        let x = noise([2, 9, 7, 5], 3, -1.0, 1.0, &device);
        let p = parameters(5, 19, kernel, 4, &device);
        let run = |path| ops::conv_norm(path, x.clone(), p.clone(), settings(stride, false)).0;
        same(run(Path::Fused), run(Path::Composite), "folded");
    }
    let x = noise([2, 6, 7, 8], 3, -1.0, 1.0, &device);
    let (p, q) = (parameters(8, 4, 1, 4, &device), parameters(4, 8, 3, 14, &device));
    let run = |path| ops::residual(path, x.clone(), p.clone(), q.clone(), settings(1, false)).0;
    same(run(Path::Fused), run(Path::Composite), "folded residual");
}
