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

/// A colour seen nowhere says nothing.
const UNSEEN: f32 = 2e-4;
/// No single colour decides alone.
const MOST: f32 = 2.5;

/// The colours of a view: the few bins that occur in it, and how counts spread over them.
pub struct Palette {
    /// For every cell, the number of its colour among those that occur.
    pub colours: Vec<u16>,
    /// Where each colour's entries in `shares` end.
    ends: Vec<usize>,
    /// Colours whose counts spread to a colour, with the share that arrives: 1 2 1 along all three axes, of which most lead nowhere.
    shares: Vec<(u16, f32)>,
}

/// Not a colour's number.
const ABSENT: u16 = u16::MAX;

impl Palette {
    /// Of cells whose channels are square roots of light.
    #[must_use]
    pub fn new(cells: &[Colour]) -> Self {
        let mut numbers = [ABSENT; BINS];
        let mut bins: Vec<u16> = Vec::with_capacity(256);
        let colours = cells
            .iter()
            .map(|cell| {
                let bin = bin(*cell);
                let number = &mut numbers[bin as usize];
                if *number == ABSENT {
                    *number = bins.len() as u16;
                    bins.push(bin);
                }
                *number
            })
            .collect();
        let mut palette = Self { colours, ends: Vec::with_capacity(bins.len()), shares: Vec::with_capacity(8 * bins.len()) };
        // A bin at the end of an axis is its own neighbour.
        let near = |at: usize, n: usize| [(at.saturating_sub(1), 0.25f32), (at, 0.5), ((at + 1).min(n - 1), 0.25)];
        for bin in &bins {
            let bin = *bin as usize;
            for (light, a) in near(bin / (CHROMA * CHROMA), LIGHT) {
                for (red_green, b) in near(bin / CHROMA % CHROMA, CHROMA) {
                    for (yellow_blue, c) in near(bin % CHROMA, CHROMA) {
                        let number = numbers[(light * CHROMA + red_green) * CHROMA + yellow_blue];
                        if number != ABSENT {
                            palette.shares.push((number, a * b * c));
                        }
                    }
                }
            }
            palette.ends.push(palette.shares.len());
        }
        palette
    }

    /// Counts of nothing yet, `[marker, surroundings]` for every colour that occurs.
    #[must_use]
    pub fn no_counts(&self) -> Vec<[f32; 2]> {
        vec![[0.0; 2]; self.ends.len()]
    }

    /// The logarithm of how much likelier each colour is in the marker than in its surroundings, by the counts `[marker, surroundings]` of
    /// every colour.
    #[must_use]
    pub fn log_odds(&self, counts: &[[f32; 2]]) -> Vec<f32> {
        let total = counts.iter().fold([1e-6f32; 2], |[m, a], c| [m + c[0], a + c[1]]);
        let mut from = 0;
        let odds = self.ends.iter().map(|end| {
            let mut sum = [0.0f32; 2];
            for (number, share) in &self.shares[from..*end] {
                let [m, a] = counts[*number as usize];
                sum = [sum[0] + share * m, sum[1] + share * a];
            }
            from = *end;
            let (m, a) = (sum[0] / total[0], sum[1] / total[1]);
            if m + a > 0.0 { ((m + UNSEEN) / (a + UNSEEN)).ln().clamp(-MOST, MOST) } else { 0.0 }
        });
        odds.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every bin, one axis after the other.
    fn naive_smooth(counts: &[f32]) -> Vec<f32> {
        let mut counts = counts.to_vec();
        for (stride, n) in [(1, CHROMA), (CHROMA, CHROMA), (CHROMA * CHROMA, LIGHT)] {
            let before = counts.clone();
            for (i, v) in counts.iter_mut().enumerate() {
                let k = i / stride % n;
                let (down, up) = (if k > 0 { i - stride } else { i }, if k + 1 < n { i + stride } else { i });
                *v = 0.25 * before[down] + 0.5 * before[i] + 0.25 * before[up];
            }
        }
        counts
    }

    #[test]
    fn odds_equal_those_over_all_bins() {
        let mut rng = tcross_dataset::Rng::for_item(3, "test/palette", 0);
        // Dark ones at one end of the axes, and neighbours among them.
        let cells: Vec<Colour> = (0..300).map(|_| std::array::from_fn(|_| rng.uniform(0.0, 1.0).powi(3) as f32)).collect();
        let palette = Palette::new(&cells);
        let weights: Vec<[f32; 2]> = cells.iter().map(|_| [rng.uniform(0.0, 1.0) as f32, rng.uniform(0.0, 1.0) as f32]).collect();
        let mut counts = palette.no_counts();
        let mut all = [vec![0.0f32; BINS], vec![0.0f32; BINS]];
        for ((cell, colour), weight) in cells.iter().zip(&palette.colours).zip(&weights) {
            for k in 0..2 {
                counts[*colour as usize][k] += weight[k];
                all[k][bin(*cell) as usize] += weight[k];
            }
        }
        let odds = palette.log_odds(&counts);
        let smooth = all.map(|counts| {
            let total: f32 = counts.iter().sum();
            naive_smooth(&counts).iter().map(|c| c / total).collect::<Vec<_>>()
        });
        for (cell, colour) in cells.iter().zip(&palette.colours) {
            let [m, a] = [0, 1].map(|k| smooth[k][bin(*cell) as usize]);
            let want = ((m + UNSEEN) / (a + UNSEEN)).ln().clamp(-MOST, MOST);
            assert!((odds[*colour as usize] - want).abs() < 1e-3, "{} not {want}", odds[*colour as usize]);
        }
    }

    #[test]
    fn a_colour_of_one_side_only_tells() {
        let (green, paper) = ([0.1, 0.8, 0.2], [0.9, 0.9, 0.88]);
        let palette = Palette::new(&[green, paper, [0.9, 0.1, 0.1]]);
        let odds = palette.log_odds(&[[2.0, 0.0], [0.5, 1.5], [0.0, 0.0]]);
        assert!(odds[0] > 2.0 && odds[1] < -0.2, "{odds:?}");
        assert_eq!(odds[2], 0.0);
    }
}
