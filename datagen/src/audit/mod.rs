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
mod hand_drawn;
mod paper;

/// How well one parameter's values follow the law that was asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Fit {
    /// Name of the parameter.
    pub name: String,
    /// The config's key in `[data]` that gives the law; empty where the style itself does.
    pub key: String,
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

/// A distribution of the config that this dataset says too little of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Unjudged {
    /// The config's key in `[data]`.
    pub key: String,
    /// The law, as in the config.
    pub asked: String,
    /// Why it is not judged.
    pub why: String,
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
    /// What was asked for and is not judged.
    pub unjudged: Vec<Unjudged>,
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
    let (columns, few): (Vec<_>, Vec<_>) = columns::columns(config, &kept).into_iter().partition(|c| c.count() >= LEAST);
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
    Audit { level, fits, unjudged: few.iter().filter_map(unjudged).collect(), pairs }
}

/// Why a column is not judged; `None` where the config asks for nothing.
fn unjudged(column: &columns::Column) -> Option<Unjudged> {
    let count = column.count();
    let why = match column.absent {
        _ if count > 0 => format!("{count} values; at least {LEAST} are needed"),
        "" => "not recorded".into(),
        why => why.into(),
    };
    let asked = !column.key.is_empty() && !matches!(column.law, columns::Law::None);
    asked.then(|| Unjudged { key: column.key.into(), asked: column.law.words(), why })
}

