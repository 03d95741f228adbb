//! `tcross infer MODEL INPUT...`
use super::{ConfigArgs, Part, example, must_exist, refuse};
use crate::{
    console,
    exit::{Failure, Outcome},
    work,
};
use std::path::PathBuf;
use tcross_dataset::ImageDetections;
use tcross_infer::{Boxes, Detector, Lens, RunOptions, Source, VideoReport, video};

const EXAMPLE: &str = "infer runs/quickstart/run photos/ --out detections.jsonl --overlay overlays --pose";

/// Detects markers, and with --pose recovers their poses
#[derive(clap::Args)]
#[command(after_help = example(EXAMPLE))]
pub struct Args {
    /// MODEL: a run's folder, a .safetensors file with its model.toml, or a Darknet .cfg with its .weights beside it (left
    /// out with --boxes). INPUT: images, folders, a dataset, a video, or a camera (camera:0, /dev/video0, rtsp://...)
    #[arg(required_unless_present = "print_config", value_name = "MODEL INPUT", num_args = 1..)]
    model_and_inputs: Vec<PathBuf>,
    /// Detections file to write; without it they go to stdout
    #[arg(long, value_name = "F.jsonl")]
    out: Option<PathBuf>,
    /// Folder for pictures, or an annotated video, with the detections drawn on them
    #[arg(long, value_name = "DIR")]
    overlay: Option<PathBuf>,
    /// Which part of a dataset: train, val, test or all [default: test]
    #[arg(long)]
    split: Option<Part>,
    /// Keeps detections of at least this score, 0 to 1
    #[arg(long, value_name = "S")]
    score: Option<f64>,
    /// Of two detections that overlap by more than this IoU, the weaker goes
    #[arg(long, value_name = "T")]
    nms: Option<f64>,
    /// Recovers centre, corners, angle and homography of each marker
    #[arg(long)]
    pose: bool,
    /// The camera in pixels, or its horizontal field of view in degrees; poses then hold rotation and translation
    #[arg(long, value_name = "fx,fy,cx,cy[,k1,k2]", value_parser = |s: &str| s.parse::<Lens>())]
    camera: Option<Lens>,
    /// Side of the markers, in the unit in which positions are wanted
    #[arg(long, value_name = "L", requires = "camera")]
    side: Option<f64>,
    /// Takes boxes from a detections file, or from a dataset's list, in place of a MODEL
    #[arg(long, value_name = "F.jsonl")]
    boxes: Option<PathBuf>,
    /// A picture to lay over each marker, with its perspective
    #[arg(long, value_name = "PICTURE", requires = "overlay")]
    replace: Option<PathBuf>,
    /// Stands a cube on each marker
    #[arg(long, requires = "overlay")]
    cube: bool,
    /// Folder for pictures of the steps of the paper's method
    #[arg(long, value_name = "DIR")]
    steps: Option<PathBuf>,
    /// Smooths the poses of a video or a camera over time
    #[arg(long)]
    smooth: bool,
    /// Looks at this many frames of a video a second, or asks a camera for them
    #[arg(long, value_name = "R")]
    fps: Option<f64>,
    /// A config with an [infer] section
    #[arg(long)]
    config: Option<PathBuf>,
    #[command(flatten)]
    config_args: ConfigArgs,
}

pub fn run(args: Args) -> Outcome {
    let config = args.config_args.load(args.config.as_deref(), |c| {
        c.infer.score = args.score.unwrap_or(c.infer.score);
        c.infer.nms = args.nms.unwrap_or(c.infer.nms);
        // Given boxes are of use for poses only.
        c.infer.pose |= args.pose || args.boxes.is_some() || args.camera.is_some() || args.replace.is_some() || args.cube;
        c.infer.pose |= args.smooth;
        c.infer.smoothing.on |= args.smooth;
    })?;
    let Some(config) = config else { return Ok(()) };
    let (mut boxes, inputs) = match (&args.boxes, args.model_and_inputs.as_slice()) {
        (Some(file), inputs) => (Boxes::given(file)?, inputs),
        (None, [model, inputs @ ..]) if !inputs.is_empty() => {
            must_exist(model, "model")?;
            (Boxes::Detector(Box::new(config.infer.configure(Detector::load(model)?))), inputs)
        }
        _ => return Err(Failure::usage(format!("INPUT is missing: images, folders or a dataset; type for instance: tcross {EXAMPLE}"))),
    };
    let videos: Vec<video::Input> = inputs.iter().filter_map(|i| video::Input::parse(&i.to_string_lossy())).collect();
    for input in inputs.iter().filter(|i| video::Input::parse(&i.to_string_lossy()).is_none_or(|v| v.is_file())) {
        must_exist(input, "input")?;
    }
    let options = RunOptions {
        out: args.out.clone(),
        overlay: args.overlay,
        camera: args.camera,
        side: args.side,
        replace: args.replace,
        cube: args.cube,
        steps: args.steps,
        names: boxes.names().to_vec(),
    };
    let to_stdout = args.out.is_none();
    let show = |line: &ImageDetections| {
        if to_stdout && let Ok(text) = serde_json::to_string(line) {
            console::result(&text);
        }
    };
    let report = match videos.as_slice() {
        [] => {
            refuse([("--fps", args.fps.is_some()), ("--smooth", args.smooth)], "INPUT is neither a video nor a camera")?;
            let source = match args.split {
                Some(Part::All) => work::all_splits(inputs)?,
                Some(Part::One(split)) => Source::open(inputs, Some(split))?,
                None => Source::open(inputs, None)?,
            };
            work::infer(&mut boxes, &source, &config.infer, &options, show)?
        }
        [input] if inputs.len() == 1 => {
            refuse([("--split", args.split.is_some())], "INPUT is a video or a camera, not a dataset")?;
            let report = work::watch(&mut boxes, input, args.fps, &config.infer, &options, show)?;
            console::note(&video_summary(&report));
            report.run
        }
        _ => return Err(Failure::usage("one video or camera at a time, and no images beside it")),
    };
    let poses = if config.infer.pose { format!(", {} poses, {} refused", report.poses, report.refused) } else { String::new() };
    console::note(&format!("{} images, {} detections{poses}", report.images, report.detections));
    Ok(())
}

/// `61.2 frames/s end to end; ms median (p95): decode 3.1 (4.0), network ...`.
fn video_summary(report: &VideoReport) -> String {
    let stages: Vec<String> = report.stages().iter().map(|(name, median, p95)| format!("{name} {median:.2} ({p95:.2})")).collect();
    let dropped = if report.dropped > 0 { format!("; {} frames came too fast and were dropped", report.dropped) } else { String::new() };
    let rate = report.frames_per_second();
    format!("{rate:.1} frames/s end to end (the input has {:.2}); ms, median (p95): {}{dropped}", report.rate, stages.join(", "))
}
