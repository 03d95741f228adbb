//! Whole trainings of a tiny network on a toy dataset.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "helpers of tests may panic too")]
mod fast_path;
#[cfg(feature = "wgpu")]
mod gpu;
#[path = "../../src/toy.rs"]
mod toy;

use std::{
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
};
use tcross_dataset::{Dataset, Split};
use tcross_train::{
    Config, End, Progress, RunOptions, RunSummary, TrainError,
    config::{Augment, Freeze, Optimizer, OptimizerKind, ScheduleKind, Validate},
    fit,
};
use tcross_yolo::{Architecture, Model, ModelSection, NetSize, Yolo, decode::decode, input, network::read_logits};

fn network() -> ModelSection {
    ModelSection { architecture: Architecture::YoloV3Tiny, width: 0.0625, input: NetSize::square(64), ..ModelSection::default() }
}

fn short() -> Config {
    Config {
        batch: 4,
        epochs: Some(2.0),
        augment: Augment { mosaic: 0.3, mixup: 0.2, scale: 0.2, ..Augment::default() },
        ..Config::default()
    }
}

fn data(dir: &Path, train: usize) -> Dataset {
    toy::write(&dir.join("data"), train, 6, 64).unwrap();
    Dataset::open(dir.join("data")).unwrap()
}

fn train(config: &Config, dataset: &Dataset, out: PathBuf) -> Result<RunSummary, TrainError> {
    fit(config, &network(), dataset, &RunOptions::new(out, 5, &AtomicBool::new(false)), &mut |_| {})
}

/// Trains and stops after each of these steps, then goes on.
fn train_with_stops(config: &Config, dataset: &Dataset, out: &Path, stops: &[u64]) -> RunSummary {
    for &at in stops {
        let stop = AtomicBool::new(false);
        let options = RunOptions { resume: true, ..RunOptions::new(out, 5, &stop) };
        let summary = fit(config, &network(), dataset, &options, &mut |news| {
            if let Progress::Step(report) = news {
                stop.store(report.step >= at, Ordering::Relaxed);
            }
        });
        assert_eq!((summary.as_ref().unwrap().end, summary.unwrap().steps), (End::Interrupted, at));
    }
    let options_stop = AtomicBool::new(false);
    fit(config, &network(), dataset, &RunOptions { resume: true, ..RunOptions::new(out, 5, &options_stop) }, &mut |_| {}).unwrap()
}

/// Rows without what depends on the clock.
fn timeless(summary: &RunSummary) -> Vec<Vec<(&'static str, Option<f64>)>> {
    let timed = ["seconds", "images_per_second"];
    summary.history.rows.iter().map(|r| r.columns().into_iter().filter(|(name, _)| !timed.contains(name)).collect()).collect()
}

#[test]
fn stopping_and_resuming_changes_nothing_and_repeats_are_bit_identical() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = data(dir.path(), 18); // 4.5 steps an epoch: epochs end within a batch
    let once = train(&short(), &dataset, dir.path().join("once")).unwrap();
    let again = train(&short(), &dataset, dir.path().join("again")).unwrap();
    let stopped = train_with_stops(&short(), &dataset, &dir.path().join("stopped"), &[2, 3, 7]);
    assert_eq!((once.end, once.steps), (End::Finished, 9));
    for other in [&again, &stopped] {
        assert_eq!(timeless(&once), timeless(other));
        assert_eq!(once.best, other.best);
    }
    for name in ["best.safetensors", "last.safetensors", "model.toml"] {
        let read = |run: &str| std::fs::read(dir.path().join(run).join(name)).unwrap();
        assert!(read("once") == read("again"), "{name} differs between repeats");
        assert!(read("once") == read("stopped"), "{name} differs after stops");
    }
}

/// A batch in parts is another way to learn, as batch norm sees less at once, and as repeatable.
#[test]
fn parts_of_a_batch_stop_resume_and_repeat_to_equal_bits() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = data(dir.path(), 10);
    let with = |batch_parts| Config { batch_parts, ..short() };
    let weights = |run: &str| std::fs::read(dir.path().join(run).join("last.safetensors")).unwrap();
    for (run, parts) in [("once", 2), ("again", 2), ("whole", 1)] {
        train(&with(parts), &dataset, dir.path().join(run)).unwrap();
    }
    train_with_stops(&with(2), &dataset, &dir.path().join("stopped"), &[1, 3]);
    assert!(weights("once") == weights("again") && weights("once") == weights("stopped"));
    assert!(weights("once") != weights("whole"));
}

