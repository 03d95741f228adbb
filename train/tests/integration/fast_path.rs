//! The fused operations learn what burn's own learn, and the same bits on any number of threads.
use super::{data, toy};
use std::{path::Path, sync::atomic::AtomicBool};
use tcross_dataset::Dataset;
use tcross_train::{Config, Progress, RunOptions, config::Validate, fit};
use tcross_yolo::{Model, ModelSection, NetSize};

/// Small, but with residual units, and with layers large enough for every kernel.
fn network() -> ModelSection {
    ModelSection { width: 0.125, depth: 0.25, input: NetSize::square(96), ..ModelSection::default() }
}

fn losses(config: &Config, dataset: &Dataset, out: &Path) -> Vec<f64> {
    let mut losses = Vec::new();
    fit(config, &network(), dataset, &RunOptions::new(out, 5, &AtomicBool::new(false)), &mut |news| {
        if let Progress::Step(report) = news {
            losses.push(report.loss.total());
        }
    })
    .unwrap();
    losses
}

#[test]
fn two_hundred_steps_follow_the_composite() {
    let dir = tempfile::tempdir().unwrap();
    toy::write(&dir.path().join("data"), 40, 1, 96).unwrap();
    let dataset = Dataset::open(dir.path().join("data")).unwrap();
    let config = |fused| Config {
        batch: 4,
        steps: Some(200),
        epochs: None,
        fused,
        validate: Validate { every: 1000, ..Validate::default() },
        ..Config::default()
    };
    let fused = losses(&config(true), &dataset, &dir.path().join("fused"));
    let composite = losses(&config(false), &dataset, &dir.path().join("composite"));
    assert_eq!((fused.len(), composite.len()), (200, 200));
    // Rounding differs, so that the curves part slowly: the first steps agree to five digits, means over twenty steps within noise.
    for (step, (a, b)) in fused.iter().zip(&composite).take(3).enumerate() {
        assert!((a - b).abs() < 1e-3 * b, "step {step}: loss {a} instead of {b}");
    }
    let means = |losses: &[f64]| losses.chunks(20).map(|c| c.iter().sum::<f64>() / 20.0).collect::<Vec<_>>();
    let (a, b) = (means(&fused), means(&composite));
    for (k, (x, y)) in a.iter().zip(&b).enumerate() {
        assert!((x / y - 1.0).abs() < 0.15, "steps {}..{}: mean loss {x} instead of {y}", 20 * k, 20 * k + 20);
    }
    assert!(a[9] < 0.5 * a[0] && b[9] < 0.5 * b[0], "neither curve may stand still: {a:?}, {b:?}");
}

#[test]
fn threads_change_no_bit() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = data(dir.path(), 8);
    for batch_parts in [1, 2] {
        let config = Config { batch: 4, batch_parts, steps: Some(4), epochs: None, ..Config::default() };
        let weights = [1, 2, 3, 4].map(|threads| {
            let out = dir.path().join(format!("{batch_parts}-{threads}"));
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| losses(&config, &dataset, &out));
            Model::load(&out).unwrap().weights
        });
        assert!(weights.iter().all(|other| *other == weights[0]), "{batch_parts} parts");
    }
}
