//! Trains a second stage for the detector of a finished run, and says what it brings on validation images:
//! `cargo run --release -p tcross-train --example second_stage -- RUN DATA PASSES [key=value ...]`, keys such as `batch=64`, `optimizer.rate=1e-3`.
use std::{error::Error, sync::atomic::AtomicBool, time::Instant};
use tcross_dataset::Dataset;
use tcross_train::{Config, Progress, Refine, RunOptions, refine};

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let (Some(run), Some(data), Some(passes)) = (args.next(), args.next(), args.next()) else {
        return Err("usage: second_stage RUN DATA PASSES [key=value ...]".into());
    };
    let settings: String = args.map(|arg| arg + "\n").collect();
    let refine_config = Refine { epochs: passes.parse()?, ..toml::from_str(&settings)? };
    let config = Config { refine: refine_config, ..Config::default() };
    let stop = AtomicBool::new(false);
    let (started, mut said) = (Instant::now(), Instant::now());
    refine(&config, &Dataset::open(data)?, &RunOptions::new(run, 0, &stop), &mut |news| match news {
        Progress::Refined(s) if said.elapsed().as_secs() >= 15 => {
            said = Instant::now();
            let (t, seconds) = (s.loss, started.elapsed().as_secs_f64());
            eprintln!(
                "{seconds:.0} s, pass {:.1}: score {:.3} box {:.3} frame {:.3}, {:.0} claims/s",
                s.epoch, t.objectness, t.center, t.size, s.images_per_second
            );
        }
        Progress::SecondStage { words, .. } => eprintln!("{:.0} s: {words}", started.elapsed().as_secs_f64()),
        Progress::Warning(text) => eprintln!("{text}"),
        _ => {}
    })?;
    Ok(())
}