/// Muon's state is saved and read back too, and it is another way to learn than AdamW's.
#[test]
fn muon_stops_resumes_and_repeats_to_equal_bits() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = data(dir.path(), 10);
    let with = |kind| Config { optimizer: Optimizer { kind, ..Optimizer::default() }, ..short() };
    let weights = |run: &str| std::fs::read(dir.path().join(run).join("last.safetensors")).unwrap();
    for (run, kind) in [("once", OptimizerKind::Muon), ("again", OptimizerKind::Muon), ("adamw", OptimizerKind::Adamw)] {
        train(&with(kind), &dataset, dir.path().join(run)).unwrap();
    }
    train_with_stops(&with(OptimizerKind::Muon), &dataset, &dir.path().join("stopped"), &[1, 3]);
    assert!(weights("once") == weights("again") && weights("once") == weights("stopped"));
    assert!(weights("once") != weights("adamw"));
}

/// A list without images is no validation, as no list is.
#[test]
fn an_empty_validation_split_is_none() {
    let dir = tempfile::tempdir().unwrap();
    toy::write(&dir.path().join("data"), 4, 0, 64).unwrap();
    let dataset = Dataset::open(dir.path().join("data")).unwrap();
    let summary = train(&Config { epochs: Some(1.0), ..short() }, &dataset, dir.path().join("run")).unwrap();
    assert_eq!((summary.end, summary.best), (End::Finished, None));
    assert!(dir.path().join("run/best.safetensors").is_file());
}

#[test]
fn class_names_are_as_many_as_classes() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = data(dir.path(), 4);
    let named = |names: &[&str]| Config { steps: Some(1), classes: names.iter().map(ToString::to_string).collect(), ..short() };
    let error = train(&named(&["t_cross", "star"]), &dataset, dir.path().join("two")).unwrap_err().to_string();
    assert!(error.contains("train.classes = 2 names: expected 1"), "{error}");
    train(&named(&["t_cross"]), &dataset, dir.path().join("one")).unwrap();
    assert_eq!(Model::load(dir.path().join("one")).unwrap().config.names, ["t_cross"]);
}

#[test]
fn a_resume_may_lengthen_but_not_change_a_run() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = data(dir.path(), 8);
    let out = dir.path().join("run");
    train(&Config { epochs: Some(1.0), ..short() }, &dataset, out.clone()).unwrap();
    let stop = AtomicBool::new(false);
    let resume = RunOptions { resume: true, ..RunOptions::new(&out, 5, &stop) };
    let summary = fit(&Config { epochs: Some(3.0), ..short() }, &network(), &dataset, &resume, &mut |_| {}).unwrap();
    assert_eq!((summary.steps, summary.history.rows.len()), (6, 3));
    let error = fit(&Config { ignore_iou: 0.7, ..short() }, &network(), &dataset, &resume, &mut |_| {}).unwrap_err().to_string();
    assert!(error.contains("ignore_iou = 0.6") && error.contains("ignore_iou = 0.7"), "{error}");
    assert!(matches!(train(&short(), &dataset, out), Err(TrainError::RunExists { .. })));
}

/// Stopped within an epoch and given a longer end: the same bits as the long run that never stopped, where the rate does not hang on the length.
#[test]
fn lengthening_within_an_epoch_changes_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = data(dir.path(), 18); // 4.5 steps an epoch
    let mut long = Config { epochs: Some(3.0), ..short() };
    long.schedule.kind = ScheduleKind::Constant;
    let once = train(&long, &dataset, dir.path().join("once")).unwrap();
    let (stop, out) = (AtomicBool::new(false), dir.path().join("stopped"));
    let shorter = Config { epochs: Some(2.0), ..long.clone() };
    fit(&shorter, &network(), &dataset, &RunOptions::new(&out, 5, &stop), &mut |news| {
        if let Progress::Step(report) = news {
            stop.store(report.step >= 6, Ordering::Relaxed);
        }
    })
    .unwrap();
    let resumed = train_with_stops(&long, &dataset, &out, &[11]);
    assert_eq!((resumed.steps, timeless(&resumed)), (14, timeless(&once)));
    for name in ["best.safetensors", "last.safetensors"] {
        let read = |run: &str| std::fs::read(dir.path().join(run).join(name)).unwrap();
        assert!(read("once") == read("stopped"), "{name}");
    }
}

