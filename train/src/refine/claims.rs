//! What the second stage learns from: what the finished detector claims in the training images, and what it might have claimed.
use crate::{data::evenly, error::TrainError};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};
use tcross_dataset::{Dataset, PixelBox, Record, Split, geom::boxes::iou, picture};
use tcross_yolo::{
    DetectOptions, Detector,
    refiner::{self, LEAST_SCORE, Patch, polar},
};

/// From this IoU with a marker on, a claim means it, and learns its box.
const MEANS: f64 = 0.3;
/// Up to this IoU with every marker, a claim means none.
const MEANS_NONE: f64 = 0.2;
/// Narrower ones show nothing.
const LEAST_SIDE_PX: f64 = 8.0;
/// Images between two looks at whether to stop.
const CHUNK: usize = 64;

/// One claim, the detector's or made.
#[derive(Debug, Clone)]
pub struct Claim {
    /// Its surroundings.
    pub patch: Patch,
    /// What the detector says: the logit that the second stage's is added to; 0 for boxes that it did not claim.
    pub logit: f32,
    /// The marker that it means, in the claim's units; none if it means none.
    pub truth: Option<polar::UnitBox>,
}

/// All claims of a detector on the training split, with those markers and near misses themselves, in the order of the records; none if
/// stopped. Of `most` images (0: all), evenly spread. `told` hears how many images are done, of how many.
///
/// # Errors
/// If the split's list cannot be read.
pub fn collect(
    detector: &Detector,
    dataset: &Dataset,
    most: usize,
    stop: &AtomicBool,
    told: &mut dyn FnMut(usize, usize),
) -> Result<Option<Vec<Claim>>, TrainError> {
    let records = thinned(dataset, Split::Train, most)?;
    let mut claims = Vec::new();
    for (k, chunk) in records.chunks(CHUNK).enumerate() {
        if stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        told(k * CHUNK, records.len());
        let of_image = |detector: &mut Detector, record: &Record| match picture::read(dataset.image_path(record)) {
            Ok(image) => of_image(detector, &image, record, dataset.header.boxes.extra()),
            Err(_) => Vec::new(), // it was warned of when the training began
        };
        claims.extend(chunk.par_iter().map_init(|| detector.clone(), of_image).collect::<Vec<_>>().into_iter().flatten());
    }
    Ok(Some(claims))
}

/// A split's records, about `most` of them, the same that a detector's validation takes.
///
/// # Errors
/// If the split's list cannot be read.
pub fn thinned(dataset: &Dataset, split: Split, most: usize) -> Result<Vec<Record>, TrainError> {
    let records = dataset.records(split)?;
    Ok(evenly(records.len(), most).into_iter().map(|k| records[k].clone()).collect())
}

fn of_image(detector: &mut Detector, image: &image::RgbImage, record: &Record, extra: f64) -> Vec<Claim> {
    let markers: Vec<PixelBox> = record.markers.iter().map(|m| m.bounds.grown(extra)).collect();
    let meant = |b: &PixelBox| markers.iter().map(|m| (iou(b, m), *m)).max_by(|a, b| a.0.total_cmp(&b.0));
    let options = DetectOptions { score: LEAST_SCORE, ..detector.options };
    let made = markers.iter().copied().chain(record.confusers.iter().map(|c| c.bounds.grown(extra))).map(|b| (b, 0.0));
    let found: Vec<_> = detector.claims(image, &options).iter().map(|d| (d.bounds.grown(extra), refiner::logit(d.score))).collect();
    let learned = |(bounds, logit): (PixelBox, f32)| {
        let truth = match meant(&bounds) {
            Some((overlap, marker)) if overlap >= MEANS => Some(polar::in_units_of(&bounds, &marker)),
            Some((overlap, _)) if overlap > MEANS_NONE => return None,
            _ => None,
        };
        (bounds.short_side() >= LEAST_SIDE_PX).then(|| Claim { patch: Patch::cut(image, &bounds), logit, truth })
    };
    found.into_iter().chain(made).filter_map(learned).collect()
}
