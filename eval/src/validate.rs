//! Scores in memory, fast enough for every epoch of a training.
use crate::{
    config::Config,
    matching::{Rule, match_image},
    protocol::{
        coco::{CocoCell, CocoClaim, CocoScores, CocoTruth, match_cell, score},
        paper::{Counts, MatchedImage, Row, Scores},
    },
};
use rayon::prelude::*;
use std::collections::HashMap;
use tcross_dataset::{Detection, ImageDetections, Marker, PixelBox, Record, dataset::BoxConvention};

/// What training watches. Undefined values are absent.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ValidationScores {
    /// COCO's average precision at IoU 0.5.
    pub ap50: Option<f64>,
    /// COCO's average precision, mean over IoU 0.50 to 0.95.
    pub ap: Option<f64>,
    /// The paper's mean IoU at the threshold: misses count as 0.
    pub mean_iou: Option<f64>,
    /// At the threshold.
    pub precision: Option<f64>,
    /// At the threshold.
    pub recall: Option<f64>,
    /// At the threshold.
    pub f1: Option<f64>,
    /// The threshold among 0.05, 0.10 .. 0.95 of highest F1 (of equals the lowest), and that F1.
    pub best_f1: Option<(f64, f64)>,
    /// Images scored.
    pub images: usize,
}

/// Scores detections against records. Images are joined by name; one that has no detections counts as empty.
///
/// `config` gives threshold, least IoU and classes; `boxes` how the dataset's boxes are to be read.
#[must_use]
pub fn validate(records: &[Record], detections: &[ImageDetections], boxes: BoxConvention, config: &Config) -> ValidationScores {
    let rule = Rule::from(config);
    let by_name: HashMap<&str, &[Detection]> = detections.iter().map(|d| (d.image.as_str(), d.detections.as_slice())).collect();
    let claimed = |r: &Record| by_name.get(r.image.as_str()).copied().unwrap_or(&[]);
    let images: Vec<MatchedImage> = records
        .par_iter()
        .map(|r| MatchedImage { markers: r.markers.len() as u32, claims: match_image(&r.markers, claimed(r), &rule) })
        .collect();
    let cells: Vec<Vec<CocoCell>> = records.par_iter().map(|r| coco_cells(&r.markers, claimed(r), boxes, &rule)).collect();
    let coco = score_native(cells);
    let at = Scores::new(&images, &[config.threshold], 0, 0).counts.pop().unwrap_or_default();
    let grid: Vec<f64> = (1..20).map(|k| f64::from(k) / 20.0).collect();
    let f1 = Scores::new(&images, &grid, 0, 0).counts.iter().map(Counts::f1).collect::<Vec<_>>();
    ValidationScores {
        ap50: coco.ap50,
        ap: coco.ap,
        mean_iou: at.mean_iou(),
        precision: at.precision(),
        recall: at.recall(),
        f1: at.f1(),
        best_f1: best_f1(&grid, &f1),
        images: records.len(),
    }
}

/// The threshold of highest F1; of equals the lowest.
#[must_use]
pub fn best_f1(thresholds: &[f64], f1: &[Option<f64>]) -> Option<(f64, f64)> {
    let known = thresholds.iter().zip(f1).filter_map(|(t, f)| Some((*t, (*f)?)));
    known.fold(None, |best, (t, f)| if best.is_none_or(|(_, b)| f > b) { Some((t, f)) } else { best })
}

/// The headline row of one set.
#[must_use]
pub fn row_at(images: &[MatchedImage], threshold: f64) -> Row {
    Scores::new(images, &[threshold], 0, 0).row(0)
}

/// COCO cells of one image, a class.
pub(crate) fn coco_cells(markers: &[Marker], detections: &[Detection], boxes: BoxConvention, rule: &Rule) -> Vec<CocoCell> {
    let extra = boxes.extra();
    let bbox = |b: &PixelBox| [b.x_min, b.y_min, b.width() + extra, b.height() + extra];
    let cell = |class: u32| {
        let truths: Vec<CocoTruth> = markers
            .iter()
            .filter(|m| rule.class_of(m) == Some(class))
            .map(|m| {
                let bbox = bbox(&m.bounds);
                CocoTruth { bbox, area: bbox[2] * bbox[3], crowd: false }
            })
            .collect();
        let claims: Vec<CocoClaim> = detections
            .iter()
            .filter(|d| rule.class_of_detection(d) == class)
            .map(|d| CocoClaim { bbox: bbox(&d.bounds), score: d.score })
            .collect();
        match_cell(&truths, &claims)
    };
    (0..rule.classes.len().max(1) as u32).map(cell).collect()
}

/// Scores `[image][class]` cells.
pub(crate) fn score_native(images: Vec<Vec<CocoCell>>) -> CocoScores {
    let classes = images.first().map_or(0, Vec::len);
    let mut categories: Vec<Vec<CocoCell>> = (0..classes).map(|_| Vec::with_capacity(images.len())).collect();
    for image in images {
        categories.iter_mut().zip(image).for_each(|(category, cell)| category.push(cell));
    }
    score(&categories)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(name: &str, boxes: &[[f64; 4]]) -> Record {
        let markers = boxes.iter().map(|b| Marker::from_box("t_cross", (*b).into())).collect();
        Record {
            image: name.into(),
            width: 100,
            height: 100,
            background: None,
            markers,
            confusers: Vec::new(),
            intrinsics: None,
            distortion: None,
            effects: serde_json::Map::new(),
        }
    }

    fn found(name: &str, claims: &[(f64, [f64; 4])]) -> ImageDetections {
        let detections = claims.iter().map(|(score, b)| Detection { score: *score, class: 0, bounds: (*b).into(), pose: None }).collect();
        ImageDetections { image: name.into(), width: 100, height: 100, detections, ms: None }
    }

    #[test]
    fn perfect_detections_score_one_and_none_score_zero() {
        let b = [10.0, 10.0, 40.0, 50.0];
        let records = [record("a", &[b]), record("b", &[])];
        let perfect = validate(&records, &[found("a", &[(0.9, b)])], BoxConvention::Continuous, &Config::default());
        assert!([perfect.ap50, perfect.ap].iter().all(|v| v.is_some_and(|v| (v - 1.0).abs() < 1e-12)));
        assert_eq!((perfect.mean_iou, perfect.precision, perfect.recall), (Some(1.0), Some(1.0), Some(1.0)));
        assert_eq!(perfect.best_f1, Some((0.05, 1.0)));
        let none = validate(&records, &[], BoxConvention::Continuous, &Config::default());
        assert_eq!((none.ap50, none.mean_iou, none.precision, none.recall), (Some(0.0), Some(0.0), None, Some(0.0)));
        assert_eq!(validate(&[], &[], BoxConvention::Continuous, &Config::default()), ValidationScores::default());
    }

    #[test]
    fn a_loose_box_is_found_by_the_paper_but_not_by_ap50() {
        let records = [record("a", &[[10.0, 10.0, 40.0, 40.0]])];
        let scores = validate(&records, &[found("a", &[(0.5, [20.0, 20.0, 50.0, 50.0])])], BoxConvention::Continuous, &Config::default());
        assert_eq!((scores.recall, scores.ap50), (Some(1.0), Some(0.0)));
    }
}