/// The head grows by a field and everything else stays: a marker's centre and its stem's corner are learned in the same pass as its box.
#[test]
fn a_head_with_keypoints_learns_them() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = data(dir.path(), 160);
    let mut config = Config {
        batch: 4,
        epochs: Some(32.0),
        ema: 0.9,
        objectness_bias: -4.0,
        validate: Validate { every: 16, ..Validate::default() },
        ..Config::default()
    };
    config.optimizer.rate = 5e-3;
    let section = ModelSection { width: 0.125, keypoints: 2, ..network() };
    let (stop, out) = (AtomicBool::new(false), dir.path().join("run"));
    let summary = fit(&config, &section, &dataset, &RunOptions::new(&out, 5, &stop), &mut |_| {}).unwrap();
    let rows = &summary.history.rows;
    assert!(rows[1].loss.keypoints > 0.0 && rows[1].loss.keypoints < rows[0].loss.keypoints, "{rows:?}");

    let model = Model::load(&out).unwrap();
    assert_eq!(model.config.keypoints, 2);
    let (device, net) = (burn::tensor::Device::flex(), model.config.input);
    let yolo = Yolo::new(&model.config, &model.weights, &device).unwrap();
    let (mut errors, records) = (Vec::new(), dataset.records(Split::Val).unwrap());
    for record in &records {
        let image = image::open(dataset.image_path(record)).unwrap().to_rgb8();
        let mut values = vec![0.0; 3 * net.width * net.height];
        let letterbox = input::prepare(&image, net, &mut values);
        let heads =
            yolo.forward(burn::tensor::Tensor::from_data(burn::tensor::TensorData::new(values, [1, 3, net.height, net.width]), &device));
        let logits: Vec<Vec<f32>> = heads.iter().map(read_logits).collect();
        let views: Vec<&[f32]> = logits.iter().map(Vec::as_slice).collect();
        let mut claims = decode(&model.config.geometry(net), &views, 0.05);
        claims.sort_by(|a, b| b.score.total_cmp(&a.score));
        let (Some(claim), marker) = (claims.first(), &record.markers[0]) else { continue };
        let truths = [marker.center.unwrap(), marker.corners.unwrap().0[0]].map(|p| letterbox.net_from_source(p));
        let side = marker.bounds.width();
        errors.extend(truths.iter().zip(&claim.keypoints).map(|(t, c)| (t[0] - c[0]).hypot(t[1] - c[1]) / side));
    }
    assert!(errors.len() >= 8, "{} of {} found", errors.len() / 2, records.len());
    errors.sort_by(f64::total_cmp);
    assert!(errors[errors.len() / 2] < 0.15, "{errors:?}"); // in sides of the marker

    let wrong = ModelSection { keypoints: 6, ..section };
    let error = fit(&config, &wrong, &dataset, &RunOptions::new(dir.path().join("six"), 5, &stop), &mut |_| {}).unwrap_err().to_string();
    assert!(error.contains("model.keypoints = 6: expected 0 to 5"), "{error}");
}

#[test]
fn the_folder_holds_what_was_promised() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = data(dir.path(), 8);
    let out = dir.path().join("run");
    let mut opened = false;
    let stop = AtomicBool::new(false);
    fit(&short(), &network(), &dataset, &RunOptions::new(&out, 5, &stop), &mut |news| {
        opened |= matches!(news, Progress::Opened { train: 8, val: 6, step: 0, .. });
    })
    .unwrap();
    assert!(opened);
    for name in [
        "config.toml",
        "model.toml",
        "best.safetensors",
        "last.safetensors",
        "state/state.safetensors",
        "metrics.csv",
        "events.out.tfevents.0000000000",
        "curves/loss.svg",
        "curves/scores.svg",
        "curves/rate.svg",
        "batches/00000.jpg",
        "batches/worst-00002.jpg",
        "log.txt",
    ] {
        assert!(out.join(name).is_file(), "{name} is missing");
    }
    let model = Model::load(&out).unwrap();
    assert_eq!(model.config.input, NetSize::square(64));
    assert_eq!(std::fs::read_to_string(out.join("metrics.csv")).unwrap().lines().count(), 3);
}

#[test]
fn learns_a_toy_in_seconds() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = data(dir.path(), 48);
    let mut config = Config {
        batch: 4,
        epochs: Some(24.0),
        ema: 0.9,
        objectness_bias: -4.0,
        validate: Validate { every: 8, ..Validate::default() },
        ..Config::default()
    };
    config.optimizer.rate = 5e-3;
    let network = ModelSection { width: 0.125, ..network() };
    let stop = AtomicBool::new(false);
    let summary = fit(&config, &network, &dataset, &RunOptions::new(dir.path().join("run"), 5, &stop), &mut |_| {}).unwrap();
    let row = summary.history.rows.last().unwrap();
    assert!(row.scores[1].unwrap() > 0.8, "{:?}", summary.history.rows);
}

