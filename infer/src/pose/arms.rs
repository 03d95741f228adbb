//! The lines inside the marker: which three of the four half diagonals carry one, where exactly, and where they meet.
//!
//! The eight symmetries of the square are four choices of the stem's corner times a mirroring; a T cross looks the same mirrored at its stem,
//! so four answers are left, and each half diagonal without a line names one: the stem lies opposite. Lines drawn by a hand bow to a side, so
//! each is followed along the bow that shows it best.
use super::{
    crop::{Colour, Picture},
    plane::{Point, distance, sub},
    stroke::Stroke,
};
use nalgebra::{Matrix3, Vector3};
use tcross_dataset::Homography;

/// Stations along a half diagonal.
pub const STATIONS: usize = 16;
/// Samples across it at each station.
const ACROSS: usize = 25;
/// Stations lie between these shares of the half diagonal: clear of the other arms and of the outline.
const FROM: f64 = 0.20;
const TO: f64 = 0.80;
/// Half of the width looked at, in sides of the marker.
const HALF_WIDTH: f64 = 0.18;
/// Samples at each end of a row that stand for the fill beside the line, as far as they lie inside the outline.
const FLANK: usize = 6;
/// Distance from the outline, in sides, from which a sample counts as inside.
const CLEAR: f64 = 0.03;
/// Half of the width of the window in which a line is summed, in samples: 0.07 sides in all.
const CORE: usize = 2;
/// Largest bow looked for to either side, in samples.
const BOW: i32 = 4;
/// A station is not seen where its fill is as light as this in all channels (square root of light; grey level 250 of 255): glare.
const BLOWN: f32 = 0.977;
/// Of sorted stations so many of a hundred at each end are left out: a gap in a line, a spot on the fill.
const TRIM_PERCENT: usize = 20;

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
    /// Strength of the lines, in deviations of the fill.
    pub strength: f64,
    /// Deviation of the samples beside the lines, in the same unit.
    pub noise: f64,
    /// Stations of all three lines at which the line shows.
    pub shown: usize,
    /// Stations that are not blown out, on the half diagonal where they are fewest.
    pub seen: usize,
    /// By how much the best choice of the half diagonal without a line explains the stations better than the next, in the lines' strength.
    pub lead: f64,
    /// How far beside the corner the line towards it ends, in sides to the right as seen from the centre.
    pub ends: [Option<f64>; 4],
    /// Where the lines meet, in the unit square, and its variances along the stem and across it.
    pub meeting: Point,
    /// How far from the middle of the quadrilateral the lines meet if nothing is known of where they should, in sides: far where a part of
    /// the marker is taken for the whole.
    pub beside: f64,
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

/// How many samples at each end of the row at station `i` lie too near to the outline or beyond it.
fn outside(i: usize) -> usize {
    let limit = std::f64::consts::FRAC_1_SQRT_2 * (1.0 - share(i)) - CLEAR;
    (0..ACROSS / 2).take_while(|j| -across(*j as f64) > limit).count()
}

/// Colours across one half diagonal, less the colour of their flanks; nothing where they lie outside the outline.
struct Band {
    rows: [[Colour; ACROSS]; STATIONS],
    /// False where the fill is blown out.
    seen: [bool; STATIONS],
}

/// The samples of a row that stand for the fill.
fn flanks(i: usize) -> impl Iterator<Item = usize> {
    (outside(i)..FLANK).flat_map(|j| [j, ACROSS - 1 - j])
}

