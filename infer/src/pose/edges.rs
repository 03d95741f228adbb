//! Sub-pixel positions of the outline on the full-resolution picture: profiles across each side, in linear light, where a
//! blurred edge is the share of fill in each sample and its middle is where that share passes one half.
use super::{
    crop::{Colour, Picture},
    plane::{Line, Point, along},
    quad::on_side,
};

/// Profiles a side.
pub const PROFILES: usize = 24;
/// Samples a profile, from inside to outside.
const SAMPLES: usize = 25;
/// Samples in a third of the profile, whose means stand for fill and surroundings.
const THIRD: usize = SAMPLES / 3;
/// Squared linear-light distance of fill and surroundings below which a profile says nothing.
const LEAST_CONTRAST: f32 = 4e-4;

/// One measured point of the outline.
#[derive(Debug, Clone, Copy)]
pub struct EdgePoint {
    /// Side, from corner `side` to corner `side + 1`.
    pub side: usize,
    /// Where, in pixels.
    pub at: Point,
    /// How clear the step was, 0..1.
    pub weight: f64,
}

fn mean(colours: &[Colour]) -> Colour {
    let scale = 1.0 / colours.len() as f32;
    colours.iter().fold([0.0; 3], |m, c| std::array::from_fn(|k| m[k] + c[k] * scale))
}

fn minus(a: Colour, b: Colour) -> Colour {
    std::array::from_fn(|k| a[k] - b[k])
}

fn product(a: Colour, b: Colour) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Looks for the outline within `reach` pixels of each side of `corners`; profiles without a clear step, or outside the
/// picture, are left out.
#[must_use]
pub fn measure(picture: &Picture, corners: &[Point; 4], reach: f64) -> Vec<EdgePoint> {
    let mut found = Vec::with_capacity(4 * PROFILES);
    let step = 2.0 * reach / (SAMPLES - 1) as f64;
    let mut profiles = vec![[[0.0f32; 3]; SAMPLES]; PROFILES];
    for side in 0..4 {
        let Some(line) = Line::through(corners[side], corners[(side + 1) % 4]) else { continue };
        let foot = |i: usize| on_side(corners, side, 0.04 + 0.92 * (i as f64 + 0.5) / PROFILES as f64);
        for (i, profile) in profiles.iter_mut().enumerate() {
            for (j, sample) in profile.iter_mut().enumerate() {
                *sample = picture.at(along(foot(i), line.normal, -reach + step * j as f64));
            }
        }
        let inner: Vec<Colour> = profiles.iter().map(|p| mean(&p[..THIRD])).collect();
        let fill = median(&inner);
        for (i, profile) in profiles.iter().enumerate() {
            if !picture.holds(along(foot(i), line.normal, reach), 0.0) {
                continue;
            }
            if let Some((offset, weight)) = step_position(profile, fill) {
                found.push(EdgePoint { side, at: along(foot(i), line.normal, -reach + step * offset), weight });
            }
        }
    }
    found
}

/// Median of each channel: the fill, though arms cross some of the profiles.
fn median(colours: &[Colour]) -> Colour {
    std::array::from_fn(|k| {
        let mut values: Vec<f32> = colours.iter().map(|c| c[k]).collect();
        let middle = values.len() / 2;
        *values.select_nth_unstable_by(middle, f32::total_cmp).1
    })
}

/// Where a profile steps from fill to surroundings, in samples from its start, and how clearly; `None` without a step.
fn step_position(profile: &[Colour; SAMPLES], fill: Colour) -> Option<(f64, f64)> {
    let apart = |a: Colour, b: Colour| product(minus(a, b), minus(a, b)).sqrt();
    // Light changes along a side, so a profile's own inside is the better reference unless an arm or a hole lies there.
    let own = mean(&profile[..THIRD]);
    let outer = apart(mean(&profile[SAMPLES - THIRD..]), fill);
    let fill = if apart(own, fill) < 0.35 * outer { own } else { fill };
    // The first place from which the colour stays away from the fill: whatever lies behind it is clutter.
    let limit = (0.05 * product(fill, fill).sqrt() + 0.012).max(0.25 * outer);
    let away = |j: usize| apart(profile[j], fill) > limit;
    let first = (0..SAMPLES - 2).find(|j| away(*j) && away(j + 1) && away(j + 2)).filter(|j| *j >= 4)?;
    let around = mean(&profile[(first + 3).min(SAMPLES - 3)..(first + 3 + THIRD).min(SAMPLES)]);
    let direction = minus(fill, around);
    let contrast = product(direction, direction);
    if contrast < LEAST_CONTRAST {
        return None;
    }
    // Share of fill in each sample, and its running sum.
    let mut sums = [0.0f32; SAMPLES + 1];
    for j in 0..SAMPLES {
        sums[j + 1] = sums[j] + (product(minus(profile[j], around), direction) / contrast).clamp(-0.5, 1.5);
    }
    let mean_of = |from: usize, to: usize| (sums[to] - sums[from]) / (to - from) as f32;
    // The clearest step between the means of the samples before and after it, near that place.
    let height = |j: usize| mean_of(j.saturating_sub(THIRD), j) - mean_of(j, (j + THIRD).min(SAMPLES));
    let best = (first.saturating_sub(2).max(3)..(first + THIRD).min(SAMPLES - 2)).max_by(|a, b| height(*a).total_cmp(&height(*b)))?;
    // An ideal step with the same levels and the same area under it: exact for any symmetric blur within the window.
    let half = THIRD.min(best).min(SAMPLES - best);
    let (from, to) = (best - half, best + half);
    let level = (half / 2).max(1);
    let (inside, outside) = (mean_of(from, from + level), mean_of(to - level, to));
    if inside - outside < 0.35 {
        return None;
    }
    let filled = ((mean_of(from, to) - outside) / (inside - outside)).clamp(0.0, 1.0);
    let offset = from as f64 + (to - from) as f64 * f64::from(filled) - 0.5;
    Some((offset, f64::from((inside - outside).min(1.0))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{Rgb, RgbImage};

    #[test]
    fn a_square_is_found_to_a_twentieth_of_a_pixel() {
        // Coverage is drawn in linear light, so the stored grey of a half-covered pixel is 188.
        let (lo, hi) = (20.3f64, 70.8f64);
        let cover = |v: u32| (f64::from(v + 1).min(hi) - f64::from(v).max(lo)).clamp(0.0, 1.0);
        let image = RgbImage::from_fn(96, 96, |x, y| {
            let share = cover(x) * cover(y);
            let srgb = |v: f64| if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
            Rgb([(255.0 * srgb(1.0 - share)).round() as u8, 255, (255.0 * srgb(1.0 - share)).round() as u8])
        });
        let picture = Picture::new(&image).unwrap();
        let corners = [[21.5, 19.5], [70.0, 21.0], [71.5, 70.0], [20.0, 71.5]];
        let points = measure(&picture, &corners, 6.0);
        assert!(points.len() > 80);
        for p in points {
            let [x, y] = p.at;
            let off = [y - lo, x - hi, y - hi, x - lo][p.side];
            assert!(off.abs() < 0.05, "side {} off {off}", p.side);
        }
    }

    #[test]
    fn one_colour_has_no_edge() {
        let image = RgbImage::from_pixel(50, 50, Rgb([9, 200, 30]));
        let picture = Picture::new(&image).unwrap();
        assert!(measure(&picture, &[[10.0, 10.0], [40.0, 10.0], [40.0, 40.0], [10.0, 40.0]], 5.0).is_empty());
    }
}
