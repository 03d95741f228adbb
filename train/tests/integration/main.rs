//! Whole trainings of a tiny network on a toy dataset.
mod fast_path;
#[path = "../../src/toy.rs"]
mod toy;

use std::{
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
};
use tcross_dataset::Dataset;
use tcross_train::{
    Config, End, Progress, RunOptions, RunSummary, TrainError,
    config::{Augment, Freeze, Validate},
    fit,
};
use tcross_yolo::{Architecture, Model, ModelSection, NetSize};

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

#[test]
fn divergence_stops_and_shows_its_batch() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = data(dir.path(), 8);
    let mut config = short();
    config.optimizer.rate = 90.0;
    config.epochs = Some(50.0);
    let error = train(&config, &dataset, dir.path().join("run")).unwrap_err();
    let TrainError::Diverged { batch, .. } = &error else { panic!("{error}") };
    assert!(batch.is_file());
}

#[test]
fn patience_and_the_clock_end_a_training() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = data(dir.path(), 8);
    let mut config = Config { epochs: Some(50.0), validate: Validate { patience: 2, ..Validate::default() }, ..short() };
    config.optimizer.rate = 1e-12; // nothing is learned, so nothing gets better
    let summary = train(&config, &dataset, dir.path().join("patience")).unwrap();
    assert_eq!((summary.end, summary.history.rows.len() as u64), (End::EarlyStopped, summary.best.map_or(2, |_| 3)));
    let config = Config { epochs: None, max_minutes: Some(0.02), ..short() };
    let summary = train(&config, &dataset, dir.path().join("clock")).unwrap();
    assert!(summary.end == End::Finished && (1.2..10.0).contains(&summary.seconds), "{summary:?}");
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
