use proptest::{prelude::*, test_runner::RngSeed};
use tcross_kernels::{Activation, ConvShape, Isa, conv, pack, reference, weight_gradient::weight_gradient};

fn noise(len: usize, seed: u32) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9E37_79B9) | 1;
    (0..len)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            (state >> 8) as f32 / (1 << 24) as f32 - 0.5
        })
        .collect()
}

fn close(got: &[f32], want: &[f64], what: &str) {
    assert_eq!(got.len(), want.len());
    let scale = want.iter().fold(1e-3f64, |m, v| m.max(v.abs()));
    for (i, (g, w)) in got.iter().zip(want).enumerate() {
        assert!((f64::from(*g) - w).abs() <= 2e-5 * scale, "{what}: element {i}: {g} instead of {w}");
    }
}

fn shapes() -> impl Strategy<Value = ConvShape> {
    let kind = prop_oneof![Just((1, 1)), Just((3, 1)), Just((3, 2))];
    (1usize..4, 1usize..20, 1usize..20, 1usize..41, 1usize..41, kind).prop_map(
        |(batch, height, width, in_channels, out_channels, (kernel, stride))| ConvShape {
            batch,
            height,
            width,
            in_channels,
            out_channels,
            kernel,
            stride,
        },
    )
}

/// Shapes large enough that training takes Winograd's algorithm.
fn many_tiles() -> impl Strategy<Value = ConvShape> {
    (2usize..5, 15usize..24, 15usize..24, 14usize..41, 14usize..41).prop_map(|(batch, height, width, in_channels, out_channels)| {
        ConvShape { batch, height, width, in_channels, out_channels, kernel: 3, stride: 1 }
    })
}

fn check(shape: ConvShape, seed: u32) {
    let (x, w, dz) = (noise(shape.input_len(), seed), noise(shape.weight_len(), seed + 1), noise(shape.output_len(), seed + 2));
    let want =
        [reference::forward(&shape, &x, &w), reference::input_gradient(&shape, &dz, &w), reference::weight_gradient(&shape, &x, &dz)];
    let scale: Vec<f32> = noise(shape.in_channels, 9).iter().map(|v| v + 1.0).collect();
    let shift = noise(shape.in_channels, 10);
    let activation = Activation { scale: &scale, shift: &shift, slope: 0.1 };
    let activated: Vec<f32> = x
        .iter()
        .enumerate()
        .map(|(i, v)| {
            let z = v * scale[i % shape.in_channels] + shift[i % shape.in_channels];
            z.max(0.1 * z)
        })
        .collect();
    for isa in Isa::available() {
        let mut out = vec![f32::NAN; shape.output_len()];
        conv::forward(&shape, &x, &pack::pack_once(isa, &shape, &w), &mut out);
        close(&out, &want[0], &format!("{isa:?} forward of {shape:?}, packed once"));
        let packed = pack::forward(isa, &shape, &w);
        out.fill(f32::NAN);
        conv::forward(&shape, &x, &packed, &mut out);
        close(&out, &want[0], &format!("{isa:?} forward of {shape:?}"));

        let mut dx = vec![f32::NAN; shape.input_len()];
        conv::input_gradient(isa, &shape, &dz, &w, false, &mut dx);
        close(&dx, &want[1], &format!("{isa:?} input gradient of {shape:?}"));
        conv::input_gradient(isa, &shape, &dz, &w, true, &mut dx);
        close(&dx, &want[1].iter().map(|v| 2.0 * v).collect::<Vec<_>>(), "accumulated");

        close(&weight_gradient(isa, &shape, &x, None, &dz), &want[2], &format!("{isa:?} weight gradient of {shape:?}"));

        let sums = conv::forward_with_statistics(&shape, &x, Some(activation), &packed, &mut out);
        let fused = reference::forward(&shape, &activated, &w);
        close(&out, &fused, "activated on the way in");
        for (c, sum) in sums.iter().enumerate() {
            let column: Vec<f64> = fused.iter().skip(c).step_by(shape.out_channels).copied().collect();
            let (s, q): (f64, f64) = (column.iter().sum(), column.iter().map(|v| v * v).sum());
            assert!((sum[0] - s).abs() < 1e-4 * (q.sqrt() * (column.len() as f64).sqrt() + 1.0) && (sum[1] - q).abs() < 1e-4 * (q + 1.0));
        }
        close(
            &weight_gradient(isa, &shape, &x, Some(activation), &dz),
            &reference::weight_gradient(&shape, &activated, &dz),
            "activated gradient",
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..Default::default() })]
    #[test]
    fn random_shapes(shape in shapes(), seed in 0u32..1000) {
        check(shape, seed);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 16, rng_seed: RngSeed::Fixed(2), failure_persistence: None, ..Default::default() })]
    #[test]
    fn random_shapes_of_many_tiles(shape in many_tiles(), seed in 0u32..1000) {
        check(shape, seed);
    }
}

#[test]
fn shapes_of_the_network() {
    for (height, cin, cout, kernel, stride) in [
        (40, 3, 8, 3, 1),
        (40, 8, 16, 3, 2),
        (26, 32, 64, 3, 1),
        (13, 128, 64, 1, 1),
        (13, 64, 18, 1, 1),
        (9, 96, 160, 3, 1),
        (13, 48, 640, 3, 2),
        (17, 640, 48, 3, 1),
    ] {
        check(ConvShape { batch: 2, height, width: height, in_channels: cin, out_channels: cout, kernel, stride }, 3);
    }
}

#[test]
fn any_kernel_as_one_product() {
    for (kernel, stride) in [(1, 1), (1, 2), (3, 1), (3, 2), (5, 1), (5, 2), (7, 2)] {
        let shape = ConvShape { batch: 2, height: 9, width: 11, in_channels: 3, out_channels: 5, kernel, stride };
        let (x, w, r) = (noise(shape.input_len(), 1), noise(shape.weight_len(), 2), noise(shape.output_len(), 3));
        let bias = noise(5, 4);
        let mut got = vec![0.0; shape.output_len()];
        conv::forward_plain(&shape, &x, &w, conv::Epilogue { bias: &bias, slope: 0.1, residual: Some(&r) }, &mut got);
        let plain = reference::forward(&shape, &x, &w);
        let finish = |(at, z): (usize, f64)| {
            let z = z + f64::from(bias[at % 5]);
            z.max(0.1 * z) + f64::from(r[at])
        };
        close(&got, &plain.into_iter().enumerate().map(finish).collect::<Vec<_>>(), "plain");
    }
}
