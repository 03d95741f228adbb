//! COCO's form: `SPLIT/x.jpg`, `annotations/instances_SPLIT.json` with boxes, keypoints (four corners, the stem's first, and
//! the centre) and masks (uncompressed run lengths over columns).
use super::{Labelled, bare, file_name, with_geometry};
use crate::{DatasetError, Marker, PixelBox, Record, Split, dataset::BoxConvention, files, geom::quad::Quad};
use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, path::Path};

#[derive(Serialize, Deserialize)]
struct File {
    images: Vec<Image>,
    annotations: Vec<Annotation>,
    categories: Vec<Category>,
}

#[derive(Serialize, Deserialize)]
struct Image {
    id: u64,
    file_name: String,
    width: u32,
    height: u32,
}

#[derive(Serialize, Deserialize)]
struct Annotation {
    id: u64,
    image_id: u64,
    category_id: u64,
    bbox: [f64; 4],
    area: f64,
    iscrowd: u8,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    keypoints: Vec<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    num_keypoints: Option<u32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    segmentation: Option<Segmentation>,
}

/// Run lengths, or anything else a foreign file has there.
#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum Segmentation {
    Runs { counts: Vec<u32>, size: [u32; 2] },
    Other(serde_json::Value),
}

#[derive(Serialize, Deserialize)]
struct Category {
    id: u64,
    name: String,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    keypoints: Vec<String>,
}

/// Writes it.
///
/// # Errors
/// If a picture is missing or the folder cannot be written.
pub fn write(set: &Labelled, out: &Path) -> Result<(), DatasetError> {
    let shapes = set.shapes();
    let keypoints = ["stem_corner", "corner_2", "corner_3", "corner_4", "center"].map(String::from).to_vec();
    set.place_pictures(out, |split, r| Path::new(split.name()).join(file_name(r)))?;
    files::create_dir(out.join("annotations"))?;
    for (split, rows) in &set.splits {
        let categories =
            shapes.iter().zip(1..).map(|(name, id)| Category { id, name: name.clone(), keypoints: keypoints.clone() }).collect();
        let mut file = File { images: Vec::new(), annotations: Vec::new(), categories };
        for (record, id) in rows.iter().map(|i| &i.record).zip(1..) {
            file.images.push(Image { id, file_name: file_name(record).into(), width: record.width, height: record.height });
            for marker in &record.markers {
                let next = file.annotations.len() as u64 + 1;
                let category = shapes.binary_search(&marker.shape).unwrap_or(0) as u64 + 1;
                file.annotations.push(annotation(set, record, marker, next, id, category));
            }
        }
        let path = out.join(format!("annotations/instances_{split}.json"));
        files::write_atomically(&path, serde_json::to_vec(&file).map_err(|e| DatasetError::line(&path, 1, e))?)?;
    }
    Ok(())
}

fn annotation(set: &Labelled, record: &Record, marker: &Marker, id: u64, image_id: u64, category_id: u64) -> Annotation {
    let b = set.continuous(&marker.bounds);
    let size = (record.width as usize, record.height as usize);
    // COCO's keypoints: x, y and 2 where it is known, else three zeros.
    let known = |p: [f64; 2]| [p[0], p[1], 2.0];
    let center = marker.center.map_or([0.0; 3], known);
    let points: Vec<[f64; 3]> = marker.corners.map(|q| q.0.into_iter().map(known).chain([center]).collect()).unwrap_or_default();
    let counts = marker.mask.as_ref().map(|runs| encode(&transpose(&decode(runs, size.0 * size.1), size)));
    let covered = marker.mask.as_ref().map(|runs| runs.iter().skip(1).step_by(2).map(|n| f64::from(*n)).sum());
    Annotation {
        id,
        image_id,
        category_id,
        bbox: [b.x_min, b.y_min, b.width(), b.height()],
        area: covered.unwrap_or_else(|| b.area()),
        iscrowd: 0,
        num_keypoints: (!points.is_empty()).then(|| points.iter().filter(|p| p[2] > 0.0).count() as u32),
        keypoints: points.concat(),
        segmentation: counts.map(|counts| Segmentation::Runs { counts, size: [record.height, record.width] }),
    }
}

/// Reads it. Foreign polygons are passed over; boxes and keypoints of our five points are taken.
///
/// # Errors
/// If no annotations are there, a file does not parse, or an annotation names an image or a category that is not there.
pub fn read(dir: &Path) -> Result<Labelled, DatasetError> {
    let mut splits = BTreeMap::new();
    for split in Split::ALL {
        let path = dir.join(format!("annotations/instances_{split}.json"));
        if path.is_file() {
            splits.insert(split, split_records(&path, split)?);
        }
    }
    if splits.is_empty() {
        return Err(DatasetError::unfit(
            dir.join("annotations"),
            "no list",
            "instances_train.json, instances_val.json or instances_test.json",
        ));
    }
    Ok(Labelled::in_folder(dir, BoxConvention::Continuous, splits))
}

