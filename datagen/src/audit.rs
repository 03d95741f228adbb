//! Whether a dataset is what its config asked for: every distribution against its draws, and every pair of parameters that should know
//! nothing of each other.
//!
//! Of an image with several markers only the first is judged: later ones are left out where there is no room, which favours small ones.
use crate::{
    config::{Config, Style},
    dist::Dist,
    error::DatagenError,
    manifest::Manifest,
};
use serde::{Deserialize, Serialize};
use std::path::Path;
use tcross_dataset::{Dataset, DatasetError, Record, files};

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
}

/// Chance of a false alarm over the whole audit.
const LEVEL: f64 = 0.01;

/// The least number of values to judge.
const LEAST: usize = 30;

/// One parameter over all images, `None` where an image has none of it.
struct Column {
    name: &'static str,
    law: Option<Dist>,
    /// In degrees, where 0 is next to 360.
    angle: bool,
    values: Vec<Option<f64>>,
}

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

/// Judges records by a config.
#[must_use]
pub fn judge(config: &Config, records: &[Record]) -> Audit {
    let columns = match config.style {
        Style::Paper => paper_columns(config, records),
        Style::HandDrawn => hand_columns(config, records),
    };
    let columns: Vec<Column> = columns.into_iter().filter(|c| c.values.iter().flatten().count() >= LEAST).collect();
    let tests = columns.iter().filter(|c| c.law.is_some()).count() + columns.len() * columns.len().saturating_sub(1) / 2;
    let level = LEVEL / tests.max(1) as f64;
    let fits = columns.iter().filter_map(|c| Some(fit(c, c.law.as_ref()?, level))).collect();
    let mut pairs = Vec::new();
    for (k, a) in columns.iter().enumerate() {
        for b in &columns[k + 1..] {
            pairs.extend(pair(a, b, level));
        }
    }
    Audit { level, fits, pairs }
}

fn column(name: &'static str, law: Option<Dist>, records: &[Record], value: impl Fn(&Record) -> Option<f64>) -> Column {
    Column { name, law, angle: false, values: records.iter().map(value).collect() }
}

fn paper_columns(config: &Config, records: &[Record]) -> Vec<Column> {
    let p = &config.paper;
    let first = |r: &Record| r.markers.first().cloned();
    let bounds = move |r: &Record| first(r).map(|m| m.bounds);
    // Where a marker may stand depends on its size: its place is judged as a fraction of the room it had.
    let room = |at: f64, size: f64, image: u32| {
        let room = f64::from(image) - size - 1.0;
        (at - 1.0 + 0.5) / room
    };
    vec![
        column("width", Some(p.width.clone()), records, move |r| bounds(r).map(|b| b.width())),
        column("height", Some(p.height.clone()), records, move |r| bounds(r).map(|b| b.height())),
        column("place_x", Some(Dist::uniform(0.0, 1.0)), records, move |r| bounds(r).map(|b| room(b.x_min, b.width(), r.width))),
        column("place_y", Some(Dist::uniform(0.0, 1.0)), records, move |r| bounds(r).map(|b| room(b.y_min, b.height(), r.height))),
        column("thickness", Some(p.thickness.clone()), records, move |r| first(r)?.thickness),
        column("variant", Some(Dist::int(0, 3)), records, move |r| {
            let marker = first(r)?;
            let (c, m) = (marker.corners?.0[0], marker.center?);
            Some(f64::from(u8::from(c[0] > m[0])) + 2.0 * f64::from(u8::from(c[1] > m[1])))
        }),
    ]
}

