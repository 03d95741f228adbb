//! Markers sorted by what makes them hard: size, blur, tilt, occlusion, colour, medium, background, and any effect the
//! dataset tells of. Recall, mean IoU and errors of poses a class.
use crate::{
    evaluation::{Evaluation, MarkerOutcome},
    interval::{Interval, quantile, wilson},
    min_side::short_side,
    truth::Truth,
};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use tcross_dataset::{Marker, Record};

/// Markers of one class of a factor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Class {
    /// What they share, such as `16-24` or `crayon`.
    pub label: String,
    /// Middle of the class, for plots; absent for words.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub middle: Option<f64>,
    /// How many.
    pub markers: u64,
    /// Of these found.
    pub found: u64,
    /// Found / markers.
    pub recall: f64,
    /// 95 %, Wilson.
    pub recall_ci: Interval,
    /// Misses as 0.
    pub mean_iou: f64,
    /// False positives in the images that hold these markers.
    pub fp: u64,
    /// Found / (found + false positives).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub precision: Option<f64>,
    /// Where poses were recovered.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pose: Option<ClassPose>,
}

/// Errors of the recovered poses of one class.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ClassPose {
    /// Recovered poses.
    pub recovered: u64,
    /// Median error of the centre, percent of the side.
    pub center_percent: f64,
    /// Median error of the angle, degrees.
    pub angle_deg: f64,
    /// Median error of the corners, percent of the side.
    pub corner_percent: f64,
}

/// All classes of a factor; markers that the factor does not apply to are in none.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Slice {
    /// As a file's name: `size`, `blur`, ...
    pub key: String,
    /// On an axis, with its unit.
    pub label: String,
    /// By rising value, or by the alphabet.
    pub classes: Vec<Class>,
}

impl Slice {
    /// What the markers are sorted by, without its unit.
    pub(crate) fn name(&self) -> &str {
        self.label.split(" (").next().unwrap_or(&self.label)
    }
}

/// A factor's value for one marker.
enum Value {
    Number(f64),
    Word(String),
}

/// How numbers become classes.
enum Edges {
    /// Between these.
    Fixed(Vec<f64>),
    /// Each value its own where there are at most twelve, else eight classes of equal size.
    Found,
}

type Factor = (&'static str, &'static str, Edges, fn(&Record, &Marker) -> Option<Value>);

/// Slices by every factor that the truth tells of, at the configured threshold.
#[must_use]
pub fn slices(truth: &Truth, evaluation: &Evaluation) -> Vec<Slice> {
    let outcomes = evaluation.markers_at(evaluation.config.threshold);
    let extra = truth.boxes.extra();
    let mut out = Vec::new();
    let sizes = outcomes.iter().map(|o| Some(Value::Number(short_side(&marker_of(truth, o).bounds, extra))));
    let edges = Edges::Fixed(evaluation.config.size_edges_px.clone());
    out.extend(slice("size", "short side of the box (px)", edges, &outcomes, sizes.collect(), evaluation));
    for (key, label, edges, value) in factors() {
        let values = outcomes.iter().map(|o| value(&truth.records[o.image], marker_of(truth, o))).collect();
        out.extend(slice(key, label, edges, &outcomes, values, evaluation));
    }
    let effects: BTreeSet<&String> = truth.records.iter().flat_map(|r| r.effects.keys()).collect();
    for effect in effects {
        let value = |o: &MarkerOutcome| match truth.records[o.image].effects.get(effect)? {
            serde_json::Value::Number(v) => v.as_f64().map(Value::Number),
            serde_json::Value::String(word) => Some(Value::Word(word.clone())),
            _ => None,
        };
        out.extend(slice(effect, &effect_label(effect), Edges::Found, &outcomes, outcomes.iter().map(value).collect(), evaluation));
    }
    out
}

fn marker_of<'a>(truth: &'a Truth, o: &MarkerOutcome) -> &'a Marker {
    &truth.records[o.image].markers[o.marker]
}

