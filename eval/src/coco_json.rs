//! COCO's own files: instances (truth) and results (detections), in and out.
use crate::{
    error::EvalError,
    matching::Rule,
    protocol::coco::{CocoCell, CocoClaim, CocoScores, CocoTruth, match_cell, score},
    truth::Truth,
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::{
    collections::{BTreeSet, HashMap},
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
    pub bbox: [f64; 4],
    /// In px squared.
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
    pub bbox: [f64; 4],
    /// 0..1.
    pub score: f64,
}

/// Reads a file of instances.
///
/// # Errors
/// If it cannot be read or does not hold the format's keys.
pub fn read_instances(path: impl AsRef<Path>) -> Result<Instances, EvalError> {
    read(path.as_ref())
}

/// Reads a file of results.
///
/// # Errors
/// If it cannot be read or does not hold the format's keys.
pub fn read_results(path: impl AsRef<Path>) -> Result<Vec<CocoResult>, EvalError> {
    read(path.as_ref())
}

fn read<T: DeserializeOwned>(path: &Path) -> Result<T, EvalError> {
    let text = files::read_text(path)?;
    serde_json::from_str(&text).map_err(|e| EvalError::Coco { path: path.to_owned(), message: e.to_string() })
}

/// Scores results, read from `path`, against instances. Results for a category that the instances lack are left out, as pycocotools does.
///
/// # Errors
/// If a result names an image that the instances lack.
pub fn score_instances(instances: &Instances, results: &[CocoResult], path: &Path) -> Result<CocoScores, EvalError> {
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
        let Some(image) = images.get(&r.image_id) else {
            let message = format!("result {k} is for image {}, which the instances lack", r.image_id);
            return Err(EvalError::Coco { path: path.to_owned(), message });
        };
        if let Some(c) = categories.get(&r.category_id) {
            claims.push((*c as u32, *image as u32, k as u32));
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
    Ok(score(&cells))
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
            let coco = score_instances(&serde_json::from_str(&text).unwrap(), &claims, Path::new("results.json")).unwrap();
            assert!(coco.ap.unwrap() > 0.0);
            assert_eq!((coco.ap, coco.ap50), (native.ap, native.ap50));
        }
    }

    #[test]
    fn an_unknown_image_is_an_error() {
        let result = CocoResult { image_id: 3, category_id: 1, bbox: [0.0; 4], score: 0.5 };
        let message = score_instances(&Instances::default(), &[result], Path::new("results.json")).unwrap_err().to_string();
        assert!(message.contains("image 3"), "{message}");
    }
}
