//! The external program `ffmpeg`: raw frames out of a file, a stream or a camera, and raw frames into an encoded file, each over a pipe.
use crate::error::InferError;
use image::RgbImage;
use std::{
    ffi::OsStr,
    io::{BufReader, ErrorKind, Read, Write},
    path::{Path, PathBuf},
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
    thread::JoinHandle,
};

/// Frames a second where nothing tells another rate.
pub const DEFAULT_RATE: f64 = 30.0;

/// Where frames come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Input {
    /// A file, or the address of a stream.
    File(PathBuf),
    /// A camera, by its number or name: whatever the system's own capture interface calls it.
    Camera(String),
}

/// Endings of the files that count as videos.
const ENDINGS: [&str; 10] = ["mp4", "mov", "mkv", "webm", "avi", "m4v", "mpg", "mpeg", "ts", "gif"];

impl Input {
    /// `camera:0`, `/dev/video0`, `rtsp://...` or a file whose ending is a video's; `None` for anything else.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        if let Some(name) = text.strip_prefix("camera:") {
            return Some(Self::Camera(name.to_owned()));
        }
        if text.starts_with("/dev/video") {
            return Some(Self::Camera(text.to_owned()));
        }
        let ending = Path::new(text).extension().and_then(OsStr::to_str).map(str::to_ascii_lowercase);
        (text.contains("://") || ending.is_some_and(|e| ENDINGS.contains(&e.as_str()))).then(|| Self::File(text.into()))
    }

    /// True where frames come in their own time, whether they are looked at or not.
    #[must_use]
    pub fn is_live(&self) -> bool {
        match self {
            Self::Camera(_) => true,
            Self::File(path) => path.to_string_lossy().starts_with("rtsp://"),
        }
    }

    /// True for a path that must exist.
    #[must_use]
    pub fn is_file(&self) -> bool {
        matches!(self, Self::File(path) if !path.to_string_lossy().contains("://"))
    }

    /// What stands in the detections file before `#` and the frame's number.
    #[must_use]
    pub fn name(&self) -> String {
        match self {
            Self::Camera(name) => format!("camera:{name}"),
            Self::File(path) => path.to_string_lossy().replace('\\', "/"),
        }
    }

    /// A name for files made from it.
    #[must_use]
    pub fn stem(&self) -> String {
        match self {
            Self::Camera(name) => format!("camera-{}", name.trim_start_matches("/dev/").replace(['/', ':', ' '], "-")),
            Self::File(path) => path.file_stem().map_or_else(|| "video".into(), |s| s.to_string_lossy().into_owned()),
        }
    }

    /// Arguments that open it, up to and with `-i`.
    fn arguments(&self, rate: Option<f64>) -> Vec<String> {
        let mut arguments = Vec::new();
        match self {
            Self::File(path) => arguments.extend(["-i".into(), path.to_string_lossy().into_owned()]),
            Self::Camera(name) => {
                let (interface, device) = if cfg!(target_os = "macos") {
                    ("avfoundation", name.clone())
                } else if cfg!(windows) {
                    ("dshow", format!("video={name}"))
                } else {
                    ("v4l2", if name.parse::<u32>().is_ok() { format!("/dev/video{name}") } else { name.clone() })
                };
                arguments.extend(["-f".into(), interface.into()]);
                if let Some(rate) = rate {
                    arguments.extend(["-framerate".into(), rate.to_string()]);
                }
                arguments.extend(["-i".into(), device]);
            }
        }
        arguments
    }
}

fn start(program: &str, command: &mut Command) -> Result<Child, InferError> {
    // Ctrl-C is ours: a child that stopped by itself would leave a broken file.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(command, 0);
    command.spawn().map_err(|e| {
        InferError::Video(match e.kind() {
            ErrorKind::NotFound => {
                format!("{program}: no such program; videos and cameras need ffmpeg: install it (ffmpeg.org), or give images instead")
            }
            _ => format!("{program}: {e}"),
        })
    })
}