fn hand_columns(config: &Config, records: &[Record]) -> Vec<Column> {
    let (m, c) = (&config.markers, &config.camera);
    let first = |r: &Record| r.markers.first().cloned();
    let effect = |name: &'static str| move |r: &Record| r.effects.get(name)?.as_f64();
    let turned = |k: usize| {
        move |r: &Record| {
            // Rotation = to-ray * turn(azimuth) * lean(tilt) * turn(roll - azimuth): the lean's axis seen from the camera and from the marker.
            let marker = r.markers.first()?;
            let (q, t) = (marker.rotation?, marker.translation?);
            let n = (t[0] * t[0] + t[1] * t[1] + t[2] * t[2]).sqrt();
            let (x, y, z) = (t[0] / n, t[1] / n, t[2] / n);
            let a = 1.0 / (1.0 + z);
            let back = [1.0 - x * x * a, -x * y * a, -x, -x * y * a, 1.0 - y * y * a, -y, x, y, z];
            let s: [f64; 9] = std::array::from_fn(|i| (0..3).map(|j| back[i / 3 * 3 + j] * q[j * 3 + i % 3]).sum());
            // The normal leans towards the azimuth's right: (sin az sin tilt, -cos az sin tilt, cos tilt).
            let azimuth = s[2].atan2(-s[5]);
            let spin = s[6].atan2(s[7]);
            let angle = if k == 0 { azimuth } else { azimuth + spin };
            (marker.tilt_deg? > 2.0).then(|| angle.to_degrees().rem_euclid(360.0))
        }
    };
    let mut columns = vec![
        column("tilt_deg", Some(m.tilt_deg.clone()), records, move |r| first(r)?.tilt_deg),
        column("white_balance_stops", Some(c.white_balance_stops.clone()), records, effect("white_balance_stops")),
        column("exposure_stops", Some(c.exposure_stops.clone()), records, effect("exposure_stops")),
        column("defocus_px", Some(c.defocus_px.clone()), records, effect("defocus_px")),
        column("noise_percent", Some(c.noise_percent.clone()), records, effect("noise_percent")),
        column("distortion", Some(c.distortion.clone()), records, |r| Some(r.distortion.map_or(0.0, |k| k[0]))),
        column("motion_angle_deg", None, records, |r| r.effects.get("motion")?.get("angle_deg")?.as_f64()),
        column("side_px", Some(m.side_px.clone()), records, move |r| Some(first(r)?.corners?.side_px())),
        column("visible", None, records, move |r| first(r)?.visible),
    ];
    for (k, name) in ["azimuth_deg", "roll_deg"].into_iter().enumerate() {
        let law = if k == 0 { Some(Dist::uniform(0.0, 360.0)) } else { Some(m.roll_deg.clone()).filter(|d| d.bounds() == (0.0, 360.0)) };
        columns.push(Column { angle: true, ..column(name, law, records, turned(k)) });
    }
    columns
}

/// Pairs that are tied by design: how much is visible depends on the size, which decides what the border cuts.
fn tied(a: &str, b: &str) -> bool {
    a == "visible" || b == "visible"
}

fn fit(column: &Column, law: &Dist, level: f64) -> Fit {
    let mut values: Vec<f64> = column.values.iter().flatten().copied().collect();
    values.sort_by(f64::total_cmp);
    let n = values.len() as f64;
    let (statistic, p) = if law.has_atoms() { chi_squared(&values, law) } else { kolmogorov(&values, law) };
    Fit {
        name: column.name.into(),
        asked: law.to_string(),
        count: values.len(),
        mean: values.iter().sum::<f64>() / n,
        statistic,
        p,
        good: p >= level,
    }
}

/// Kolmogorov's distance and its p-value (the usual series, with Stephens' correction for small samples).
fn kolmogorov(sorted: &[f64], law: &Dist) -> (f64, f64) {
    let n = sorted.len() as f64;
    let distance = sorted.iter().enumerate().fold(0.0f64, |d, (k, v)| {
        let at = law.cdf(*v);
        d.max((at - k as f64 / n).abs()).max(((k + 1) as f64 / n - at).abs())
    });
    let x = distance * (n.sqrt() + 0.12 + 0.11 / n.sqrt());
    let series: f64 = (1..=100).map(|k| 2.0 * if k % 2 == 1 { 1.0 } else { -1.0 } * (-2.0 * f64::from(k * k) * x * x).exp()).sum();
    (distance, if x < 0.2 { 1.0 } else { series.clamp(0.0, 1.0) })
}

/// Chi-squared over the law's atoms and ten equally likely cells between them; over the degrees of freedom, and its p-value
/// (Wilson and Hilferty).
fn chi_squared(sorted: &[f64], law: &Dist) -> (f64, f64) {
    let n = sorted.len() as f64;
    let close = |a: f64, b: f64| (a - b).abs() < 1e-3;
    let atoms = law.atoms();
    let mut cells: Vec<(f64, f64)> =
        atoms.iter().map(|(at, weight)| (sorted.iter().filter(|v| close(**v, *at)).count() as f64, weight * n)).collect();
    let rest: Vec<f64> = sorted.iter().copied().filter(|v| !atoms.iter().any(|a| close(*v, a.0))).collect();
    let spread = 1.0 - atoms.iter().map(|a| a.1).sum::<f64>();
    if spread > 1e-9 {
        // The cumulative distribution without its atoms turns the rest into uniform numbers.
        let smooth = |x: f64| (law.cdf(x) - atoms.iter().filter(|a| a.0 <= x).map(|a| a.1).sum::<f64>()) / spread;
        let mut counts = [0.0; 10];
        rest.iter().for_each(|v| counts[((smooth(*v) * 10.0) as usize).min(9)] += 1.0);
        cells.extend(counts.map(|c| (c, spread * n / 10.0)));
    } else if !rest.is_empty() {
        return (f64::INFINITY, 0.0);
    }
    // Cells that expect less than five are thrown together.
    let (small, mut large): (Vec<_>, Vec<_>) = cells.into_iter().partition(|c| c.1 < 5.0);
    let sum = small.iter().fold((0.0, 0.0), |s, c| (s.0 + c.0, s.1 + c.1));
    if sum.1 > 0.0 {
        large.push(sum);
    }
    let freedom = (large.len() as f64 - 1.0).max(1.0);
    let chi: f64 = large.iter().map(|(found, asked)| (found - asked).powi(2) / asked.max(1e-9)).sum();
    let z = ((chi / freedom).cbrt() - (1.0 - 2.0 / (9.0 * freedom))) / (2.0 / (9.0 * freedom)).sqrt();
    (chi / freedom, if large.len() < 2 { 1.0 } else { upper_normal(z) })
}

