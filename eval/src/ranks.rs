//! Scores by their rank, where there are too many to sort: counted in bins first, then only the bins of the wanted ranks are sorted.
use rayon::prelude::*;

/// Bins of equal width over 0..=1.
const BINS: usize = 1 << 16;

/// The bin of a score in 0..=1.
pub(crate) fn bin(score: f64) -> usize {
    ((score * BINS as f64) as usize).min(BINS - 1)
}

/// How many scores lie in each bin.
pub(crate) struct Counts(Vec<usize>);

/// Counts groups of scores in 0..=1.
pub(crate) fn count<I: IntoIterator<Item = f64>>(groups: impl IndexedParallelIterator<Item = I>) -> Counts {
    // Few long pieces: each has bins of its own.
    let length = groups.len().div_ceil(4 * rayon::current_num_threads()).max(1);
    let own = groups.with_min_len(length).fold(
        || vec![0usize; BINS],
        |mut bins, group| {
            group.into_iter().for_each(|score| bins[bin(score)] += 1);
            bins
        },
    );
    Counts(own.reduce(|| vec![0; BINS], |a, b| a.iter().zip(&b).map(|(a, b)| a + b).collect()))
}

impl Counts {
    /// How many scores there are.
    pub(crate) fn total(&self) -> usize {
        self.0.iter().sum()
    }

    /// The scores at some ranks, 0 the highest; ranks rise and are below [`Self::total`]. `groups` gives the scores once more.
    pub(crate) fn at<I, P>(&self, ranks: impl Iterator<Item = usize>, groups: impl Fn() -> P) -> Vec<f64>
    where
        I: IntoIterator<Item = f64>,
        P: ParallelIterator<Item = I>,
    {
        // Of each rank its bin, and how many scores lie above that bin.
        let (mut next, mut above) = (BINS - 1, 0);
        let mut places = Vec::new();
        for rank in ranks {
            while above + self.0[next] <= rank {
                above += self.0[next];
                next -= 1;
            }
            places.push((next, above, rank));
        }
        let mut wanted = vec![false; BINS];
        places.iter().for_each(|(bin, ..)| wanted[*bin] = true);
        let wanted = &wanted;
        let mut kept: Vec<f64> = groups().flat_map_iter(|group| group.into_iter().filter(|score| wanted[bin(*score)])).collect();
        kept.par_sort_unstable_by(|a, b| b.total_cmp(a));
        let first = |of: usize| kept.partition_point(|score| bin(*score) > of);
        places.into_iter().map(|(bin, above, rank)| kept[first(bin) + rank - above]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tcross_dataset::Rng;

    #[test]
    fn ranks_are_those_of_sorting() {
        let mut rng = Rng::for_item(1, "test/ranks", 0);
        // Ties, both ends, and many in one bin.
        let mut score = |k: usize| match k % 5 {
            0 => 0.25,
            1 => [0.0, 1.0][k / 5 % 2],
            2 => 0.5 + 1e-9 * rng.unit(),
            _ => rng.unit(),
        };
        let groups: Vec<Vec<f64>> = (0..60).map(|g| (0..g % 9).map(|k| score(g + k)).collect()).collect();
        let mut sorted = groups.concat();
        sorted.sort_by(|a, b| b.total_cmp(a));
        let counts = count(groups.par_iter().map(|g| g.iter().copied()));
        assert_eq!(counts.total(), sorted.len());
        assert_eq!(counts.at(0..sorted.len(), || groups.par_iter().map(|g| g.iter().copied())), sorted);
        assert!(counts.at(std::iter::empty(), || groups.par_iter().map(|g| g.iter().copied())).is_empty());
    }
}