fn factors() -> Vec<Factor> {
    let fixed = |edges: &[f64]| Edges::Fixed(edges.to_vec());
    vec![
        ("blur", "motion blur (fraction of the short side)", fixed(&[0.02, 0.05, 0.1, 0.2, 0.4]), |_, m| {
            m.blur_px.map(|b| Value::Number(b / short_side(&m.bounds, 0.0).max(1.0)))
        }),
        ("tilt", "tilt (degrees)", fixed(&[15.0, 30.0, 45.0, 60.0, 75.0]), |_, m| m.tilt_deg.map(Value::Number)),
        ("occlusion", "hidden part of the marker (fraction)", fixed(&[0.01, 0.1, 0.2, 0.35, 0.5]), |_, m| {
            m.occlusion.or(m.visible.map(|v| 1.0 - v)).map(Value::Number)
        }),
        ("angle", "angle (degrees)", fixed(&[45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0]), |_, m| m.angle.map(Value::Number)),
        ("color", "colour of the fill", Edges::Found, |_, m| m.fill.as_deref().and_then(hue_name).map(|n| Value::Word(n.into()))),
        ("medium", "drawn with", Edges::Found, |_, m| m.medium.as_deref().map(in_words)),
        ("surface", "drawn on", Edges::Found, |_, m| m.surface.as_deref().map(in_words)),
        ("shape", "shape", Edges::Found, |_, m| Some(in_words(&m.shape))),
        ("background", "background", Edges::Found, |r, _| r.background.as_deref().map(|b| Value::Word(background_kind(b)))),
    ]
}

fn in_words(key: &str) -> Value {
    Value::Word(key.replace('_', " "))
}

/// The name of an effect with its unit: `noise_percent` is `noise (%)`.
fn effect_label(key: &str) -> String {
    let units = [("_px", "px"), ("_deg", "degrees"), ("_percent", "%"), ("_stops", "stops")];
    let found = units.into_iter().find_map(|(end, unit)| key.strip_suffix(end).map(|name| format!("{name} ({unit})")));
    found.unwrap_or_else(|| key.to_owned()).replace('_', " ")
}

/// `embedded/<kind>` as it is; of a photo its folder.
fn background_kind(background: &str) -> String {
    match background.rsplit_once('/') {
        _ if background.starts_with("embedded/") => background.to_owned(),
        Some((folder, _)) => folder.to_owned(),
        None => "photos".to_owned(),
    }
}

/// The word for a colour `#rrggbb`; `None` for another text.
#[must_use]
pub fn hue_name(hex: &str) -> Option<&'static str> {
    let digits = hex.strip_prefix('#').filter(|d| d.len() == 6 && d.is_ascii())?;
    let channel = |k: usize| u8::from_str_radix(&digits[2 * k..2 * k + 2], 16).ok().map(f64::from);
    let (r, g, b) = (channel(0)?, channel(1)?, channel(2)?);
    let (hi, lo) = (r.max(g).max(b), r.min(g).min(b));
    if hi - lo < 0.15 * hi.max(40.0) {
        return Some("grey");
    }
    let hue = 60.0
        * if hi == r {
            ((g - b) / (hi - lo)).rem_euclid(6.0)
        } else if hi == g {
            (b - r) / (hi - lo) + 2.0
        } else {
            (r - g) / (hi - lo) + 4.0
        };
    let names = [
        (15.0, "red"),
        (45.0, "orange"),
        (70.0, "yellow"),
        (165.0, "green"),
        (200.0, "cyan"),
        (260.0, "blue"),
        (290.0, "purple"),
        (345.0, "magenta"),
    ];
    Some(names.into_iter().find(|(end, _)| hue < *end).map_or("red", |(_, name)| name))
}

/// Sorts markers into classes; `None` where the factor applies to no marker, or is the same word or number for
/// all and no classes were asked for.
fn slice(
    key: &str,
    label: &str,
    edges: Edges,
    outcomes: &[MarkerOutcome],
    values: Vec<Option<Value>>,
    evaluation: &Evaluation,
) -> Option<Slice> {
    let numbers: Vec<f64> = values.iter().flatten().filter_map(|v| if let Value::Number(n) = v { Some(*n) } else { None }).collect();
    let asked_for = matches!(edges, Edges::Fixed(_));
    let edges = match edges {
        Edges::Fixed(edges) => edges,
        Edges::Found => found_edges(numbers),
    };
    // Ordered by class number, then by word.
    let mut groups: BTreeMap<(usize, String), Vec<usize>> = BTreeMap::new();
    for (k, value) in values.iter().enumerate() {
        let class = match value {
            Some(Value::Number(v)) => (edges.partition_point(|e| e <= v), String::new()),
            Some(Value::Word(w)) => (0, w.clone()),
            None => continue,
        };
        groups.entry(class).or_default().push(k);
    }
    let alike = groups.len() == 1 && groups.keys().all(|(_, word)| !(asked_for && word.is_empty()));
    if groups.is_empty() || alike {
        return None;
    }
    let class = |((class, word), members): (&(usize, String), &Vec<usize>)| {
        let (label, middle) = if word.is_empty() { class_label(&edges, *class, &values, members) } else { (word.clone(), None) };
        summary(label, middle, members.iter().map(|&k| outcomes[k]), evaluation)
    };
    Some(Slice { key: key.into(), label: label.into(), classes: groups.iter().map(class).collect() })
}

