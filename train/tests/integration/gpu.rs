//! The same training on a graphics card, or on a software driver such as Mesa's lavapipe: `cargo test -p tcross-train --features wgpu gpu`.
use super::{data, network};
use std::sync::atomic::AtomicBool;
use tcross_train::{Accelerator, Config, RunOptions, TrainError, fit};
use tcross_yolo::{ModelSection, NetSize};

#[test]
fn wgpu_learns_what_the_processor_learns() {
    if let Err(TrainError::Device { device, message }) = Accelerator::Wgpu.check() {
        eprintln!("skipped: device '{device}': {message}");
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let dataset = data(dir.path(), 6);
    let section = ModelSection { input: NetSize::square(32), ..network() };
    let config = Config { batch: 2, epochs: None, steps: Some(4), ema: 0.0, ..Config::default() };
    let stop = AtomicBool::new(false);
    let losses = [Accelerator::Cpu, Accelerator::Wgpu].map(|accelerator| {
        let options = RunOptions { accelerator, ..RunOptions::new(dir.path().join(accelerator.to_string()), 5, &stop) };
        let summary = fit(&config, &section, &dataset, &options, &mut |_| {}).unwrap();
        assert!(options.out.join("best.safetensors").is_file());
        let rows: Vec<(u64, f64, f64)> = summary.history.rows.iter().map(|r| (r.step, r.loss.total(), r.gradient_norm)).collect();
        rows
    });
    assert_eq!(losses[0].len(), 2); // an epoch of three steps, and the end
    for (cpu, gpu) in losses[0].iter().zip(&losses[1]) {
        let close = |a: f64, b: f64| (a / b - 1.0).abs() < 0.01;
        assert!(cpu.0 == gpu.0 && close(cpu.1, gpu.1) && close(cpu.2, gpu.2), "{cpu:?} {gpu:?}");
    }
}
