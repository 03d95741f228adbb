//! Non-maximum suppression.
use crate::decode::NetDetection;
use tcross_dataset::{Detection, PixelBox, geom::boxes::iou};

/// What can suppress and be suppressed.
pub trait Claim {
    /// 0..1.
    fn score(&self) -> f64;
    /// Index of the class.
    fn class(&self) -> u32;
    /// In pixels of some image.
    fn bounds(&self) -> &PixelBox;
}

impl Claim for NetDetection {
    fn score(&self) -> f64 {
        f64::from(self.score)
    }

    fn class(&self) -> u32 {
        self.class
    }

    fn bounds(&self) -> &PixelBox {
        &self.bounds
    }
}

impl Claim for Detection {
    fn score(&self) -> f64 {
        self.score
    }

    fn class(&self) -> u32 {
        self.class
    }

    fn bounds(&self) -> &PixelBox {
        &self.bounds
    }
}

/// Keeps, class by class, each claim that no better one of its class overlaps by more than `max_iou`; at most `most` in all, by falling
/// score, equal scores in their given order.
#[must_use]
pub fn nms<C: Claim>(mut detections: Vec<C>, max_iou: f64, most: usize) -> Vec<C> {
    detections.sort_by(|a, b| b.score().total_cmp(&a.score())); // stable: equal scores keep their order
    let mut kept: Vec<C> = Vec::new();
    for candidate in detections {
        if kept.len() == most {
            break;
        }
        let free = |k: &C| k.class() != candidate.class() || iou(k.bounds(), candidate.bounds()) <= max_iou;
        if kept.iter().all(free) {
            kept.push(candidate);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use tcross_dataset::{PixelBox, Rng};

    /// The naive twin: take the best that is left, strike out what it suppresses, repeat; a class at a time.
    fn naive(all: &[NetDetection], max_iou: f64) -> Vec<NetDetection> {
        let mut kept = Vec::new();
        for class in 0..3 {
            let mut left: Vec<(usize, &NetDetection)> = all.iter().enumerate().filter(|(_, d)| d.class == class).collect();
            while let Some(best) = left.iter().copied().reduce(|a, b| if b.1.score > a.1.score { b } else { a }) {
                kept.push(best);
                left.retain(|(index, d)| *index != best.0 && iou(&d.bounds, &best.1.bounds) <= max_iou);
            }
        }
        kept.sort_by(|a, b| b.1.score.total_cmp(&a.1.score).then(a.0.cmp(&b.0)));
        kept.into_iter().map(|(_, d)| d.clone()).collect()
    }

    #[test]
    fn equals_its_naive_twin() {
        let mut rng = Rng::for_item(1, "test/nms", 0);
        for n in [0, 1, 2, 40, 120] {
            let all: Vec<NetDetection> = (0..n)
                .map(|_| NetDetection {
                    score: rng.int(1, 20) as f32 / 20.0, // many ties
                    objectness: 1.0,
                    class: rng.index(3) as u32,
                    bounds: PixelBox::from_center(rng.uniform(0.0, 40.0), rng.uniform(0.0, 40.0), rng.uniform(1.0, 30.0), 12.0),
                    keypoints: Vec::new(),
                })
                .collect();
            let expected = naive(&all, 0.45);
            assert_eq!(nms(all.clone(), 0.45, usize::MAX), expected);
            assert_eq!(nms(all, 0.45, 5), expected[..expected.len().min(5)]);
        }
    }
}
