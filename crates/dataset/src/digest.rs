//! `b3sums.txt`: the digest of every file of a dataset, in the form that the tool `b3sum --check` reads.
use crate::{DatasetError, files};
use rayon::prelude::*;
use std::{
    collections::BTreeMap,
    fmt::Write,
    path::{Path, PathBuf},
};

/// Name of the list.
pub const LIST: &str = "b3sums.txt";

/// What differs from the list.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Differences {
    /// Files checked.
    pub files: usize,
    /// Listed files that are not there.
    pub missing: Vec<String>,
    /// Files whose bytes differ.
    pub changed: Vec<String>,
    /// Files that are not listed.
    pub unlisted: Vec<String>,
}

impl Differences {
    /// True where nothing differs.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.missing.is_empty() && self.changed.is_empty() && self.unlisted.is_empty()
    }
}

/// Every file that belongs to a dataset, sorted, relative to it: lists, pictures, `dataset.toml`.
fn members(dir: &Path) -> Result<Vec<String>, DatasetError> {
    fn walk(folder: &Path, found: &mut Vec<PathBuf>) -> Result<(), DatasetError> {
        for entry in std::fs::read_dir(folder).map_err(|e| DatasetError::io(folder, e))? {
            let path = entry.map_err(|e| DatasetError::io(folder, e))?.path();
            if path.is_dir() {
                walk(&path, found)?;
            } else {
                found.push(path);
            }
        }
        Ok(())
    }
    let mut found = Vec::new();
    walk(dir, &mut found)?;
    let own = |p: &PathBuf| {
        let top = p.strip_prefix(dir).ok().and_then(|p| p.components().next()).map(|c| c.as_os_str().to_string_lossy().into_owned());
        let ending = p.extension().and_then(|e| e.to_str()).unwrap_or_default();
        let split = |name: &str| ["train", "val", "test"].contains(&name);
        top.is_some_and(|top| split(&top) || top == "dataset.toml" || top.strip_suffix(".jsonl").is_some_and(split)) && ending != "partial"
    };
    let name = |p: PathBuf| {
        p.strip_prefix(dir).unwrap_or(&p).components().map(|c| c.as_os_str().to_string_lossy().into_owned()).collect::<Vec<_>>().join("/")
    };
    let mut names: Vec<String> = found.into_iter().filter(own).map(name).collect();
    names.sort();
    Ok(names)
}

/// Writes the list and returns its own digest.
///
/// # Errors
/// If a file cannot be read or the folder cannot be written.
pub fn write(dir: &Path) -> Result<String, DatasetError> {
    let names = members(dir)?;
    let digests: Vec<String> = names.par_iter().map(|n| files::digest(dir.join(n))).collect::<Result<_, _>>()?;
    let mut text = String::new();
    for (name, digest) in names.iter().zip(digests) {
        let _ = writeln!(text, "{digest}  {name}");
    }
    files::write_atomically(dir.join(LIST), &text)?;
    Ok(files::digest_bytes(text))
}

/// Compares every file with the list.
///
/// # Errors
/// If there is no list, a line of it is not `digest  name`, or a file cannot be read.
pub fn verify(dir: &Path) -> Result<Differences, DatasetError> {
    let path = dir.join(LIST);
    if !path.is_file() {
        return Err(DatasetError::unfit(dir, format!("no {LIST}"), "the list of digests that a dataset is written with"));
    }
    let text = files::read_text(&path)?;
    let mut listed = BTreeMap::new();
    for (k, line) in text.lines().enumerate() {
        let entry = line.split_once("  ").filter(|(d, name)| d.len() == 64 && !name.contains(".."));
        let (digest, name) = entry.ok_or_else(|| DatasetError::line(&path, k + 1, "expected 64 digits, two spaces, a name"))?;
        listed.insert(name, digest);
    }
    let unlisted = members(dir)?.into_iter().filter(|n| !listed.contains_key(n.as_str())).collect();
    let (there, missing): (Vec<_>, Vec<_>) = listed.iter().partition(|(name, _)| dir.join(name).is_file());
    let same: Vec<bool> =
        there.par_iter().map(|(name, digest)| Ok(files::digest(dir.join(name))? == **digest)).collect::<Result<_, DatasetError>>()?;
    let changed = there.iter().zip(same).filter(|(_, same)| !same).map(|((name, _), _)| (**name).to_owned()).collect();
    Ok(Differences { files: listed.len(), missing: missing.into_iter().map(|(n, _)| (*n).to_owned()).collect(), changed, unlisted })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{dataset::BoxConvention, formats};

    #[test]
    fn every_kind_of_difference_is_named() {
        let (from, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let dir = dir.path();
        formats::native::write(&formats::tests::random_set(from.path(), 1, BoxConvention::Continuous), dir).unwrap();
        write(dir).unwrap();
        let clean = verify(dir).unwrap();
        assert!(clean.is_empty() && clean.files == 13, "{clean:?}");
        std::fs::remove_file(dir.join("train/00001.png")).unwrap();
        std::fs::write(dir.join("train/x.png"), "x").unwrap();
        files::write_atomically(dir.join("val.jsonl"), "").unwrap();
        let found = verify(dir).unwrap();
        assert_eq!(
            (found.missing, found.changed, found.unlisted),
            (vec!["train/00001.png".into()], vec!["val.jsonl".into()], vec!["train/x.png".into()])
        );
    }
}
