//! Makes a dataset: images in parallel, chunk by chunk, so that memory stays bounded and a killed run loses one chunk at most.
use crate::{
    background::Backgrounds,
    card,
    config::Config,
    error::DatagenError,
    jpeg,
    manifest::{BackgroundsEntry, Manifest, fingerprint},
    sample::sample,
};
use rayon::prelude::*;
use std::{
    fs,
    io::{BufRead, BufReader, BufWriter, Write},
    ops::Range,
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
};
use tcross_dataset::{DatasetError, Split, files};

/// Images made and recorded together; memory holds the records of one chunk.
const CHUNK: u64 = 256;

/// Where finished chunks wait until the dataset is whole.
const PARTS: &str = ".parts";

/// How to make a dataset.
#[derive(Debug, Clone, Default)]
pub struct GenerateOptions {
    /// The folder to write.
    pub out: PathBuf,
    /// The seed of everything.
    pub seed: u64,
    /// Number of images instead of the config's.
    pub images: Option<u64>,
    /// Threads; all cores where absent.
    pub threads: Option<usize>,
    /// `(index, count)`: only this contiguous part of the images, for job arrays.
    pub shard: Option<(u64, u64)>,
    /// Only image K.
    pub only: Option<u64>,
    /// Keep what an earlier run of the same options has finished; without it, that is made anew.
    pub resume: bool,
    /// Commit of the program, for `dataset.toml`.
    pub commit: Option<String>,
}

/// How far the work is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// Images done.
    pub done: u64,
    /// Images to do.
    pub total: u64,
}

/// What was made.
#[derive(Debug, Clone)]
pub struct Summary {
    /// What `dataset.toml` says.
    pub manifest: Manifest,
    /// Images that an earlier run had finished.
    pub resumed: u64,
}

/// One image that is on disk: a line of a finished chunk, `digest markers record`.
struct Finished {
    digest: blake3::Hash,
    markers: usize,
    record: String,
}

impl Finished {
    fn to_line(&self) -> String {
        format!("{} {} {}\n", self.digest.to_hex(), self.markers, self.record)
    }

    fn from_line(line: &str) -> Option<Self> {
        let (digest, rest) = line.split_once(' ')?;
        let (markers, record) = rest.split_once(' ')?;
        Some(Self { digest: blake3::Hash::from_hex(digest).ok()?, markers: markers.parse().ok()?, record: record.to_owned() })
    }
}

/// Makes a dataset. Its bytes depend on config, seed and backgrounds only: not on threads, shards or interruptions.
/// `progress` is told about every chunk; once `stop` is true, the current chunk is finished and [`DatagenError::Stopped`] returned.
///
/// # Errors
/// If the config is impossible, a photo folder has no usable photo, the folder holds another dataset, or cannot be written; what was
/// finished stays and `resume` goes on from there.
pub fn generate(
    config: &Config,
    backgrounds: &Backgrounds,
    options: &GenerateOptions,
    stop: &AtomicBool,
    progress: &mut (dyn FnMut(Progress) + Send),
) -> Result<Summary, DatagenError> {
    let mut config = config.clone();
    config.images = options.images.unwrap_or(config.images);
    config.validate()?;
    let range = range(config.images, options)?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(options.threads.unwrap_or(0))
        .build()
        .map_err(|e| DatagenError::io(&options.out, std::io::Error::other(e)))?;
    let fingerprint = fingerprint(&config, options.seed, backgrounds);
    let total = range.end - range.start;
    let identity = identity(&fingerprint, options.shard.map(|(index, count)| [index, count]), options.only);
    match found(&options.out, &identity)? {
        Found::Whole(manifest) if options.resume => return Ok(Summary { manifest: *manifest, resumed: total }),
        Found::Half if options.resume => {}
        Found::Nothing => prepare(&options.out, &identity)?,
        Found::Half | Found::Whole(_) => {
            clear(&options.out)?;
            prepare(&options.out, &identity)?;
        }
    }
    let parts = options.out.join(PARTS);
    let mut resumed = 0;
    pool.install(|| backgrounds.prepare(&config));
    for chunk in chunks(&range) {
        if stop.load(Ordering::Relaxed) {
            return Err(DatagenError::Stopped);
        }
        let part = part_path(&parts, &chunk);
        if part.is_file() {
            resumed += chunk.end - chunk.start;
        } else {
            let made: Vec<Finished> = pool.install(|| {
                chunk.clone().into_par_iter().map(|index| make(&config, backgrounds, options, index)).collect::<Result<_, DatagenError>>()
            })?;
            files::write_atomically(&part, made.iter().map(Finished::to_line).collect::<String>())?;
        }
        progress(Progress { done: chunk.end - range.start, total });
    }
    let manifest = finish(&config, backgrounds, options, &range, &parts, fingerprint)?;
    Ok(Summary { manifest, resumed })
}

