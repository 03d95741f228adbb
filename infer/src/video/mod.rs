//! Videos and cameras: frames through ffmpeg, detections and poses frame by frame, one JSON line a frame, and an annotated video.
//!
//! Decoding, looking and drawing run side by side; a frame's latency counts from the moment it was read to its result. A file is looked at
//! whole, frame by frame; of a camera the newest frame is taken, and frames that come too fast are dropped and counted.
pub mod ffmpeg;
pub mod smooth;
pub mod times;

pub use ffmpeg::Input;
pub use smooth::Smoother;
pub use times::Times;

use crate::{
    config::Config,
    error::InferError,
    overlay,
    run::{Boxes, Progress, RunOptions, RunReport, Sink, look, ms_since},
    source::read_image,
};
use image::RgbImage;
use std::{
    path::{Path, PathBuf},
    sync::{
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{Receiver, SyncSender, TrySendError, sync_channel},
    },
    time::Instant,
};
use tcross_dataset::{Detection, ImageDetections, detections::StageTimes, files};

/// What a finished video says.
#[derive(Debug, Clone, Default)]
pub struct VideoReport {
    /// Counts, with frames as images.
    pub run: RunReport,
    /// Frames a second of the input.
    pub rate: f64,
    /// From the first frame's arrival to the last result.
    pub seconds: f64,
    /// Frames of a camera that nobody had time for.
    pub dropped: u64,
    /// Reading and decoding a frame (of a camera mostly waiting for it).
    pub decode: Times,
    /// Letterbox, network, boxes.
    pub network: Times,
    /// All poses of a frame, smoothing included.
    pub pose: Times,
    /// From a frame's arrival to its result.
    pub latency: Times,
    /// Drawing and encoding a frame.
    pub draw: Times,
    /// What is wrong with the input, of which some frames could be read all the same.
    pub damage: Option<String>,
}

impl VideoReport {
    /// End to end: decoding, looking and, where asked for, drawing and encoding.
    #[must_use]
    pub fn frames_per_second(&self) -> f64 {
        self.run.images as f64 / self.seconds.max(1e-9)
    }

    /// Median and 95th percentile of each stage that ran, in milliseconds.
    #[must_use]
    pub fn stages(&self) -> Vec<(&'static str, f64, f64)> {
        let all =
            [("decode", &self.decode), ("network", &self.network), ("pose", &self.pose), ("latency", &self.latency), ("draw", &self.draw)];
        all.into_iter().filter_map(|(name, t)| Some((name, t.quantile(0.5)?, t.quantile(0.95)?))).collect()
    }
}

/// A frame on its way.
struct Frame {
    index: u64,
    image: RgbImage,
    decode_ms: f64,
    arrived: Instant,
}