/// Frames a second of an input and, where it is known, how many there are. An input that does not say counts as 30 a second.
///
/// # Errors
/// If `ffprobe`, which comes with ffmpeg, is absent.
pub fn probe(input: &Input) -> Result<(f64, Option<u64>), InferError> {
    let Input::File(path) = input else { return Ok((DEFAULT_RATE, None)) };
    let mut command = Command::new("ffprobe");
    command
        .args(["-v", "error", "-select_streams", "v:0", "-show_entries", "stream=r_frame_rate,avg_frame_rate,nb_frames", "-of", "json"])
        .arg(path)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let output = start("ffprobe", &mut command)?.wait_with_output().map_err(|e| InferError::Video(format!("ffprobe: {e}")))?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        return Err(InferError::Video(last_line(&said).unwrap_or("ffprobe failed").to_owned()));
    }
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
    let stream = &json["streams"][0];
    if stream.is_null() {
        return Err(InferError::Video(format!("{}: no picture in it", path.display())));
    }
    let rate = ["avg_frame_rate", "r_frame_rate"].iter().filter_map(|key| ratio(stream[*key].as_str()?)).next();
    let frames = stream["nb_frames"].as_str().and_then(|n| n.parse().ok());
    Ok((rate.unwrap_or(DEFAULT_RATE), frames))
}

/// `30000/1001` as a number; `None` where it is none above 0 and up to 1000.
fn ratio(text: &str) -> Option<f64> {
    let (a, b) = text.split_once('/')?;
    let value = a.parse::<f64>().ok()? / b.parse::<f64>().ok()?;
    (value > 0.0 && value <= 1000.0).then_some(value)
}

fn last_line(text: &str) -> Option<&str> {
    text.lines().map(str::trim).rfind(|l| !l.is_empty())
}

/// Decodes an input: an iterator over its frames, at a constant rate.
pub struct Reader {
    child: Child,
    frames: BufReader<ChildStdout>,
    said: Option<JoinHandle<String>>,
    name: String,
    given: u64,
    ended: bool,
}

impl Reader {
    /// Starts decoding. `rate` asks a file for that many frames a second, and a camera for that mode.
    ///
    /// # Errors
    /// If ffmpeg is absent.
    pub fn open(input: &Input, rate: Option<f64>) -> Result<Self, InferError> {
        let mut command = Command::new("ffmpeg");
        command.args(["-hide_banner", "-nostdin", "-loglevel", "error"]).args(input.arguments(rate)).arg("-an");
        if let (Input::File(_), Some(rate)) = (input, rate) {
            command.args(["-r", &rate.to_string()]);
        }
        // A PPM's header says how large each frame is, after the file's own rotation.
        command.args(["-f", "image2pipe", "-c:v", "ppm", "-pix_fmt", "rgb24", "-"]);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = start("ffmpeg", &mut command)?;
        let missing = || InferError::Video("ffmpeg: no pipe".into());
        let frames = BufReader::with_capacity(1 << 20, child.stdout.take().ok_or_else(missing)?);
        let mut errors = child.stderr.take().ok_or_else(missing)?;
        let said = std::thread::spawn(move || {
            let mut text = String::new();
            let _ = errors.read_to_string(&mut text);
            text
        });
        Ok(Self { child, frames, said: Some(said), name: input.name(), given: 0, ended: false })
    }

    /// The next frame in the buffer of `used`, which is re-used where the size is the same; `None` after the last.
    ///
    /// # Errors
    /// If ffmpeg fails before the first frame, or breaks off within one.
    pub fn next(&mut self, used: Option<RgbImage>) -> Result<Option<RgbImage>, InferError> {
        if self.ended {
            return Ok(None);
        }
        let Some((width, height)) = self.header()? else {
            self.ended = true;
            return self.finish().map(|()| None);
        };
        let wanted = width as usize * height as usize * 3;
        let mut bytes = used.map_or_else(Vec::new, RgbImage::into_raw);
        bytes.resize(wanted, 0);
        self.frames.read_exact(&mut bytes).map_err(|e| InferError::Video(format!("{}: broken off in a frame: {e}", self.name)))?;
        self.given += 1;
        Ok(RgbImage::from_raw(width, height, bytes))
    }

