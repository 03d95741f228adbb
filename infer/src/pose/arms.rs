//! The lines inside the marker: which three of the four half diagonals carry one, and where exactly.
//!
//! The eight symmetries of the square are four choices of the stem's corner times a mirroring; a T cross looks the same
//! mirrored at its stem, so four answers are left, and each half diagonal without a line names one: the stem lies opposite.
use super::{
    crop::{Colour, Picture},
    plane::Point,
};
use tcross_dataset::Homography;

/// Stations along a half diagonal.
pub const STATIONS: usize = 16;
/// Samples across it at each station.
const ACROSS: usize = 23;
/// Stations lie between these shares of the half diagonal: clear of the other arms and of the outline.
const FROM: f64 = 0.26;
const TO: f64 = 0.80;
/// Half of the width looked at, in sides of the marker.
const HALF_WIDTH: f64 = 0.17;

/// What the four half diagonals show. Index `k` is the one from the centre to corner `k`.
#[derive(Debug, Clone)]
pub struct Arms {
    /// How much line each half diagonal carries: 0 for none, 1 for the mean of the three that carry most.
    pub presence: [f64; 4],
    /// The corner of the stem: opposite of the emptiest half diagonal.
    pub stem: usize,
    /// The emptiest against the next: their difference in standard errors.
    pub separation: f64,
    /// How alike the three lines are in colour, -1..1.
    pub likeness: f64,
    /// Contrast of line and fill, linear light.
    pub contrast: f64,
    /// Measured points of the lines in pixels, with the corner they lead to and a weight.
    pub points: Vec<(usize, Point, f64)>,
}

fn dot(a: Colour, b: Colour) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Colours across one half diagonal, less the colour of their flanks.
struct Band {
    rows: Vec<[Colour; ACROSS]>,
}

/// Position across in sides of the marker.
fn across(j: usize) -> f64 {
    HALF_WIDTH * (2.0 * (j as f64 + 0.5) / ACROSS as f64 - 1.0)
}

/// The point of the unit square at station `i` of half diagonal `k`, `s` sides to its right as seen from the centre.
fn station(k: usize, i: usize, s: f64) -> Point {
    let r = FROM + (TO - FROM) * (i as f64 + 0.5) / STATIONS as f64;
    let (dx, dy) = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)][k];
    let unit = std::f64::consts::SQRT_2 * s;
    [0.5 + dx * r - dy * unit, 0.5 + dy * r + dx * unit]
}

impl Band {
    fn new(picture: &Picture, map: &Homography, k: usize) -> Self {
        let rows = (0..STATIONS)
            .map(|i| {
                let mut row: [Colour; ACROSS] = std::array::from_fn(|j| picture.at(map.apply(station(k, i, across(j)))));
                // The flanks: the outer quarter on each side; the better of the two ends is not known, so both.
                let edge = ACROSS / 5;
                let ends: Colour = std::array::from_fn(|c| {
                    let sum = |range: std::ops::Range<usize>| row[range].iter().map(|v| v[c]).sum::<f32>();
                    (sum(0..edge) + sum(ACROSS - edge..ACROSS)) / (2 * edge) as f32
                });
                for v in &mut row {
                    *v = std::array::from_fn(|c| v[c] - ends[c]);
                }
                row
            })
            .collect();
        Self { rows }
    }

    /// Mean colour difference inside the flanks at each station.
    fn strengths(&self) -> Vec<Colour> {
        let edge = ACROSS / 5;
        let n = (ACROSS - 2 * edge) as f32;
        self.rows
            .iter()
            .map(|row| row[edge..ACROSS - edge].iter().fold([0.0; 3], |m, v| std::array::from_fn(|c| m[c] + v[c] / n)))
            .collect()
    }
}

/// Reads the arms under a homography from the unit square to pixels; `None` where nothing differs from the fill.
#[must_use]
pub fn read(picture: &Picture, map: &Homography) -> Option<Arms> {
    let bands: [Band; 4] = std::array::from_fn(|k| Band::new(picture, map, k));
    let strengths: [Vec<Colour>; 4] = std::array::from_fn(|k| bands[k].strengths());
    let means: [Colour; 4] =
        std::array::from_fn(|k| strengths[k].iter().fold([0.0; 3], |m, v| std::array::from_fn(|c| m[c] + v[c] / STATIONS as f32)));
    // Three lines of one colour against one half diagonal without: their sum points from fill to line.
    let sum: Colour = std::array::from_fn(|c| means.iter().map(|m| m[c]).sum());
    let length = dot(sum, sum).sqrt();
    if !(length > 1e-4) {
        return None;
    }
    let line = sum.map(|v| v / length);
    let along: [f32; 4] = std::array::from_fn(|k| dot(means[k], line));
    let mut order = [0, 1, 2, 3];
    order.sort_by(|a, b| along[*a].total_cmp(&along[*b]));
    let scale = (along[order[1]] + along[order[2]] + along[order[3]]) / 3.0;
    if !(scale > 1e-4) {
        return None;
    }
    let error = |k: usize| {
        let deviation: f32 = strengths[k].iter().map(|v| (dot(*v, line) - along[k]).powi(2)).sum::<f32>() / STATIONS as f32;
        deviation / STATIONS as f32
    };
    let noise = (error(order[0]) + error(order[1])).sqrt() + 0.02 * scale;
    let likeness = order[1..].iter().map(|k| dot(means[*k], line) / dot(means[*k], means[*k]).sqrt().max(1e-6)).fold(1.0, f32::min);
    let mut points = Vec::with_capacity(3 * STATIONS);
    let mut contrast = 0.0f32;
    for &k in &order[1..] {
        contrast = contrast.max(points_of(&bands[k], map, k, line, &mut points));
    }
    Some(Arms {
        presence: std::array::from_fn(|k| f64::from(along[k] / scale)),
        stem: (order[0] + 2) % 4,
        separation: f64::from((along[order[1]] - along[order[0]]) / noise),
        likeness: f64::from(likeness),
        contrast: f64::from(contrast),
        points,
    })
}

/// Adds the line's middle at each station where it is clear; returns the line's contrast.
fn points_of(band: &Band, map: &Homography, k: usize, line: Colour, points: &mut Vec<(usize, Point, f64)>) -> f32 {
    let lines: Vec<[f32; ACROSS]> = band.rows.iter().map(|row| row.map(|v| dot(v, line))).collect();
    let profile: [f32; ACROSS] = std::array::from_fn(|j| lines.iter().map(|l| l[j]).sum::<f32>() / STATIONS as f32);
    let peak = profile.iter().copied().fold(0.0, f32::max);
    if peak <= 1e-4 {
        return 0.0;
    }
    for (i, l) in lines.iter().enumerate() {
        // Half of the mean peak separates line from fill whatever the blur.
        let (mut mass, mut moment) = (0.0, 0.0);
        for (j, v) in l.iter().enumerate() {
            let over = f64::from((v - 0.35 * peak).clamp(0.0, 2.0 * peak));
            mass += over;
            moment += over * across(j);
        }
        if mass > 0.3 * f64::from(peak) {
            points.push((k, map.apply(station(k, i, moment / mass)), 1.0));
        }
    }
    peak
}
