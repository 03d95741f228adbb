//! One file of detections scored against one truth: the matching, and everything counted from it.
use crate::{
    config::{Config, Protocol},
    error::EvalError,
    input::{self, DetectionSource, Located, ProblemCounts},
    matching::{MarkerIndex, Rule, Tally, Verdict, match_image, tally},
    min_side::{MinSide, min_sides},
    protocol::{
        coco::{CocoCell, CocoScores},
        paper::{MatchedImage, Row, Scores},
        pose::{PoseOutcomes, measure_poses},
    },
    ranks,
    truth::Truth,
    validate::{coco_cells, score_native},
};
use rayon::prelude::*;
use tcross_dataset::{ImageDetections, detections::StageTimes};

/// Detections after scoring.
#[derive(Debug, Clone)]
pub struct Evaluation {
    /// What they are called in tables and figures.
    pub name: String,
    /// How they were scored.
    pub config: Config,
    /// One an image, in order of the truth.
    pub images: Vec<MatchedImage>,
    /// Counts at the configured thresholds and at those of the curves.
    pub scores: Scores,
    /// COCO's numbers, where asked for.
    pub coco: Option<CocoScores>,
    /// The paper's metrics for markers of at least the configured sizes, where asked for.
    pub min_sides: Vec<MinSide>,
    /// Errors of poses, where asked for.
    pub pose: Option<PoseOutcomes>,
    /// Faults met in a lenient reading.
    pub problems: ProblemCounts,
    /// Mean milliseconds an image of each stage, where the file tells them.
    pub ms: Option<StageTimes>,
    /// For reading single images' detections again.
    pub located: Located,
}

/// A marker at one threshold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MarkerOutcome {
    /// Index of its record.
    pub image: usize,
    /// Index in the record.
    pub marker: usize,
    /// True if a detection overlaps it enough.
    pub found: bool,
    /// Best IoU of a detection; 0 without one.
    pub iou: f64,
}

/// What one line of detections becomes.
struct Scored {
    matched: MatchedImage,
    coco: Vec<CocoCell>,
    pose: PoseOutcomes,
    ms: Option<StageTimes>,
}

/// Reads, checks, matches and counts. With `lenient` faults are counted instead of reported as an error.
///
/// # Errors
/// If the configuration or, unless `lenient`, the detections are not what they should be.
pub fn evaluate(truth: &Truth, name: &str, source: DetectionSource, config: &Config, lenient: bool) -> Result<Evaluation, EvalError> {
    config.validate()?;
    let most = MarkerIndex::MOST;
    if let Some(r) = truth.records.iter().find(|r| r.markers.len() > most) {
        return Err(EvalError::Markers { path: truth.path.clone(), image: r.image.clone(), markers: r.markers.len(), most });
    }
    let rule = Rule::from(config);
    let (coco, pose) = (config.wants(Protocol::Coco), config.wants(Protocol::Pose));
    let score = |index: usize, row: &ImageDetections| {
        let markers = &truth.records[index].markers;
        let claims = match_image(markers, &row.detections, &rule);
        Scored {
            coco: if coco { coco_cells(markers, &row.detections, truth.boxes, &rule) } else { Vec::new() },
            pose: if pose { measure_poses(index, markers, &row.detections, &claims, config.threshold) } else { PoseOutcomes::default() },
            matched: MatchedImage { markers: markers.len() as u32, claims },
            ms: row.ms,
        }
    };
    let reading = input::read(truth, source, lenient, score)?;
    let mut images = Vec::with_capacity(truth.records.len());
    let mut cells = Vec::new();
    let mut outcomes = PoseOutcomes::default();
    let mut times = Vec::new();
    for (k, (image, record)) in reading.images.into_iter().zip(&truth.records).enumerate() {
        let nothing = || ImageDetections {
            image: record.image.clone(),
            width: record.width,
            height: record.height,
            detections: Vec::new(),
            ms: None,
        };
        let scored = image.unwrap_or_else(|| score(k, &nothing()));
        images.push(scored.matched);
        cells.push(scored.coco);
        outcomes.append(scored.pose);
        times.extend(scored.ms);
    }
    let thresholds = grid(&images, config);
    let mut evaluation = Evaluation {
        name: name.to_owned(),
        config: config.clone(),
        scores: Scores::new(&images, &thresholds, config.bootstrap_draws, config.seed),
        images,
        min_sides: Vec::new(),
        coco: coco.then(|| score_native(cells)),
        pose: pose.then_some(outcomes),
        problems: reading.problems,
        ms: mean_times(&times),
        located: reading.located,
    };
    if config.wants(Protocol::Paper) {
        evaluation.min_sides = min_sides(truth, &evaluation);
    }
    Ok(evaluation)
}

