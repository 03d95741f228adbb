//! A dataset's folder: `dataset.toml`, `{train,val,test}.jsonl`, `{train,val,test}/NNNNN.jpg`.
use crate::{error::DatasetError, files, record::Record, split::Split};
use serde::{Deserialize, Serialize};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// How the numbers of `box` are to be read.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BoxConvention {
    /// Continuous pixels: width = x_max - x_min.
    #[default]
    Continuous,
    /// The paper's pixel indices, both ends in: width = x_max - x_min + 1.
    Inclusive,
}

impl BoxConvention {
    /// What is added to the maxima to get continuous pixels: 0 or 1.
    #[must_use]
    pub fn extra(self) -> f64 {
        match self {
            Self::Continuous => 0.0,
            Self::Inclusive => 1.0,
        }
    }
}

/// What every reader of `dataset.toml` needs; the generator writes more beside it.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct DatasetHeader {
    /// Version of the format: 1.
    #[serde(default = "one")]
    pub format: u32,
    /// How the numbers of `box` are to be read.
    #[serde(default)]
    pub boxes: BoxConvention,
    /// A digest a split, see [`crate::digest`].
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub digests: BTreeMap<String, String>,
}

fn one() -> u32 {
    1
}

/// An opened dataset. A set from elsewhere may lack `dataset.toml` and splits.
#[derive(Debug, Clone)]
pub struct Dataset {
    /// Its folder.
    pub dir: PathBuf,
    /// From `dataset.toml`, or the defaults.
    pub header: DatasetHeader,
}

impl Dataset {
    /// Opens a folder.
    ///
    /// # Errors
    /// If it is no folder, has no split at all, or `dataset.toml` does not parse or has a newer format.
    pub fn open(dir: impl AsRef<Path>) -> Result<Self, DatasetError> {
        let dir = dir.as_ref().to_owned();
        std::fs::read_dir(&dir).map_err(|e| DatasetError::io(&dir, e))?;
        let path = dir.join("dataset.toml");
        let header = if path.is_file() {
            let text = files::read_text(&path)?;
            let line_of = |e: &toml::de::Error| e.span().map_or(1, |s| text[..s.start].lines().count().max(1));
            let header: DatasetHeader = toml::from_str(&text).map_err(|e| DatasetError::line(&path, line_of(&e), e.message()))?;
            if header.format > 1 {
                return Err(DatasetError::line(
                    &path,
                    1,
                    format!("format {} is newer than this program, which reads format 1", header.format),
                ));
            }
            header
        } else {
            DatasetHeader { format: 1, ..Default::default() }
        };
        let dataset = Self { dir, header };
        if dataset.splits().is_empty() {
            return Err(DatasetError::MissingSplit { dir: dataset.dir, split: "train, val or test".into(), found: "none".into() });
        }
        Ok(dataset)
    }

    /// The splits that are there.
    #[must_use]
    pub fn splits(&self) -> Vec<Split> {
        Split::ALL.into_iter().filter(|s| self.list_path(*s).is_file()).collect()
    }

    /// The JSONL file of a split.
    #[must_use]
    pub fn list_path(&self, split: Split) -> PathBuf {
        self.dir.join(format!("{split}.jsonl"))
    }

    /// The picture of a record.
    #[must_use]
    pub fn image_path(&self, record: &Record) -> PathBuf {
        self.dir.join(&record.image)
    }

    /// Every record of a split, in order of id.
    ///
    /// # Errors
    /// If the split is missing or a line does not parse.
    pub fn records(&self, split: Split) -> Result<Vec<Record>, DatasetError> {
        let path = self.list_path(split);
        if !path.is_file() {
            let found = self.splits().iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
            let found = if found.is_empty() { "none".into() } else { found };
            return Err(DatasetError::MissingSplit { dir: self.dir.clone(), split: split.to_string(), found });
        }
        files::read_jsonl(path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Marker;

    #[test]
    fn writes_and_reads_back() {
        let dir = tempfile::tempdir().unwrap();
        let record = Record {
            image: "test/00009.jpg".into(),
            width: 416,
            height: 416,
            background: None,
            markers: vec![Marker::from_box("t_cross", [1.0, 2.0, 3.0, 4.0].into())],
            confusers: Vec::new(),
            intrinsics: None,
            distortion: None,
            effects: serde_json::Map::new(),
        };
        files::write_jsonl(dir.path().join("test.jsonl"), [&record]).unwrap();
        let text = files::read_text(dir.path().join("test.jsonl")).unwrap();
        assert_eq!(
            text,
            "{\"image\":\"test/00009.jpg\",\"width\":416,\"height\":416,\"markers\":[{\"shape\":\"t_cross\",\"box\":[1.0,2.0,3.0,4.0]}]}\n"
        );
        let dataset = Dataset::open(dir.path()).unwrap();
        assert_eq!(dataset.records(Split::Test).unwrap(), vec![record]);
        assert!(matches!(dataset.records(Split::Train), Err(DatasetError::MissingSplit { .. })));
    }

    #[test]
    fn a_bad_line_is_named() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("val.jsonl"), "\n{\"image\":3}\n").unwrap();
        let message = Dataset::open(dir.path()).unwrap().records(Split::Val).unwrap_err().to_string();
        assert!(message.contains("val.jsonl:2"), "{message}");
    }
}