fn band(picture: &Picture, map: &Homography, k: usize) -> Band {
    let mut seen = [true; STATIONS];
    let rows = std::array::from_fn(|i| {
        // A homography is nearly even along so short a row.
        let (a, b) = (map.apply(station(k, share(i), across(0.0))), map.apply(station(k, share(i), across((ACROSS - 1) as f64))));
        let step = [(b[0] - a[0]) / (ACROSS - 1) as f64, (b[1] - a[1]) / (ACROSS - 1) as f64];
        let outside = outside(i);
        let inside = outside..ACROSS - outside;
        let mut row = [[0.0f32; 3]; ACROSS];
        for j in inside.clone() {
            row[j] = picture.at([a[0] + step[0] * j as f64, a[1] + step[1] * j as f64]).map(f32::sqrt);
        }
        let count = flanks(i).count() as f32;
        let flank: Colour = std::array::from_fn(|c| flanks(i).map(|j| row[j][c]).sum::<f32>() / count);
        seen[i] = flank.iter().any(|v| *v < BLOWN);
        for v in &mut row[inside] {
            *v = std::array::from_fn(|c| v[c] - flank[c]);
        }
        row
    });
    Band { rows, seen }
}

/// Mean over the middle of all rows seen.
fn middle_of(band: &Band) -> Colour {
    const REACH: usize = 4;
    let (mut sum, mut count) = ([0.0f32; 3], 1e-6);
    for (row, _) in band.rows.iter().zip(&band.seen).filter(|(_, seen)| **seen) {
        for v in &row[ACROSS / 2 - REACH..=ACROSS / 2 + REACH] {
            (0..3).for_each(|c| sum[c] += v[c]);
        }
        count += (2 * REACH + 1) as f32;
    }
    sum.map(|v| v / count)
}

