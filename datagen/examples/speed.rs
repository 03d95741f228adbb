//! Makes images of a preset and prints images a second: `speed CONFIG|paper|hand OUT N [THREADS] [PHOTOS]`.
#![allow(clippy::print_stdout)]
use std::{env, fs, sync::atomic::AtomicBool, time::Instant};
use tcross_datagen::{Backgrounds, Config, GenerateOptions, Style, generate};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = env::args().skip(1).collect();
    let word = |k: usize| words.get(k).map_or("", String::as_str);
    let config = match word(0) {
        "hand" => Config::default(),
        "paper" => Config { style: Style::Paper, ..Default::default() },
        path => {
            let mut table: toml::Table = toml::from_str(&fs::read_to_string(path)?)?;
            table.remove("data").ok_or("no [data]")?.try_into()?
        }
    };
    let backgrounds = if words.len() > 4 { Backgrounds::open(word(4))? } else { Backgrounds::embedded() };
    let options =
        GenerateOptions { out: word(1).into(), images: Some(word(2).parse()?), threads: word(3).parse().ok(), ..Default::default() };
    let start = Instant::now();
    let made = generate(&config, &backgrounds, &options, &AtomicBool::new(false), &mut |_| {})?;
    let seconds = start.elapsed().as_secs_f64();
    let images: u64 = made.manifest.counts.values().sum();
    println!("{images} images, {} markers, {seconds:.2} s, {:.1} images/s", made.manifest.markers, images as f64 / seconds);
    Ok(())
}
