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
    pub(super) law: Law,
    /// In degrees, where 0 is next to 360.
    pub(super) angle: bool,
    pub(super) values: Vec<Option<f64>>,
}

/// What the config says of a parameter.
pub(super) enum Law {
    /// Nothing: only its ties are judged.
    None,
    /// A distribution.
    Dist(Dist),
    /// A distribution whose values are rounded to whole numbers.
    Rounded(Dist),
    /// Numbers of choices, with their probabilities and names.
    Choice(Vec<(f64, String)>),
}

impl Law {
    /// As in the config.
    pub(super) fn words(&self) -> String {
        match self {
            Self::None => String::new(),
            Self::Dist(dist) | Self::Rounded(dist) => dist.to_string(),
            Self::Choice(shares) => {
                let named: Vec<String> = shares.iter().map(|(p, name)| format!("{:.1}% {name}", 100.0 * p)).collect();
                named.join(", ")
            }
        }
    }
}

/// The columns of a config's style.
pub(super) fn columns(config: &Config, records: &[Record]) -> Vec<Column> {
    match config.style {
        Style::Paper => paper(config, records),
        Style::HandDrawn => hand_drawn(config, records),
    }
}

fn column(name: &'static str, law: Law, records: &[Record], value: impl Fn(&Record) -> Option<f64>) -> Column {
    Column { name, law, angle: false, values: records.iter().map(value).collect() }
}

/// A choice among names by weight; values are the names' numbers in order.
fn choice(
    name: &'static str,
    weights: &BTreeMap<String, f64>,
    records: &[Record],
    word: impl for<'a> Fn(&'a Record) -> Option<&'a str>,
) -> Column {
    let sum: f64 = weights.values().sum();
    let shares = weights.iter().filter(|w| *w.1 > 0.0).map(|(name, w)| (w / sum, name.clone())).collect::<Vec<_>>();
    // A name that was not to be drawn has the number after the last.
    let number = |word: &str| shares.iter().position(|s| s.1 == word).unwrap_or(shares.len()) as f64;
    let values = records.iter().map(|r| word(r).map(number)).collect();
    Column { name, law: Law::Choice(shares), angle: false, values }
}

/// A yes or no.
fn share(name: &'static str, yes: f64, records: &[Record], value: impl Fn(&Record) -> Option<bool>) -> Column {
    let law = Law::Choice(vec![(1.0 - yes, "no".into()), (yes, "yes".into())]);
    column(name, law, records, |r| value(r).map(f64::from))
}

fn named<T: serde::Serialize + Ord>(weights: &Weights<T>) -> BTreeMap<String, f64> {
    let word = |name: &T| serde_json::to_value(name).ok()?.as_str().map(str::to_owned);
    weights.iter().filter_map(|(name, w)| Some((word(name)?, *w))).collect()
}

fn paper(config: &Config, records: &[Record]) -> Vec<Column> {
    let p = &config.paper;
    let first = |r: &Record| r.markers.first().cloned();
    let bounds = move |r: &Record| first(r).map(|m| m.bounds);
    // Where a marker may stand depends on its size: its place is judged as a fraction of the room it had.
    let room = |at: f64, size: f64, image: u32| {
        let room = f64::from(image) - size - 1.0;
        (at - 1.0 + 0.5) / room
    };
    vec![
        column("width", Law::Dist(p.width.clone()), records, move |r| bounds(r).map(|b| b.width())),
        column("height", Law::Dist(p.height.clone()), records, move |r| bounds(r).map(|b| b.height())),
        column("place_x", Law::Dist(Dist::uniform(0.0, 1.0)), records, move |r| bounds(r).map(|b| room(b.x_min, b.width(), r.width))),
        column("place_y", Law::Dist(Dist::uniform(0.0, 1.0)), records, move |r| bounds(r).map(|b| room(b.y_min, b.height(), r.height))),
        column("thickness", Law::Dist(p.thickness.clone()), records, move |r| first(r)?.thickness),
        column("variant", Law::Dist(Dist::int(0, 3)), records, move |r| {
            let marker = first(r)?;
            let (c, m) = (marker.corners?.0[0], marker.center?);
            Some(f64::from(u8::from(c[0] > m[0])) + 2.0 * f64::from(u8::from(c[1] > m[1])))
        }),
    ]
}

