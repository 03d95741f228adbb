//! Detection and pose from another program: `cargo run --release -p tcross-infer --example five_lines -- RUN photo.jpg`.
#![allow(clippy::print_stdout)]
use tcross_infer::{Detector, pose, read_image};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let [model, photo] = std::env::args().skip(1).collect::<Vec<_>>().try_into().map_err(|_| "usage: five_lines MODEL IMAGE")?;
    let image = read_image(photo.as_ref())?;
    for found in Detector::load(model)?.detect(&image) {
        println!("{:.2} {:?} {:?}", found.score, found.bounds, pose::recover(&image, &found.bounds, &pose::Config::default()));
    }
    Ok(())
}