#[test]
fn a_frozen_backbone_stands_still() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = data(dir.path(), 8);
    let start = |freeze, out: &str| {
        let config = Config { freeze, ema: 0.0, epochs: Some(1.0), multi_scale: vec![64, 96], multi_scale_steps: 1, ..short() };
        let out = dir.path().join(out);
        train(&config, &dataset, out.clone()).unwrap();
        Model::load(out.join("last.safetensors")).unwrap()
    };
    let (free, frozen, running) = (start(Freeze::None, "a"), start(Freeze::Backbone, "b"), start(Freeze::BackboneRunning, "c"));
    let (first, last) = (0, free.weights.convolutions.len() - 1);
    let kernel = |m: &Model, k: usize| m.weights.convolutions[k].kernel.clone();
    let mean = |m: &Model| m.weights.convolutions[first].norm.as_ref().unwrap().mean.clone();
    assert_eq!(kernel(&frozen, first), kernel(&running, first));
    assert_ne!(kernel(&free, first), kernel(&frozen, first));
    assert_ne!(kernel(&frozen, last), kernel(&running, last));
    assert!(mean(&running).iter().all(|v| *v == 0.0) && mean(&frozen).iter().any(|v| *v != 0.0));
}

/// What a still backbone says of still images is computed once; the training's bits are those of computing it at every step.
#[test]
fn kept_features_change_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = data(dir.path(), 8);
    let still = Augment { flip: 0.0, color_probability: 0.0, ..Augment::default() };
    assert!(still.is_still() && !Augment::default().is_still());
    let start = |cache_gb, out: &str| {
        let config = Config { freeze: Freeze::BackboneRunning, augment: still.clone(), cache_gb, epochs: Some(4.0), ..short() };
        let out = dir.path().join(out);
        train(&config, &dataset, out.clone()).unwrap();
        Model::load(out.join("last.safetensors")).unwrap().weights
    };
    assert!(start(1.0, "kept") == start(0.0, "computed"));
}

#[test]
fn divergence_stops_and_shows_its_batch() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = data(dir.path(), 8);
    let mut config = short();
    config.optimizer.rate = 90.0;
    config.epochs = Some(50.0);
    let error = train(&config, &dataset, dir.path().join("run")).unwrap_err();
    let TrainError::Diverged { batch, step, .. } = &error else { panic!("{error}") };
    assert!(batch.is_file());
    let report: serde_json::Value = serde_json::from_slice(&std::fs::read(batch.with_extension("json")).unwrap()).unwrap();
    assert_eq!((report["step"].as_u64(), report["images"].as_array().unwrap().len()), (Some(*step), 4));
    assert!(report["images"][0]["made_of"][0].as_str().unwrap().starts_with("train/"), "{report}");
}

#[test]
fn patience_and_the_clock_end_a_training() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = data(dir.path(), 8);
    let mut config = Config { epochs: Some(50.0), validate: Validate { patience: 2, ..Validate::default() }, ..short() };
    config.optimizer.rate = 1e-12; // nothing is learned, so nothing gets better
    let summary = train(&config, &dataset, dir.path().join("patience")).unwrap();
    assert_eq!((summary.end, summary.history.rows.len() as u64), (End::EarlyStopped, summary.best.map_or(2, |_| 3)));
    // Gone on with, it is still at its end.
    let again = train_with_stops(&config, &dataset, &dir.path().join("patience"), &[]);
    assert_eq!((again.end, again.steps, &again.history), (End::EarlyStopped, summary.steps, &summary.history));
    // With more patience it goes on.
    config.validate.patience = 4;
    let longer = train_with_stops(&config, &dataset, &dir.path().join("patience"), &[]);
    assert_eq!((longer.end, longer.history.rows.len()), (End::EarlyStopped, summary.history.rows.len() + 2));
    let config = Config { epochs: None, max_minutes: Some(0.02), ..short() };
    let summary = train(&config, &dataset, dir.path().join("clock")).unwrap();
    // The last validation is planned for: at most half of the time is set aside for it.
    assert!(summary.end == End::Finished && (0.6..10.0).contains(&summary.seconds), "{summary:?}");
    assert!(summary.history.rows.last().unwrap().rate < 0.1 * config.optimizer.rate);
}

/// The recipes that are shipped are valid, and say what they are to say.
#[test]
fn shipped_recipes_are_valid() {
    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Recipe {
        model: ModelSection,
        train: Config,
    }
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/recipes");
    let read = |name: &str| -> Recipe {
        let recipe: Recipe = toml::from_str(&std::fs::read_to_string(dir.join(name)).unwrap()).unwrap();
        recipe.train.validate().unwrap();
        recipe.model.validate().unwrap();
        recipe
    };
    assert_eq!(std::fs::read_dir(&dir).unwrap().count(), 3);
    assert_eq!(read("cpu.toml").model.width, 0.125);
    assert_eq!(read("darknet.toml").train.batch, 64);
    assert_eq!(read("paper.toml").train.freeze, Freeze::Backbone);
}
