//! COCO's own files: instances (truth) and results (detections), in and out.
use crate::{
    error::EvalError,
    input::{Fault, Problem, ProblemCounts, ProblemKind, bad_score, counted, without_nan},
    matching::Rule,
    protocol::coco::{CocoCell, CocoClaim, CocoScores, CocoTruth, match_cell, score},
    truth::Truth,
};
use rayon::prelude::*;
use serde::{Deserialize, Deserializer, Serialize, de::DeserializeOwned};
use std::{
    collections::{BTreeSet, HashMap, HashSet},
    path::Path,
};
use tcross_dataset::{Detection, files};

/// A file of instances. What scoring does not need is passed over when reading.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Instances {
    /// Every image that is scored.
    pub images: Vec<CocoImage>,
    /// Every category that is scored.
    pub categories: Vec<CocoCategory>,
    /// The truth.
    pub annotations: Vec<CocoAnnotation>,
}

/// An image.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CocoImage {
    /// By which annotations and results name it.
    pub id: u64,
    /// In pixels.
    #[serde(default)]
    pub width: u32,
    /// In pixels.
    #[serde(default)]
    pub height: u32,
    /// Relative to the dataset's folder.
    #[serde(default)]
    pub file_name: String,
}

/// A category.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CocoCategory {
    /// By which annotations and results name it.
    pub id: u64,
    /// In words.
    #[serde(default)]
    pub name: String,
}

/// A true box.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CocoAnnotation {
    /// Its own number.
    #[serde(default)]
    pub id: u64,
    /// The image's id.
    pub image_id: u64,
    /// The category's id.
    pub category_id: u64,
    /// Left, upper, width, height in pixels.
    #[serde(deserialize_with = "numbers")]
    pub bbox: [f64; 4],
    /// In px squared.
    #[serde(deserialize_with = "number")]
    pub area: f64,
    /// 1 for a region of many objects.
    #[serde(default)]
    pub iscrowd: u8,
}

/// A claimed box.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CocoResult {
    /// The image's id.
    pub image_id: u64,
    /// The category's id.
    pub category_id: u64,
    /// Left, upper, width, height in pixels.
    #[serde(deserialize_with = "numbers")]
    pub bbox: [f64; 4],
    /// 0..1.
    #[serde(deserialize_with = "number")]
    pub score: f64,
}

/// Reads a file of instances. Faults are errors or, with `lenient`, left out and counted.
///
/// # Errors
/// If it cannot be read or does not hold the format's keys; unless `lenient`, if two images or categories have one id, or an annotation is
/// of none of them or has a reversed box.
pub fn read_instances(path: impl AsRef<Path>, lenient: bool) -> Result<(Instances, ProblemCounts), EvalError> {
    let path = path.as_ref();
    let mut instances: Instances = read(path)?;
    let mut problems = Vec::new();
    let (mut images, mut categories) = (HashSet::new(), HashSet::new());
    let twice = |id: u64, seen: &mut HashSet<u64>| {
        (!seen.insert(id)).then(|| (ProblemKind::DuplicateId, format!("id {id}, which an earlier one has already")))
    };
    sift(&mut instances.images, "image", path, &mut problems, |image| twice(image.id, &mut images));
    sift(&mut instances.categories, "category", path, &mut problems, |category| twice(category.id, &mut categories));
    sift(&mut instances.annotations, "annotation", path, &mut problems, |a| {
        unknown(&images, &categories, a.image_id, a.category_id).or_else(|| bad_box(&a.bbox)).or_else(|| bad_area(a.area))
    });
    let counts = counted(&problems, lenient)?;
    Ok((instances, counts))
}

/// Reads a file of results for these instances. Faults are errors or, with `lenient`, left out and counted.
///
/// # Errors
/// If it cannot be read or does not hold the format's keys; unless `lenient`, if a result is of an image or a category that the instances
/// lack, or has a reversed box or a score that is not in 0..1.
pub fn read_results(path: impl AsRef<Path>, instances: &Instances, lenient: bool) -> Result<(Vec<CocoResult>, ProblemCounts), EvalError> {
    let path = path.as_ref();
    let mut results: Vec<CocoResult> = read(path)?;
    let images: HashSet<u64> = instances.images.iter().map(|i| i.id).collect();
    let categories: HashSet<u64> = instances.categories.iter().map(|c| c.id).collect();
    let mut problems = Vec::new();
    sift(&mut results, "result", path, &mut problems, |r| {
        unknown(&images, &categories, r.image_id, r.category_id).or_else(|| bad_box(&r.bbox)).or_else(|| bad_score(r.score))
    });
    let counts = counted(&problems, lenient)?;
    Ok((results, counts))
}