/// One half diagonal seen in the lines' colour.
struct Lane {
    /// Sums over windows of `2 * CORE + 1` samples, divided by their number.
    smooth: [[f32; ACROSS]; STATIONS],
    /// Stations that are not blown out.
    seen: [bool; STATIONS],
    /// The bow, in samples at the middle of the half diagonal, that shows most line.
    bow: f32,
    /// Line along that bow: mean of the middle stations, and the deviation of a station.
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
        for (row, out) in band.rows.iter().zip(&mut smooth) {
            let on: [f32; ACROSS] = std::array::from_fn(|j| dot(row[j], line));
            for (j, v) in out.iter_mut().enumerate() {
                let (from, to) = (j.saturating_sub(CORE), (j + CORE + 1).min(ACROSS));
                *v = on[from..to].iter().sum::<f32>() / (to - from) as f32;
            }
        }
        let mut lane = Self { smooth, seen: band.seen, bow: 0.0, mean: 0.0, deviation: 0.0 };
        let mut best = f32::MIN;
        for bow in -BOW..=BOW {
            // A straight line is likelier than a bowed one.
            let value = (0..STATIONS).filter(|i| lane.seen[*i]).map(|i| lane.at(i, bow as f32)).sum::<f32>();
            let value = value * (1.0 - 0.02 * bow.abs() as f32);
            if value > best {
                (best, lane.bow) = (value, bow as f32);
            }
        }
        let mut values = [0.0f32; STATIONS];
        let mut count = 0;
        for i in (0..STATIONS).filter(|i| lane.seen[*i]) {
            values[count] = lane.at(i, lane.bow);
            count += 1;
        }
        let values = &mut values[..count];
        values.sort_unstable_by(f32::total_cmp);
        let trim = count * TRIM_PERCENT / 100;
        let middle = &values[trim..count - trim];
        if !middle.is_empty() {
            lane.mean = middle.iter().sum::<f32>() / middle.len() as f32;
            // The ends, pulled in to the middle ones.
            let (lo, hi) = (middle[0], middle[middle.len() - 1]);
            let spread = values.iter().map(|v| (v.clamp(lo, hi) - lane.mean).powi(2)).sum::<f32>();
            lane.deviation = (spread / count as f32).sqrt();
        }
        lane
    }

    fn at(&self, i: usize, bow: f32) -> f32 {
        self.smooth[i][(ACROSS as f32 / 2.0 + bowed(bow, i)) as usize]
    }

    /// The line's place across at station `i`, in sides; `None` where it does not show.
    fn place(&self, i: usize, strength: f32) -> Option<f64> {
        if !self.seen[i] {
            return None;
        }
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

/// What must differ from the fill at least to be told from it, in square roots of light: keeps [`whiten`] from trusting an even fill blindly.
const GRAIN: f32 = 0.02;

/// Turns colours such that the fill beside the lines varies by 1 in every direction: the gaps of a hatched fill, which differ from it more than
/// many a line does but all in one direction, then weigh no more than its noise.
fn whiten(bands: &mut [Band; 4]) -> Option<()> {
    let mut sum = Matrix3::<f32>::identity() * (GRAIN * GRAIN);
    let (mut spread, mut count) = (Matrix3::<f32>::zeros(), 1e-6f32);
    for band in bands.iter() {
        for i in (0..STATIONS).filter(|i| band.seen[*i]) {
            for j in flanks(i) {
                let v = Vector3::from(band.rows[i][j]);
                spread += v * v.transpose();
                count += 1.0;
            }
        }
    }
    sum += spread / count;
    let turn = sum.cholesky()?.l().try_inverse()?;
    for band in bands {
        for v in band.rows.iter_mut().flatten() {
            *v = (turn * Vector3::from(*v)).into();
        }
    }
    Some(())
}

/// Reads the arms under a homography from the unit square to pixels; `None` where nothing differs from the fill.
#[must_use]
pub fn read(picture: &Picture, map: &Homography) -> Option<Arms> {
    let mut bands: [Band; 4] = std::array::from_fn(|k| band(picture, map, k));
    let differences: [Colour; 4] = std::array::from_fn(|k| middle_of(&bands[k]));
    whiten(&mut bands)?;
    let means: [Colour; 4] = std::array::from_fn(|k| middle_of(&bands[k]));
    // The colour that leads from fill to line: that of the three half diagonals which agree most, and of all where none does.
    let direction = |without: usize| {
        let sum: Colour = std::array::from_fn(|c| (0..4).filter(|k| *k != without).map(|k| means[k][c]).sum());
        let length = dot(sum, sum).sqrt();
        (sum.map(|v| v / length.max(1e-9)), length)
    };
    let lanes = |line: Colour| -> [Lane; 4] { std::array::from_fn(|k| Lane::new(&bands[k], line)) };
    let mut best: Option<(f32, usize, [Lane; 4], Colour)> = None;
    let mut next = f32::MIN;
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
            next = best.map_or(next, |b| b.0);
            best = Some((value, without, lanes, line));
        } else {
            next = next.max(value);
        }
    }
    let (value, without, lanes, line) = best?;
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
        let (mut sum, mut count) = (0.0f32, 1e-6f32);
        for (band, i) in bands.iter().flat_map(|band| (0..STATIONS).filter(|i| band.seen[*i]).map(move |i| (band, i))) {
            for j in flanks(i) {
                sum += dot(band.rows[i][j], line).powi(2);
                count += 1.0;
            }
        }
        (sum / count).sqrt()
    };
    let mut places: [Vec<(f64, f64)>; 4] = Default::default();
    for &k in &carrying {
        places[k].extend((0..STATIONS).filter_map(|i| Some((share(i), lanes[k].place(i, lanes[k].mean.max(0.3 * scale))?))));
    }
    let stem = (without + 2) % 4;
    let (strokes, free) = (Strokes::fit(&places, stem, &STROKE), Strokes::fit(&places, stem, &FREE));
    Some(Arms {
        presence: std::array::from_fn(|k| f64::from(lanes[k].mean / scale)),
        stem,
        separation: f64::from(separation),
        likeness: f64::from(likeness),
        contrast: carrying.iter().map(|k| f64::from(dot(differences[*k], differences[*k]).sqrt())).sum::<f64>() / 3.0,
        strength: f64::from(scale),
        noise: f64::from(noise),
        shown: places.iter().map(Vec::len).sum(),
        seen: bands.iter().map(|b| b.seen.iter().filter(|s| **s).count()).min().unwrap_or(0),
        lead: f64::from((value - next) / scale),
        ends: std::array::from_fn(|k| free.off(k, 1.0)),
        meeting: strokes.meeting(),
        beside: distance(free.meeting(), [0.5, 0.5]),
        wobble: strokes.wobble(),
    })
}

