//! The images of a split with their labels, letterboxed, decoded when first needed and kept while there is room.
use crate::{
    augment::{Label, Labels, planes::Planes},
    error::TrainError,
};
use rayon::prelude::*;
use std::{
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, OnceLock,
        atomic::{AtomicUsize, Ordering},
    },
};
use tcross_dataset::{Dataset, Letterbox, Record, Split, picture};
use tcross_yolo::{NetSize, input};

/// About `most` of `count` indices, evenly spread; 0 for all.
#[must_use]
pub fn evenly(count: usize, most: usize) -> Vec<usize> {
    let most = if most == 0 { count } else { most.min(count) };
    (0..most).map(|k| k * count / most).collect()
}

/// Images of one split at one letterboxed size.
pub struct Samples {
    /// The usable records, in order of id.
    pub records: Vec<Record>,
    paths: Vec<PathBuf>,
    labels: Vec<Vec<Label>>,
    size: NetSize,
    cache: Vec<OnceLock<Arc<Planes>>>,
    cached_bytes: AtomicUsize,
    budget_bytes: usize,
    warnings: Mutex<Vec<String>>,
}

impl Samples {
    /// Reads a split's list and the headers of its images. An image that cannot be read is left out with a warning that names it.
    ///
    /// # Errors
    /// If the split is missing, holds no usable image, or a label cannot be learned (with the list's line).
    pub fn open(dataset: &Dataset, split: Split, size: NetSize, classes: &[String], budget_bytes: usize) -> Result<Self, TrainError> {
        let list = dataset.list_path(split);
        let records = dataset.records(split)?;
        let extra = dataset.header.boxes.extra();
        let checked: Vec<(Option<String>, Vec<Label>)> = records
            .par_iter()
            .enumerate()
            .map(|(k, record)| {
                let labels = labels_of(record, size, extra, classes).map_err(|(marker, message)| TrainError::Label {
                    path: list.clone(),
                    line: k + 1,
                    image: record.image.clone(),
                    marker,
                    message,
                })?;
                Ok((unreadable(&dataset.image_path(record), record), labels))
            })
            .collect::<Result<_, TrainError>>()?;
        let mut samples = Self {
            records: Vec::new(),
            paths: Vec::new(),
            labels: Vec::new(),
            size,
            cache: Vec::new(),
            cached_bytes: AtomicUsize::new(0),
            budget_bytes,
            warnings: Mutex::default(),
        };
        for (record, (problem, labels)) in records.into_iter().zip(checked) {
            match problem {
                Some(message) => samples.warn(message),
                None => {
                    samples.paths.push(dataset.image_path(&record));
                    samples.labels.push(labels);
                    samples.records.push(record);
                }
            }
        }
        if samples.records.is_empty() {
            return Err(TrainError::Empty { path: list, what: "readable image".into() });
        }
        samples.cache.resize_with(samples.records.len(), OnceLock::new);
        Ok(samples)
    }

    /// Keeps about `most` records, evenly spread; 0 keeps all.
    #[must_use]
    pub fn thinned(mut self, most: usize) -> Self {
        let chosen = evenly(self.records.len(), most);
        self.records = chosen.iter().map(|&k| self.records[k].clone()).collect();
        self.paths = chosen.iter().map(|&k| self.paths[k].clone()).collect();
        self.labels = chosen.iter().map(|&k| self.labels[k].clone()).collect();
        self.cache.truncate(chosen.len());
        self
    }

    /// The letterboxed picture of image `index`; none, with a warning, if it cannot be decoded.
    pub fn read(&self, index: usize) -> Option<Arc<Planes>> {
        if let Some(planes) = self.cache[index].get() {
            return Some(Arc::clone(planes));
        }
        let image = match picture::read(&self.paths[index]) {
            Ok(image) => image,
            Err(error) => {
                self.warn(format!("{error}; skipped"));
                return None;
            }
        };
        let planes = Arc::new(Planes::from_rgb(&input::letterboxed(&image, self.size).0));
        let bytes = planes.data.len();
        if self.cached_bytes.fetch_add(bytes, Ordering::Relaxed) + bytes <= self.budget_bytes {
            let _ = self.cache[index].set(Arc::clone(&planes)); // another thread may have been first with the same pixels
        }
        Some(planes)
    }

    /// Where image `index` lies in the network's input.
    #[must_use]
    pub fn letterbox(&self, index: usize) -> Letterbox {
        let record = &self.records[index];
        Letterbox::new((record.width as usize, record.height as usize), (self.size.width, self.size.height))
    }

    /// Widths and heights of all labels, in pixels of the letterboxed images.
    #[must_use]
    pub fn box_sizes(&self) -> Vec<[f32; 2]> {
        self.labels.iter().flatten().map(|l| [l.bounds.width() as f32, l.bounds.height() as f32]).collect()
    }

    /// True where a label knows its marker's centre and corners.
    #[must_use]
    pub fn has_points(&self) -> bool {
        self.labels.iter().flatten().any(|label| label.points.is_some())
    }

    /// Takes the warnings since the last call; each names its file.
    pub fn take_warnings(&self) -> Vec<String> {
        std::mem::take(&mut *self.warnings.lock().unwrap_or_else(|poisoned| poisoned.into_inner()))
    }

    fn warn(&self, message: String) {
        let mut warnings = self.warnings.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        if !warnings.contains(&message) {
            warnings.push(message);
        }
    }
}

impl Labels for Samples {
    fn count(&self) -> usize {
        self.records.len()
    }

    fn labels(&self, index: usize) -> &[Label] {
        &self.labels[index]
    }

    fn size(&self) -> NetSize {
        self.size
    }
}

