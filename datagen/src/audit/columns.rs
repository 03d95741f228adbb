//! What of a dataset is judged: each parameter's values, image by image, and the law that the config gives it.
use crate::{
    config::{Config, Style, Weights},
    dist::Dist,
};
use std::collections::BTreeMap;
use tcross_dataset::{Marker, Record};

/// One parameter over all images, `None` where an image has none of it.
pub(super) struct Column {
    pub(super) name: &'static str,
    /// The config's key that gives the law.
    pub(super) key: &'static str,
    pub(super) law: Law,
    /// In degrees, where 0 is next to 360.
    pub(super) angle: bool,
    pub(super) values: Vec<Option<f64>>,
    /// Why a dataset may hold no value.
    pub(super) absent: &'static str,
}

/// What the config says of a parameter.
pub(super) enum Law {
    /// Nothing: only its ties are judged.
    None,
    /// A distribution.
    Dist(Dist),
    /// A distribution whose values are rounded to the nearest whole number.
    Rounded(Dist),
    /// A distribution whose values are rounded down to a whole number.
    Whole(Dist),
    /// Numbers of choices, with their probabilities and names.
    Choice(Vec<(f64, String)>),
    /// A share of things of which a marker has many; its values are the shares found marker by marker.
    Tally { share: f64, some: f64, all: f64 },
}

impl Law {
    /// As in the config.
    pub(super) fn words(&self) -> String {
        match self {
            Self::None => String::new(),
            Self::Dist(dist) | Self::Rounded(dist) | Self::Whole(dist) => dist.to_string(),
            Self::Choice(shares) => {
                let named: Vec<String> = shares.iter().map(|(p, name)| format!("{:.1}% {name}", 100.0 * p)).collect();
                named.join(", ")
            }
            Self::Tally { share, .. } => format!("{:.1}% yes", 100.0 * share),
        }
    }
}

/// The columns of a config's style: one for each of its distributions at least.
pub(super) fn columns(config: &Config, records: &[Record]) -> Vec<Column> {
    let mut columns = match config.style {
        Style::Paper => super::paper::columns(config, records),
        Style::HandDrawn => super::hand_drawn::columns(config, records),
    };
    columns.extend(behind(config, records));
    columns
}

/// What stands behind the markers, and how a picture is stored.
fn behind(config: &Config, records: &[Record]) -> [Column; 4] {
    const NO_CROPS: &str = "only crops of photographs have it: not embedded scenes, not the whole photographs behind videos";
    let b = &config.background;
    [
        column("crop", "background.crop", Law::Dist(b.crop.clone()), records, asked("crop")).absent(NO_CROPS),
        share("mirrored", "background.mirrored", b.mirrored, records, |r| r.effects.get("mirrored")?.as_bool()).absent(NO_CROPS),
        choice("scene", "background.scenes", &named(&b.scenes), records, |r| r.background.as_deref()?.strip_prefix("embedded/"))
            .absent("the backgrounds are photographs"),
        column("jpeg_quality", "jpeg_quality", Law::Rounded(config.jpeg_quality.clone()), records, effect("jpeg_quality")),
    ]
}

impl Column {
    /// Says why a dataset may hold no value.
    pub(super) fn absent(self, why: &'static str) -> Self {
        Self { absent: why, ..self }
    }

    /// A direction in degrees.
    pub(super) fn angle(self) -> Self {
        Self { angle: true, ..self }
    }

    /// Number of images that have a value.
    pub(super) fn count(&self) -> usize {
        self.values.iter().flatten().count()
    }
}

/// The first marker, the only one that is judged.
pub(super) fn first(r: &Record) -> Option<&Marker> {
    r.markers.first()
}

/// A number that was drawn for the whole image.
pub(super) fn asked(name: &'static str) -> impl Fn(&Record) -> Option<f64> {
    move |r| r.effects.get("asked")?.get(name)?.as_f64()
}

/// A number of what was done to the whole image.
pub(super) fn effect(name: &'static str) -> impl Fn(&Record) -> Option<f64> {
    move |r| r.effects.get(name)?.as_f64()
}

pub(super) fn column(
    name: &'static str,
    key: &'static str,
    law: Law,
    records: &[Record],
    value: impl Fn(&Record) -> Option<f64>,
) -> Column {
    Column { name, key, law, angle: false, values: records.iter().map(value).collect(), absent: "" }
}

/// A choice among names by weight; values are the names' numbers in order.
pub(super) fn choice(
    name: &'static str,
    key: &'static str,
    weights: &BTreeMap<String, f64>,
    records: &[Record],
    word: impl for<'a> Fn(&'a Record) -> Option<&'a str>,
) -> Column {
    let sum: f64 = weights.values().sum();
    let shares = weights.iter().filter(|w| *w.1 > 0.0).map(|(name, w)| (w / sum, name.clone())).collect::<Vec<_>>();
    // A name that was not to be drawn has the number after the last.
    let number = |word: &str| shares.iter().position(|s| s.1 == word).unwrap_or(shares.len()) as f64;
    let values = records.iter().map(|r| word(r).map(number)).collect();
    Column { name, key, law: Law::Choice(shares), angle: false, values, absent: "" }
}

/// A yes or no.
pub(super) fn share(
    name: &'static str,
    key: &'static str,
    yes: f64,
    records: &[Record],
    value: impl Fn(&Record) -> Option<bool>,
) -> Column {
    let law = Law::Choice(vec![(1.0 - yes, "no".into()), (yes, "yes".into())]);
    column(name, key, law, records, |r| value(r).map(f64::from))
}

/// Many times yes or no; `value` says how often yes, and how often at all.
pub(super) fn tally(
    name: &'static str,
    key: &'static str,
    yes: f64,
    records: &[Record],
    value: impl Fn(&Record) -> Option<[f64; 2]>,
) -> Column {
    let found: Vec<_> = records.iter().map(value).collect();
    let sum = |k: usize| found.iter().flatten().map(|tally| tally[k]).sum();
    let law = Law::Tally { share: yes, some: sum(0), all: sum(1) };
    Column { name, key, law, angle: false, values: found.iter().map(|t| t.map(|[some, all]| some / all)).collect(), absent: "" }
}

/// Weights by the names' words.
pub(super) fn named<T: serde::Serialize + Ord>(weights: &Weights<T>) -> BTreeMap<String, f64> {
    let word = |name: &T| serde_json::to_value(name).ok()?.as_str().map(str::to_owned);
    weights.iter().filter_map(|(name, w)| Some((word(name)?, *w))).collect()
}