/// Edges just above each of few values, or at eighths of many.
fn found_edges(mut numbers: Vec<f64>) -> Vec<f64> {
    numbers.sort_by(f64::total_cmp);
    let mut levels = numbers.clone();
    levels.dedup();
    if levels.len() <= 12 {
        return levels.windows(2).map(|w| (w[0] + w[1]) / 2.0).collect();
    }
    let mut edges: Vec<f64> = (1..8).filter_map(|k| quantile(&numbers, f64::from(k) / 8.0)).collect();
    edges.dedup();
    edges
}

fn class_label(edges: &[f64], class: usize, values: &[Option<Value>], members: &[usize]) -> (String, Option<f64>) {
    let inside = members.iter().filter_map(|&k| if let Some(Value::Number(v)) = values[k] { Some(v) } else { None });
    let (sum, lo, hi) = inside.fold((0.0, f64::INFINITY, f64::NEG_INFINITY), |(s, lo, hi), v| (s + v, f64::min(lo, v), f64::max(hi, v)));
    let middle = Some(sum / members.len() as f64);
    let short = |v: f64| format!("{}", (v * 1000.0).round() / 1000.0);
    let label = match (class.checked_sub(1).and_then(|k| edges.get(k)), edges.get(class)) {
        _ if lo == hi => short(lo),
        (None, Some(end)) => format!("< {}", short(*end)),
        (Some(start), None) => format!(">= {}", short(*start)),
        (Some(start), Some(end)) => format!("{}-{}", short(*start), short(*end)),
        (None, None) => "all".into(),
    };
    (label, middle)
}

fn summary(label: String, middle: Option<f64>, members: impl Iterator<Item = MarkerOutcome>, evaluation: &Evaluation) -> Class {
    let members: Vec<MarkerOutcome> = members.collect();
    let (markers, found) = (members.len() as u64, members.iter().filter(|o| o.found).count() as u64);
    let images: BTreeSet<usize> = members.iter().map(|o| o.image).collect();
    let fp: u64 = images.iter().map(|&k| evaluation.tally_at(k, evaluation.config.threshold).fp).sum();
    Class {
        label,
        middle,
        markers,
        found,
        recall: found as f64 / markers as f64,
        recall_ci: wilson(found, markers).unwrap_or([0.0, 1.0]),
        mean_iou: members.iter().map(|o| o.iou).sum::<f64>() / markers as f64,
        fp,
        precision: (found + fp > 0).then(|| found as f64 / (found + fp) as f64),
        pose: evaluation.pose.as_ref().and_then(|p| class_pose(p, &members)),
    }
}

fn class_pose(outcomes: &crate::protocol::pose::PoseOutcomes, members: &[MarkerOutcome]) -> Option<ClassPose> {
    let inside: BTreeSet<(usize, usize)> = members.iter().map(|o| (o.image, o.marker)).collect();
    let errors: Vec<_> = outcomes.errors.iter().filter(|e| inside.contains(&(e.image, e.marker))).collect();
    let median = |f: &dyn Fn(&crate::protocol::pose::PoseError) -> f64| {
        let mut v: Vec<f64> = errors.iter().map(|e| f(e)).collect();
        v.sort_by(f64::total_cmp);
        quantile(&v, 0.5)
    };
    Some(ClassPose {
        recovered: errors.len() as u64,
        center_percent: median(&|e| e.center_percent())?,
        angle_deg: median(&|e| e.angle_deg.abs())?,
        corner_percent: median(&|e| e.corner_percent())?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_have_names() {
        for (hex, name) in [
            ("#c80000", "red"),
            ("#ff00c8", "magenta"),
            ("#00c800", "green"),
            ("#0000c8", "blue"),
            ("#f0e000", "yellow"),
            ("#808080", "grey"),
        ] {
            assert_eq!(hue_name(hex), Some(name), "{hex}");
        }
        assert_eq!((hue_name("red"), hue_name("#12345é")), (None, None));
    }

    #[test]
    fn few_levels_are_their_own_classes() {
        assert_eq!(found_edges(vec![3.0, 1.0, 2.0, 1.0]), [1.5, 2.5]);
        assert_eq!(found_edges((0..800).map(f64::from).collect()).len(), 7);
        assert!(found_edges(vec![]).is_empty());
    }

    #[test]
    fn effects_have_units() {
        let labels = ["noise_percent", "white_balance_stops", "jpeg_quality"].map(effect_label);
        assert_eq!(labels, ["noise (%)", "white balance (stops)", "jpeg quality"]);
    }

    #[test]
    fn backgrounds_are_grouped_by_folder() {
        assert_eq!(background_kind("indoor/kitchen/3.jpg"), "indoor/kitchen");
        assert_eq!(background_kind("embedded/room"), "embedded/room");
        assert_eq!(background_kind("a.jpg"), "photos");
    }
}
