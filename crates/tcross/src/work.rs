//! The stages as the program runs them: progress drawn, warnings said, Ctrl-C obeyed. Used by the single commands and by
//! `reproduce` alike.
use crate::{
    config::Config,
    console::{self, Progress},
    exit::{Failure, Outcome},
    nearest, stop,
};
use std::{collections::BTreeSet, path::Path, sync::atomic::Ordering};
use tcross_datagen::{Backgrounds, DatagenError, GenerateOptions};
use tcross_dataset::{Dataset, Split};
use tcross_infer::{Boxes, RunReport, Source};
use tcross_train::{End, RunSummary};

/// The commit this program was built from.
pub const COMMIT: &str = env!("TCROSS_COMMIT");

/// The tables of a report that are printed.
pub const SHORT_TABLES: [&str; 5] = ["headline", "min-side", "sweeps", "coco", "pose"];

/// The photos, or the embedded scenes, that a config names.
pub fn backgrounds(config: &Config) -> Outcome<Backgrounds> {
    let Some(dir) = config.backgrounds.as_ref().filter(|_| !config.data.background.embedded) else {
        return Ok(Backgrounds::embedded());
    };
    if !dir.is_dir() {
        return Err(Failure::new(format!("{}: no such folder of backgrounds{}", dir.display(), nearest::path_hint(dir))));
    }
    Ok(Backgrounds::open(dir)?)
}

/// Generates a dataset; photos that cannot be used are warned of, those that only turn out so while drawing at the end.
pub fn datagen(config: &Config, options: &GenerateOptions) -> Outcome<tcross_datagen::Summary> {
    let backgrounds = backgrounds(config)?;
    let mut named = BTreeSet::new();
    let mut warn = || {
        for photo in backgrounds.skipped().into_iter().filter(|photo| named.insert(photo.clone())) {
            console::warn(&format!("{photo}: skipped"));
        }
    };
    warn();
    let mut bar = Progress::new("datagen", config.data.images);
    let made = tcross_datagen::generate(&config.data, &backgrounds, options, &stop::flag(), &mut |p| bar.at(p.done, p.total, "images"));
    drop(bar);
    warn();
    made.map_err(|e| match e {
        DatagenError::Stopped => {
            Failure::Interrupted { kept: format!("{} keeps what was finished; --resume goes on", options.out.display()) }
        }
        other => other.into(),
    })
}

/// Trains a network.
pub fn train(config: &Config, data: &Path, options: &tcross_train::RunOptions) -> Outcome<RunSummary> {
    use tcross_train::Progress::{Claims, Epoch, Opened, Refined, SecondStage, Step, Validating, Warning};
    let dataset = Dataset::open(data)?;
    // Thousandths: the number of steps is not always known beforehand.
    let mut bar = Progress::new("train", 1000);
    let summary = tcross_train::fit(&config.train, &config.model, &dataset, options, &mut |news| match news {
        Opened { train, val, parameters, memory, anchor_iou, weights, step, .. } => {
            let fit = anchor_iou.map_or(String::new(), |iou| format!(", anchors fit with IoU {iou:.2}"));
            console::note(&format!("train: {train} images, {val} to validate, {parameters} parameters{fit}; memory: {memory}"));
            if let Some(weights) = weights {
                console::note(&format!("train: weights: {weights}"));
            }
            if step > 0 {
                console::note(&format!("train: goes on after step {step}"));
            }
        }
        Step(s) => {
            let left = time_left(&s);
            let parts = format!("box {:.2} objectness {:.2} class {:.2}", s.loss.center + s.loss.size, s.loss.objectness, s.loss.class);
            let message = format!("epoch {:.1}: loss {:.2} ({parts}), {:.1} images/s{left}", s.epoch, s.loss.total(), s.images_per_second);
            bar.at((s.fraction * 1000.0) as u64, 1000, &message);
        }
        Validating { .. } => {}
        Claims { done, of } => bar.at(done as u64, of as u64, "images looked at for the second stage"),
        Refined(s) => {
            let parts = format!("score {:.3} box {:.3} frame {:.3}", s.loss.objectness, s.loss.center, s.loss.size);
            let message = format!("second stage, pass {:.1}: loss {parts}, {:.0} claims/s{}", s.epoch, s.images_per_second, time_left(&s));
            bar.at((s.fraction * 1000.0) as u64, 1000, &message);
        }
        SecondStage { words, kept } => {
            let fate = if kept { "" } else { "; it does not help and is not kept" };
            console::note(&format!("second stage: {words}{fate}"));
        }
        Epoch { row, best } => {
            let score = |name: &str| row.columns().iter().find(|c| c.0 == name).and_then(|c| c.1).map_or("-".into(), |v| format!("{v:.3}"));
            let mark = if best { " *" } else { "" };
            console::note(&format!(
                "epoch {:.1}: loss {:.2}, AP {}, AP50 {}, mean IoU {}, precision {}, recall {}{mark}",
                row.epoch,
                row.loss.total(),
                score("val_ap"),
                score("val_ap50"),
                score("val_mean_iou"),
                score("val_precision"),
                score("val_recall")
            ));
        }
        Warning(text) => console::warn(text),
    })?;
    drop(bar);
    if summary.end == End::Interrupted {
        let kept = format!("{} is saved after step {}; --resume goes on", options.out.display(), summary.steps);
        return Err(Failure::Interrupted { kept });
    }
    Ok(summary)
}

