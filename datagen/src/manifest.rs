//! `dataset.toml`: everything needed to make the dataset again, and the digests that say whether it is still the same.
use crate::{background::Backgrounds, config::Config};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use tcross_dataset::dataset::BoxConvention;

/// What `dataset.toml` holds.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Manifest {
    /// Version of the format: 1.
    pub format: u32,
    /// How the numbers of `box` are to be read.
    pub boxes: BoxConvention,
    /// `tcross datagen`.
    pub generator: String,
    /// Version of the program.
    pub version: String,
    /// Commit of the program, where it was known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub commit: Option<String>,
    /// The seed.
    pub seed: u64,
    /// Images of the whole dataset, over all shards.
    pub images: u64,
    /// Markers in the images written here.
    pub markers: u64,
    /// `[index, count]` where this is one of several shards.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shard: Option<[u64; 2]>,
    /// The one image that this is of a dataset.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub only: Option<u64>,
    /// Digest of config, seed, backgrounds and generator: equal fingerprints make equal bytes.
    pub fingerprint: String,
    /// Images a split, written here.
    pub counts: BTreeMap<String, u64>,
    /// A split's digest: BLAKE3 over the BLAKE3 digests (32 bytes each) of its picture files in order of id, followed by that of its list.
    pub digests: BTreeMap<String, String>,
    /// Where the backgrounds came from.
    pub backgrounds: BackgroundsEntry,
    /// The whole effective `[data]` section.
    pub config: Config,
}

/// The `[backgrounds]` table of `dataset.toml`.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct BackgroundsEntry {
    /// `embedded` or `photos`.
    pub kind: String,
    /// Number of photos.
    pub count: u64,
    /// Of the list of photos, or the version of the embedded scenes.
    pub digest: String,
    /// Photos that could not be read.
    pub skipped: Vec<String>,
    /// Photos that show nearly the same, group by group; each group stands in one split.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub near_duplicates: Vec<Vec<String>>,
}

impl BackgroundsEntry {
    pub(crate) fn of(backgrounds: &Backgrounds) -> Self {
        Self {
            kind: backgrounds.kind().into(),
            count: backgrounds.count() as u64,
            digest: backgrounds.digest(),
            skipped: backgrounds.skipped(),
            near_duplicates: backgrounds.near_duplicates(),
        }
    }
}

/// Version of the code that draws and encodes; moves with every change of a byte of a picture.
pub const DRAWING: u32 = 4;

/// Equal where the bytes of the dataset are equal (of the photos, names, sizes and first 64 KiB are looked at).
#[must_use]
pub fn fingerprint(config: &Config, seed: u64, backgrounds: &Backgrounds) -> String {
    let mut hasher = blake3::Hasher::new();
    let config = serde_json::to_string(config).unwrap_or_default();
    for part in [config.as_str(), &seed.to_string(), &backgrounds.digest(), &DRAWING.to_string()] {
        hasher.update(part.as_bytes()).update(b"\n");
    }
    hasher.finalize().to_hex()[..32].to_owned()
}