/// The images of this shard.
fn range(images: u64, options: &GenerateOptions) -> Result<Range<u64>, DatagenError> {
    if let Some(only) = options.only {
        return if only < images { Ok(only..only + 1) } else { Err(DatagenError::config("only", only, format!("0 to {}", images - 1))) };
    }
    match options.shard {
        None => Ok(0..images),
        Some((index, count)) if index < count => Ok(images * index / count..images * (index + 1) / count),
        Some((index, count)) => Err(DatagenError::config("shard", format!("{index}/{count}"), "I/N with I from 0 to N - 1")),
    }
}

fn chunks(range: &Range<u64>) -> impl Iterator<Item = Range<u64>> + use<> {
    let end = range.end;
    (range.start..end).step_by(CHUNK as usize).map(move |first| first..(first + CHUNK).min(end))
}

fn part_path(parts: &Path, chunk: &Range<u64>) -> PathBuf {
    parts.join(format!("{:08}-{:08}.jsonl", chunk.start, chunk.end))
}

/// What is to be made: datasets and parts of them with equal identities have equal bytes.
fn identity(fingerprint: &str, shard: Option<[u64; 2]>, only: Option<u64>) -> String {
    let shard = shard.map_or(String::new(), |[index, count]| format!(" shard {index}/{count}"));
    format!("{fingerprint}{shard}{}", only.map_or(String::new(), |k| format!(" only {k}")))
}

/// What stands in the output folder.
enum Found {
    Nothing,
    /// Finished chunks of the same dataset.
    Half,
    /// The same dataset.
    Whole(Box<Manifest>),
}

/// # Errors
/// If another dataset stands there, finished or half.
fn found(out: &Path, wanted: &str) -> Result<Found, DatagenError> {
    let other = || DatagenError::Mismatch { dir: out.to_owned() };
    let (whole, mark) = (out.join("dataset.toml"), out.join(PARTS).join("fingerprint"));
    if whole.is_file() {
        let manifest: Manifest = toml::from_str(&files::read_text(&whole)?).map_err(|_| other())?;
        let same = identity(&manifest.fingerprint, manifest.shard, manifest.only) == wanted;
        return if same { Ok(Found::Whole(Box::new(manifest))) } else { Err(other()) };
    }
    match mark.is_file() {
        true if files::read_text(&mark)? == wanted => Ok(Found::Half),
        true => Err(other()),
        false => Ok(Found::Nothing),
    }
}

fn folders(out: &Path) -> impl Iterator<Item = PathBuf> {
    Split::ALL.map(|s| out.join(s.name())).into_iter().chain([out.join(PARTS)])
}

/// Removes what an earlier run wrote.
fn clear(out: &Path) -> Result<(), DatagenError> {
    for dir in folders(out).filter(|dir| dir.is_dir()) {
        fs::remove_dir_all(&dir).map_err(|e| DatagenError::io(&dir, e))?;
    }
    for file in Split::ALL.map(|s| format!("{s}.jsonl")).into_iter().chain(["dataset.toml".into()]).map(|name| out.join(name)) {
        if file.is_file() {
            fs::remove_file(&file).map_err(|e| DatagenError::io(&file, e))?;
        }
    }
    Ok(())
}

