//! Forms in which labelled pictures are kept: read and written, one a file.
//!
//! Between them stands [`Labelled`]: the pictures where they lie, and our records. A form that knows less than ours loses
//! what it cannot say (each module tells what); what it can say comes back unchanged.
pub mod coco;
pub mod native;
pub mod paper;
pub mod voc;
pub mod yolo;
pub mod yolo_pose;

use crate::{
    DatasetError, Marker, PixelBox, Record, Split,
    dataset::BoxConvention,
    files,
    geom::{
        homography::Homography,
        quad::{Quad, angle_deg},
    },
};
use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
    path::{Path, PathBuf},
    str::FromStr,
};

/// A form of labelled pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Ours.
    Native,
    /// YOLO's text files: class and box, normalised.
    Yolo,
    /// YOLO's with keypoints: the four corners and the centre.
    YoloPose,
    /// COCO's JSON: boxes, keypoints, masks.
    Coco,
    /// Pascal VOC's XML.
    Voc,
    /// The paper's lists.
    Paper,
}

impl Format {
    /// All of them.
    pub const ALL: [Self; 6] = [Self::Native, Self::Yolo, Self::YoloPose, Self::Coco, Self::Voc, Self::Paper];

    /// The word on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Native => "native",
            Self::Yolo => "yolo",
            Self::YoloPose => "yolo-pose",
            Self::Coco => "coco",
            Self::Voc => "voc",
            Self::Paper => "paper",
        }
    }

    /// The form of what lies in a folder, by its files.
    #[must_use]
    pub fn detect(dir: &Path) -> Option<Self> {
        let any = |names: &[&str]| names.iter().any(|n| dir.join(n).is_file());
        if any(&["train.jsonl", "val.jsonl", "test.jsonl"]) {
            Some(Self::Native)
        } else if dir.join("data.yaml").is_file() {
            Some(if yolo_pose::is_pose(dir) { Self::YoloPose } else { Self::Yolo })
        } else if dir.join("annotations").is_dir() {
            Some(Self::Coco)
        } else if dir.join("Annotations").is_dir() {
            Some(Self::Voc)
        } else if any(&["train.txt", "val.txt", "test.txt"]) {
            Some(Self::Paper)
        } else {
            None
        }
    }

    /// Reads a folder of this form.
    ///
    /// # Errors
    /// If a file is missing or a line is not of this form (with its number).
    pub fn read(self, dir: &Path) -> Result<Labelled, DatasetError> {
        match self {
            Self::Native => native::read(dir),
            Self::Yolo => yolo::read(dir),
            Self::YoloPose => yolo_pose::read(dir),
            Self::Coco => coco::read(dir),
            Self::Voc => voc::read(dir),
            Self::Paper => paper::read(dir),
        }
    }

    /// Writes a folder of this form; pictures are linked or copied.
    ///
    /// # Errors
    /// If a picture is missing or the folder cannot be written.
    pub fn write(self, set: &Labelled, out: &Path) -> Result<(), DatasetError> {
        files::create_dir(out)?;
        match self {
            Self::Native => native::write(set, out),
            Self::Yolo => yolo::write(set, out),
            Self::YoloPose => yolo_pose::write(set, out),
            Self::Coco => coco::write(set, out),
            Self::Voc => voc::write(set, out),
            Self::Paper => paper::write(set, out),
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Format {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        let names = || Self::ALL.map(Self::name).join(", ");
        Self::ALL.into_iter().find(|k| k.name() == s).ok_or_else(|| format!("unknown format '{s}': expected one of {}", names()))
    }
}

/// A picture where it lies, and its record. Written elsewhere, it is called by the last part of the record's `image`.
#[derive(Debug, Clone, PartialEq)]
pub struct Item {
    /// Where it lies.
    pub picture: PathBuf,
    /// What is on it.
    pub record: Record,
}

/// Labelled pictures, whatever form they were read from.
#[derive(Debug, Clone, PartialEq)]
pub struct Labelled {
    /// How the numbers of `box` are to be read.
    pub boxes: BoxConvention,
    /// A split's pictures, in the order they were found.
    pub splits: BTreeMap<Split, Vec<Item>>,
}

impl Labelled {
    /// Records whose pictures lie in `root` under the names they say.
    #[must_use]
    pub fn in_folder(root: &Path, boxes: BoxConvention, splits: BTreeMap<Split, Vec<Record>>) -> Self {
        let items = |rows: Vec<Record>| rows.into_iter().map(|record| Item { picture: root.join(&record.image), record }).collect();
        Self { boxes, splits: splits.into_iter().map(|(split, rows)| (split, items(rows))).collect() }
    }

    /// Every picture with its split.
    pub fn items(&self) -> impl Iterator<Item = (Split, &Item)> {
        self.splits.iter().flat_map(|(s, items)| items.iter().map(|i| (*s, i)))
    }

    /// Every record with its split.
    pub fn records(&self) -> impl Iterator<Item = (Split, &Record)> {
        self.items().map(|(s, i)| (s, &i.record))
    }

    /// Names of all shapes, sorted: the class numbers of forms that number them.
    #[must_use]
    pub fn shapes(&self) -> Vec<String> {
        let mut names: Vec<String> = self.records().flat_map(|(_, r)| r.markers.iter().map(|m| m.shape.clone())).collect();
        names.sort();
        names.dedup();
        names
    }

    /// The box in continuous pixels.
    #[must_use]
    pub fn continuous(&self, b: &PixelBox) -> PixelBox {
        let one = self.boxes.extra();
        PixelBox { x_max: b.x_max + one, y_max: b.y_max + one, ..*b }
    }

    /// The box as whole pixel indices, both ends in.
    #[must_use]
    pub fn inclusive(&self, b: &PixelBox) -> [i64; 4] {
        let c = self.continuous(b);
        let (x, y) = (c.x_min.round(), c.y_min.round());
        [x, y, (c.x_max.round() - 1.0).max(x), (c.y_max.round() - 1.0).max(y)].map(|v| v as i64)
    }

    /// Puts every picture under `name(split, record)` in `out`.
    fn place_pictures(&self, out: &Path, name: impl Fn(Split, &Record) -> PathBuf) -> Result<(), DatasetError> {
        self.items().try_for_each(|(split, i)| files::place(&i.picture, out.join(name(split, &i.record))))
    }
}

/// A set that grows picture by picture, with no name twice in a split.
#[derive(Debug)]
pub(crate) struct Gathering {
    set: Labelled,
    names: BTreeSet<(Split, String)>,
}

impl Gathering {
    /// Nothing yet.
    pub(crate) fn new(boxes: BoxConvention) -> Self {
        Self { set: Labelled { boxes, splits: BTreeMap::new() }, names: BTreeSet::new() }
    }

    /// Adds a picture under its own name or, where the split has one of that name, with `prefix` and a dash in front, as often as it takes.
    pub(crate) fn add(&mut self, split: Split, mut item: Item, prefix: &str) {
        while !self.names.insert((split, file_name(&item.record).to_owned())) {
            item.record.image = format!("{split}/{prefix}-{}", file_name(&item.record));
        }
        self.set.splits.entry(split).or_default().push(item);
    }

    /// The whole, each split in order of id: shorter names first, then by letters.
    pub(crate) fn finish(mut self) -> Labelled {
        for items in self.set.splits.values_mut() {
            items.sort_by_cached_key(|i| (file_name(&i.record).len(), file_name(&i.record).to_owned()));
        }
        self.set
    }
}

/// The last part of a record's picture: forms with a folder a split need no more.
fn file_name(record: &Record) -> &str {
    record.image.rsplit('/').next().unwrap_or(&record.image)
}

/// The file name without its ending.
fn stem(record: &Record) -> &str {
    let name = file_name(record);
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}

/// A record of which only the picture is known.
fn bare(image: String, (width, height): (u32, u32)) -> Record {
    Record {
        image,
        width,
        height,
        background: None,
        markers: Vec::new(),
        confusers: Vec::new(),
        intrinsics: None,
        distortion: None,
        effects: serde_json::Map::new(),
    }
}

/// Adds corners and centre, and what follows from them, to a marker.
fn with_geometry(mut marker: Marker, corners: Quad, center: Option<[f64; 2]>) -> Marker {
    let center = center.or_else(|| corners.diagonal_crossing());
    marker.corners = Some(corners);
    marker.center = center;
    marker.angle = center.map(|c| angle_deg(corners.0[0][0] - c[0], corners.0[0][1] - c[1]));
    marker.stem = Some(0);
    marker.homography = Homography::from_unit_square(&corners.0);
    marker
}

/// Pictures of a folder, sorted by name; not of the folders in it.
pub(crate) fn pictures_in(dir: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let entries = std::fs::read_dir(dir).map_err(|e| DatasetError::io(dir, e))?;
    let is_picture = |p: &PathBuf| {
        let ending = p.extension().and_then(|e| e.to_str()).unwrap_or_default().to_lowercase();
        ["jpg", "jpeg", "png", "webp"].contains(&ending.as_str())
    };
    let mut found: Vec<PathBuf> = entries.flatten().map(|e| e.path()).filter(is_picture).collect();
    found.sort();
    Ok(found)
}

/// A path relative to `root`, with `/`.
pub(crate) fn relative(path: &Path, root: &Path) -> String {
    let parts = path.strip_prefix(root).unwrap_or(path).components();
    parts.map(|c| c.as_os_str().to_string_lossy()).collect::<Vec<_>>().join("/")
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::Rng;

    /// A small set with pictures, drawn at random: markers with and without corners, an image without any.
    pub(crate) fn random_set(dir: &Path, seed: u64, boxes: BoxConvention) -> Labelled {
        let mut splits = BTreeMap::new();
        for (s, split) in Split::ALL.into_iter().enumerate() {
            let mut rows = Vec::new();
            for k in 0..3u64 {
                let mut rng = Rng::for_item(seed, "test/formats", s as u64 * 100 + k);
                let (width, height) = (rng.int(40, 90) as u32, rng.int(40, 90) as u32);
                let mut record = bare(format!("{split}/{k:05}.png"), (width, height));
                for m in 0..k {
                    let (x, y) = (rng.int(0, 10) as f64, rng.int(0, 10) as f64);
                    let marker = Marker::from_box(
                        ["star", "t_cross"][m as usize % 2],
                        [x, y, x + rng.int(4, 20) as f64, y + rng.int(4, 20) as f64].into(),
                    );
                    let corners = Quad([[x, y], [x + 12.5, y + 1.0], [x + 11.0, y + 14.25], [x + 0.5, y + 13.0]]);
                    record.markers.push(if m == 0 { with_geometry(marker, corners, None) } else { marker });
                }
                let path = dir.join(&record.image);
                files::create_dir(path.parent().unwrap()).unwrap();
                image::RgbImage::from_pixel(width, height, image::Rgb([90, 120, 30])).save(path).unwrap();
                rows.push(record);
            }
            splits.insert(split, rows);
        }
        Labelled::in_folder(dir, boxes, splits)
    }

    #[test]
    fn every_form_comes_back() {
        for boxes in [BoxConvention::Continuous, BoxConvention::Inclusive] {
            for format in Format::ALL {
                let (from, to) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
                let set = random_set(from.path(), 5, boxes);
                format.write(&set, to.path()).unwrap();
                assert_eq!(Format::detect(to.path()), Some(format));
                let back = format.read(to.path()).unwrap();
                for ((split, want), (split_back, got)) in set.records().zip(back.records()) {
                    assert_eq!((split, want.width, want.height), (split_back, got.width, got.height), "{format}");
                    assert!(to.path().join(&got.image).is_file(), "{format}: {}", got.image);
                    assert_eq!(want.markers.len(), got.markers.len(), "{format}: {}", want.image);
                    for (a, b) in want.markers.iter().zip(&got.markers) {
                        assert_eq!(a.shape, b.shape, "{format}");
                        let (p, q): ([f64; 4], [f64; 4]) = (set.continuous(&a.bounds).into(), back.continuous(&b.bounds).into());
                        assert!(p.iter().zip(q).all(|(p, q)| (p - q).abs() < 1e-6), "{format}: {p:?} {q:?}");
                        if matches!(format, Format::YoloPose | Format::Coco | Format::Native) {
                            assert_eq!(a.corners.is_some(), b.corners.is_some(), "{format}");
                            if let (Some(a), Some(b)) = (a.corners, b.corners) {
                                assert!(a.0.iter().flatten().zip(b.0.iter().flatten()).all(|(p, q)| (p - q).abs() < 1e-4), "{format}");
                            }
                        }
                    }
                }
                assert_eq!(set.records().count(), back.records().count());
            }
        }
    }
}