/// The number in a picture's name.
fn image_number(record: &Record) -> Option<u64> {
    record.image.rsplit('/').next()?.split('.').next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        background::Backgrounds,
        config::{PaperColors, PaperConfig, Style},
        dist::Dist,
        hand::EQUAL_ANGLES,
        media::Medium,
        sample::sample,
        shapes::Shape,
    };
    use std::collections::BTreeMap;

    fn records(config: &Config, n: u64) -> Vec<Record> {
        let backgrounds = Backgrounds::embedded();
        (0..n).map(|index| sample(config, &backgrounds, 3, index).unwrap().record).collect()
    }

    fn small_paper(paper: PaperConfig) -> Config {
        Config { style: Style::Paper, width: 128, height: 96, paper, ..Default::default() }
    }

    fn small_hand_drawn() -> Config {
        let mut config = Config { width: 96, height: 96, ..Default::default() };
        config.markers.side_px = Dist::log(8.0, 60.0);
        config
    }

    /// The config's keys that leave something to chance, with what they say.
    fn laws(config: &Config) -> BTreeMap<String, serde_json::Value> {
        const NO_CHANCE: [&str; 11] = [
            "style",
            "images",
            "width",
            "height",
            "background.near_duplicates_together",
            "background.embedded",
            "camera.motion_blur_max_px",
            "video.sequences",
            "video.fps",
            "video.every",
            "video.whole_sequences",
        ];
        let sections: &[&str] = match config.style {
            Style::Paper => &["background", "paper"],
            Style::HandDrawn if config.video.sequences > 0 => &["background", "markers", "hand", "camera", "confusers", "video"],
            Style::HandDrawn => &["background", "markers", "hand", "camera", "confusers"],
        };
        let mut laws = BTreeMap::new();
        for (key, value) in serde_json::to_value(config).unwrap().as_object().unwrap() {
            match value.as_object() {
                Some(section) if sections.contains(&key.as_str()) => {
                    laws.extend(section.iter().map(|(name, v)| (format!("{key}.{name}"), v.clone())));
                }
                Some(_) => {}
                None => _ = laws.insert(key.clone(), value.clone()),
            }
        }
        laws.retain(|key, _| !NO_CHANCE.contains(&key.as_str()));
        laws
    }

    fn unjudged(audit: &Audit) -> Vec<&str> {
        audit.unjudged.iter().map(|u| u.key.as_str()).collect()
    }

    #[test]
    fn every_distribution_of_a_config_is_judged_or_named_as_not_judged() {
        let colored = PaperConfig { colors: PaperColors::Colored, ..Default::default() };
        let at_sign = PaperConfig { shape: Shape::AtSign, ..Default::default() };
        let mut video = small_hand_drawn();
        (video.video.sequences, video.images) = (40, 40);
        (video.markers.per_image, video.confusers.near_misses) = (Dist::constant(1.0), Dist::constant(0.0));
        for config in [small_paper(PaperConfig::default()), small_paper(colored), small_paper(at_sign), small_hand_drawn(), video] {
            for n in [0, 40] {
                let audit = judge(&config, &records(&config, n));
                let named: Vec<&str> = audit.fits.iter().map(|f| f.key.as_str()).chain(unjudged(&audit)).collect();
                let missing: Vec<String> = laws(&config).into_keys().filter(|key| !named.contains(&key.as_str())).collect();
                assert!(missing.is_empty(), "{n}: {missing:?}");
            }
        }
    }

    /// A config that asks for something else than the images were made from is caught, whichever key it is.
    #[test]
    fn every_other_law_is_caught() {
        let mut hand_drawn = small_hand_drawn();
        hand_drawn.confusers.near_misses = Dist::int(0, 2);
        let colored = PaperConfig { colors: PaperColors::Colored, ..Default::default() };
        for (config, n) in [(small_paper(PaperConfig::default()), 100), (small_paper(colored), 100), (hand_drawn, 400)] {
            let records = records(&config, n);
            let audit = judge(&config, &records);
            for (key, value) in laws(&config).into_iter().filter(|(key, _)| !unjudged(&audit).contains(&key.as_str())) {
                use serde_json::{Value, json};
                let other = match &value {
                    // The list of hues and the paper's words have tests of their own.
                    Value::Array(_) => continue,
                    Value::String(_) if ["paper.shape", "paper.colors"].contains(&key.as_str()) => continue,
                    Value::String(_) => json!("-77"),
                    Value::Object(weights) => json!({ weights.keys().next().unwrap(): 1.0 }),
                    share => json!(if share.as_f64().unwrap() < 0.5 { 0.97 } else { 0.03 }),
                };
                let mut changed = serde_json::to_value(&config).unwrap();
                *changed.pointer_mut(&format!("/{}", key.replace('.', "/"))).unwrap() = other;
                let changed: Config = serde_json::from_value(changed).unwrap();
                // Where there is one name only, there is no other.
                if changed != config {
                    let audit = judge(&changed, &records);
                    assert!(audit.fits.iter().any(|f| f.key == key && !f.good), "{key}: {:#?}", audit.fits);
                }
            }
        }
    }

    #[test]
    fn videos_are_judged_by_what_was_asked_for_them() {
        let mut config = small_hand_drawn();
        (config.video.sequences, config.images) = (200, 400);
        (config.markers.per_image, config.confusers.near_misses) = (Dist::constant(1.0), Dist::constant(0.0));
        config.markers.hues = vec![0.0, 120.0, 240.0];
        let audit = judge(&config, &records(&config, 400));
        let wrong: Vec<_> = audit.fits.iter().filter(|f| !f.good).collect();
        assert!(audit.passed(), "{wrong:#?} {:#?}", audit.pairs.iter().filter(|p| p.flagged).collect::<Vec<_>>());
        assert!(
            ["side_px", "tilt_deg", "wander", "exposure_ms"].iter().all(|name| audit.fits.iter().any(|f| f.name == *name && f.count > 190))
        );
        let moved = ["camera.motion_blur", "camera.motion_deg", "camera.motion_curve", "camera.camera_moves"];
        assert!(moved.iter().chain(&["markers.hues"]).all(|key| unjudged(&audit).contains(key)), "{:?}", audit.unjudged);
    }

    #[test]
    fn listed_hues_are_judged_where_chance_picks_them() {
        let mut config = small_hand_drawn();
        config.markers.hues = vec![0.0, 120.0, 240.0];
        let records = records(&config, 100);
        let hue = |config: &Config| judge(config, &records).fits.into_iter().find(|f| f.key == "markers.hues").unwrap();
        assert!(hue(&config).good);
        config.markers.hues.extend([300.0; 6]);
        assert!(!hue(&config).good, "six hues that never came");
    }

    #[test]
    fn the_papers_coloured_variants_and_the_at_sign_pass() {
        let colored = PaperConfig { colors: PaperColors::Colored, ..Default::default() };
        let config = small_paper(colored);
        let colored = records(&config, 600);
        let audit = judge(&config, &colored);
        assert!(audit.passed() && audit.fits.iter().any(|f| f.name == "line_level"), "{audit:#?}");
        let fixed = judge(&small_paper(PaperConfig::default()), &colored);
        assert!(fixed.fits.iter().any(|f| f.key == "paper.colors" && !f.good));
        let at_sign = small_paper(PaperConfig { shape: Shape::AtSign, ..Default::default() });
        let audit = judge(&at_sign, &records(&at_sign, 300));
        assert!(audit.passed() && audit.fits.iter().any(|f| f.key == "paper.at_sign_side"), "{audit:#?}");
    }

    #[test]
    fn the_papers_protocol_passes_and_a_wrong_width_is_caught() {
        let config = small_paper(PaperConfig::default());
        let records = records(&config, 2000);
        let audit = judge(&config, &records);
        assert!(audit.passed(), "{audit:#?}");
        let mut other = config;
        other.paper.width = Dist::int(5, 50);
        assert!(!judge(&other, &records).fits[0].good);
    }

    #[test]
    fn the_hand_drawn_style_passes_and_two_equal_angles_are_caught() {
        let mut config = small_hand_drawn();
        config.markers.per_image = Dist::constant(1.0);
        let audit = judge(&config, &records(&config, 700));
        let wrong =
            (audit.fits.iter().filter(|f| !f.good).collect::<Vec<_>>(), audit.pairs.iter().filter(|p| p.flagged).collect::<Vec<_>>());
        assert!(audit.passed() && audit.fits.len() > 45, "{wrong:#?}");

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
