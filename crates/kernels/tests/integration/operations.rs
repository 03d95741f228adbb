//! The fused operations against burn's composition of the same: outputs, statistics and every gradient.
use burn::tensor::{Device, Tensor, TensorData};
use proptest::{prelude::*, test_runner::RngSeed};
use tcross_kernels::{
    ConvShape,
    ops::{self, ConvNorm, NormSettings, Path},
    reference,
};

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
        assert!((x - y).abs() <= 1e-4 * scale, "{what}[{i}]: {x} instead of {y} (largest {scale})");
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
        // A norm undoes the scale of a single weight, whose gradient is therefore zero up to epsilon, and rounding.
        prop_assume!(cin * kernel > 1);
        both(|path| {
            let x = noise([n, h, w, cin], seed + 50, -1.0, 1.0, &device).require_grad();
            let p = parameters(cin, cout, kernel, seed, &device);
            let (y, s) = ops::conv_norm(path, x.clone(), p.clone(), settings(stride, batch));
            (y, vec![s.mean, s.variance], vec![p.gamma, p.beta], vec![x, p.weight])
        }, &device);
    }

    #[test]
    fn residual_unit(n in 1usize..3, h in 2usize..9, w in 2usize..9, narrow in 1usize..12, wide in 2usize..24, batch in any::<bool>(), seed in 0u64..99) {
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
            let y = ops::upsample(path, ops::conv_bias(path, x.clone(), weight.clone(), bias.clone(), 1));
            (ops::max_pool(path, ops::max_pool(path, y, 1), 2), vec![], vec![bias], vec![x, weight])
        }, &device);
    }
}

#[test]
fn columns_around_a_circle() {
    let device = Device::flex().autodiff();
    for (first, count, width, margin, arc) in [(0, 5, 5, 2, 3), (1, 4, 6, 3, 5), (2, 3, 7, 1, 4), (0, 2, 3, 5, 1)] {
        both(
            |path| {
                let x = noise([2, 3, width, 4], 5, -1.0, 1.0, &device).require_grad();
                let y = ops::wrap(path, x.clone(), first, count, margin);
                let z = ops::around(path, x.clone(), first, count, arc);
                let all = Tensor::cat(vec![y.reshape([2, 1, 1, -1]), z.reshape([2, 1, 1, -1])], 3);
                (all, vec![], vec![], vec![x])
            },
            &device,
        );
    }
}

/// There are no fast kernels for these: the composite runs in their place.
#[test]
fn other_kernels_run_too() {
    let device = Device::flex().autodiff();
    for (kernel, stride) in [(5, 1), (7, 2), (1, 2)] {
        let x = noise([2, 9, 7, 5], 3, -1.0, 1.0, &device);
        let p = parameters(5, 6, kernel, 4, &device);
        let run = |path| ops::conv_norm(path, x.clone(), p.clone(), settings(stride, true)).0;
        same(run(Path::Fused), run(Path::Composite), "output");
    }
}

