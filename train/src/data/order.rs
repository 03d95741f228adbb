//! Which image comes when: a function of (seed, position), where position counts images since the start of the training.
use tcross_dataset::Rng;

/// Epoch after epoch, each a new permutation.
#[derive(Debug, Clone)]
pub struct Order {
    seed: u64,
    marked: Vec<usize>,
    empty: Vec<usize>,
    /// Images without a marker that an epoch draws.
    empty_per_epoch: usize,
    epoch: Option<(u64, Vec<usize>)>,
}

impl Order {
    /// Over images of which `marked[k]` says whether image k has a marker. With `empty_ratio` (0..1), images without one are drawn
    /// anew for each epoch so that they make up this share of it, or as much as there are.
    #[must_use]
    pub fn new(seed: u64, marked: &[bool], empty_ratio: Option<f64>) -> Self {
        let indices = |wanted: bool| (0..marked.len()).filter(|&k| marked[k] == wanted).collect::<Vec<_>>();
        let (with, empty) = (indices(true), indices(false));
        let wanted = empty_ratio.map_or(empty.len(), |ratio| (with.len() as f64 * ratio / (1.0 - ratio)).round() as usize);
        let empty_per_epoch = if with.is_empty() { empty.len() } else { wanted.min(empty.len()) };
        Self { seed, marked: with, empty, empty_per_epoch, epoch: None }
    }

    /// Images in an epoch.
    #[must_use]
    pub fn images(&self) -> usize {
        self.marked.len() + self.empty_per_epoch
    }

    /// The image at a position.
    pub fn at(&mut self, position: u64) -> usize {
        let images = self.images() as u64;
        let epoch = position / images;
        if self.epoch.as_ref().is_none_or(|(known, _)| *known != epoch) {
            self.epoch = Some((epoch, self.shuffled(epoch)));
        }
        self.epoch.as_ref().map_or(0, |(_, order)| order[(position % images) as usize])
    }

    fn shuffled(&self, epoch: u64) -> Vec<usize> {
        let mut rng = Rng::for_item(self.seed, "train/order", epoch);
        let mut empty = self.empty.clone();
        if self.empty_per_epoch < empty.len() {
            rng.shuffle(&mut empty);
            empty.truncate(self.empty_per_epoch);
        }
        let mut order = self.marked.clone();
        order.extend(empty);
        rng.shuffle(&mut order);
        order
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_epoch_shows_every_image_once_in_another_order() {
        let mut order = Order::new(7, &[true; 20], None);
        let epochs: Vec<Vec<usize>> = (0..3).map(|e| (0..20).map(|k| order.at(e * 20 + k)).collect()).collect();
        for epoch in &epochs {
            let mut sorted = epoch.clone();
            sorted.sort_unstable();
            assert_eq!(sorted, (0..20).collect::<Vec<_>>());
        }
        assert!(epochs[0] != epochs[1] && epochs[1] != epochs[2]);
        assert_eq!(Order::new(7, &[true; 20], None).at(45), epochs[2][5]);
        assert_ne!((0..20).map(|k| Order::new(8, &[true; 20], None).at(k)).collect::<Vec<_>>(), epochs[0]);
    }

    #[test]
    fn empty_images_make_up_the_wanted_share() {
        let marked: Vec<bool> = (0..200).map(|k| k < 80).collect();
        let mut order = Order::new(1, &marked, Some(0.2));
        assert_eq!(order.images(), 100);
        for epoch in 0..3 {
            let shown: Vec<usize> = (0..100).map(|k| order.at(epoch * 100 + k)).collect();
            assert_eq!(shown.iter().filter(|k| marked[**k]).count(), 80);
        }
        assert_eq!(Order::new(1, &marked, None).images(), 200);
        assert_eq!(Order::new(1, &marked, Some(0.9)).images(), 200);
    }
}
