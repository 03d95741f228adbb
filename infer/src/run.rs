//! Many images in, one JSON line an image out, with poses and overlays where asked for.
use crate::{
    camera::Lens,
    config::Config,
    error::InferError,
    overlay, pose,
    source::{Source, read_image},
    video::Smoother,
};
use image::RgbImage;
use std::{
    collections::BTreeMap,
    fs::File,
    io::{BufWriter, Write},
    path::{Path, PathBuf},
    sync::mpsc::sync_channel,
    time::Instant,
};
use tcross_dataset::{
    Detection, ImageDetections, Pose, PoseOutcome,
    detections::{self, StageTimes},
    files,
};
use tcross_yolo::Detector;

/// What claims the boxes.
pub enum Boxes {
    /// A network.
    Detector(Box<Detector>),
    /// A file of detections, by name of image: poses from given boxes.
    Given {
        /// The file, for messages.
        path: PathBuf,
        /// Lines by image.
        lines: BTreeMap<String, Vec<Detection>>,
    },
}

impl Boxes {
    /// Reads given boxes from a detections file, or from a dataset's list of truths (each marker with score 1).
    ///
    /// # Errors
    /// If the file cannot be read or is neither.
    pub fn given(path: impl Into<PathBuf>) -> Result<Self, InferError> {
        let path = path.into();
        let truths = || -> Result<BTreeMap<String, Vec<Detection>>, tcross_dataset::DatasetError> {
            let records: Vec<tcross_dataset::Record> = files::read_jsonl(&path)?;
            let boxes = |r: &tcross_dataset::Record| {
                r.markers.iter().map(|m| Detection { score: 1.0, class: 0, bounds: m.bounds, pose: None }).collect()
            };
            Ok(records.iter().map(|r| (r.image.clone(), boxes(r))).collect())
        };
        let lines = match detections::read(&path) {
            Ok(rows) => rows.into_iter().map(|row| (row.image, row.detections)).collect(),
            Err(error) => truths().map_err(|_| error)?,
        };
        Ok(Self::Given { path, lines })
    }

    /// Names of the classes; empty where they are not known.
    #[must_use]
    pub fn names(&self) -> &[String] {
        match self {
            Self::Detector(detector) => &detector.model().names,
            Self::Given { .. } => &[],
        }
    }

    fn of(&mut self, name: &str, image: &RgbImage) -> Result<Vec<Detection>, InferError> {
        match self {
            Self::Detector(detector) => Ok(detector.detect(image)),
            Self::Given { path, lines } => lines.get(name).cloned().ok_or_else(|| InferError::NoBoxes {
                boxes: path.clone(),
                image: name.to_owned(),
                lines: lines.len(),
            }),
        }
    }
}

/// Where results go besides the caller.
#[derive(Debug, Clone, Default)]
pub struct RunOptions {
    /// Detections file to write.
    pub out: Option<PathBuf>,
    /// Folder for pictures with the detections drawn on them.
    pub overlay: Option<PathBuf>,
    /// The camera, for poses in space.
    pub camera: Option<Lens>,
    /// Side of the markers, in the unit in which positions are wanted; 1 for sides.
    pub side: Option<f64>,
    /// A picture drawn over each marker with its perspective.
    pub replace: Option<PathBuf>,
    /// Whether a cube is stood on each marker.
    pub cube: bool,
    /// Folder for the pictures of the paper's steps.
    pub steps: Option<PathBuf>,
    /// Names of the classes, written beside the scores of overlays; where there are none, or only one, scores stand alone.
    pub names: Vec<String>,
}

impl RunOptions {
    /// The name to write beside a detection; empty for none.
    #[must_use]
    pub fn name_of(&self, detection: &Detection) -> &str {
        self.names.get(detection.class as usize).filter(|_| self.names.len() > 1).map_or("", String::as_str)
    }
}

/// What happens while images are looked at.
#[derive(Debug)]
pub enum Progress<'a> {
    /// An image is done.
    Done {
        /// Images done or skipped so far.
        images: usize,
        /// All images.
        of: usize,
        /// What was found.
        line: &'a ImageDetections,
    },
    /// An image could not be read and is left out.
    Skipped {
        /// Why, with its name.
        warning: &'a str,
    },
}

