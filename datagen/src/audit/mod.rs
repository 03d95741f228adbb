//! Whether a dataset is what its config asked for: every distribution against its draws, and every pair of parameters that should know
//! nothing of each other.
//!
//! Of an image with several markers only the first is judged: later ones are left out where there is no room, which favours small ones.
use crate::{config::Config, error::DatagenError, hand::video::Moment, manifest::Manifest};
use serde::{Deserialize, Serialize};
use std::path::Path;
use tcross_dataset::{Dataset, DatasetError, Record, files};

mod columns;
mod fit;

/// How well one parameter's values follow the law that was asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Fit {
    /// Name of the parameter.
    pub name: String,
    /// The law, as in the config.
    pub asked: String,
    /// Number of values.
    pub count: usize,
    /// Their mean.
    pub mean: f64,
    /// Kolmogorov's distance for continuous laws; chi-squared over its degrees of freedom for whole numbers and choices.
    pub statistic: f64,
    /// Probability of a worse fit by chance.
    pub p: f64,
    /// True where p is not below the audit's level.
    pub good: bool,
}

/// Two parameters and how they go together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Pair {
    /// The first.
    pub a: String,
    /// The second.
    pub b: String,
    /// Spearman's rank correlation; for angles the largest circular correlation of sines and cosines.
    pub correlation: f64,
    /// Probability of a larger one by chance.
    pub p: f64,
    /// True where the two should be independent and are not.
    pub flagged: bool,
}

/// The whole audit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Audit {
    /// Level of each test after Bonferroni's correction for their number.
    pub level: f64,
    /// One a parameter.
    pub fits: Vec<Fit>,
    /// One a pair.
    pub pairs: Vec<Pair>,
}

impl Audit {
    /// True where every law fits and no pair is flagged.
    #[must_use]
    pub fn passed(&self) -> bool {
        self.fits.iter().all(|f| f.good) && self.pairs.iter().all(|p| !p.flagged)
    }

    /// The parameters of the pairs, in order.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        for name in self.pairs.iter().flat_map(|p| [&p.a, &p.b]) {
            if !names.contains(name) {
                names.push(name.clone());
            }
        }
        names
    }

    /// The pair of two parameters, in either order.
    #[must_use]
    pub fn pair(&self, a: &str, b: &str) -> Option<&Pair> {
        self.pairs.iter().find(|p| (p.a == a && p.b == b) || (p.a == b && p.b == a))
    }
}

/// Chance of a false alarm over the whole audit.
const LEVEL: f64 = 0.01;

/// The least number of values to judge.
const LEAST: usize = 30;

/// Reads a dataset and judges it by the config in its `dataset.toml`.
///
/// # Errors
/// If it has no `dataset.toml` of this generator, or a list does not parse.
pub fn audit(dir: &Path) -> Result<Audit, DatagenError> {
    let path = dir.join("dataset.toml");
    let manifest: Manifest = toml::from_str(&files::read_text(&path)?).map_err(|e| DatasetError::line(&path, 1, e.message()))?;
    let dataset = Dataset::open(dir)?;
    let mut records = Vec::new();
    for split in dataset.splits() {
        records.extend(dataset.records(split)?);
    }
    Ok(judge(&manifest.config, &records))
}

/// Judges records, in order of image, by a config. Of a video only the first frame counts: later ones are not independent of it.
#[must_use]
pub fn judge(config: &Config, records: &[Record]) -> Audit {
    let first = |k: u64| Moment::of(&config.video, config.images, k).is_none_or(|m| m.frame == 0);
    let kept: Vec<Record> = records.iter().filter(|r| image_number(r).is_none_or(first)).cloned().collect();
    let columns = columns::columns(config, &kept);
    let columns: Vec<_> = columns.into_iter().filter(|c| c.values.iter().flatten().count() >= LEAST).collect();
    let tests =
        columns.iter().filter(|c| !matches!(c.law, columns::Law::None)).count() + columns.len() * columns.len().saturating_sub(1) / 2;
    let level = LEVEL / tests.max(1) as f64;
    let fits = columns.iter().filter_map(|c| fit::fit(c, level)).collect();
    let mut pairs = Vec::new();
    for (k, a) in columns.iter().enumerate() {
        for b in &columns[k + 1..] {
            pairs.extend(fit::pair(a, b, level));
        }
    }
    Audit { level, fits, pairs }
}

