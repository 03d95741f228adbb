//! What a dataset consists of: every number and every word of its records, ready to be drawn as distributions.
use crate::{Dataset, DatasetError, Record, Split};
use std::collections::BTreeMap;

/// One quantity over all markers, or over all images.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// Its key in the record, or what it is: `width`, `short side`.
    pub name: &'static str,
    /// `px`, `degrees` or nothing.
    pub unit: &'static str,
    /// In order of the records.
    pub values: Vec<f64>,
}

impl Column {
    /// The value below which this share of all lies; `None` where there are none.
    #[must_use]
    pub fn quantile(&self, share: f64) -> Option<f64> {
        let mut sorted = self.values.clone();
        sorted.sort_by(f64::total_cmp);
        let at = share.clamp(0.0, 1.0) * (sorted.len().checked_sub(1)? as f64);
        let (low, high) = (sorted[at.floor() as usize], sorted[at.ceil() as usize]);
        Some(low + (high - low) * at.fract())
    }

    /// Counts in `bins` bins of equal width from the smallest to the largest value.
    #[must_use]
    pub fn histogram(&self, bins: usize) -> Vec<(f64, usize)> {
        let (Some(low), Some(high)) = (self.quantile(0.0), self.quantile(1.0)) else { return Vec::new() };
        let bins = if high > low { bins.max(1) } else { 1 };
        let step = if high > low { (high - low) / bins as f64 } else { 1.0 };
        let mut counts = vec![0; bins];
        for v in &self.values {
            counts[(((v - low) / step) as usize).min(bins - 1)] += 1;
        }
        counts.into_iter().enumerate().map(|(k, n)| (low + (k as f64 + 0.5) * step, n)).collect()
    }
}

/// Counts and distributions of some splits.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Stats {
    /// Images a split.
    pub images: BTreeMap<Split, usize>,
    /// Images without a marker.
    pub empty: usize,
    /// Markers of all images.
    pub markers: usize,
    /// Numbers; columns without a value are left out.
    pub columns: Vec<Column>,
    /// Words, such as `medium`, with how often each occurs.
    pub words: BTreeMap<&'static str, BTreeMap<String, usize>>,
}

/// Collects them.
///
/// # Errors
/// If a split is missing or a line does not parse.
pub fn collect(dataset: &Dataset, splits: &[Split]) -> Result<Stats, DatasetError> {
    let mut stats = Stats::default();
    let mut all: Vec<Record> = Vec::new();
    for split in splits {
        let records = dataset.records(*split)?;
        stats.images.insert(*split, records.len());
        all.extend(records);
    }
    stats.empty = all.iter().filter(|r| r.markers.is_empty()).count();
    let extra = dataset.header.boxes.extra();
    let mut numbers = |name, unit, of: &dyn Fn(&Record, &crate::Marker) -> Option<f64>| {
        let values: Vec<f64> = all.iter().flat_map(|r| r.markers.iter().filter_map(|m| of(r, m))).collect();
        if !values.is_empty() {
            stats.columns.push(Column { name, unit, values });
        }
    };
    numbers("width", "px", &|_, m| Some(m.bounds.width() + extra));
    numbers("height", "px", &|_, m| Some(m.bounds.height() + extra));
    numbers("short side", "px", &|_, m| Some(m.bounds.short_side() + extra));
    numbers("x of the centre", "of the image's width", &|r, m| Some((m.bounds.center()[0] + extra / 2.0) / f64::from(r.width.max(1))));
    numbers("y of the centre", "of the image's height", &|r, m| Some((m.bounds.center()[1] + extra / 2.0) / f64::from(r.height.max(1))));
    numbers("angle", "degrees", &|_, m| m.angle);
    numbers("tilt", "degrees", &|_, m| m.tilt_deg);
    numbers("visible", "share", &|_, m| m.visible);
    numbers("occlusion", "share", &|_, m| m.occlusion);
    numbers("motion blur", "px", &|_, m| m.blur_px);
    numbers("defocus", "px", &|_, m| m.defocus_px);
    numbers("thickness", "px", &|_, m| m.thickness);
    stats.columns.push(Column { name: "markers an image", unit: "", values: all.iter().map(|r| r.markers.len() as f64).collect() });
    stats.markers = all.iter().map(|r| r.markers.len()).sum();
    let mut count = |name, word: Option<&str>| {
        if let Some(word) = word {
            *stats.words.entry(name).or_default().entry(word.to_owned()).or_default() += 1;
        }
    };
    for record in &all {
        // Photos are counted together; embedded scenes by kind.
        count("background", record.photo().map_or(record.background.as_deref(), |_| Some("photo")));
        for marker in &record.markers {
            count("shape", Some(&marker.shape));
            count("medium", marker.medium.as_deref());
            count("surface", marker.surface.as_deref());
            count("fill", marker.fill.as_deref().and_then(hue_name));
        }
    }
    Ok(stats)
}

/// The colour family of `#rrggbb`.
fn hue_name(hex: &str) -> Option<&'static str> {
    let value = u32::from_str_radix(hex.strip_prefix('#')?, 16).ok()?;
    let [r, g, b] = [16, 8, 0].map(|s| f64::from(value >> s & 255));
    let (max, min) = (r.max(g).max(b), r.min(g).min(b));
    if max - min < 0.15 * max.max(1.0) {
        return Some("grey");
    }
    let hue = if max == r {
        (g - b) / (max - min)
    } else if max == g {
        2.0 + (b - r) / (max - min)
    } else {
        4.0 + (r - g) / (max - min)
    };
    let names = ["red", "orange", "yellow", "lime", "green", "turquoise", "cyan", "azure", "blue", "violet", "magenta", "pink"];
    Some(names[((hue * 2.0).rem_euclid(12.0).round() as usize) % 12])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_and_histograms() {
        let column = Column { name: "x", unit: "", values: vec![4.0, 1.0, 3.0, 2.0] };
        assert_eq!((column.quantile(0.0), column.quantile(0.5), column.quantile(1.0)), (Some(1.0), Some(2.5), Some(4.0)));
        assert_eq!(column.histogram(3).iter().map(|b| b.1).collect::<Vec<_>>(), [1, 1, 2]);
        let same = Column { values: vec![2.0; 5], ..column.clone() };
        assert_eq!(same.histogram(10), [(2.5, 5)]);
        assert_eq!(Column { values: vec![], ..column }.quantile(0.5), None);
    }

    #[test]
    fn colours_have_names() {
        for (hex, name) in [
            ("#ff0000", "red"),
            ("#00c800", "green"),
            ("#0000c8", "blue"),
            ("#ffff00", "yellow"),
            ("#808080", "grey"),
            ("#ff00ff", "magenta"),
        ] {
            assert_eq!(hue_name(hex), Some(name));
        }
    }
}