/// Looks at every frame of an input; `rate` asks for another number of frames a second than its own. With `options.overlay` the
/// annotated video is written there, as `NAME.mp4`. `progress` returns false to stop; what was done is kept.
///
/// # Errors
/// If ffmpeg is absent or cannot read the input, an output cannot be written, or a given box file lacks a frame.
pub fn run(
    boxes: &mut Boxes,
    input: &Input,
    rate: Option<f64>,
    config: &Config,
    options: &RunOptions,
    progress: &mut dyn FnMut(Progress) -> bool,
) -> Result<VideoReport, InferError> {
    config.validate()?;
    if rate.is_some_and(|r| !(r > 0.0 && r <= 1000.0)) {
        let found = rate.unwrap_or_default().to_string();
        return Err(InferError::Value { key: "fps", found, allowed: "frames a second, above 0 and up to 1000" });
    }
    let (own_rate, frames) = ffmpeg::probe(input)?;
    let of = if rate.is_none() { frames.unwrap_or(0) as usize } else { 0 };
    let mut reader = ffmpeg::Reader::open(input, rate)?;
    let rate = rate.unwrap_or(own_rate);
    let mut sink = options.out.as_deref().map(Sink::create).transpose()?;
    let replacement = options.replace.as_ref().map(|p| read_image(p)).transpose()?;
    let path = options.overlay.as_ref().map(|dir| annotated(dir, input));
    if let Some(dir) = &options.overlay {
        files::create_dir(dir)?;
    }
    let mut smoother = config.smoothing.on.then(|| Smoother::new(config.smoothing));
    let mut report = VideoReport { rate, ..VideoReport::default() };
    let (dropped, stop) = (AtomicU64::new(0), AtomicBool::new(false));
    let name = input.name();
    std::thread::scope(|scope| -> Result<(), InferError> {
        let (frames_in, frames_out) = sync_channel::<Frame>(2);
        let (used_in, used_out) = sync_channel::<RgbImage>(4);
        let (live, dropped, stop) = (input.is_live(), &dropped, &stop);
        let decoding = scope.spawn(move || decode(&mut reader, live, &frames_in, &used_out, dropped, stop));
        let drawing = path.as_ref().map(|path| {
            let (sender, receiver) = sync_channel::<(RgbImage, Vec<Detection>)>(2);
            let (used, replacement) = (used_in.clone(), replacement.as_ref());
            (sender, scope.spawn(move || draw(path, rate, receiver, &used, config, options, replacement)))
        });
        let mut began = None;
        let looking = || -> Result<(), InferError> {
            for frame in frames_out {
                let began = *began.get_or_insert(frame.arrived);
                let secs = if live { frame.arrived.duration_since(began).as_secs_f64() } else { frame.index as f64 / rate };
                let image = format!("{name}#{:06}", frame.index);
                let mut looked = look(boxes, &image, &frame.image, config, options, smoother.as_mut().map(|s| (s, secs)))?;
                report.run.count(&mut looked.found, config.pose_filter);
                report.decode.add(frame.decode_ms);
                report.network.add(looked.network_ms);
                looked.pose_ms.iter().for_each(|ms| report.pose.add(*ms));
                report.latency.add(ms_since(frame.arrived));
                report.seconds = began.elapsed().as_secs_f64();
                let line = ImageDetections {
                    image,
                    width: frame.image.width(),
                    height: frame.image.height(),
                    detections: looked.found,
                    ms: Some(StageTimes { decode: frame.decode_ms, network: looked.network_ms, pose: looked.pose_ms }),
                };
                if let Some(sink) = &mut sink {
                    sink.write(&line)?;
                }
                let on = progress(Progress::Done { images: report.run.images, of, line: &line });
                match &drawing {
                    // A closed channel: the drawing has failed and says why below.
                    Some((sender, _)) => {
                        if sender.send((frame.image, line.detections)).is_err() {
                            break;
                        }
                    }
                    None => drop(used_in.try_send(frame.image)),
                }
                if !on {
                    report.run.stopped = true;
                    break;
                }
            }
            Ok(())
        };
        let looked = looking();
        stop.store(true, Ordering::Relaxed);
        let drawn = drawing.map(|(sender, thread)| {
            drop(sender);
            thread.join()
        });
        let decoded = decoding.join();
        looked?;
        let panicked = |what: &str| InferError::Video(format!("{what} broke down"));
        if !report.run.stopped {
            report.damage = decoded.map_err(|_| panicked("decoding"))??;
        }
        if let Some(drawn) = drawn {
            report.draw = drawn.map_err(|_| panicked("drawing"))??;
            report.seconds = began.map_or(0.0, |b| b.elapsed().as_secs_f64());
        }
        Ok(())
    })?;
    report.dropped = dropped.into_inner();
    if let Some(sink) = sink {
        sink.finish()?;
    }
    Ok(report)
}

/// Where the annotated video goes: what stands after other dots of the name is part of it.
fn annotated(dir: &Path, input: &Input) -> PathBuf {
    dir.join(format!("{}.mp4", input.stem()))
}

/// Hands frames over until there are no more or nobody wants them; tells what the input suffers from.
fn decode(
    reader: &mut ffmpeg::Reader,
    live: bool,
    frames: &SyncSender<Frame>,
    used: &Receiver<RgbImage>,
    dropped: &AtomicU64,
    stop: &AtomicBool,
) -> Result<Option<String>, InferError> {
    let mut spare = None;
    for index in 0.. {
        let start = Instant::now();
        let Some(image) = reader.next(spare.take().or_else(|| used.try_recv().ok()))? else { break };
        let frame = Frame { index, image, decode_ms: ms_since(start), arrived: Instant::now() };
        if stop.load(Ordering::Relaxed) {
            break;
        }
        if live {
            match frames.try_send(frame) {
                Ok(()) => {}
                Err(TrySendError::Full(frame)) => {
                    dropped.fetch_add(1, Ordering::Relaxed);
                    spare = Some(frame.image);
                }
                Err(TrySendError::Disconnected(_)) => break,
            }
        } else if frames.send(frame).is_err() {
            break;
        }
    }
    Ok(reader.damage().map(str::to_owned))
}

/// Draws and encodes until the last frame; the first frame gives the video's size.
fn draw(
    path: &Path,
    rate: f64,
    frames: Receiver<(RgbImage, Vec<Detection>)>,
    used: &SyncSender<RgbImage>,
    config: &Config,
    options: &RunOptions,
    replacement: Option<&RgbImage>,
) -> Result<Times, InferError> {
    let mut writer: Option<ffmpeg::Writer> = None;
    let mut times = Times::default();
    for (image, found) in frames {
        let start = Instant::now();
        let picture = overlay::draw(&image, &found, config, options, replacement);
        let writer = match &mut writer {
            Some(writer) => writer,
            none => none.insert(ffmpeg::Writer::create(path, picture.dimensions(), rate)?),
        };
        writer.write(&picture)?;
        times.add(ms_since(start));
        drop(used.try_send(image));
    }
    writer.map_or(Ok(()), ffmpeg::Writer::finish)?;
    Ok(times)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_videos_name_is_kept() {
        let named = |input: &str| annotated(Path::new("out"), &Input::parse(input).unwrap());
        assert_eq!(named("clips/clip.v2.mp4"), Path::new("out/clip.v2.mp4"));
        assert_eq!(named("clip.mov"), Path::new("out/clip.mp4"));
        assert_eq!(named("camera:0"), Path::new("out/camera-0.mp4"));
    }
}