/// Makes the folders, marked with what is to stand in them.
fn prepare(out: &Path, identity: &str) -> Result<(), DatagenError> {
    folders(out).try_for_each(files::create_dir)?;
    Ok(files::write_atomically(out.join(PARTS).join("fingerprint"), identity)?)
}

/// Makes one image and writes its picture.
fn make(config: &Config, backgrounds: &Backgrounds, options: &GenerateOptions, index: u64) -> Result<Finished, DatagenError> {
    let made = sample(config, backgrounds, options.seed, index)?;
    let path = options.out.join(&made.record.image);
    let bytes = jpeg::encode(&made.image, made.quality).ok_or_else(|| DatagenError::Encode {
        path: path.clone(),
        message: format!("a JPEG file has 1 to {} pixels a side", jpeg::LARGEST),
    })?;
    let digest = blake3::hash(&bytes);
    // Half a picture is of a chunk that is not recorded, and is made anew.
    fs::write(&path, bytes).map_err(|e| DatagenError::io(&path, e))?;
    let record = serde_json::to_string(&made.record).map_err(|e| DatasetError::line(&path, 0, e))?;
    Ok(Finished { digest, markers: made.record.markers.len(), record })
}

/// Joins the chunks to the lists of the splits and writes `dataset.toml`.
fn finish(
    config: &Config,
    backgrounds: &Backgrounds,
    options: &GenerateOptions,
    range: &Range<u64>,
    parts: &Path,
    fingerprint: String,
) -> Result<Manifest, DatagenError> {
    let mut manifest = Manifest {
        format: 1,
        boxes: config.boxes(),
        generator: "tcross datagen".into(),
        version: env!("CARGO_PKG_VERSION").into(),
        commit: options.commit.clone(),
        seed: options.seed,
        images: config.images,
        markers: 0,
        shard: options.shard.map(|(index, count)| [index, count]),
        only: options.only,
        fingerprint,
        counts: Default::default(),
        digests: Default::default(),
        backgrounds: BackgroundsEntry::of(backgrounds),
        config: config.clone(),
    };
    for split in Split::ALL {
        let path = options.out.join(format!("{split}.jsonl"));
        let partial = options.out.join(format!("{split}.jsonl.partial"));
        let io = |e| DatagenError::io(&partial, e);
        let mut file = BufWriter::new(fs::File::create(&partial).map_err(io)?);
        let (mut pictures, mut list, mut count) = (blake3::Hasher::new(), blake3::Hasher::new(), 0u64);
        for chunk in chunks(range) {
            let part = part_path(parts, &chunk);
            for (line, text) in BufReader::new(fs::File::open(&part).map_err(|e| DatagenError::io(&part, e))?).lines().enumerate() {
                let text = text.map_err(|e| DatagenError::io(&part, e))?;
                let unreadable = || DatasetError::line(&part, line + 1, "not a finished image; delete this file and resume");
                let finished = Finished::from_line(&text).ok_or_else(unreadable)?;
                if !finished.record.starts_with(&format!("{{\"image\":\"{split}/")) {
                    continue;
                }
                let row = finished.record + "\n";
                pictures.update(finished.digest.as_bytes());
                list.update(row.as_bytes());
                file.write_all(row.as_bytes()).map_err(io)?;
                manifest.markers += finished.markers as u64;
                count += 1;
            }
        }
        file.into_inner().map_err(|e| io(e.into_error()))?.sync_all().map_err(io)?;
        fs::rename(&partial, &path).map_err(|e| DatagenError::io(&path, e))?;
        pictures.update(list.finalize().as_bytes());
        manifest.counts.insert(split.to_string(), count);
        manifest.digests.insert(split.to_string(), pictures.finalize().to_hex().to_string());
    }
    let path = options.out.join("dataset.toml");
    let text = toml::to_string(&manifest).map_err(|e| DatasetError::line(&path, 0, e))?;
    card::write(&manifest, &options.out)?;
    // Last, because a folder with it is a whole dataset.
    files::write_atomically(path, text)?;
    fs::remove_dir_all(parts).map_err(|e| DatagenError::io(parts, e))?;
    Ok(manifest)
}
