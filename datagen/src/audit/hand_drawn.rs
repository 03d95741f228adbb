//! The distributions of the hand-drawn style.
//!
//! What came out is judged where it is what was asked for; where placing, visibility, a lens or a video made something else of it, what was
//! drawn is (the keys `asked` of a record and of a marker).
use super::columns::{Column, Law, asked, choice, column, effect, first, named, share, tally};
use crate::{config::Config, dist::Dist, media::Medium};
use tcross_dataset::{Marker, Record};

pub(super) fn columns(config: &Config, records: &[Record]) -> Vec<Column> {
    let mut columns = markers(config, records);
    columns.extend(hand(config, records));
    columns.extend(camera(config, records));
    columns.extend(confusers(config, records));
    columns.extend(video(config, records));
    columns
}

fn dist(dist: &Dist) -> Law {
    Law::Dist(dist.clone())
}

/// What was drawn for the first marker.
fn of_marker(name: &'static str) -> impl Fn(&Record) -> Option<f64> {
    move |r| first(r)?.asked.get(name)?.as_f64()
}

fn markers(config: &Config, records: &[Record]) -> Vec<Column> {
    let m = &config.markers;
    let videos = config.video.sequences > 0;
    // In a video the camera has moved away from the place that size, tilt and turn were asked for.
    let seen = |name: &'static str, key, law, value: fn(&Record) -> Option<f64>| match videos {
        true => column(name, key, law, records, of_marker(name)),
        false => column(name, key, law, records, value),
    };
    let flag = |name: &'static str| move |r: &Record| first(r)?.asked.get(name)?.as_bool();
    let bend = |r: &Record| flag("bent")(r)?.then(|| first(r).and_then(|m| m.bend).map_or(0.0, |b| b[0]));
    // An angle read from the pose knows no full turns.
    let whole_turn = m.roll_deg.bounds() == (0.0, 360.0);
    let roll = if whole_turn {
        seen("roll_deg", "markers.roll_deg", dist(&m.roll_deg), |r| turned(r, 1))
    } else {
        column("roll_deg", "markers.roll_deg", dist(&m.roll_deg), records, of_marker("roll_deg"))
    };
    vec![
        column("markers", "markers.per_image", Law::Whole(m.per_image.clone()), records, asked("markers")),
        // A marker of which the border and what covers it leave nothing is not annotated: about one in a thousand.
        share("empty", "markers.per_image", m.per_image.cdf(0.999).max(0.002), records, |r| Some(r.markers.is_empty())),
        choice("shape", "markers.shapes", &named(&m.shapes), records, |r| Some(&first(r)?.shape)),
        seen("side_px", "markers.side_px", dist(&m.side_px), |r| Some(first(r)?.corners?.side_px())),
        seen("tilt_deg", "markers.tilt_deg", dist(&m.tilt_deg), |r| first(r)?.tilt_deg),
        seen("azimuth_deg", "", Law::Dist(Dist::uniform(0.0, 360.0)), |r| turned(r, 0)).angle(),
        roll.angle(),
        column("aspect", "markers.aspect", dist(&m.aspect), records, by_hand("aspect")),
        share("cut", "markers.cut", m.cut, records, flag("cut")),
        column("occlusion", "markers.occlusion", dist(&m.occlusion), records, |r| first(r)?.occlusion),
        share("bent", "markers.bent", m.bent, records, flag("bent")).absent("no marker is on paper"),
        column("bend", "markers.bend", dist(&m.bend), records, bend).absent("no sheet is bent"),
        column("margin", "markers.margin", dist(&m.margin), records, of_marker("margin")).absent("no marker is on a sheet"),
        choice("surface", "markers.surfaces", &named(&m.surfaces), records, |r| first(r)?.surface.as_deref()),
        choice("medium", "markers.media", &named(&m.media), records, |r| first(r)?.medium.as_deref()),
        choice("line_medium", "markers.line_media", &named(&m.line_media), records, |r| first(r)?.asked.get("line_medium")?.as_str()),
        hues(config, records),
        choice("blend", "markers.blend", &named(&m.blend), records, |r| first(r)?.blend.as_deref()),
        column("visible", "", Law::None, records, |r| first(r)?.visible),
    ]
}

/// Any hue alike, or each of a list alike; videos take them in turn.
fn hues(config: &Config, records: &[Record]) -> Column {
    let hues = &config.markers.hues;
    if hues.is_empty() {
        return column("hue_deg", "markers.hues", Law::Dist(Dist::uniform(0.0, 360.0)), records, of_marker("hue_deg")).angle();
    }
    let law = Law::Choice(hues.iter().map(|h| (1.0 / hues.len() as f64, format!("{h}"))).collect());
    let by_chance = config.video.sequences == 0;
    let drawn = of_marker("hue");
    column("hue", "markers.hues", law, records, |r| drawn(r).filter(|_| by_chance)).absent("videos take the hues in turn, not by chance")
}

/// The direction of the tilt as the camera sees it, or the turn about the normal, in degrees; `None` where the marker is seen too straight
/// to tell.
fn turned(r: &Record, which: usize) -> Option<f64> {
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
    let angle = if which == 0 { azimuth } else { azimuth + spin };
    (marker.tilt_deg? > 2.0).then(|| angle.to_degrees().rem_euclid(360.0))
}

/// A number of how the hand drew.
fn by_hand(name: &'static str) -> impl Fn(&Record) -> Option<f64> {
    move |r| first(r)?.hand.get(name)?.as_f64()
}