    /// Width and height out of `P6 WIDTH HEIGHT 255`; `None` at the end.
    fn header(&mut self) -> Result<Option<(u32, u32)>, InferError> {
        let mut words: Vec<String> = Vec::new();
        let mut word = String::new();
        let mut byte = [0u8];
        while words.len() < 4 {
            match self.frames.read(&mut byte) {
                Ok(0) if words.is_empty() && word.is_empty() => return Ok(None),
                Ok(0) => break,
                Ok(_) if byte[0].is_ascii_whitespace() => words.push(std::mem::take(&mut word)),
                Ok(_) => word.push(byte[0].into()),
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) => return Err(InferError::Video(format!("{}: {e}", self.name))),
            }
            if word.len() > 8 {
                break;
            }
        }
        let size = |k: usize| words.get(k).and_then(|w| w.parse::<u32>().ok()).filter(|v| (1..=32_768).contains(v));
        match (words.first().map(String::as_str), size(1), size(2)) {
            (Some("P6"), Some(width), Some(height)) => Ok(Some((width, height))),
            _ => Err(InferError::Video(format!("{}: ffmpeg gave no frame: {words:?}", self.name))),
        }
    }

    fn finish(&mut self) -> Result<(), InferError> {
        let status = self.child.wait().map_err(|e| InferError::Video(format!("ffmpeg: {e}")))?;
        let said = self.said.take().and_then(|s| s.join().ok()).unwrap_or_default();
        match (status.success(), last_line(&said)) {
            (true, _) if self.given > 0 => Ok(()),
            // A damaged end is common; what was decoded counts.
            (false, _) if self.given > 0 => Ok(()),
            (_, Some(line)) => Err(InferError::Video(format!("{}: {line}", self.name))),
            _ => Err(InferError::Video(format!("{}: no frame in it", self.name))),
        }
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Encodes frames of one size into a file, first under a temporary name.
pub struct Writer {
    child: Child,
    pipe: Option<ChildStdin>,
    partial: PathBuf,
    path: PathBuf,
    size: (u32, u32),
}

impl Writer {
    /// Starts encoding to `path`, whose ending chooses the format.
    ///
    /// # Errors
    /// If ffmpeg is absent.
    pub fn create(path: &Path, (width, height): (u32, u32), rate: f64) -> Result<Self, InferError> {
        let name = path.file_name().map_or_else(|| "video.mp4".into(), |n| n.to_string_lossy().into_owned());
        let partial = path.with_file_name(format!("partial-{name}"));
        let mut command = Command::new("ffmpeg");
        command
            .args(["-hide_banner", "-nostdin", "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"])
            .args(["-s", &format!("{width}x{height}"), "-r", &rate.to_string(), "-i", "-"])
            // Players want even sizes and this pixel format.
            .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"])
            .arg(&partial)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        let mut child = start("ffmpeg", &mut command)?;
        let pipe = child.stdin.take();
        Ok(Self { child, pipe, partial, path: path.to_owned(), size: (width, height) })
    }

    /// Adds a frame; one of another size is left out.
    ///
    /// # Errors
    /// If ffmpeg has stopped.
    pub fn write(&mut self, frame: &RgbImage) -> Result<(), InferError> {
        if frame.dimensions() != self.size {
            return Ok(());
        }
        match self.pipe.as_mut().map(|p| p.write_all(frame.as_raw())) {
            Some(Ok(())) => Ok(()),
            _ => Err(self.failure()),
        }
    }

    fn failure(&mut self) -> InferError {
        drop(self.pipe.take());
        let mut said = String::new();
        if let Some(mut errors) = self.child.stderr.take() {
            let _ = errors.read_to_string(&mut said);
        }
        let _ = self.child.wait();
        InferError::Video(format!("{}: ffmpeg: {}", self.path.display(), last_line(&said).unwrap_or("stopped")))
    }

    /// Ends the file and gives it its name.
    ///
    /// # Errors
    /// If ffmpeg failed or the file cannot be renamed.
    pub fn finish(mut self) -> Result<(), InferError> {
        drop(self.pipe.take());
        match self.child.wait() {
            Ok(status) if status.success() => std::fs::rename(&self.partial, &self.path).map_err(|e| InferError::io(&self.path, e)),
            _ => Err(self.failure()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inputs_are_told_apart() {
        assert_eq!(Input::parse("camera:0"), Some(Input::Camera("0".into())));
        assert_eq!(Input::parse("/dev/video2"), Some(Input::Camera("/dev/video2".into())));
        assert_eq!(Input::parse("a/b.MP4"), Some(Input::File("a/b.MP4".into())));
        assert!(Input::parse("rtsp://host/stream").unwrap().is_live());
        assert_eq!(Input::parse("photo.jpg"), None);
        assert_eq!(Input::parse("runs/quickstart/run"), None);
        assert_eq!(Input::Camera("/dev/video2".into()).stem(), "camera-video2");
    }

    #[test]
    fn rates_are_ratios() {
        assert_eq!(ratio("30/1"), Some(30.0));
        assert!((ratio("30000/1001").unwrap() - 29.97).abs() < 0.01);
        assert_eq!((ratio("0/0"), ratio("x"), ratio("1/0")), (None, None, None));
    }
}