fn read<T: DeserializeOwned>(path: &Path) -> Result<T, EvalError> {
    let text = files::read_text(path)?;
    let parsed = serde_json::from_str(&text).or_else(|e| without_nan(&text).map_or(Err(e), |text| serde_json::from_str(&text)));
    parsed.map_err(|e| EvalError::Coco { path: path.to_owned(), message: e.to_string() })
}

/// `null`, which stands for what JSON has no number for, as NaN.
fn number<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(from)?.unwrap_or(f64::NAN))
}

fn numbers<'de, D: Deserializer<'de>>(from: D) -> Result<[f64; 4], D::Error> {
    Ok(<[Option<f64>; 4]>::deserialize(from)?.map(|v| v.unwrap_or(f64::NAN)))
}

/// Takes out of a file's list what has a fault, and notes it with its place in the list, from 0.
fn sift<T>(list: &mut Vec<T>, what: &str, path: &Path, problems: &mut Vec<Problem>, mut fault: impl FnMut(&T) -> Option<Fault>) {
    let mut index = 0;
    list.retain(|item| {
        let found = fault(item);
        let keep = found.is_none();
        problems.extend(found.map(|(kind, message)| Problem {
            kind,
            path: path.to_owned(),
            line: 0,
            message: format!("{what} {index}: {message}"),
        }));
        index += 1;
        keep
    });
}

fn unknown(images: &HashSet<u64>, categories: &HashSet<u64>, image: u64, category: u64) -> Option<Fault> {
    let lacks = |kind, what: &str, id| Some((kind, format!("is of {what} {id}, which the instances lack")));
    match (images.contains(&image), categories.contains(&category)) {
        (false, _) => lacks(ProblemKind::UnknownImage, "image", image),
        (_, false) => lacks(ProblemKind::UnknownCategory, "category", category),
        _ => None,
    }
}

/// A box may have no area, as pycocotools allows.
fn bad_box(bbox: &[f64; 4]) -> Option<Fault> {
    let good = bbox.iter().all(|v| v.is_finite()) && bbox[2] >= 0.0 && bbox[3] >= 0.0;
    (!good).then(|| (ProblemKind::BadBox, format!("bbox {bbox:?}: allowed are finite numbers, width and height from 0")))
}

fn bad_area(area: f64) -> Option<Fault> {
    let good = area >= 0.0 && area.is_finite();
    (!good).then(|| (ProblemKind::BadBox, format!("area {area}: allowed is a finite number from 0")))
}

/// Scores results against instances; what the instances lack is passed over.
#[must_use]
pub fn score_instances(instances: &Instances, results: &[CocoResult]) -> CocoScores {
    let sorted = |ids: BTreeSet<u64>| -> HashMap<u64, usize> { ids.into_iter().enumerate().map(|(k, id)| (id, k)).collect() };
    let images = sorted(instances.images.iter().map(|i| i.id).collect());
    let categories = sorted(instances.categories.iter().map(|c| c.id).collect());
    // (category, image, position in the file) of every box that is scored; sorted, the boxes of one cell stand together.
    let mut truths: Vec<(u32, u32, u32)> = Vec::with_capacity(instances.annotations.len());
    for (k, a) in instances.annotations.iter().enumerate() {
        if let (Some(c), Some(i)) = (categories.get(&a.category_id), images.get(&a.image_id)) {
            truths.push((*c as u32, *i as u32, k as u32));
        }
    }
    let mut claims: Vec<(u32, u32, u32)> = Vec::with_capacity(results.len());
    for (k, r) in results.iter().enumerate() {
        if let (Some(c), Some(i)) = (categories.get(&r.category_id), images.get(&r.image_id)) {
            claims.push((*c as u32, *i as u32, k as u32));
        }
    }
    truths.par_sort_unstable();
    claims.par_sort_unstable();
    let category = |c: u32| -> Vec<CocoCell> {
        let part = |all: &[(u32, u32, u32)]| all.partition_point(|x| x.0 < c)..all.partition_point(|x| x.0 <= c);
        let (mut t, mut d) = (&truths[part(&truths)], &claims[part(&claims)]);
        let mut cells = Vec::new();
        while let Some(image) = t.first().map(|x| x.1).into_iter().chain(d.first().map(|x| x.1)).min() {
            let (ts, dn) = (t.partition_point(|x| x.1 == image), d.partition_point(|x| x.1 == image));
            let boxes: Vec<CocoTruth> = t[..ts]
                .iter()
                .map(|x| &instances.annotations[x.2 as usize])
                .map(|a| CocoTruth { bbox: a.bbox, area: a.area, crowd: a.iscrowd != 0 })
                .collect();
            let claimed: Vec<CocoClaim> =
                d[..dn].iter().map(|x| &results[x.2 as usize]).map(|r| CocoClaim { bbox: r.bbox, score: r.score }).collect();
            cells.push(match_cell(&boxes, &claimed));
            (t, d) = (&t[ts..], &d[dn..]);
        }
        cells
    };
    let cells: Vec<Vec<CocoCell>> = (0..categories.len() as u32).into_par_iter().map(category).collect();
    score(&cells)
}

