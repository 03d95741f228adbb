//! The lines inside the marker: which three of the four half diagonals carry one, where exactly, and where they meet.
//!
//! The eight symmetries of the square are four choices of the stem's corner times a mirroring; a T cross looks the same mirrored at its stem,
//! so four answers are left, and each half diagonal without a line names one: the stem lies opposite. Lines drawn by a hand bow to a side, so
//! each is followed along the bow that shows it best.
use super::{
    crop::{Colour, Picture},
    plane::Point,
};
use nalgebra::{SMatrix, SVector};
use tcross_dataset::Homography;

/// Stations along a half diagonal.
pub const STATIONS: usize = 16;
/// Samples across it at each station.
const ACROSS: usize = 25;
/// Stations lie between these shares of the half diagonal: clear of the other arms and of the outline.
const FROM: f64 = 0.20;
const TO: f64 = 0.88;
/// Half of the width looked at, in sides of the marker.
const HALF_WIDTH: f64 = 0.18;
/// Samples at each end of a row that stand for the fill beside the line.
const FLANK: usize = 6;
/// Half of the width of the window in which a line is summed, in samples: 0.07 sides in all.
const CORE: usize = 2;
/// Largest bow looked for to either side, in samples.
const BOW: i32 = 4;

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
    /// Contrast of line and fill, in square roots of light.
    pub contrast: f64,
    /// Deviation of the rows' samples beside the lines, in the same unit.
    pub noise: f64,
    /// Measured points of the lines in pixels, with the corner they lead to and a weight.
    pub points: Vec<(usize, Point, f64)>,
    /// Where the lines meet, in the unit square, and its variances along the stem and across it.
    pub meeting: Point,
    /// Deviation of the measured points from smooth strokes, in sides.
    pub wobble: f64,
}

fn dot(a: Colour, b: Colour) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Position across in sides of the marker.
fn across(j: f64) -> f64 {
    HALF_WIDTH * (2.0 * (j + 0.5) / ACROSS as f64 - 1.0)
}

/// Share of the half diagonal at station `i`.
fn share(i: usize) -> f64 {
    FROM + (TO - FROM) * (i as f64 + 0.5) / STATIONS as f64
}

/// Unit square, from the centre towards corner `k`.
const TOWARDS: [Point; 4] = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]];

/// The point of the unit square at share `r` of half diagonal `k`, `s` sides to its right as seen from the centre.
fn station(k: usize, r: f64, s: f64) -> Point {
    let [dx, dy] = TOWARDS[k];
    let unit = std::f64::consts::SQRT_2 * s;
    [0.5 + dx * r - dy * unit, 0.5 + dy * r + dx * unit]
}

/// Colours across one half diagonal, less the colour of their flanks.
type Band = [[Colour; ACROSS]; STATIONS];

fn band(picture: &Picture, map: &Homography, k: usize) -> Band {
    std::array::from_fn(|i| {
        // A homography is nearly even along so short a row.
        let (a, b) = (map.apply(station(k, share(i), across(0.0))), map.apply(station(k, share(i), across((ACROSS - 1) as f64))));
        let step = [(b[0] - a[0]) / (ACROSS - 1) as f64, (b[1] - a[1]) / (ACROSS - 1) as f64];
        let mut row: [Colour; ACROSS] =
            std::array::from_fn(|j| picture.at([a[0] + step[0] * j as f64, a[1] + step[1] * j as f64]).map(f32::sqrt));
        let flank: Colour = std::array::from_fn(|c| {
            let sum = |range: std::ops::Range<usize>| row[range].iter().map(|v| v[c]).sum::<f32>();
            (sum(0..FLANK) + sum(ACROSS - FLANK..ACROSS)) / (2 * FLANK) as f32
        });
        for v in &mut row {
            *v = std::array::from_fn(|c| v[c] - flank[c]);
        }
        row
    })
}

/// Mean over the middle of all rows.
fn middle_of(band: &Band) -> Colour {
    const REACH: usize = 4;
    let mut sum = [0.0f32; 3];
    for row in band {
        for v in &row[ACROSS / 2 - REACH..=ACROSS / 2 + REACH] {
            (0..3).for_each(|c| sum[c] += v[c]);
        }
    }
    sum.map(|v| v / (STATIONS * (2 * REACH + 1)) as f32)
}

/// One half diagonal seen in the lines' colour.
struct Lane {
    /// Sums over windows of `2 * CORE + 1` samples, divided by their number.
    smooth: [[f32; ACROSS]; STATIONS],
    /// The bow, in samples at the middle of the half diagonal, that shows most line.
    bow: f32,
    /// Line along that bow: mean, and the deviation of a station.
    mean: f32,
    deviation: f32,
}