/// Why an image cannot be used: missing, empty, no picture, or of another size than its record says.
fn unreadable(path: &Path, record: &Record) -> Option<String> {
    match picture::dimensions(path) {
        Err(e) => Some(format!("{e}; skipped")),
        Ok(found) if found != (record.width, record.height) => Some(format!(
            "{}: {}x{} pixels, but its record says {}x{}; skipped",
            path.display(),
            found.0,
            found.1,
            record.width,
            record.height
        )),
        Ok(_) => None,
    }
}

/// A record's labels in the letterboxed image, cut at the image's border; the marker's index and what is wrong with it otherwise.
fn labels_of(record: &Record, size: NetSize, extra: f64, classes: &[String]) -> Result<Vec<Label>, (usize, String)> {
    let (width, height) = (f64::from(record.width), f64::from(record.height));
    if record.width == 0 || record.height == 0 {
        return Ok(Vec::new()); // left out for its size, with a warning
    }
    let letterbox = Letterbox::new((record.width as usize, record.height as usize), (size.width, size.height));
    let label = |(k, marker): (usize, &tcross_dataset::Marker)| {
        let b = marker.bounds;
        let continuous = b.grown(extra);
        let inside = continuous.clipped(width, height);
        if !b.is_valid() || inside.width() <= 0.0 || inside.height() <= 0.0 {
            let found: [f64; 4] = b.into();
            return Err((k, format!("box {found:?}: expected x_min < x_max and y_min < y_max, inside {width} x {height}")));
        }
        let class = match classes.iter().position(|c| *c == marker.shape) {
            Some(class) => class,
            None if classes.is_empty() => 0,
            None => return Err((k, format!("shape '{}': expected one of train.classes: {}", marker.shape, classes.join(", ")))),
        };
        let points = points_of(marker).map(|points| points.map(|point| letterbox.net_from_source(point)));
        Ok(Label { bounds: letterbox.box_to_net(&inside), class: class as u32, points })
    };
    record.markers.iter().enumerate().map(label).collect()
}

/// A marker's centre and corners, where its record tells them; the centre is where the diagonals cross, if it is not told itself.
fn points_of(marker: &tcross_dataset::Marker) -> Option<[[f64; 2]; 5]> {
    let corners = marker.corners?;
    let center = marker.center.or_else(|| corners.diagonal_crossing())?;
    let [a, b, c, d] = corners.0;
    Some([center, a, b, c, d])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::toy;

    #[test]
    fn bad_images_are_left_out_and_named() {
        let dir = tempfile::tempdir().unwrap();
        toy::write(dir.path(), 12, 4, 32).unwrap();
        std::fs::write(dir.path().join("train/00002.png"), b"no picture").unwrap();
        std::fs::write(dir.path().join("train/00003.png"), b"").unwrap();
        std::fs::remove_file(dir.path().join("train/00005.png")).unwrap();
        let samples = Samples::open(&Dataset::open(dir.path()).unwrap(), Split::Train, NetSize::square(32), &[], 1 << 20).unwrap();
        assert_eq!(samples.count(), 9);
        let warnings = samples.take_warnings();
        assert_eq!(warnings.len(), 3);
        for (warning, name) in warnings.iter().zip(["00002.png", "00003.png", "00005.png"]) {
            assert!(warning.contains(name), "{warning}");
        }
        assert!(samples.take_warnings().is_empty());
    }

    #[test]
    fn a_picture_that_breaks_off_is_skipped_once() {
        let dir = tempfile::tempdir().unwrap();
        toy::write(dir.path(), 3, 1, 64).unwrap();
        let path = dir.path().join("train/00001.png");
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        let samples = Samples::open(&Dataset::open(dir.path()).unwrap(), Split::Train, NetSize::square(64), &[], 1 << 20).unwrap();
        assert!(samples.read(0).is_some() && samples.read(1).is_none() && samples.read(1).is_none());
        let warnings = samples.take_warnings();
        assert!(warnings.len() == 1 && warnings[0].contains("00001.png"), "{warnings:?}");
    }

    #[test]
    fn what_does_not_fit_the_cache_is_decoded_again() {
        let dir = tempfile::tempdir().unwrap();
        toy::write(dir.path(), 4, 1, 32).unwrap();
        let samples = Samples::open(&Dataset::open(dir.path()).unwrap(), Split::Train, NetSize::square(32), &[], 2 * 3 * 1024).unwrap();
        let first: Vec<_> = (0..4).map(|k| samples.read(k).unwrap()).collect();
        let second: Vec<_> = (0..4).map(|k| samples.read(k).unwrap()).collect();
        assert_eq!(first, second);
        assert_eq!((0..4).filter(|&k| Arc::ptr_eq(&first[k], &second[k])).count(), 2);
    }

    #[test]
    fn impossible_labels_name_list_line_and_marker() {
        let dir = tempfile::tempdir().unwrap();
        toy::write(dir.path(), 3, 1, 32).unwrap();
        let list = dir.path().join("train.jsonl");
        let text = std::fs::read_to_string(&list).unwrap();
        let mut lines: Vec<String> = text.lines().map(String::from).collect();
        let good = lines[1].clone();
        for (bad, words) in [
            (good.split("\"box\":").next().unwrap().to_owned() + "\"box\":[40.0,2.0,50.0,9.0]}]}", "box [40.0, 2.0, 50.0, 9.0]: expected"),
            (good.replace("t_cross", "star"), "shape 'star'"),
        ] {
            lines[1] = bad;
            std::fs::write(&list, lines.join("\n")).unwrap();
            let opened = Samples::open(&Dataset::open(dir.path()).unwrap(), Split::Train, NetSize::square(32), &["t_cross".into()], 0);
            let message = opened.err().unwrap().to_string();
            assert!(message.contains("train.jsonl:2") && message.contains(words), "{message}");
        }
    }
}