/// Deviation of a measured place, in sides.
const PLACE: f64 = 0.012;
/// What a stroke's offset, its turn, and its first three bows may be, in sides, where the quadrilateral is right.
const STROKE: [f64; 5] = [0.015, 0.015, 0.020, 0.010, 0.006];
/// The same where the quadrilateral is to be corrected.
const FREE: [f64; 5] = [0.05, 0.05, 0.020, 0.010, 0.006];

/// The two lines of a T cross as smooth curves: the whole diagonal, from the corner left of the stem to the one right of it, and the stem.
struct Strokes {
    stem: usize,
    whole: Option<Stroke>,
    short: Option<Stroke>,
}

impl Strokes {
    /// Fits places `(share, across)` of each half diagonal; to the right of one half is left of the other.
    fn fit(places: &[Vec<(f64, f64)>; 4], stem: usize, prior: &[f64; 5]) -> Self {
        let (right, left) = ((stem + 1) % 4, (stem + 3) % 4);
        let whole = places[left].iter().map(|(r, s)| (0.5 - 0.5 * r, -s)).chain(places[right].iter().map(|(r, s)| (0.5 + 0.5 * r, *s)));
        Self { stem, whole: Stroke::fit(whole, PLACE, prior), short: Stroke::fit(places[stem].iter().copied(), PLACE, prior) }
    }

    /// How far to the right of half diagonal `k`, as seen from the centre, its line runs at share `r` of it, in sides; `None` on the half
    /// diagonal without.
    fn off(&self, k: usize, r: f64) -> Option<f64> {
        match (k + 4 - self.stem) % 4 {
            0 => self.short.as_ref().map(|s| s.at(r)),
            1 => self.whole.as_ref().map(|s| s.at(0.5 + 0.5 * r)),
            3 => self.whole.as_ref().map(|s| -s.at(0.5 - 0.5 * r)),
            _ => None,
        }
    }

    /// Where they meet in the unit square.
    fn meeting(&self) -> Point {
        let [a, b] = [(self.stem + 1) % 4, self.stem].map(|k| sub(station(k, 0.0, self.off(k, 0.0).unwrap_or(0.0)), [0.5, 0.5]));
        [0.5 + a[0] + b[0], 0.5 + a[1] + b[1]]
    }

    /// Distance of the places from the curves, in sides: root mean square.
    fn wobble(&self) -> f64 {
        let squared = |stroke: &Option<Stroke>| stroke.as_ref().map_or(0.0, |s| s.wobble * s.wobble);
        ((2.0 * squared(&self.whole) + squared(&self.short)) / 3.0).sqrt()
    }
}

/// The point beside corner `k` of the unit square where its line ends, and the line's direction there.
#[must_use]
pub fn end_point(map: &Homography, k: usize, off: f64) -> (Point, Point) {
    (map.apply(station(k, 1.0, off)), map.apply(station(k, 0.9, off)))
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
        let strokes = Strokes::fit(&places, 0, &STROKE);
        let ([x, y], wobble) = (strokes.meeting(), strokes.wobble());
        let want = 0.5 - 0.02 / std::f64::consts::SQRT_2;
        assert!((x - want).abs() < 0.003 && (y - want).abs() < 0.003, "{x} {y}, not {want}");
        assert!(wobble < 0.003, "{wobble}");
        let free = Strokes::fit(&places, 0, &FREE);
        assert!((0..4).filter_map(|k| free.off(k, 1.0)).all(|off| off.abs() < 0.008));
        assert_eq!((0..4).map(|k| free.off(k, 1.0).is_some()).collect::<Vec<_>>(), [true, true, false, true]);
    }

    #[test]
    fn what_stands_for_the_fill_lies_inside() {
        for i in 0..STATIONS {
            let limit = std::f64::consts::FRAC_1_SQRT_2 * (1.0 - share(i));
            assert!(flanks(i).all(|j| across(j as f64).abs() < limit), "station {i}");
            assert!(flanks(i).count() >= 4, "station {i}");
        }
    }
}