#[test]
fn a_seed_hands_its_gradient_on() {
    let device = Device::flex().autodiff();
    let run = |path| {
        let x = noise([2, 3, 4, 5], 1, -1.0, 1.0, &device).require_grad();
        let planes = ops::channels_first(x.clone());
        let gradient = noise(planes.dims(), 2, -1.0, 1.0, &device);
        let other = ops::seed(path, x.clone() * 2.0, noise([2, 3, 4, 5], 3, -1.0, 1.0, &device));
        x.grad(&(ops::seed(path, planes, gradient) + other).backward()).unwrap()
    };
    same(run(Path::Fused), run(Path::Composite), "seeded");
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

/// A convolution with norm and its gradients in f64, from the definition.
struct Exact {
    output: Vec<f64>,
    dx: Vec<f64>,
    dw: Vec<f64>,
    dgamma: Vec<f64>,
    dbeta: Vec<f64>,
}

/// `g` is the gradient of the output. Layouts as in `ops`.
fn exact(shape: &ConvShape, x: &[f32], p: &[Vec<f32>; 3], g: &[f32]) -> Exact {
    let [weight, gamma, beta] = p;
    let z = reference::forward(shape, x, weight);
    let (cout, n) = (shape.out_channels, shape.out_pixels() as f64);
    let mut e = Exact { output: z.clone(), dx: vec![], dw: vec![], dgamma: vec![0.0; cout], dbeta: vec![0.0; cout] };
    let mut dz = z.clone();
    for c in 0..cout {
        let column = |v: &[f64]| v.iter().skip(c).step_by(cout).copied().collect::<Vec<f64>>();
        let zc = column(&z);
        let mean = zc.iter().sum::<f64>() / n;
        let deviation = (zc.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n + 1e-5).sqrt();
        let (gamma, beta) = (f64::from(gamma[c]), f64::from(beta[c]));
        let hat: Vec<f64> = zc.iter().map(|v| (v - mean) / deviation).collect();
        let pre: Vec<f64> = hat.iter().map(|h| h * gamma + beta).collect();
        let gc: Vec<f64> = g.iter().skip(c).step_by(cout).map(|v| f64::from(*v)).collect();
        let gc: Vec<f64> = gc.iter().zip(&pre).map(|(g, p)| if *p < 0.0 { 0.1 * g } else { *g }).collect();
        e.dbeta[c] = gc.iter().sum();
        e.dgamma[c] = gc.iter().zip(&hat).map(|(g, h)| g * h).sum();
        for (k, (g, h)) in gc.iter().zip(&hat).enumerate() {
            e.output[k * cout + c] = pre[k].max(0.1 * pre[k]);
            dz[k * cout + c] = gamma / deviation * (g - e.dbeta[c] / n - h * e.dgamma[c] / n);
        }
    }
    // The judge of the plain gradients reads f32; what is lost in two parts is f64's.
    let high: Vec<f32> = dz.iter().map(|v| *v as f32).collect();
    let low: Vec<f32> = dz.iter().zip(&high).map(|(v, h)| (v - f64::from(*h)) as f32).collect();
    let sum = |a: Vec<f64>, b: Vec<f64>| a.iter().zip(b).map(|(a, b)| a + b).collect();
    e.dx = sum(reference::input_gradient(shape, &high, weight), reference::input_gradient(shape, &low, weight));
    e.dw = sum(reference::weight_gradient(shape, x, &high), reference::weight_gradient(shape, x, &low));
    e
}

fn near(got: &[f32], want: &[f64], what: &str) {
    assert_eq!(got.len(), want.len(), "{what}");
    let scale = want.iter().fold(1e-2f64, |m, v| m.max(v.abs()));
    let worst = got.iter().zip(want).fold(0f64, |m, (g, w)| m.max((f64::from(*g) - w).abs()));
    assert!(worst <= 2e-5 * scale, "{what}: off by {:.1e} of the largest", worst / scale);
}

fn against_f64_sums(shape: ConvShape, seed: u64) {
    let device = Device::flex().autodiff();
    let ConvShape { batch, height, width, in_channels, out_channels, kernel, stride } = shape;
    let x = noise([batch, height, width, in_channels], seed + 50, -1.0, 1.0, &device).require_grad();
    let p = parameters(in_channels, out_channels, kernel, seed, &device);
    let (y, _) = ops::conv_norm(Path::Fused, x.clone(), p.clone(), settings(stride, true));
    let g = noise(y.dims(), 77, -1.0, 1.0, &device);
    let grads = (y.clone() * g.clone()).sum().backward();
    fn read<const D: usize>(t: Tensor<D>) -> Vec<f32> {
        t.into_data().try_into_vec().unwrap()
    }
    let vectors = [read(p.weight.clone().inner()), read(p.gamma.clone().inner()), read(p.beta.clone().inner())];
    let want = exact(&shape, &read(x.clone().inner()), &vectors, &read(g.inner()));
    near(&read(y.inner()), &want.output, "output");
    near(&read(x.grad(&grads).unwrap()), &want.dx, "gradient of the input");
    near(&read(p.weight.grad(&grads).unwrap()), &want.dw, "gradient of the weights");
    near(&read(p.gamma.grad(&grads).unwrap()), &want.dgamma, "gradient of gamma");
    near(&read(p.beta.grad(&grads).unwrap()), &want.dbeta, "gradient of beta");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, rng_seed: RngSeed::Fixed(3), failure_persistence: None, ..Default::default() })]
    #[test]
    fn gradients_agree_with_f64_sums(batch in 1usize..5, height in 5usize..24, width in 5usize..24, in_channels in 1usize..36, out_channels in 1usize..36, kind in 0usize..3, seed in 0u64..99) {
        let (kernel, stride) = [(1, 1), (3, 1), (3, 2)][kind];
        against_f64_sums(ConvShape { batch, height, width, in_channels, out_channels, kernel, stride }, seed);
    }
}

/// A mean of some thirty deviations: sums of plain squares in f32 would lose a ten-thousandth of the variance.
#[test]
fn a_large_mean_costs_no_accuracy() {
    for (in_channels, kernel) in [(24, 3), (3, 3), (24, 1)] {
        let shape = ConvShape { batch: 4, height: 19, width: 18, in_channels, out_channels: 20, kernel, stride: 1 };
        let inner = |device: &Device| noise([4, 19, 18, in_channels], 5, 9.9, 10.1, device);
        let device = Device::flex().autodiff();
        let p = parameters(in_channels, 20, kernel, 1, &device);
        let (y, s) = ops::conv_norm(Path::Fused, inner(&device), p.clone(), settings(1, true));
        let _ = y;
        let (x, w): (Vec<f32>, Vec<f32>) =
            (inner(&Device::flex()).into_data().try_into_vec().unwrap(), p.weight.inner().into_data().try_into_vec().unwrap());
        let z = reference::forward(&shape, &x, &w);
        let got: Vec<f32> = s.variance.inner().into_data().try_into_vec().unwrap();
        for (c, got) in got.iter().enumerate() {
            let column: Vec<f64> = z.iter().skip(c).step_by(20).copied().collect();
            let mean = column.iter().sum::<f64>() / column.len() as f64;
            let want = column.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / column.len() as f64;
            assert!((f64::from(*got) - want).abs() < 1e-4 * want, "variance {got} instead of {want}");
        }
    }
}
