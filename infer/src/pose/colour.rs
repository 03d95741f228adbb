//! What colours say: how much likelier each is inside the marker than beside it, learnt from the picture itself, so that any fill works (red
//! as well as green, pale as well as saturated, hatched, lit or in shadow).
use super::crop::Colour;

/// Bins along the two colour differences and along brightness.
const CHROMA: usize = 20;
const LIGHT: usize = 10;
const BINS: usize = CHROMA * CHROMA * LIGHT;

/// The bin of a colour whose channels are square roots of light. Differences are stretched near grey, where a small step decides between
/// a pale fill and paper.
#[must_use]
pub fn bin([r, g, b]: Colour) -> u16 {
    let stretch = |d: f32| d.abs().sqrt().copysign(d);
    let place = |v: f32, n: usize| ((v * n as f32) as usize).min(n - 1);
    let red_green = place(0.5 + 0.5 * stretch(r - g), CHROMA);
    let yellow_blue = place(0.5 + 0.5 * stretch((r + g) / 2.0 - b), CHROMA);
    ((place((r + g + b) / 3.0, LIGHT) * CHROMA + red_green) * CHROMA + yellow_blue) as u16
}

/// Spreads every count over its neighbours (1 2 1) along all three axes.
fn smooth(counts: &mut [f32]) {
    for (stride, n) in [(1, CHROMA), (CHROMA, CHROMA), (CHROMA * CHROMA, LIGHT)] {
        for line in 0..BINS / n {
            let start = line / stride * stride * n + line % stride;
            let mut before = counts[start];
            for k in 0..n {
                let i = start + k * stride;
                let here = counts[i];
                let after = if k + 1 < n { counts[i + stride] } else { here };
                counts[i] = 0.25 * before + 0.5 * here + 0.25 * after;
                before = here;
            }
        }
    }
}

/// A colour seen nowhere says nothing.
const UNSEEN: f32 = 2e-4;
/// No single colour decides alone.
const MOST: f32 = 2.5;

/// The logarithm of how much likelier each bin's colour is among cells taken for marker than among those taken for its surroundings.
#[must_use]
pub fn log_odds(bins: &[u16], marker: &[f32], around: &[f32]) -> Vec<f32> {
    let histogram = |weights: &[f32]| {
        let mut counts = vec![0.0f32; BINS];
        for (bin, weight) in bins.iter().zip(weights) {
            counts[*bin as usize] += weight;
        }
        smooth(&mut counts);
        let scale = 1.0 / weights.iter().sum::<f32>().max(1e-6);
        counts.iter_mut().for_each(|c| *c *= scale);
        counts
    };
    let (marker, around) = (histogram(marker), histogram(around));
    let mut table = marker;
    for (m, a) in table.iter_mut().zip(&around) {
        *m = if *m + a > 0.0 { ((*m + UNSEEN) / (a + UNSEEN)).ln().clamp(-MOST, MOST) } else { 0.0 };
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smoothing_keeps_the_total() {
        let mut counts = vec![0.0; BINS];
        let at = CHROMA * CHROMA * 3 + CHROMA * 5 + 7;
        counts[at] = 64.0;
        smooth(&mut counts);
        assert!((counts.iter().sum::<f32>() - 64.0).abs() < 1e-3);
        assert!((counts[at] - 8.0).abs() < 1e-4);
        assert!((counts[at + 1 + CHROMA + CHROMA * CHROMA] - 1.0).abs() < 1e-4);
    }

    #[test]
    fn a_colour_of_one_side_only_tells() {
        let (green, paper) = (bin([0.1, 0.8, 0.2]), bin([0.9, 0.9, 0.88]));
        let table = log_odds(&[green, green, paper, paper], &[1.0, 1.0, 0.5, 0.0], &[0.0, 0.0, 0.5, 1.0]);
        assert!(table[green as usize] > 2.0 && table[paper as usize] < -0.2, "{} {}", table[green as usize], table[paper as usize]);
        assert_eq!(table[bin([0.9, 0.1, 0.1]) as usize], 0.0);
    }
}