fn mean_times(times: &[StageTimes]) -> Option<StageTimes> {
    let n = times.len() as f64;
    let mean = |f: &dyn Fn(&StageTimes) -> f64| times.iter().map(f).sum::<f64>() / n;
    let pose = times.iter().any(|t| t.pose.is_some()).then(|| mean(&|t| t.pose.unwrap_or(0.0)));
    (!times.is_empty()).then(|| StageTimes { decode: mean(&|t| t.decode), network: mean(&|t| t.network), pose })
}

/// The scores of an image's false positives.
fn false_positives(image: &MatchedImage) -> impl Iterator<Item = f64> {
    image.claims.iter().filter(|c| c.verdict == Verdict::FalsePositive).map(|c| c.score)
}

/// The thresholds at which everything is counted: the configured ones, steps of 0.01 for curves over the threshold, and the
/// scores at which false positives reach round numbers an image, for curves over false positives.
fn grid(images: &[MatchedImage], config: &Config) -> Vec<f64> {
    let mut all: Vec<f64> =
        config.thresholds.iter().copied().chain([config.threshold]).chain((0..=100).map(|k| f64::from(k) / 100.0)).collect();
    let false_positives = || images.par_iter().map(false_positives);
    let counts = ranks::count(false_positives());
    let rounded = std::iter::successors(Some(1.0), |rank: &f64| Some((rank * 1.15).max(rank + 1.0))).map(|rank| rank as usize - 1);
    all.extend(counts.at(rounded.take_while(|rank| *rank < counts.total()), false_positives));
    all.sort_by(f64::total_cmp);
    all.dedup_by(|a, b| (*a - *b).abs() < 1e-12);
    all
}

impl Evaluation {
    /// The table's rows, at the configured thresholds.
    #[must_use]
    pub fn rows(&self) -> Vec<Row> {
        self.config.thresholds.iter().filter_map(|t| self.scores.position(*t)).map(|k| self.scores.row(k)).collect()
    }

    /// The row at the configured threshold.
    #[must_use]
    pub fn headline(&self) -> Row {
        self.row_at(self.config.threshold)
    }

    /// The row at any threshold, 0..1.
    #[must_use]
    pub fn row_at(&self, threshold: f64) -> Row {
        match self.scores.position(threshold) {
            Some(k) => self.scores.row(k),
            None => Scores::new(&self.images, &[threshold], self.config.bootstrap_draws, self.config.seed).row(0),
        }
    }

    /// What image `index` adds at a threshold.
    #[must_use]
    pub fn tally_at(&self, index: usize, threshold: f64) -> Tally {
        let image = &self.images[index];
        tally(&image.claims, image.markers as usize, &[threshold])[0]
    }

    /// Every marker at a threshold, in order of the truth.
    #[must_use]
    pub fn markers_at(&self, threshold: f64) -> Vec<MarkerOutcome> {
        let mut out = Vec::new();
        for (image, matched) in self.images.iter().enumerate() {
            let start = out.len();
            out.extend((0..matched.markers as usize).map(|marker| MarkerOutcome { image, marker, found: false, iou: 0.0 }));
            for claim in matched.claims.iter().take_while(|c| c.score >= threshold) {
                if let Some(m) = claim.marker {
                    let outcome = &mut out[start + m.get()];
                    outcome.found |= claim.verdict == Verdict::Hit;
                    outcome.iou = outcome.iou.max(claim.iou);
                }
            }
        }
        out
    }
}
