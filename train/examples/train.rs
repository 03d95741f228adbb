//! Trains on a dataset for some minutes, with the default recipe: `cargo run --release -p tcross-train --example train DATA OUT MINUTES`.
use std::sync::atomic::AtomicBool;
use tcross_dataset::Dataset;
use tcross_train::{Config, Progress, RunOptions, fit};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, data, out, minutes, settings @ ..] = arguments.as_slice() else {
        return Err("expected: DATA OUT MINUTES [SETTING = VALUE]...".into());
    };
    let mut config: Config = toml::from_str(&settings.join("\n"))?;
    config.max_minutes = Some(minutes.parse()?);
    let stop = AtomicBool::new(false);
    let (mut waited, mut next) = (0.0, 10.0);
    let summary = fit(&config, &Default::default(), &Dataset::open(data)?, &RunOptions::new(out, 0, &stop), &mut |news| match news {
        Progress::Opened { train, val, anchor_iou, parameters, memory, .. } => {
            eprintln!("{train} images, {val} to validate; anchors cover {anchor_iou:.3?}; {parameters} parameters; memory {memory}");
        }
        Progress::Step(s) => {
            waited += s.waiting / s.images_per_second * config.batch as f64;
            if s.seconds > next {
                next = s.seconds + 10.0;
                let share = 100.0 * waited / s.seconds;
                eprintln!(
                    "{:6.1} s  step {}  {:.1} images/s, {share:.1} % waiting  loss {:.3}",
                    s.seconds,
                    s.step,
                    s.images_per_second,
                    s.loss.total()
                );
            }
        }
        Progress::Validating { images } => eprintln!("validating on {images} images"),
        Progress::Epoch { row, best } => eprintln!("epoch {:.2}{}: {:?}", row.epoch, if best { " (best)" } else { "" }, row.columns()),
        Progress::SecondStage { words, .. } => eprintln!("second stage: {words}"),
        Progress::Claims { .. } | Progress::Refined(_) => {}
        Progress::Warning(message) => eprintln!("warning: {message}"),
    })?;
    eprintln!("{:?} after {} steps; best {:?}", summary.end, summary.steps, summary.best);
    Ok(())
}
