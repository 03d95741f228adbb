//! Where images come from: files, folders, a dataset's split. Unreadable ones are skipped with a warning and counted.
use crate::error::InferError;
use image::RgbImage;
use std::path::{Path, PathBuf};
use tcross_dataset::{Dataset, Split, picture};

/// Endings of the files that count as images in a folder.
const ENDINGS: [&str; 4] = ["jpg", "jpeg", "png", "webp"];

/// One image to look at.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Item {
    /// What stands in the detections file: the record's path in a dataset, relative to a folder, else the path as given.
    pub name: String,
    /// The file.
    pub path: PathBuf,
}

/// Images in the order in which they are looked at.
#[derive(Debug, Clone, Default)]
pub struct Source {
    /// Every image.
    pub items: Vec<Item>,
}

impl Source {
    /// Gathers the images of the inputs: files as given; a dataset (a folder with a list) as its split, `test` unless
    /// named; any other folder with everything below it, in order of name.
    ///
    /// # Errors
    /// If an input does not exist or holds no image, or a dataset has no such split.
    pub fn open<P: AsRef<Path>>(inputs: &[P], split: Option<Split>) -> Result<Self, InferError> {
        let mut items = Vec::new();
        for input in inputs {
            let path = input.as_ref();
            let kind = std::fs::metadata(path).map_err(|e| InferError::io(path, e))?;
            if !kind.is_dir() {
                if !is_image(path) {
                    return Err(InferError::Input { path: path.to_owned(), found: "a file of another kind" });
                }
                items.push(Item { name: path.to_string_lossy().replace('\\', "/"), path: path.to_owned() });
            } else if split.is_some() || Split::ALL.iter().any(|s| path.join(format!("{s}.jsonl")).is_file()) {
                let dataset = Dataset::open(path)?;
                for record in dataset.records(split.unwrap_or(Split::Test))? {
                    items.push(Item { path: dataset.image_path(&record), name: record.image });
                }
            } else {
                let before = items.len();
                folder(path, path, &mut items)?;
                if items.len() == before {
                    return Err(InferError::Input { path: path.to_owned(), found: "a folder without images" });
                }
            }
        }
        Ok(Self { items })
    }
}

fn is_image(path: &Path) -> bool {
    path.extension().and_then(|e| e.to_str()).is_some_and(|e| ENDINGS.contains(&e.to_ascii_lowercase().as_str()))
}

fn folder(root: &Path, at: &Path, items: &mut Vec<Item>) -> Result<(), InferError> {
    let entries = std::fs::read_dir(at).map_err(|e| InferError::io(at, e))?;
    let mut paths = entries.map(|e| e.map(|e| e.path())).collect::<Result<Vec<_>, _>>().map_err(|e| InferError::io(at, e))?;
    paths.sort();
    for path in paths {
        if path.is_dir() {
            folder(root, &path, items)?;
        } else if is_image(&path) {
            let name = path.strip_prefix(root).unwrap_or(&path).to_string_lossy().replace('\\', "/");
            items.push(Item { name, path });
        }
    }
    Ok(())
}

/// Reads an image as a person sees it: its EXIF orientation applied, any colour type turned into RGB.
///
/// # Errors
/// If it cannot be read or has no pixels.
pub fn read_image(path: &Path) -> Result<RgbImage, InferError> {
    Ok(picture::read(path)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_walked_in_order_of_name() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir(dir.path().join("b")).unwrap();
        for name in ["c.png", "b/x.JPG", "a.webp", "notes.txt"] {
            std::fs::write(dir.path().join(name), "").unwrap();
        }
        let source = Source::open(&[dir.path()], None).unwrap();
        assert_eq!(source.items.iter().map(|i| i.name.as_str()).collect::<Vec<_>>(), ["a.webp", "b/x.JPG", "c.png"]);
        assert!(read_image(&source.items[0].path).is_err());
        assert!(matches!(Source::open(&[dir.path().join("notes.txt")], None), Err(InferError::Input { .. })));
        assert!(matches!(Source::open(&[dir.path().join("none.png")], None), Err(InferError::Io { .. })));
        assert!(matches!(Source::open(&[dir.path()], Some(Split::Val)), Err(InferError::Dataset(_))));
    }
}
