//! Resampling of images: one set of draws, from which every interval and band of a report follows.
use crate::interval::{Interval, percentile_interval};
use rayon::prelude::*;
use tcross_dataset::Rng;

/// Above this many images neighbours are resampled together, in blocks of equal length: blocks are as independent as the
/// images are, and the work no longer grows with the set.
const MAX_BLOCKS: usize = 4096;

/// Sums of per-image quantities over resampled images.
#[derive(Debug, Clone, PartialEq)]
pub struct Bootstrap {
    width: usize,
    draws: Vec<f32>,
}

impl Bootstrap {
    /// Draws `draws` times as many images as there are, with replacement, and sums their rows of `width` numbers.
    /// `fill(i, row)` adds image `i` to a row. Draw `k` depends on the seed and `k` only.
    pub fn new(images: usize, width: usize, draws: usize, seed: u64, fill: impl Fn(usize, &mut [f32]) + Sync) -> Self {
        Self::with_sums(images, width, draws, seed, |i, row, (): &mut ()| fill(i, row)).0
    }

    /// The same where `fill` also adds the image to sums of its own, one a block of neighbours; they come in order.
    pub fn with_sums<S: Default + Send>(
        images: usize,
        width: usize,
        draws: usize,
        seed: u64,
        fill: impl Fn(usize, &mut [f32], &mut S) + Sync,
    ) -> (Self, Vec<S>) {
        let length = images.div_ceil(MAX_BLOCKS).max(1);
        let blocks = images.div_ceil(length);
        let mut rows = vec![0.0f32; blocks * width];
        let block = |(b, row): (usize, &mut [f32])| {
            let mut own = S::default();
            (b * length..images.min((b + 1) * length)).for_each(|i| fill(i, row, &mut own));
            own
        };
        let own = rows.par_chunks_mut(width.max(1)).enumerate().map(block).collect();
        let times: Vec<Vec<f32>> = (0..draws).into_par_iter().map(|k| weights(blocks, seed, k)).collect();
        let tiles: Vec<Vec<[f32; TILE]>> = (0..width.div_ceil(TILE)).into_par_iter().map(|t| sum_tile(&rows, width, t, &times)).collect();
        let mut sums = vec![0.0f32; draws * width];
        for (k, sum) in sums.chunks_mut(width.max(1)).enumerate() {
            sum.chunks_mut(TILE).zip(&tiles).for_each(|(part, tile)| part.copy_from_slice(&tile[k][..part.len()]));
        }
        (Self { width, draws: sums }, own)
    }

    /// The middle 95 % of a quantity computed from each draw's sums; draws where it is not finite are left out. `None`
    /// without draws.
    pub fn interval(&self, quantity: impl Fn(&[f32]) -> f64) -> Option<Interval> {
        percentile_interval(self.values(quantity))
    }

    /// A quantity of every draw.
    pub fn values(&self, quantity: impl Fn(&[f32]) -> f64) -> Vec<f64> {
        self.rows().map(quantity).collect()
    }

    /// The sums of every draw.
    pub fn rows(&self) -> impl Iterator<Item = &[f32]> {
        self.draws.chunks_exact(self.width.max(1))
    }
}

/// Columns that are summed together: their sums stay in registers, their rows in the cache for every draw.
const TILE: usize = 32;

/// The sums of every draw over the columns of tile `t`.
fn sum_tile(rows: &[f32], width: usize, t: usize, times: &[Vec<f32>]) -> Vec<[f32; TILE]> {
    let part = |row: &[f32]| {
        let mut out = [0.0; TILE];
        let from = &row[t * TILE..width.min((t + 1) * TILE)];
        out[..from.len()].copy_from_slice(from);
        out
    };
    let rows: Vec<[f32; TILE]> = rows.chunks_exact(width).map(part).collect();
    let sum = |times: &Vec<f32>| {
        let mut sum = [0.0f32; TILE];
        for (row, n) in rows.iter().zip(times) {
            sum.iter_mut().zip(row).for_each(|(s, r)| *s += n * r);
        }
        sum
    };
    times.iter().map(sum).collect()
}

/// How often each block is drawn in draw `k`.
fn weights(blocks: usize, seed: u64, k: usize) -> Vec<f32> {
    let mut rng = Rng::for_item(seed, "eval/bootstrap", k as u64);
    let mut times = vec![0.0; blocks];
    for _ in 0..blocks {
        times[rng.index(blocks)] += 1.0;
    }
    times
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interval_of_a_mean_has_the_known_width() {
        // 400 images, a quarter of them 1: the standard error of the mean is sqrt(0.25 * 0.75 / 400) = 0.02165.
        for images in [400, 400 * 50] {
            let draws = Bootstrap::new(images, 1, 2000, 1, |i, row| row[0] += if i % 4 == 0 { 1.0 } else { 0.0 });
            let [lo, hi] = draws.interval(|s| f64::from(s[0]) / images as f64).unwrap();
            let width = 2.0 * 1.96 * (0.25 * 0.75 / images as f64).sqrt();
            // Blocks of five neighbours hold one or two ones each, so only the first case has the binomial's width.
            if images == 400 {
                assert!(((hi - lo) / width - 1.0).abs() < 0.1, "{lo} {hi}");
            }
            assert!(lo < 0.25 && 0.25 < hi);
        }
    }

    #[test]
    fn tiles_add_up_as_single_columns_do() {
        // 70 columns fill two tiles and a part of a third.
        let value = |i: usize, c: usize| ((i * 31 + c * 17) % 23) as f32;
        let all = Bootstrap::new(40, 70, 9, 3, |i, row| row.iter_mut().enumerate().for_each(|(c, r)| *r += value(i, c)));
        for c in 0..70 {
            let one = Bootstrap::new(40, 1, 9, 3, |i, row| row[0] += value(i, c));
            assert_eq!(all.values(|s| f64::from(s[c])), one.values(|s| f64::from(s[0])), "column {c}");
        }
    }

    #[test]
    fn the_same_on_any_number_of_threads() {
        let make = || Bootstrap::new(97, 2, 50, 5, |i, row| row.iter_mut().for_each(|r| *r += i as f32));
        let pool = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        assert_eq!(pool(1).install(make), pool(3).install(make));
    }

    #[test]
    fn nothing_to_draw_from() {
        assert_eq!(Bootstrap::new(0, 3, 10, 0, |_, _| {}).interval(|s| f64::from(s[0] / s[1])), None);
        assert_eq!(Bootstrap::new(5, 3, 0, 0, |_, _| {}).interval(|s| f64::from(s[0])), None);
    }
}