/// The truth as instances: image ids are positions in the truth, from 1; so are category ids.
#[must_use]
pub fn instances(truth: &Truth, rule: &Rule) -> Instances {
    let extra = truth.boxes.extra();
    let mut out = Instances::default();
    let names = if rule.classes.is_empty() { vec!["marker".to_owned()] } else { rule.classes.clone() };
    out.categories = names.into_iter().enumerate().map(|(k, name)| CocoCategory { id: k as u64 + 1, name }).collect();
    for (k, record) in truth.records.iter().enumerate() {
        let image_id = k as u64 + 1;
        out.images.push(CocoImage { id: image_id, width: record.width, height: record.height, file_name: record.image.clone() });
        for marker in &record.markers {
            if let Some(class) = rule.class_of(marker) {
                let b = &marker.bounds;
                let bbox = [b.x_min, b.y_min, b.width() + extra, b.height() + extra];
                let id = out.annotations.len() as u64 + 1;
                let area = bbox[2] * bbox[3];
                out.annotations.push(CocoAnnotation { id, image_id, category_id: u64::from(class) + 1, bbox, area, iscrowd: 0 });
            }
        }
    }
    out
}

/// The detections of image number `index` of the truth as results, with the ids of [`instances`].
#[must_use]
pub fn results(truth: &Truth, rule: &Rule, index: usize, detections: &[Detection]) -> Vec<CocoResult> {
    let extra = truth.boxes.extra();
    let result = |d: &Detection| CocoResult {
        image_id: index as u64 + 1,
        category_id: u64::from(rule.class_of_detection(d)) + 1,
        bbox: [d.bounds.x_min, d.bounds.y_min, d.bounds.width() + extra, d.bounds.height() + extra],
        score: d.score,
    };
    detections.iter().map(result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::validate;
    use tcross_dataset::{ImageDetections, Record, Rng, dataset::BoxConvention};

    #[test]
    fn native_records_and_their_coco_files_score_alike() {
        let mut records: Vec<Record> = Vec::new();
        let mut found: Vec<ImageDetections> = Vec::new();
        for k in 0..40 {
            let mut rng = Rng::for_item(9, "eval/test/coco-json", k);
            let name = format!("{k}");
            let mut draw = |n: usize| -> Vec<[f64; 4]> {
                (0..n)
                    .map(|_| (rng.uniform(0.0, 50.0), rng.uniform(0.0, 50.0), rng.uniform(5.0, 60.0)))
                    .map(|(x, y, s)| [x, y, x + s, y + s])
                    .collect()
            };
            let (truths, claims) = (draw(k as usize % 4), draw(5));
            let markers: Vec<_> = truths.iter().map(|b| serde_json::json!({"shape": "t_cross", "box": b})).collect();
            records
                .push(serde_json::from_value(serde_json::json!({"image": name, "width": 100, "height": 100, "markers": markers})).unwrap());
            let claims: Vec<_> =
                claims.iter().map(|b| serde_json::json!({"score": (b[0] * 10.0).floor() / 500.0, "class": 0, "box": b})).collect();
            found.push(
                serde_json::from_value(serde_json::json!({"image": name, "width": 100, "height": 100, "detections": claims})).unwrap(),
            );
        }
        let rule = Rule::default();
        for boxes in [BoxConvention::Continuous, BoxConvention::Inclusive] {
            let truth = Truth::new(records.clone(), boxes, None);
            let native = validate(&records, &found, boxes, &crate::Config::default());
            let instances = instances(&truth, &rule);
            let claims: Vec<_> = found.iter().enumerate().flat_map(|(k, d)| results(&truth, &rule, k, &d.detections)).collect();
            let text = serde_json::to_string(&instances).unwrap();
            let coco = score_instances(&serde_json::from_str(&text).unwrap(), &claims);
            assert!(coco.ap.unwrap() > 0.0);
            assert_eq!((coco.ap, coco.ap50), (native.ap, native.ap50));
        }
    }

    const IMAGES: &str = r#"[{"id":1,"width":90,"height":90},{"id":2}]"#;
    const CATEGORIES: &str = r#"[{"id":1,"name":"marker"}]"#;

    /// A good entry, then one that each change of it makes bad.
    fn file(dir: &Path, instances: bool, entry: &str, from: &str, to: &str) -> std::path::PathBuf {
        let list = format!("[{entry},{}]", entry.replacen(from, to, 1));
        let text = if instances { format!(r#"{{"images":{IMAGES},"categories":{CATEGORIES},"annotations":{list}}}"#) } else { list };
        let path = dir.join("coco.json");
        std::fs::write(&path, text).unwrap();
        path
    }

    #[test]
    fn faults_are_errors_with_an_index_or_counted() {
        let dir = tempfile::tempdir().unwrap();
        let annotation = r#"{"image_id":1,"category_id":1,"bbox":[5,5,0,20],"area":0,"iscrowd":0}"#;
        for (from, to, words, kind) in [
            ("\"image_id\":1", "\"image_id\":3", "annotation 1: is of image 3", ProblemKind::UnknownImage),
            ("\"category_id\":1", "\"category_id\":9", "annotation 1: is of category 9", ProblemKind::UnknownCategory),
            ("0,20]", "0,-20]", "annotation 1: bbox [5.0, 5.0, 0.0, -20.0]", ProblemKind::BadBox),
            ("\"area\":0", "\"area\":-1", "annotation 1: area -1", ProblemKind::BadBox),
        ] {
            let path = file(dir.path(), true, annotation, from, to);
            let message = read_instances(&path, false).unwrap_err().to_string();
            assert!(message.contains("coco.json: ") && message.contains(words), "{message}");
            let (instances, counts) = read_instances(&path, true).unwrap();
            assert_eq!((instances.annotations.len(), counts), (1, ProblemCounts::from([(kind, 1)])));
        }
        let path = file(dir.path(), true, annotation, "", "");
        let good = read_instances(&path, false).unwrap().0;
        assert_eq!(good.annotations.len(), 2);
        let text = std::fs::read_to_string(&path).unwrap();
        for (from, to, words) in [("{\"id\":2}", "{\"id\":1}", "image 1: id 1"), (CATEGORIES, r#"[{"id":1},{"id":1}]"#, "category 1: id 1")]
        {
            std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
            let message = read_instances(&path, false).unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
            let (instances, counts) = read_instances(&path, true).unwrap();
            assert_eq!((instances.annotations.len(), counts), (2, ProblemCounts::from([(ProblemKind::DuplicateId, 1)])));
        }
        let result = r#"{"image_id":1,"category_id":1,"bbox":[5,5,0,20],"score":0.5}"#;
        for (from, to, words, kind) in [
            ("\"image_id\":1", "\"image_id\":3", "result 1: is of image 3", ProblemKind::UnknownImage),
            ("\"category_id\":1", "\"category_id\":9", "result 1: is of category 9", ProblemKind::UnknownCategory),
            ("[5,5", "[5,NaN", "result 1: bbox [5.0, NaN", ProblemKind::BadBox),
            ("0.5", "1.5", "result 1: score 1.5", ProblemKind::BadScore),
            ("0.5", "-Infinity", "result 1: score NaN", ProblemKind::BadScore),
        ] {
            let path = file(dir.path(), false, result, from, to);
            let message = read_results(&path, &good, false).unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
            let (results, counts) = read_results(&path, &good, true).unwrap();
            assert_eq!((results.len(), counts), (1, ProblemCounts::from([(kind, 1)])));
        }
    }
}