fn pair(a: &Column, b: &Column, level: f64) -> Option<Pair> {
    let both: (Vec<f64>, Vec<f64>) = a.values.iter().zip(&b.values).filter_map(|(x, y)| Some(((*x)?, (*y)?))).unzip();
    let n = both.0.len();
    if n < LEAST {
        return None;
    }
    // An angle is seen as its sine and cosine; two angles also as the sine and cosine of their difference and sum.
    let views = |c: &Column, v: &[f64]| -> Vec<Vec<f64>> {
        if c.angle {
            vec![v.iter().map(|d| d.to_radians().sin()).collect(), v.iter().map(|d| d.to_radians().cos()).collect()]
        } else {
            vec![v.to_vec()]
        }
    };
    let (first, second) = (views(a, &both.0), views(b, &both.1));
    let mut best = 0.0f64;
    for x in &first {
        for y in &second {
            let r = spearman(x, y);
            if r.abs() > best.abs() {
                best = r;
            }
        }
    }
    let tests = (first.len() * second.len()) as f64;
    let p = (2.0 * upper_normal(best.abs() * (n as f64 - 1.0).sqrt()) * tests).min(1.0);
    Some(Pair { a: a.name.into(), b: b.name.into(), correlation: best, p, flagged: p < level && !tied(a.name, b.name) })
}

/// Rank correlation; ties share their mean rank.
fn spearman(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (ranks(a), ranks(b));
    let mean = (a.len() as f64 - 1.0) / 2.0;
    let sum = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(u, v)| (u - mean) * (v - mean)).sum::<f64>();
    let scale = (sum(&a, &a) * sum(&b, &b)).sqrt();
    if scale > 0.0 { sum(&a, &b) / scale } else { 0.0 }
}

fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|i, j| values[*i].total_cmp(&values[*j]));
    let mut ranks = vec![0.0; values.len()];
    let mut k = 0;
    while k < order.len() {
        let same = order[k..].iter().take_while(|i| values[**i] == values[order[k]]).count();
        order[k..k + same].iter().for_each(|i| ranks[*i] = k as f64 + (same as f64 - 1.0) / 2.0);
        k += same;
    }
    ranks
}

/// The normal distribution's upper tail (Abramowitz and Stegun 7.1.26 through the complementary error function).
fn upper_normal(z: f64) -> f64 {
    libm::erfc(z / std::f64::consts::SQRT_2) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{hand, paper};
    use tcross_dataset::Rng;

    fn records(config: &Config, n: u64) -> Vec<Record> {
        let mut blank = Vec::new();
        for index in 0..n {
            let mut record = Record {
                image: String::new(),
                width: config.width,
                height: config.height,
                background: None,
                markers: vec![],
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
                    hand::draw(canvas, config, 3, index, &mut record);
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
        let mut records = records(&config, 700);
        let audit = judge(&config, &records);
        assert!(
            audit.passed(),
            "{:#?}",
            (audit.fits.iter().filter(|f| !f.good).collect::<Vec<_>>(), audit.pairs.iter().filter(|p| p.flagged).collect::<Vec<_>>())
        );
        // The fault on purpose: the roll is the azimuth, in every marker.
        for record in &mut records {
            for marker in &mut record.markers {
                let mut rng = Rng::for_item(marker.seed.unwrap(), "test/fault", 0);
                let angle = rng.uniform(0.0, std::f64::consts::TAU);
                let tilt = marker.tilt_deg.unwrap().to_radians();
                let (s, c) = angle.sin_cos();
                let (st, ct) = tilt.sin_cos();
                // turn(angle) * lean(tilt), seen straight ahead.
                marker.rotation = Some([c, -s * ct, s * st, s, c * ct, -c * st, 0.0, st, ct]);
                marker.translation = Some([0.0, 0.0, 5.0]);
            }
        }
        let broken = judge(&config, &records);
        let angles = broken.pairs.iter().find(|p| p.a == "azimuth_deg" && p.b == "roll_deg").unwrap();
        assert!(angles.flagged && angles.correlation.abs() > 0.9, "{angles:?}");
    }
}