fn hand_drawn(config: &Config, records: &[Record]) -> Vec<Column> {
    let (m, h, c) = (&config.markers, &config.hand, &config.camera);
    fn first(r: &Record) -> Option<&Marker> {
        r.markers.first()
    }
    let effect = |name: &'static str| move |r: &Record| r.effects.get(name)?.as_f64();
    let hand = |name: &'static str| move |r: &Record| first(r)?.hand.get(name)?.as_f64();
    let turned = |k: usize| {
        move |r: &Record| {
            // Rotation = to-ray * turn(azimuth) * lean(tilt) * turn(roll - azimuth): the lean's axis seen from the camera and from the marker.
            let marker = first(r)?;
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
    let dist = |d: &Dist| Law::Dist(d.clone());
    let mut columns = vec![
        column("tilt_deg", dist(&m.tilt_deg), records, |r| first(r)?.tilt_deg),
        column("side_px", dist(&m.side_px), records, |r| Some(first(r)?.corners?.side_px())),
        column("occlusion", dist(&m.occlusion), records, |r| first(r)?.occlusion),
        column("wobble", dist(&h.wobble), records, hand("wobble")),
        column("corner_error", dist(&h.corner_error), records, hand("corner_error")),
        column("end_error", dist(&h.end_error), records, hand("end_error")),
        column("line_width", dist(&h.line_width), records, hand("line_width")),
        column("aspect", dist(&m.aspect), records, hand("aspect")),
        column("white_balance_stops", dist(&c.white_balance_stops), records, effect("white_balance_stops")),
        column("exposure_stops", dist(&c.exposure_stops), records, effect("exposure_stops")),
        column("defocus_px", dist(&c.defocus_px), records, effect("defocus_px")),
        column("noise_percent", dist(&c.noise_percent), records, effect("noise_percent")),
        column("distortion", dist(&c.distortion), records, |r| Some(r.distortion.map_or(0.0, |k| k[0]))),
        column("motion_blur", dist(&c.motion_blur), records, effect("motion_fraction")),
        column("jpeg_quality", Law::Rounded(config.jpeg_quality.clone()), records, effect("jpeg_quality")),
        column("motion_angle_deg", Law::None, records, |r| r.effects.get("motion")?.get("angle_deg")?.as_f64()),
        column("visible", Law::None, records, |r| first(r)?.visible),
    ];
    for (k, name) in ["azimuth_deg", "roll_deg"].into_iter().enumerate() {
        let whole = m.roll_deg.bounds() == (0.0, 360.0);
        let law = if k == 0 {
            Law::Dist(Dist::uniform(0.0, 360.0))
        } else if whole {
            dist(&m.roll_deg)
        } else {
            Law::None
        };
        columns.push(Column { angle: true, ..column(name, law, records, turned(k)) });
    }
    columns.extend([
        choice("shape", &named(&m.shapes), records, |r| Some(&first(r)?.shape)),
        choice("medium", &named(&m.media), records, |r| first(r)?.medium.as_deref()),
        choice("surface", &named(&m.surfaces), records, |r| first(r)?.surface.as_deref()),
        choice("blend", &named(&m.blend), records, |r| first(r)?.blend.as_deref()),
        share("shadow", c.shadows, records, |r| Some(r.effects.contains_key("shadow"))),
        share("glare", c.glare, records, |r| Some(first(r)?.glare.is_some())),
        // A marker of which the border and what covers it leave nothing is not annotated: about one in a thousand.
        share("empty", m.per_image.cdf(0.999).max(0.002), records, |r| Some(r.markers.is_empty())),
    ]);
    if config.background.mirrored > 0.0 {
        columns.push(share("mirrored", config.background.mirrored, records, |r| r.effects.get("mirrored")?.as_bool()));
    }
    columns
}
