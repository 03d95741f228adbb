//! What the second stage learns from: what the finished detector claims in the training images, and what it might have claimed.
use crate::{data::evenly, error::TrainError};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};
use tcross_dataset::{Dataset, Marker, PixelBox, Record, Rng, Split, geom::boxes::iou, picture};
use tcross_yolo::{
    DetectOptions, Detector,
    refiner::{self, Frame, Glance, LEAST_SCORE, Patch, polar},
};

/// From this IoU with a marker on, a claim means it, and learns its box.
const MEANS: f64 = 0.3;
/// Up to this IoU with every marker, a claim means none.
const MEANS_NONE: f64 = 0.2;
/// Below this score, claims that mean nothing are learned from the more rarely the lower it is.
const DOUBTED: f64 = 0.02;
/// Narrower ones show nothing.
const LEAST_SIDE_PX: f64 = 8.0;
/// Images between two looks at whether to stop.
const CHUNK: usize = 64;

/// One claim, the detector's or made.
#[derive(Debug, Clone)]
pub struct Claim {
    /// Its surroundings.
    pub patch: Patch,
    /// What is taken up of the detector's logit, to which the second stage's is added; 0 for boxes that it did not claim.
    pub logit: f32,
    /// How many claims it stands for: of those that mean nothing and that the detector hardly believes, some are left out.
    pub weight: f32,
    /// The marker that it means; none if it means none.
    pub truth: Option<Truth>,
}

/// A marker, in the units of what is looked at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// Its box.
    pub bounds: polar::UnitBox,
    /// Its frame; that of an upright one in its box where corners are not known.
    pub frame: Frame,
}

impl Truth {
    fn of(claim: &PixelBox, marker: &Marker, extra: f64) -> Self {
        let bounds = polar::in_units_of(claim, &marker.bounds.grown(extra));
        let frame = marker.corners.zip(marker.center).map_or(Frame::of_box(bounds), |(corners, center)| {
            Frame::of(corners.0.map(|p| polar::point_in_units_of(claim, p)), polar::point_in_units_of(claim, center))
        });
        Self { bounds, frame }
    }

    /// As a glance sees it.
    #[must_use]
    pub fn seen(&self, glance: &Glance) -> Self {
        Self { bounds: glance.seen(self.bounds), frame: glance.seen_frame(&self.frame) }
    }
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
    seed: u64,
    stop: &AtomicBool,
    told: &mut dyn FnMut(usize, usize),
) -> Result<Option<Vec<Claim>>, TrainError> {
    let records = thinned(dataset, Split::Train, most)?;
    let mut claims = Vec::new();
    let numbered: Vec<(u64, Record)> = (0..).zip(records).collect();
    for (k, chunk) in numbered.chunks(CHUNK).enumerate() {
        if stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        told(k * CHUNK, numbered.len());
        let of_image = |detector: &mut Detector, (index, record): &(u64, Record)| match picture::read(dataset.image_path(record)) {
            Ok(image) => {
                of_image(detector, &image, record, dataset.header.boxes.extra(), &mut Rng::for_item(seed, "refine/claims", *index))
            }
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

fn of_image(detector: &mut Detector, image: &image::RgbImage, record: &Record, extra: f64, rng: &mut Rng) -> Vec<Claim> {
    let grown = |m: &Marker| m.bounds.grown(extra);
    let meant = |b: &PixelBox| record.markers.iter().map(|m| (iou(b, &grown(m)), m)).max_by(|a, b| a.0.total_cmp(&b.0));
    let options = DetectOptions { score: LEAST_SCORE, ..detector.options };
    let made = record.markers.iter().map(grown).chain(record.confusers.iter().map(|c| c.bounds.grown(extra))).map(|b| (b, 0.5));
    let found: Vec<_> = detector.claims(image, &options).iter().map(|d| (d.bounds.grown(extra), d.score)).collect();
    let learned = |(bounds, score): (PixelBox, f64)| {
        let truth = match meant(&bounds) {
            Some((overlap, marker)) if overlap >= MEANS => Some(Truth::of(&bounds, marker, extra)),
            Some((overlap, _)) if overlap > MEANS_NONE => return None,
            _ => None,
        };
        let share = if truth.is_none() { (score / DOUBTED).min(1.0) } else { 1.0 };
        let seen = bounds.short_side() >= LEAST_SIDE_PX && rng.chance(share);
        seen.then(|| Claim { patch: Patch::cut(image, &bounds), logit: refiner::logit(score), weight: (1.0 / share) as f32, truth })
    };
    found.into_iter().chain(made).filter_map(learned).collect()
}