/// What a progress line says of the time still to go; nothing where it is not known.
fn time_left(step: &tcross_train::StepReport) -> String {
    let left = step.seconds_left.map(|t| console::seconds(std::time::Duration::from_secs_f64(t.max(0.0))));
    left.map_or(String::new(), |left| format!(", {left} left"))
}

/// Every split of datasets, one behind the other.
pub fn all_splits(datasets: &[impl AsRef<Path>]) -> Outcome<Source> {
    let mut all = Source::default();
    for path in datasets {
        let dataset = Dataset::open(path)?;
        for split in Split::ALL.into_iter().filter(|s| dataset.list_path(*s).is_file()) {
            all.items.extend(Source::open(&[path], Some(split))?.items);
        }
    }
    Ok(all)
}

/// Looks at every image of a source; `show` gets each line of detections.
pub fn infer(
    boxes: &mut Boxes,
    source: &Source,
    config: &tcross_infer::Config,
    options: &tcross_infer::RunOptions,
    mut show: impl FnMut(&tcross_dataset::ImageDetections),
) -> Outcome<RunReport> {
    let mut bar = Progress::new("infer", source.items.len() as u64);
    let stop = stop::flag();
    let report = tcross_infer::run(boxes, source, config, options, &mut |news| {
        match news {
            tcross_infer::Progress::Done { images, of, line } => {
                let ms = line.ms.unwrap_or_default();
                bar.at(images as u64, of as u64, &format!("{:.1} ms network, {:.1} ms pose", ms.network, ms.pose.unwrap_or(0.0)));
                show(line);
            }
            tcross_infer::Progress::Skipped { warning } => console::warn(&format!("skipped {warning}")),
        }
        !stop.load(Ordering::Relaxed)
    })?;
    drop(bar);
    if report.stopped {
        return Err(Failure::Interrupted { kept: format!("{} of {} images are done", report.images, source.items.len()) });
    }
    Ok(report)
}

/// Looks at every frame of a video or a camera; `show` gets each line of detections.
pub fn watch(
    boxes: &mut Boxes,
    input: &tcross_infer::video::Input,
    rate: Option<f64>,
    config: &tcross_infer::Config,
    options: &tcross_infer::RunOptions,
    mut show: impl FnMut(&tcross_dataset::ImageDetections),
) -> Outcome<tcross_infer::VideoReport> {
    let mut bar = Progress::new("infer", 0);
    let started = std::time::Instant::now();
    let stop = stop::flag();
    let report = tcross_infer::video::run(boxes, input, rate, config, options, &mut |news| {
        if let tcross_infer::Progress::Done { images, of, line } = news {
            let ms = line.ms.unwrap_or_default();
            let rate = images as f64 / started.elapsed().as_secs_f64().max(1e-9);
            let message = format!("{rate:.1} frames/s, {:.1} ms network, {:.1} ms pose", ms.network, ms.pose.unwrap_or(0.0));
            bar.at(images as u64, of.max(images) as u64, &message);
            show(line);
        }
        !stop.load(Ordering::Relaxed)
    })?;
    drop(bar);
    if let Some(damage) = &report.damage {
        console::warn(&format!("{}: damaged, {} frames could be read: {damage}", input.name(), report.run.images));
    }
    // A camera has no end of its own: stopping it is how it is finished.
    if report.run.stopped && !input.is_live() {
        return Err(Failure::Interrupted { kept: format!("{} frames are done", report.run.images) });
    }
    Ok(report)
}

/// What a training's log and a report say of the machine and the program.
pub fn provenance() -> Vec<(String, String)> {
    let cpu = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let cpu = cpu.lines().find_map(|l| l.strip_prefix("model name")).map(|l| l.trim_start_matches([' ', '\t', ':']));
    [
        ("program", format!("tcross {} ({COMMIT})", env!("CARGO_PKG_VERSION"))),
        ("system", format!("{} {}", std::env::consts::OS, std::env::consts::ARCH)),
        ("cpu", cpu.unwrap_or("unknown").to_owned()),
        ("threads", rayon::current_num_threads().to_string()),
    ]
    .map(|(k, v)| (k.to_owned(), v))
    .to_vec()
}
