//! The truth that detections are scored against.
use crate::{
    error::EvalError,
    input::{Problem, ProblemKind},
};
use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};
use tcross_dataset::{Dataset, DatasetError, Record, Split, dataset::BoxConvention, files};

/// Records of one split, found by the name of their image.
#[derive(Debug, Clone)]
pub struct Truth {
    /// The file they come from; of truth made in memory, a word for messages.
    pub path: PathBuf,
    /// Where the pictures are; `None` where there are none.
    pub dir: Option<PathBuf>,
    /// How the boxes' numbers are to be read.
    pub boxes: BoxConvention,
    /// In order of the file.
    pub records: Vec<Record>,
    positions: HashMap<String, usize>,
}

impl Truth {
    /// Truth from memory. Of records with the same image the first is found by name.
    #[must_use]
    pub fn new(records: Vec<Record>, boxes: BoxConvention, dir: Option<PathBuf>) -> Self {
        let mut positions = HashMap::with_capacity(records.len());
        for (k, record) in records.iter().enumerate() {
            positions.entry(record.image.clone()).or_insert(k);
        }
        Self { path: "truth in memory".into(), dir, boxes, records, positions }
    }

    /// Opens a dataset's folder (its test split, or the named one), or a single JSONL file.
    ///
    /// # Errors
    /// If it cannot be read, the split is missing, or a record is not what it should be (with file and line).
    pub fn open(path: impl AsRef<Path>, split: Option<Split>) -> Result<Self, EvalError> {
        let path = path.as_ref();
        if path.is_file() {
            let dir = files::folder_of(path).to_owned();
            let boxes = if dir.join("dataset.toml").is_file() { Dataset::open(&dir)?.header.boxes } else { BoxConvention::default() };
            return Self::read(path, dir, boxes);
        }
        let dataset = Dataset::open(path)?;
        let list = dataset.list_path(split.unwrap_or(Split::Test));
        if !list.is_file() {
            // The dataset's own words about what is there.
            dataset.records(split.unwrap_or(Split::Test))?;
        }
        Self::read(&list, dataset.dir.clone(), dataset.header.boxes)
    }

    /// Opens every split of a dataset, one behind the other.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_all(path: impl AsRef<Path>) -> Result<Self, EvalError> {
        let dataset = Dataset::open(path)?;
        let mut records = Vec::new();
        for split in Split::ALL.into_iter().filter(|s| dataset.list_path(*s).is_file()) {
            records.extend(Self::read(&dataset.list_path(split), dataset.dir.clone(), dataset.header.boxes)?.records);
        }
        Ok(Self { path: dataset.dir.clone(), ..Self::new(records, dataset.header.boxes, Some(dataset.dir.clone())) })
    }

    fn read(path: &Path, dir: PathBuf, boxes: BoxConvention) -> Result<Self, EvalError> {
        let mut records: Vec<Record> = Vec::new();
        let mut problems = Vec::new();
        let mut seen = HashMap::new();
        for (k, line) in files::read_text(path)?.lines().enumerate().filter(|(_, l)| !l.trim().is_empty()) {
            let record: Record = serde_json::from_str(line).map_err(|e| DatasetError::line(path, k + 1, e))?;
            let problem = |kind, message| Problem { kind, path: path.to_owned(), line: k + 1, message };
            if let Some(first) = seen.insert(record.image.clone(), k + 1) {
                problems.push(problem(ProblemKind::DuplicateLine, format!("'{}' has a record on line {first} already", record.image)));
            }
            for (m, marker) in record.markers.iter().enumerate().filter(|(_, m)| !m.bounds.is_valid()) {
                let found = <[f64; 4]>::from(marker.bounds);
                problems
                    .push(problem(ProblemKind::BadBox, format!("box {found:?} of marker {m}: allowed is x_min <= x_max, y_min <= y_max")));
            }
            records.push(record);
        }
        if let Some(first) = problems.first() {
            return Err(EvalError::Truth { first: first.clone(), count: problems.len() });
        }
        Ok(Self { path: path.to_owned(), ..Self::new(records, boxes, Some(dir)) })
    }

    /// Index of the record of an image.
    #[must_use]
    pub fn position(&self, image: &str) -> Option<usize> {
        self.positions.get(image).copied()
    }

    /// The picture of record `index`, where there are pictures.
    #[must_use]
    pub fn image_path(&self, index: usize) -> Option<PathBuf> {
        Some(self.dir.as_ref()?.join(&self.records.get(index)?.image))
    }

    /// All markers.
    #[must_use]
    pub fn markers(&self) -> usize {
        self.records.iter().map(|r| r.markers.len()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A lenient reading counts faults of the detections only: that is not advised where it does not help.
    #[test]
    fn faults_have_a_line_and_ask_for_correction() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let line = r#"{"image":"a.jpg","width":10,"height":10,"markers":[{"shape":"t_cross","box":[5,5,1,1]}]}"#;
        std::fs::write(file.path(), format!("{line}\n{line}\n")).unwrap();
        let message = Truth::open(file.path(), None).unwrap_err().to_string();
        assert!(message.contains(":1: box [5.0, 5.0, 1.0, 1.0] of marker 0") && message.contains("and 2 more problems"), "{message}");
        assert!(message.ends_with("; correct the file"), "{message}");
    }
}