/// How far a stroke bowed by `bow` samples is from its chord at station `i`.
fn bowed(bow: f32, i: usize) -> f32 {
    let r = share(i) as f32;
    bow * 4.0 * r * (1.0 - r)
}

impl Lane {
    fn new(band: &Band, line: Colour) -> Self {
        let mut smooth = [[0.0f32; ACROSS]; STATIONS];
        for (row, out) in band.iter().zip(&mut smooth) {
            let on: [f32; ACROSS] = std::array::from_fn(|j| dot(row[j], line));
            for (j, v) in out.iter_mut().enumerate() {
                let (from, to) = (j.saturating_sub(CORE), (j + CORE + 1).min(ACROSS));
                *v = on[from..to].iter().sum::<f32>() / (to - from) as f32;
            }
        }
        let mut lane = Self { smooth, bow: 0.0, mean: f32::MIN, deviation: 0.0 };
        for bow in -BOW..=BOW {
            let mean = (0..STATIONS).map(|i| lane.at(i, bow as f32)).sum::<f32>() / STATIONS as f32;
            // A straight line is likelier than a bowed one.
            if mean * (1.0 - 0.02 * bow.abs() as f32) > lane.mean {
                (lane.mean, lane.bow) = (mean, bow as f32);
            }
        }
        let spread = (0..STATIONS).map(|i| (lane.at(i, lane.bow) - lane.mean).powi(2)).sum::<f32>();
        lane.deviation = (spread / STATIONS as f32).sqrt();
        lane
    }

    fn at(&self, i: usize, bow: f32) -> f32 {
        self.smooth[i][(ACROSS as f32 / 2.0 + bowed(bow, i)) as usize]
    }

    /// The line's place across at station `i`, in sides; `None` where it does not show.
    fn place(&self, i: usize, strength: f32) -> Option<f64> {
        let middle = (ACROSS as f32 / 2.0 + bowed(self.bow, i)) as usize;
        let (mut mass, mut moment) = (0.0f32, 0.0f32);
        for j in middle.saturating_sub(5)..(middle + 6).min(ACROSS) {
            let over = (self.smooth[i][j] - 0.4 * strength).clamp(0.0, strength);
            mass += over;
            moment += over * j as f32;
        }
        (mass > 0.6 * strength).then(|| across(f64::from(moment / mass)))
    }
}

/// Reads the arms under a homography from the unit square to pixels; `None` where nothing differs from the fill.
#[must_use]
pub fn read(picture: &Picture, map: &Homography) -> Option<Arms> {
    let bands: [Band; 4] = std::array::from_fn(|k| band(picture, map, k));
    let means: [Colour; 4] = std::array::from_fn(|k| middle_of(&bands[k]));
    // The colour that leads from fill to line: that of the three half diagonals which agree most, and of all where none does.
    let direction = |without: usize| {
        let sum: Colour = std::array::from_fn(|c| (0..4).filter(|k| *k != without).map(|k| means[k][c]).sum());
        let length = dot(sum, sum).sqrt();
        (sum.map(|v| v / length.max(1e-9)), length)
    };
    let lanes = |line: Colour| -> [Lane; 4] { std::array::from_fn(|k| Lane::new(&bands[k], line)) };
    let mut best: Option<(f32, usize, [Lane; 4], Colour)> = None;
    for without in 0..4 {
        let (line, length) = direction(without);
        if !(length > 1e-4) {
            continue;
        }
        let lanes = lanes(line);
        let others = || (0..4).filter(|k| *k != without);
        let least = others().map(|k| lanes[k].mean).fold(f32::MAX, f32::min);
        let mean = others().map(|k| lanes[k].mean).sum::<f32>() / 3.0;
        let value = 0.5 * (least + mean) - lanes[without].mean;
        if best.as_ref().is_none_or(|b| value > b.0) {
            best = Some((value, without, lanes, line));
        }
    }
    let (_, without, lanes, line) = best?;
    let mut carrying: Vec<usize> = (0..4).filter(|k| *k != without).collect();
    carrying.sort_by(|a, b| lanes[*a].mean.total_cmp(&lanes[*b].mean));
    let scale = carrying.iter().map(|k| lanes[*k].mean).sum::<f32>() / 3.0;
    if !(scale > 1e-4) {
        return None;
    }
    // Neighbouring stations share strokes of the fill: half of them count.
    let error = |k: usize| lanes[k].deviation.powi(2) / (0.5 * STATIONS as f32);
    let separation = (lanes[carrying[0]].mean - lanes[without].mean) / ((error(carrying[0]) + error(without)).sqrt() + 0.02 * scale);
    let likeness = carrying.iter().map(|k| dot(means[*k], line) / dot(means[*k], means[*k]).sqrt().max(1e-6)).fold(1.0, f32::min);
    let noise = {
        let beside = bands.iter().flatten().flat_map(|row| row[..FLANK].iter().chain(&row[ACROSS - FLANK..]));
        (beside.map(|v| dot(*v, line).powi(2)).sum::<f32>() / (4 * STATIONS * 2 * FLANK) as f32).sqrt()
    };
    let mut points = Vec::with_capacity(3 * STATIONS);
    let mut places: [Vec<(f64, f64)>; 4] = Default::default();
    for &k in &carrying {
        for i in 0..STATIONS {
            if let Some(s) = lanes[k].place(i, lanes[k].mean.max(0.3 * scale)) {
                points.push((k, map.apply(station(k, share(i), s)), 1.0));
                places[k].push((share(i), s));
            }
        }
    }
    let stem = (without + 2) % 4;
    let (meeting, wobble) = meeting(&places, stem);
    Some(Arms {
        presence: std::array::from_fn(|k| f64::from(lanes[k].mean / scale)),
        stem,
        separation: f64::from(separation),
        likeness: f64::from(likeness),
        contrast: f64::from(scale),
        noise: f64::from(noise),
        points,
        meeting,
        wobble,
    })
}

