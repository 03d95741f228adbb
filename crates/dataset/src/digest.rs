//! Digests by which a dataset can be recognised: one a split, kept in `dataset.toml`.
use crate::{Dataset, DatasetError, Split, formats};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// What differs from what `dataset.toml` says.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Differences {
    /// Pictures and lists looked at.
    pub files: usize,
    /// Files that a list names and that are not there.
    pub missing: Vec<String>,
    /// Pictures of a split's folder that its list does not name.
    pub unlisted: Vec<String>,
    /// Splits whose pictures or list have other bytes than they were written with.
    pub changed: Vec<Split>,
}

impl Differences {
    /// True where nothing differs.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.missing.is_empty() && self.changed.is_empty() && self.unlisted.is_empty()
    }
}

/// A split's digest: BLAKE3 over the BLAKE3 digests (32 bytes each) of its pictures in order of the list, then of the list.
///
/// # Errors
/// If the list or a picture cannot be read.
pub fn of_split(dataset: &Dataset, split: Split) -> Result<String, DatasetError> {
    let mut paths: Vec<_> = dataset.records(split)?.iter().map(|r| dataset.image_path(r)).collect();
    paths.push(dataset.list_path(split));
    let digest = |path| std::fs::read(path).map(|bytes| blake3::hash(&bytes)).map_err(|e| DatasetError::io(path, e));
    let parts: Vec<blake3::Hash> = paths.par_iter().map(digest).collect::<Result<_, _>>()?;
    let mut hasher = blake3::Hasher::new();
    for part in parts {
        hasher.update(part.as_bytes());
    }
    Ok(hasher.finalize().to_hex().to_string())
}

/// The digests of all splits, as `dataset.toml` has them.
///
/// # Errors
/// If a list or a picture cannot be read.
pub fn of_dataset(dataset: &Dataset) -> Result<BTreeMap<String, String>, DatasetError> {
    dataset.splits().into_iter().map(|s| Ok((s.to_string(), of_split(dataset, s)?))).collect()
}

/// Compares every file with the digests of `dataset.toml`.
///
/// # Errors
/// If there are no digests, or a file cannot be read.
pub fn verify(dir: impl AsRef<std::path::Path>) -> Result<Differences, DatasetError> {
    let dataset = Dataset::open(dir)?;
    let path = dataset.dir.join("dataset.toml");
    if dataset.header.digests.is_empty() {
        return Err(DatasetError::unfit(path, "no [digests]", "those that a generated or converted dataset is written with"));
    }
    let mut differences = Differences::default();
    for split in Split::ALL {
        let Some(expected) = dataset.header.digests.get(split.name()) else { continue };
        if !dataset.list_path(split).is_file() {
            differences.missing.push(format!("{split}.jsonl"));
            continue;
        }
        let records = dataset.records(split)?;
        differences.files += records.len() + 1;
        let missing: Vec<String> = records.iter().filter(|r| !dataset.image_path(r).is_file()).map(|r| r.image.clone()).collect();
        let listed: BTreeSet<&str> = records.iter().map(|r| r.image.as_str()).collect();
        let folder = dataset.dir.join(split.name());
        if folder.is_dir() {
            let names = formats::pictures_in(&folder)?.into_iter().map(|p| formats::relative(&p, &dataset.dir));
            differences.unlisted.extend(names.filter(|n| !listed.contains(n.as_str())));
        }
        if missing.is_empty() && of_split(&dataset, split)? != *expected {
            differences.changed.push(split);
        }
        differences.missing.extend(missing);
    }
    Ok(differences)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{dataset::BoxConvention, files};

    #[test]
    fn every_kind_of_difference_is_named() {
        let (from, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let dir = dir.path();
        formats::native::write(&formats::tests::random_set(from.path(), 1, BoxConvention::Continuous), dir).unwrap();
        let clean = verify(dir).unwrap();
        assert!(clean.is_empty() && clean.files == 12, "{clean:?}");
        std::fs::remove_file(dir.join("train/00001.png")).unwrap();
        std::fs::write(dir.join("train/x.png"), "x").unwrap();
        let image = dir.join("val/00002.png");
        let mut bytes = std::fs::read(&image).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        files::write_atomically(&image, bytes).unwrap();
        let found = verify(dir).unwrap();
        assert_eq!((found.missing, found.unlisted), (vec!["train/00001.png".into()], vec!["train/x.png".into()]));
        assert_eq!(found.changed, [Split::Val]);
    }
}