/// Counts of a finished run.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct RunReport {
    /// Images looked at.
    pub images: usize,
    /// Images left out as unreadable.
    pub skipped: usize,
    /// Detections kept.
    pub detections: usize,
    /// Poses recovered.
    pub poses: usize,
    /// Poses refused.
    pub refused: usize,
    /// True where the caller stopped early; what was done is kept.
    pub stopped: bool,
}

impl RunReport {
    /// Counts what one picture showed; where `filter` is on, refused detections are dropped before detections are counted.
    pub(crate) fn count(&mut self, found: &mut Vec<Detection>, filter: bool) {
        for outcome in found.iter().filter_map(|d| d.pose.as_ref()) {
            match outcome {
                PoseOutcome::Found(_) => self.poses += 1,
                PoseOutcome::Refused { .. } => self.refused += 1,
            }
        }
        if filter {
            found.retain(|d| !matches!(d.pose, Some(PoseOutcome::Refused { .. })));
        }
        self.images += 1;
        self.detections += found.len();
    }
}

/// Looks at every image of `source` in order; `progress` returns false to stop after the current image. The next image is
/// read while the current one is looked at.
///
/// # Errors
/// If an output cannot be written, a given box file lacks an image, or no image could be read at all.
pub fn run(
    boxes: &mut Boxes,
    source: &Source,
    config: &Config,
    options: &RunOptions,
    progress: &mut dyn FnMut(Progress) -> bool,
) -> Result<RunReport, InferError> {
    config.validate()?;
    let mut sink = options.out.as_deref().map(Sink::create).transpose()?;
    let replacement = options.replace.as_ref().map(|p| read_image(p)).transpose()?;
    if let Some(dir) = &options.overlay {
        files::create_dir(dir)?;
    }
    let mut report = RunReport::default();
    let mut first_warning = None;
    let total = source.items.len();
    std::thread::scope(|scope| -> Result<(), InferError> {
        let (sender, images) = sync_channel(2);
        scope.spawn(move || {
            for item in &source.items {
                let start = Instant::now();
                let image = read_image(&item.path);
                if sender.send((item, image, ms_since(start))).is_err() {
                    break; // the other end has stopped
                }
            }
        });
        for (item, image, decode) in images {
            let image = match image {
                Ok(image) => image,
                Err(error) => {
                    report.skipped += 1;
                    let warning = error.to_string();
                    let on = progress(Progress::Skipped { warning: &warning });
                    first_warning.get_or_insert(warning);
                    if !on {
                        report.stopped = true;
                        break;
                    }
                    continue;
                }
            };
            let mut looked = look(boxes, &item.name, &image, config, options, None)?;
            if let Some(dir) = &options.steps {
                write_steps(dir, &item.name, &image, &looked.found, config)?;
            }
            report.count(&mut looked.found, config.pose_filter);
            let line = ImageDetections {
                image: item.name.clone(),
                width: image.width(),
                height: image.height(),
                detections: looked.found,
                ms: Some(StageTimes { decode, network: looked.network_ms, pose: looked.pose_ms }),
            };
            if let Some(sink) = &mut sink {
                sink.write(&line)?;
            }
            if let Some(dir) = &options.overlay {
                let path = dir.join(overlay_name(&item.name));
                let picture = overlay::draw(&image, &line.detections, config, options, replacement.as_ref());
                save(&picture, &path)?;
            }
            if !progress(Progress::Done { images: report.images + report.skipped, of: total, line: &line }) {
                report.stopped = true;
                break;
            }
        }
        Ok(())
    })?;
    if let Some(sink) = sink {
        sink.finish()?;
    }
    match first_warning {
        Some(first) if report.images == 0 && !report.stopped => Err(InferError::NoneReadable { count: total, first }),
        _ => Ok(report),
    }
}

/// What one picture showed.
pub(crate) struct Looked {
    pub(crate) found: Vec<Detection>,
    pub(crate) network_ms: f64,
    pub(crate) pose_ms: Option<f64>,
}