fn hand(config: &Config, records: &[Record]) -> Vec<Column> {
    const NO_HATCH: &str = "no fill is hatched";
    let h = &config.hand;
    let yes = |name: &'static str| move |r: &Record| by_hand(name)(r).map(|v| v > 0.5);
    // A printer hatches nothing, and where there is no fill there is nothing to hatch.
    let hatched = |r: &Record| first(r).filter(|m| is_filled_by_hand(m)).and_then(|_| yes("hatched")(r));
    let counted = |name: &'static str| {
        move |r: &Record| {
            let pair = first(r)?.hand.get(name)?.as_array()?;
            Some([pair.first()?.as_f64()?, pair.get(1)?.as_f64()?])
        }
    };
    vec![
        column("wobble", "hand.wobble", dist(&h.wobble), records, by_hand("wobble")),
        column("corner_error", "hand.corner_error", dist(&h.corner_error), records, by_hand("corner_error")),
        column("end_error", "hand.end_error", dist(&h.end_error), records, by_hand("end_error")),
        column("line_width", "hand.line_width", dist(&h.line_width), records, by_hand("line_width")),
        share("hatched", "hand.hatched", h.hatched, records, hatched).absent("no marker is filled by hand"),
        column("hatch_spacing", "hand.hatch_spacing", dist(&h.hatch_spacing), records, by_hand("hatch_spacing")).absent(NO_HATCH),
        column("hatch_deg", "hand.hatch_deg", dist(&h.hatch_deg), records, by_hand("hatch_deg")).absent(NO_HATCH).angle(),
        share("outlined", "hand.outlined", h.outlined, records, yes("outlined")).absent("no marker is filled by hand"),
        tally("retraced", "hand.retraced", h.retraced, records, counted("retraced")).absent("no lines are drawn by hand"),
        tally("gaps", "hand.gaps", h.gaps, records, counted("gaps")).absent("no strokes are drawn by hand"),
    ]
}

/// Whether it has a fill that no printer made.
fn is_filled_by_hand(marker: &Marker) -> bool {
    marker.hand.contains_key("outlined") && marker.medium.as_deref() != Some(Medium::Print.name())
}

fn camera(config: &Config, records: &[Record]) -> Vec<Column> {
    const IN_VIDEOS: &str = "in videos the way of the camera says how much and where it moves";
    let c = &config.camera;
    let videos = config.video.sequences > 0;
    let unseen = if videos { IN_VIDEOS } else { "no motion is long enough to be seen" };
    let motion = |name: &'static str| move |r: &Record| r.effects.get("motion").filter(|_| !videos)?.get(name).cloned();
    vec![
        column("field_of_view_deg", "camera.field_of_view_deg", dist(&c.field_of_view_deg), records, asked("field_of_view_deg")),
        column("distortion", "camera.distortion", dist(&c.distortion), records, |r| Some(r.distortion.map_or(0.0, |k| k[0]))),
        column("motion_blur", "camera.motion_blur", dist(&c.motion_blur), records, effect("motion_fraction")).absent(IN_VIDEOS),
        column("motion_deg", "camera.motion_deg", dist(&c.motion_deg), records, |r| motion("angle_deg")(r)?.as_f64())
            .absent(unseen)
            .angle(),
        column("motion_curve", "camera.motion_curve", dist(&c.motion_curve), records, |r| motion("curve")(r)?.as_f64()).absent(unseen),
        share("camera_moves", "camera.camera_moves", c.camera_moves, records, |r| motion("camera")(r)?.as_bool()).absent(unseen),
        column("defocus_px", "camera.defocus_px", dist(&c.defocus_px), records, effect("defocus_px")),
        column("softness_px", "camera.softness_px", dist(&c.softness_px), records, asked("softness_px")),
        column("exposure_stops", "camera.exposure_stops", dist(&c.exposure_stops), records, effect("exposure_stops")),
        column("white_balance_stops", "camera.white_balance_stops", dist(&c.white_balance_stops), records, effect("white_balance_stops")),
        column("noise_percent", "camera.noise_percent", dist(&c.noise_percent), records, effect("noise_percent")),
        share("shadow", "camera.shadows", c.shadows, records, |r| Some(r.effects.contains_key("shadow"))),
        share("glare", "camera.glare", c.glare, records, |r| Some(first(r)?.glare.is_some())),
    ]
}

fn confusers(config: &Config, records: &[Record]) -> [Column; 3] {
    let c = &config.confusers;
    [
        column("near_misses", "confusers.near_misses", Law::Whole(c.near_misses.clone()), records, asked("near_misses")),
        choice("near_miss", "confusers.shapes", &named(&c.shapes), records, |r| r.effects.get("asked")?.get("near_miss")?.as_str())
            .absent("there are no near misses"),
        column("stickers", "confusers.stickers", Law::Whole(c.stickers.clone()), records, asked("stickers")),
    ]
}

fn video(config: &Config, records: &[Record]) -> Vec<Column> {
    let v = &config.video;
    if v.sequences == 0 {
        return Vec::new();
    }
    let drawn = |name: &'static str| move |r: &Record| r.effects.get("video")?.get(name)?.as_f64();
    vec![
        column("wander", "video.wander", dist(&v.wander), records, drawn("wander")),
        column("pace_hz", "video.pace_hz", dist(&v.pace_hz), records, drawn("pace_hz")),
        column("tremor_deg", "video.tremor_deg", dist(&v.tremor_deg), records, drawn("tremor_deg")),
        column("exposure_ms", "video.exposure_ms", dist(&v.exposure_ms), records, drawn("exposure_ms")),
    ]
}
