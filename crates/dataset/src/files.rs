//! Text files: read line by line with numbered errors, written under a temporary name and renamed.
use crate::error::DatasetError;
use serde::{Serialize, de::DeserializeOwned};
use std::{
    fs,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
};

/// Writes bytes so that the file is either the old one or the whole new one.
///
/// # Errors
/// If the folder cannot be written or the disk is full.
pub fn write_atomically(path: impl AsRef<Path>, bytes: impl AsRef<[u8]>) -> Result<(), DatasetError> {
    let path = path.as_ref();
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(".partial");
    let partial = path.with_file_name(name);
    fs::write(&partial, bytes).map_err(|e| DatasetError::io(&partial, e))?;
    fs::rename(&partial, path).map_err(|e| DatasetError::io(path, e))
}

/// Reads a text file.
///
/// # Errors
/// If it cannot be read or is not UTF-8.
pub fn read_text(path: impl AsRef<Path>) -> Result<String, DatasetError> {
    fs::read_to_string(path.as_ref()).map_err(|e| DatasetError::io(path, e))
}

/// The folder that holds a file: `.` for a bare name.
#[must_use]
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Creates a folder and those above it.
///
/// # Errors
/// If the system refuses.
pub fn create_dir(path: impl AsRef<Path>) -> Result<(), DatasetError> {
    fs::create_dir_all(path.as_ref()).map_err(|e| DatasetError::io(path, e))
}

/// Reads every line of a JSONL file; blank lines are passed over.
///
/// # Errors
/// If the file cannot be read, or a line does not parse (with its number).
pub fn read_jsonl<T: DeserializeOwned>(path: impl AsRef<Path>) -> Result<Vec<T>, DatasetError> {
    let path = path.as_ref();
    let file = fs::File::open(path).map_err(|e| DatasetError::io(path, e))?;
    let mut rows = Vec::new();
    for (k, line) in BufReader::new(file).lines().enumerate() {
        let line = line.map_err(|e| DatasetError::io(path, e))?;
        if !line.trim().is_empty() {
            rows.push(serde_json::from_str(&line).map_err(|e| DatasetError::line(path, k + 1, e))?);
        }
    }
    Ok(rows)
}

/// Writes one JSON line a row.
///
/// # Errors
/// If the folder cannot be written.
pub fn write_jsonl<'a, T: Serialize + 'a>(path: impl AsRef<Path>, rows: impl IntoIterator<Item = &'a T>) -> Result<(), DatasetError> {
    let path = path.as_ref();
    let mut text = Vec::new();
    for row in rows {
        serde_json::to_writer(&mut text, row).map_err(|e| DatasetError::line(path, 0, e))?;
        text.push(b'\n');
    }
    write_atomically(path, text)
}

/// Puts a file also under another name: as a hard link where the system can, else as a copy. Folders are made.
///
/// # Errors
/// If the source is missing or the folder cannot be written.
pub fn place(from: impl AsRef<Path>, to: impl AsRef<Path>) -> Result<(), DatasetError> {
    let (from, to) = (from.as_ref(), to.as_ref());
    if let Some(parent) = to.parent() {
        create_dir(parent)?;
    }
    if !from.is_file() {
        return Err(DatasetError::io(from, std::io::ErrorKind::NotFound.into()));
    }
    let _ = fs::remove_file(to);
    fs::hard_link(from, to).or_else(|_| fs::copy(from, to).map(|_| ())).map_err(|e| DatasetError::io(to, e))
}

/// BLAKE3 of a file's bytes, in hex.
///
/// # Errors
/// If it cannot be read.
pub fn digest(path: impl AsRef<Path>) -> Result<String, DatasetError> {
    let mut hasher = blake3::Hasher::new();
    let mut file = fs::File::open(path.as_ref()).map_err(|e| DatasetError::io(&path, e))?;
    std::io::copy(&mut file, &mut hasher).map_err(|e| DatasetError::io(&path, e))?;
    Ok(hasher.finalize().to_hex().to_string())
}

/// BLAKE3 of bytes, in hex.
#[must_use]
pub fn digest_bytes(bytes: impl AsRef<[u8]>) -> String {
    blake3::hash(bytes.as_ref()).to_hex().to_string()
}

/// The folder of reference material that larger tests compare with: `$TCROSS_SHARED`, else `../shared` beside the workspace.
/// Tests that need it are skipped, with a message, where it is absent.
#[must_use]
pub fn shared_dir() -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let named = std::env::var_os("TCROSS_SHARED").map(PathBuf::from);
    let found = named.into_iter().chain([beside]).find(|dir| dir.is_dir());
    if found.is_none() {
        eprintln!("skipped: no reference material; set TCROSS_SHARED to its folder");
    }
    found
}