fn split_records(path: &Path, split: Split) -> Result<Vec<Record>, DatasetError> {
    let file: File = serde_json::from_str(&files::read_text(path)?).map_err(|e| DatasetError::line(path, e.line(), e))?;
    let names: BTreeMap<u64, &str> = file.categories.iter().map(|c| (c.id, c.name.as_str())).collect();
    let index: BTreeMap<u64, usize> = file.images.iter().enumerate().map(|(k, i)| (i.id, k)).collect();
    let mut records: Vec<Record> = file.images.iter().map(|i| bare(format!("{split}/{}", i.file_name), (i.width, i.height))).collect();
    for a in file.annotations {
        let unknown =
            |what: &str, id: u64| DatasetError::unfit(path, format!("annotation {} of {what} {id}", a.id), format!("a {what} of the list"));
        let shape = names.get(&a.category_id).ok_or_else(|| unknown("category", a.category_id))?;
        let record = index.get(&a.image_id).map(|k| &mut records[*k]).ok_or_else(|| unknown("image", a.image_id))?;
        let [x, y, w, h] = a.bbox;
        if !(a.bbox.iter().all(|v| v.is_finite()) && w >= 0.0 && h >= 0.0) {
            return Err(DatasetError::unfit(
                path,
                format!("annotation {} with box {:?}", a.id, a.bbox),
                "x, y, width, height, not negative",
            ));
        }
        let mut marker = Marker::from_box(*shape, PixelBox { x_min: x, y_min: y, x_max: x + w, y_max: y + h });
        if let [points @ .., center] = a.keypoints.chunks_exact(3).collect::<Vec<_>>().as_slice()
            && let [a, b, c, d] = points
            && points.iter().chain([center]).all(|p| p[2] > 0.0)
        {
            let at = |p: &[f64]| [p[0], p[1]];
            marker = with_geometry(marker, Quad([at(a), at(b), at(c), at(d)]), Some(at(center)));
        }
        if let Some(Segmentation::Runs { counts, size: [height, width] }) = a.segmentation {
            if (width, height) != (record.width, record.height) {
                let allowed = format!("{} x {}, its image's size", record.width, record.height);
                return Err(DatasetError::unfit(path, format!("annotation {} with a mask of {width} x {height}", a.id), allowed));
            }
            let (w, h) = (width as usize, height as usize);
            marker.mask = Some(encode(&transpose(&decode(&counts, w * h), (h, w))));
        }
        record.markers.push(marker);
    }
    Ok(records)
}

/// Runs `[skip, take, ...]` as one flag a pixel.
fn decode(runs: &[u32], pixels: usize) -> Vec<bool> {
    let mut flags: Vec<bool> =
        runs.iter().enumerate().flat_map(|(k, n)| std::iter::repeat_n(k % 2 == 1, *n as usize)).take(pixels).collect();
    flags.resize(pixels, false);
    flags
}

/// Flags as runs `[skip, take, ...]`; trailing unset pixels are a run too, as COCO has it.
fn encode(flags: &[bool]) -> Vec<u32> {
    let mut runs = vec![0];
    let mut now = false;
    for flag in flags {
        if *flag != now {
            now = *flag;
            runs.push(0);
        }
        if let Some(last) = runs.last_mut() {
            *last += 1;
        }
    }
    runs
}

/// Rows to columns, for an image of this width and height.
fn transpose(flags: &[bool], (w, h): (usize, usize)) -> Vec<bool> {
    (0..w).flat_map(|x| (0..h).map(move |y| (x, y))).map(|(x, y)| flags[y * w + x]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_turn_and_come_back() {
        let mut rng = crate::Rng::for_item(3, "test/mask", 0);
        for _ in 0..50 {
            let (w, h) = (rng.int(1, 9) as usize, rng.int(1, 9) as usize);
            let flags: Vec<bool> = (0..w * h).map(|_| rng.chance(0.4)).collect();
            assert_eq!(decode(&encode(&flags), w * h), flags);
            assert_eq!(transpose(&transpose(&flags, (w, h)), (h, w)), flags);
        }
        assert_eq!(encode(&[true, false, false]), [0, 1, 2]);
    }

    #[test]
    fn strangers_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir(dir.path().join("annotations")).unwrap();
        let path = dir.path().join("annotations/instances_val.json");
        std::fs::write(&path, r#"{"images":[],"annotations":[{"id":7,"image_id":3,"category_id":1,"bbox":[0,0,1,1],"area":1,"iscrowd":0}],"categories":[{"id":1,"name":"x"}]}"#).unwrap();
        assert!(read(dir.path()).unwrap_err().to_string().contains("annotation 7 of image 3"));
    }
}
