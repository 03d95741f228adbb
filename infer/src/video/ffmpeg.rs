//! The external program `ffmpeg`: raw frames out of a file, a stream or a camera, and raw frames into an encoded file, each over a pipe.
use crate::error::InferError;
use image::RgbImage;
use std::{
    ffi::OsStr,
    io::{BufRead, BufReader, ErrorKind, Read, Write},
    path::{Path, PathBuf},
    process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, Stdio},
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

/// A running program whose complaints are read as they come: a pipe that nobody empties would stop it. Killed where it is given up.
struct Process {
    child: Child,
    said: Option<JoinHandle<Option<String>>>,
}

impl Process {
    fn listening(program: &str, command: &mut Command) -> Result<Self, InferError> {
        let mut child = start(program, command.stderr(Stdio::piped()))?;
        let said = child.stderr.take().map(|errors| std::thread::spawn(move || last_complaint(errors)));
        Ok(Self { child, said })
    }

    /// Waits for its end: whether it succeeded, and the last line that it complained with.
    fn end(&mut self) -> Result<(bool, Option<String>), InferError> {
        let status = self.child.wait().map_err(|e| InferError::Video(format!("ffmpeg: {e}")))?;
        Ok((status.success(), self.said.take().and_then(|s| s.join().ok()).flatten()))
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Reads to the end and keeps the last line that is not empty.
fn last_complaint(errors: ChildStderr) -> Option<String> {
    let (mut errors, mut line, mut last) = (BufReader::new(errors), Vec::new(), None);
    while errors.read_until(b'\n', &mut line).is_ok_and(|n| n > 0) {
        last = last_line(&String::from_utf8_lossy(&line)).map(str::to_owned).or(last);
        line.clear();
    }
    last
}

/// Decodes an input: an iterator over its frames.
pub struct Reader {
    process: Process,
    frames: BufReader<ChildStdout>,
    name: String,
    given: u64,
    ended: bool,
    damage: Option<String>,
}

impl Reader {
    /// Starts decoding. `rate` asks a file for that many frames a second, and a camera for that mode; without it every frame comes once.
    ///
    /// # Errors
    /// If ffmpeg is absent.
    pub fn open(input: &Input, rate: Option<f64>) -> Result<Self, InferError> {
        let mut command = Command::new("ffmpeg");
        command.args(["-hide_banner", "-nostdin", "-loglevel", "error"]).args(input.arguments(rate)).arg("-an");
        match (input, rate) {
            (Input::File(_), Some(rate)) => command.args(["-r", &rate.to_string()]),
            // Times made even, of which the pictures tell nothing: at an uneven rate ffmpeg would repeat some frames and leave out others.
            _ => command.args(["-vf", "settb=1/30,setpts=N", "-r", "30"]),
        };
        // A PPM's header says how large each frame is, after the file's own rotation.
        command.args(["-f", "image2pipe", "-c:v", "ppm", "-pix_fmt", "rgb24", "-"]);
        let mut process = Process::listening("ffmpeg", command.stdin(Stdio::null()).stdout(Stdio::piped()))?;
        let pipe = process.child.stdout.take().ok_or_else(|| InferError::Video("ffmpeg: no pipe".into()))?;
        let frames = BufReader::with_capacity(1 << 20, pipe);
        Ok(Self { process, frames, name: input.name(), given: 0, ended: false, damage: None })
    }

    /// What ffmpeg complained of last, where frames came all the same: known after the last of them.
    #[must_use]
    pub fn damage(&self) -> Option<&str> {
        self.damage.as_deref()
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
        let (succeeded, said) = self.process.end()?;
        if self.given == 0 {
            return Err(InferError::Video(format!("{}: {}", self.name, said.as_deref().unwrap_or("no frame in it"))));
        }
        // A damaged end is common; what was decoded counts.
        self.damage = said.or_else(|| (!succeeded).then(|| "ffmpeg failed".into()));
        Ok(())
    }
}

/// Encodes frames of one size into a file, first under a temporary name.
pub struct Writer {
    process: Process,
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
            .stdout(Stdio::null());
        let mut process = Process::listening("ffmpeg", &mut command)?;
        let pipe = process.child.stdin.take();
        Ok(Self { process, pipe, partial, path: path.to_owned(), size: (width, height) })
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
            _ => {
                drop(self.pipe.take());
                let (_, said) = self.process.end()?;
                Err(self.failure(said.as_deref()))
            }
        }
    }

    fn failure(&self, said: Option<&str>) -> InferError {
        InferError::Video(format!("{}: ffmpeg: {}", self.path.display(), said.unwrap_or("stopped")))
    }

    /// Ends the file and gives it its name.
    ///
    /// # Errors
    /// If ffmpeg failed or the file cannot be renamed.
    pub fn finish(mut self) -> Result<(), InferError> {
        drop(self.pipe.take());
        match self.process.end()? {
            (true, _) => std::fs::rename(&self.partial, &self.path).map_err(|e| InferError::io(&self.path, e)),
            (false, said) => Err(self.failure(said.as_deref())),
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

    /// Runs ffmpeg on `arguments`; false where there is none, and nothing to test with.
    fn ffmpeg(arguments: &[&str]) -> bool {
        let run = Command::new("ffmpeg").args(["-loglevel", "error", "-y"]).args(arguments).status();
        run.is_ok_and(|status| status.success())
    }

    /// Frames that a file gives, and what it is said to suffer from.
    fn read(path: &Path) -> (u64, Option<String>) {
        let mut reader = Reader::open(&Input::File(path.into()), None).unwrap();
        while let Some(frame) = reader.next(None).unwrap() {
            assert_eq!(frame.dimensions(), (64, 48));
        }
        (reader.given, reader.damage().map(str::to_owned))
    }

    #[test]
    fn every_frame_comes_once_at_an_uneven_rate_and_damage_is_told() {
        let dir = tempfile::tempdir().unwrap();
        let (whole, broken) = (dir.path().join("whole.mkv"), dir.path().join("broken.mkv"));
        let uneven = "setpts='if(lt(N,5),N,4*N)/30/TB'";
        let source = ["-f", "lavfi", "-i", "testsrc=size=64x48:rate=30", "-frames:v", "12", "-vf", uneven, "-c:v", "mpeg4", "-g", "1"];
        if !ffmpeg(&[&source[..], &[&whole.to_string_lossy()]].concat()) {
            return;
        }
        assert_eq!(read(&whole), (12, None));
        let bytes = std::fs::read(&whole).unwrap();
        std::fs::write(&broken, &bytes[..bytes.len() / 2]).unwrap();
        let (frames, damage) = read(&broken);
        assert!((1..12).contains(&frames) && damage.is_some(), "{frames} {damage:?}");
    }

    /// A program that complains more than a pipe holds before it reads anything.
    #[cfg(unix)]
    #[test]
    fn complaints_do_not_stop_a_program() {
        let mut command = Command::new("sh");
        command.args(["-c", "for i in $(seq 20000); do echo complaint $i >&2; done; cat >/dev/null"]).stdin(Stdio::piped());
        let mut process = Process::listening("sh", &mut command).unwrap();
        process.child.stdin.take().unwrap().write_all(&vec![0; 1 << 20]).unwrap();
        assert_eq!(process.end().unwrap(), (true, Some("complaint 20000".into())));
    }
}