/// Deviation of a measured place, in sides.
const PLACE: f64 = 0.012;
/// What a stroke's offset, its turn, and its first three bows may be, in sides.
const STROKE: [f64; 5] = [0.015, 0.015, 0.020, 0.010, 0.006];

/// Fits a smooth stroke to places `(t, s)` along it, t from 0 to 1, and says how far it is from its chord at `t`, and how far the places
/// are from it (root mean square).
fn stroke(places: impl Iterator<Item = (f64, f64)> + Clone, at: f64) -> (f64, f64) {
    let basis = |t: f64| {
        let wave = |n: f64| (n * std::f64::consts::PI * t).sin();
        SVector::<f64, 5>::from([1.0, 2.0 * t - 1.0, wave(1.0), wave(2.0), wave(3.0)])
    };
    let mut normal = SMatrix::<f64, 5, 5>::from_diagonal(&SVector::from(STROKE.map(|s| 1.0 / (s * s))));
    let mut right = SVector::<f64, 5>::zeros();
    for (t, s) in places.clone() {
        let b = basis(t);
        normal += b * b.transpose() / (PLACE * PLACE);
        right += b * s / (PLACE * PLACE);
    }
    let Some(factor) = normal.cholesky() else { return (0.0, 0.0) };
    let solved = factor.solve(&right);
    let (sum, count) = places.fold((0.0, 1e-9), |(sum, n), (t, s)| (sum + (solved.dot(&basis(t)) - s).powi(2), n + 1.0));
    (solved.dot(&basis(at)), (sum / count).sqrt())
}

/// Where the strokes meet in the unit square, and the wobble of the places along them.
fn meeting(places: &[Vec<(f64, f64)>; 4], stem: usize) -> (Point, f64) {
    let (right, left) = ((stem + 1) % 4, (stem + 3) % 4);
    // The whole diagonal runs from the corner left of the stem to the one right of it; to the right of one half is left of the other.
    let whole = places[left].iter().map(|(r, s)| (0.5 - 0.5 * r, -s)).chain(places[right].iter().map(|(r, s)| (0.5 + 0.5 * r, *s)));
    let (whole, w0) = stroke(whole, 0.5);
    let (short, w1) = stroke(places[stem].iter().copied(), 0.0);
    // To the right of the way towards `right`, and to the right of the way towards the stem.
    let side = |k: usize, s: f64| {
        let [x, y] = station(k, 0.0, s);
        [x - 0.5, y - 0.5]
    };
    let (a, b) = (side(right, whole), side(stem, short));
    ([0.5 + a[0] + b[0], 0.5 + a[1] + b[1]], ((w0 * w0 * 2.0 + w1 * w1) / 3.0).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strokes_meet_where_they_are_drawn() {
        // The whole diagonal bows towards the stem's corner 0 by 0.02 sides, the stem is straight.
        let bow = |t: f64| 0.02 * (std::f64::consts::PI * t).sin();
        let mut places: [Vec<(f64, f64)>; 4] = Default::default();
        for i in 0..STATIONS {
            let r = share(i);
            // Corner 0 lies to the left of the way from corner 3 to corner 1: negative to the right.
            places[1].push((r, -bow(0.5 + 0.5 * r)));
            places[3].push((r, bow(0.5 - 0.5 * r)));
            places[0].push((r, 0.0));
        }
        let ([x, y], wobble) = meeting(&places, 0);
        let want = 0.5 - 0.02 / std::f64::consts::SQRT_2;
        assert!((x - want).abs() < 0.003 && (y - want).abs() < 0.003, "{x} {y}, not {want}");
        assert!(wobble < 0.003, "{wobble}");
    }
}
