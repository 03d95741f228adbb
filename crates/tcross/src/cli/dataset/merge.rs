//! `tcross dataset merge DIR...`: shards of one job become the very dataset that one run would have written.
use crate::{
    console,
    exit::{Failure, Outcome},
};
use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};
use tcross_datagen::Manifest;
use tcross_dataset::{Dataset, Split, digest, files, formats::Format, merge::merge};

pub const EXAMPLE: &str = "dataset merge shards/0 shards/1 shards/2 --out data/whole";

pub fn run(dirs: &[PathBuf], out: &Path) -> Outcome {
    let mut sets = Vec::new();
    for dir in dirs {
        super::must_exist(dir, "dataset")?;
        sets.push((dir.as_path(), Format::Native.read(dir)?));
    }
    let (merged, whole) = (merge(&sets)?, whole(dirs)?);
    Format::Native.write(&merged, out)?;
    if let Some(whole) = whole {
        write_lists(dirs, out)?;
        write_manifest(whole, out)?;
    }
    console::note(&format!("{}: {} images of {} datasets", out.display(), merged.records().count(), dirs.len()));
    Ok(())
}

/// The description of the whole, where all parts are shards of it and none is missing or there twice.
fn whole(dirs: &[PathBuf]) -> Outcome<Option<Manifest>> {
    let mut shards = Vec::new();
    for dir in dirs {
        let path = dir.join("dataset.toml");
        match path.is_file().then(|| files::read_text(&path)).transpose()?.and_then(|text| toml::from_str::<Manifest>(&text).ok()) {
            Some(manifest) => shards.push(manifest),
            None => return Ok(None),
        }
    }
    let Some(first) = shards.first().cloned() else { return Ok(None) };
    if first.shard.is_none() || shards.iter().any(|s| s.fingerprint != first.fingerprint) {
        return Ok(None);
    }
    let count = first.shard.map_or(0, |s| s[1]);
    let mut indices: Vec<[u64; 2]> = shards.iter().filter_map(|s| s.shard).collect();
    indices.sort_unstable();
    let complete: Vec<[u64; 2]> = (0..count).map(|k| [k, count]).collect();
    if indices != complete {
        let missing: Vec<String> = complete.iter().filter(|s| !indices.contains(s)).map(|s| format!("{}/{count}", s[0])).collect();
        let what = if missing.is_empty() { "a shard is given twice".into() } else { format!("shards {} are missing", missing.join(", ")) };
        return Err(Failure::new(format!("{} datasets are shards of one, but {what}; give each once", dirs.len())));
    }
    let mut whole = Manifest { shard: None, ..first };
    // Each shard has met only the broken photos that it drew on.
    let skipped: BTreeSet<&String> = shards.iter().flat_map(|s| &s.backgrounds.skipped).collect();
    whole.backgrounds.skipped = skipped.into_iter().cloned().collect();
    whole.markers = shards.iter().map(|s| s.markers).sum();
    whole.counts.clear();
    for (split, n) in shards.iter().flat_map(|s| &s.counts) {
        *whole.counts.entry(split.clone()).or_default() += n;
    }
    Ok(Some(whole))
}

/// The lists of all shards line by line, so that every number keeps the digits it was written with.
fn write_lists(dirs: &[PathBuf], out: &Path) -> Outcome {
    for split in Split::ALL {
        let name = format!("{split}.jsonl");
        let texts: Vec<String> =
            dirs.iter().map(|d| d.join(&name)).filter(|p| p.is_file()).map(files::read_text).collect::<Result<_, _>>()?;
        // A line begins with the picture's name, and names are ids.
        let mut lines: Vec<&str> = texts.iter().flat_map(|t| t.lines()).collect();
        lines.sort_by_key(|line| (line.find(',').unwrap_or(0), *line));
        if out.join(&name).is_file() {
            files::write_atomically(out.join(&name), lines.iter().map(|l| format!("{l}\n")).collect::<String>())?;
        }
    }
    Ok(())
}

fn write_manifest(mut manifest: Manifest, out: &Path) -> Outcome {
    manifest.digests = digest::of_dataset(&Dataset::open(out)?)?;
    tcross_datagen::card::write(&manifest, out)?;
    let text = toml::to_string(&manifest).map_err(|e| Failure::new(format!("{}: {e}", out.display())))?;
    Ok(files::write_atomically(out.join("dataset.toml"), text)?)
}
