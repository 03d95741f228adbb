//! `stages.toml`: what each stage was made from, so that what still matches is skipped.
use crate::exit::{Failure, Outcome};
use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, path::PathBuf};
use tcross_dataset::files;

/// One stage of one row.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// Digest of everything its result depends on.
    pub inputs: String,
    /// Digest of its files; absent while it is not finished.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outputs: Option<String>,
    /// How long it took.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
}

/// The file, written after every change.
pub struct Ledger {
    path: PathBuf,
    entries: BTreeMap<String, Entry>,
}

impl Ledger {
    /// Opens the file, or starts an empty one.
    pub fn open(path: PathBuf) -> Outcome<Self> {
        let entries = if path.is_file() {
            let text = files::read_text(&path)?;
            toml::from_str(&text)
                .map_err(|e| Failure::new(format!("{}: {}; delete it to do every stage again", path.display(), e.message())))?
        } else {
            BTreeMap::new()
        };
        Ok(Self { path, entries })
    }

    pub fn get(&self, key: &str) -> Option<&Entry> {
        self.entries.get(key)
    }

    pub fn set(&mut self, key: &str, entry: Entry) -> Outcome {
        self.entries.insert(key.to_owned(), entry);
        let text = toml::to_string(&self.entries).map_err(|e| Failure::new(format!("{}: {e}", self.path.display())))?;
        Ok(files::write_atomically(&self.path, text)?)
    }

    /// Stages and the digests of what they made, in order of name.
    pub fn digests(&self) -> impl Iterator<Item = (&str, &str)> {
        self.entries.iter().filter_map(|(k, e)| Some((k.as_str(), e.outputs.as_deref()?)))
    }

    /// Stages and how long each took, in order of name.
    pub fn times(&self) -> impl Iterator<Item = (&str, f64)> {
        self.entries.iter().filter_map(|(k, e)| Some((k.as_str(), e.seconds?)))
    }
}