/// The number in a picture's name.
fn image_number(record: &Record) -> Option<u64> {
    record.image.rsplit('/').next()?.split('.').next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        config::Style,
        dist::Dist,
        hand::{self, EQUAL_ANGLES},
        media::Medium,
        paper,
    };
    use tcross_dataset::Rng;

    fn records(config: &Config, n: u64) -> Vec<Record> {
        let mut blank = Vec::new();
        for index in 0..n {
            let mut record = Record {
                image: format!("train/{index:05}.jpg"),
                width: config.width,
                height: config.height,
                background: None,
                markers: vec![],
                confusers: Vec::new(),
                intrinsics: None,
                distortion: None,
                effects: Default::default(),
            };
            match config.style {
                Style::Paper => {
                    let mut image = image::RgbImage::new(config.width, config.height);
                    record.markers.push(paper::draw(&mut image, &config.paper, &mut Rng::for_item(3, "datagen/paper", index)));
                }
                Style::HandDrawn => {
                    let canvas = crate::canvas::Canvas::filled(config.width as usize, config.height as usize, [0.3; 3]);
                    hand::draw(canvas, config, 3, index, None, &mut record);
                }
            }
            blank.push(record);
        }
        blank
    }

    #[test]
    fn the_papers_protocol_passes_and_a_wrong_width_is_caught() {
        let config = Config { style: Style::Paper, ..Default::default() };
        let records = records(&config, 2000);
        let audit = judge(&config, &records);
        assert!(audit.passed(), "{audit:#?}");
        let mut other = config;
        other.paper.width = Dist::int(5, 50);
        assert!(!judge(&other, &records).fits[0].good);
    }

    #[test]
    fn the_hand_drawn_style_passes_and_two_equal_angles_are_caught() {
        let mut config = Config { width: 96, height: 96, ..Default::default() };
        config.markers.side_px = Dist::log(8.0, 60.0);
        config.markers.per_image = Dist::constant(1.0);
        let audit = judge(&config, &records(&config, 700));
        let wrong =
            (audit.fits.iter().filter(|f| !f.good).collect::<Vec<_>>(), audit.pairs.iter().filter(|p| p.flagged).collect::<Vec<_>>());
        assert!(audit.passed() && audit.fits.len() > 20, "{wrong:#?}");

        // The generator broken on purpose: every marker is turned by the angle of its tilt.
        let broken = EQUAL_ANGLES.with(|equal| {
            equal.set(true);
            let audit = judge(&config, &records(&config, 700));
            equal.set(false);
            audit
        });
        let angles = broken.pair("azimuth_deg", "roll_deg").unwrap();
        assert!(angles.flagged && angles.correlation.abs() > 0.9, "{angles:?}");
        assert!(broken.fits.iter().all(|f| f.good), "each angle alone is as asked, which is why nobody notices");
        assert_eq!(broken.pairs.iter().filter(|p| p.flagged).count(), 1);
    }

    #[test]
    fn a_weight_that_is_not_obeyed_is_caught() {
        let mut config = Config { width: 64, height: 64, ..Default::default() };
        config.markers.side_px = Dist::log(8.0, 40.0);
        let made = records(&config, 400);
        assert!(judge(&config, &made).fits.iter().find(|f| f.name == "medium").unwrap().good);
        config.markers.media.insert(Medium::Chalk, 4.0);
        assert!(!judge(&config, &made).fits.iter().find(|f| f.name == "medium").unwrap().good);
        config.markers.media.remove(&Medium::Chalk);
        assert_eq!(judge(&config, &made).fits.iter().find(|f| f.name == "medium").unwrap().p, 0.0, "a medium that nobody asked for");
    }
}
