//! Markers of a video or a camera from another program, through ffmpeg: `cargo run --release -p tcross-infer --example watch -- RUN INPUT [DIR]`.
//! INPUT: a video, `camera:0`, `/dev/video0` or an address; DIR: where the annotated video and its detections go.
#![allow(clippy::print_stdout)]
use tcross_infer::{Boxes, Config, Detector, RunOptions, video};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let (Some(model), Some(input)) = (args.first(), args.get(1)) else { return Err("usage: watch MODEL VIDEO [DIR]".into()) };
    let input = video::Input::parse(input).ok_or("no video's ending and no camera")?;
    let mut config = Config { pose: true, score: 0.3, ..Config::default() };
    config.smoothing.on = true;
    let mut boxes =
        if model.ends_with(".jsonl") { Boxes::given(model)? } else { Boxes::Detector(Box::new(config.configure(Detector::load(model)?))) };
    let options = match args.get(2).map(std::path::PathBuf::from) {
        Some(dir) => RunOptions { out: Some(dir.join("detections.jsonl")), overlay: Some(dir), ..RunOptions::default() },
        None => RunOptions::default(),
    };
    let report = video::run(&mut boxes, &input, None, &config, &options, &mut |_| true)?;
    println!("{} frames, {} detections, {} poses", report.run.images, report.run.detections, report.run.poses);
    println!("{:.1} frames/s end to end; the input has {:.2}", report.frames_per_second(), report.rate);
    for (stage, median, p95) in report.stages() {
        println!("{stage:8} median {median:8.3} ms, p95 {p95:8.3} ms");
    }
    Ok(())
}