/// Detections of one picture with their poses; `smoother` is told at which second it was taken.
pub(crate) fn look(
    boxes: &mut Boxes,
    name: &str,
    image: &RgbImage,
    config: &Config,
    options: &RunOptions,
    smoother: Option<(&mut Smoother, f64)>,
) -> Result<Looked, InferError> {
    let start = Instant::now();
    let mut found = boxes.of(name, image)?;
    let network_ms = ms_since(start);
    if !config.pose {
        return Ok(Looked { found, network_ms, pose_ms: None });
    }
    let start = Instant::now();
    for detection in &mut found {
        detection.pose = Some(pose::recover(image, &detection.bounds, &config.recovery));
    }
    if let Some((smoother, secs)) = smoother {
        smoother.smooth(secs, poses(&mut found));
    }
    if let Some(lens) = options.camera {
        let camera = lens.camera(image.width(), image.height());
        poses(&mut found).for_each(|pose| camera.locate(pose, options.side.unwrap_or(1.0)));
    }
    Ok(Looked { found, network_ms, pose_ms: Some(ms_since(start)) })
}

fn poses(found: &mut [Detection]) -> impl Iterator<Item = &mut Pose> {
    found.iter_mut().filter_map(|d| if let Some(PoseOutcome::Found(pose)) = &mut d.pose { Some(&mut **pose) } else { None })
}

/// Writes the pictures of the paper's steps, a folder for each detection: `DIR/NAME-0/1-crop.png`, where NAME has its ending.
fn write_steps(dir: &Path, name: &str, image: &RgbImage, found: &[Detection], config: &Config) -> Result<(), InferError> {
    for (index, detection) in found.iter().enumerate() {
        let folder = dir.join(format!("{}-{index}", flat(name)));
        files::create_dir(&folder)?;
        let mut result = Ok(());
        let mut write = |name: &'static str, picture: RgbImage| {
            let path = folder.join(name).with_extension("png");
            let broken = |e: image::ImageError| InferError::Picture { path: path.clone(), message: e.to_string() };
            if let (Ok(()), Err(error)) = (&result, picture.save(&path).map_err(broken)) {
                result = Err(error);
            }
        };
        // A refusal ends the pictures at the step that failed.
        let _ = pose::paper::recover(image, &detection.bounds, &config.recovery, Some(&mut write));
        result?;
    }
    Ok(())
}

pub(crate) fn ms_since(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}

/// An image's name without folders: `test/00009.jpg` becomes `test-00009.jpg`.
fn flat(name: &str) -> String {
    name.trim_start_matches(['/', '.']).replace(['/', ':'], "-")
}

/// Overlays are JPEG files in one folder; those of other kinds keep their own ending before it, so that `a.png` does not overwrite `a.jpg`.
fn overlay_name(name: &str) -> String {
    let flat = flat(name);
    if flat.to_ascii_lowercase().ends_with(".jpg") { flat } else { flat + ".jpg" }
}

fn save(picture: &RgbImage, path: &Path) -> Result<(), InferError> {
    let file = File::create(path).map_err(|e| InferError::io(path, e))?;
    let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(BufWriter::new(file), 92);
    picture.write_with_encoder(encoder).map_err(|e| InferError::Picture { path: path.to_owned(), message: e.to_string() })
}

/// A detections file written line by line under a temporary name.
pub(crate) struct Sink {
    partial: PathBuf,
    path: PathBuf,
    file: BufWriter<File>,
}

impl Sink {
    pub(crate) fn create(path: &Path) -> Result<Self, InferError> {
        let mut name = path.file_name().unwrap_or_default().to_owned();
        name.push(".partial");
        let partial = path.with_file_name(name);
        if let Some(parent) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
            files::create_dir(parent)?;
        }
        let file = File::create(&partial).map_err(|e| InferError::io(&partial, e))?;
        Ok(Self { partial, path: path.to_owned(), file: BufWriter::new(file) })
    }

    pub(crate) fn write(&mut self, line: &ImageDetections) -> Result<(), InferError> {
        let io = |e: std::io::Error| InferError::io(&self.partial, e);
        serde_json::to_writer(&mut self.file, line).map_err(|e| io(e.into()))?;
        self.file.write_all(b"\n").map_err(io)
    }

    pub(crate) fn finish(mut self) -> Result<(), InferError> {
        self.file.flush().map_err(|e| InferError::io(&self.partial, e))?;
        std::fs::rename(&self.partial, &self.path).map_err(|e| InferError::io(&self.path, e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overlays_keep_apart() {
        let names = ["a.jpg", "a.png", "a.JPG", "test/a.jpg", "../b/a.jpeg", "a.v2.webp"].map(overlay_name);
        assert_eq!(names, ["a.jpg", "a.png.jpg", "a.JPG", "test-a.jpg", "b-a.jpeg.jpg", "a.v2.webp.jpg"]);
    }
}
