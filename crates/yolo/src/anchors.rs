//! Anchors from boxes: k-means with 1 - IoU as distance and medians as centres, as in the paper's code.
use crate::error::YoloError;
use tcross_dataset::Rng;

/// Anchors and how well they cover the boxes they came from.
#[derive(Debug, Clone, PartialEq)]
pub struct AnchorFit {
    /// `[width, height]`, by rising area.
    pub anchors: Vec<[f32; 2]>,
    /// Mean over the boxes of the IoU with the best anchor, both centred at 0.
    pub mean_iou: f64,
}

/// Boxes used at most; of more, every n-th.
const MOST_BOXES: usize = 20_000;
/// Starts, of which the best is kept.
const STARTS: u64 = 4;
const MOST_ROUNDS: usize = 200;

/// `count` anchors for boxes of these sizes (positive widths and heights in net-input pixels). The same for the same seed.
///
/// # Errors
/// If there is no box, or one is not positive and finite.
pub fn kmeans(sizes: &[[f32; 2]], count: usize, seed: u64) -> Result<AnchorFit, YoloError> {
    if let Some(bad) = sizes.iter().find(|s| !s.iter().all(|side| side.is_finite() && *side > 0.0)) {
        return Err(YoloError::value("a box's size for anchors", format!("{bad:?}"), "positive widths and heights"));
    }
    let sizes: Vec<[f32; 2]> = sizes.iter().copied().step_by(sizes.len().div_ceil(MOST_BOXES).max(1)).collect();
    if sizes.is_empty() || count == 0 {
        return Err(YoloError::value("boxes for anchors", format!("{} boxes for {count} anchors", sizes.len()), "at least one of each"));
    }
    let fit = |start| {
        let mut centres = spread(&sizes, count, &mut Rng::for_item(seed, "yolo/anchors", start));
        refine(&sizes, &mut centres);
        AnchorFit { mean_iou: mean_iou(&sizes, &centres), anchors: centres }
    };
    let mut best = (1..STARTS).map(fit).fold(fit(0), |best, other| if other.mean_iou > best.mean_iou { other } else { best });
    best.anchors.sort_by(|a, b| (a[0] * a[1]).total_cmp(&(b[0] * b[1])).then(a[0].total_cmp(&b[0])));
    Ok(best)
}

/// Mean over `sizes` of the IoU with the best of `anchors`.
#[must_use]
pub fn mean_iou(sizes: &[[f32; 2]], anchors: &[[f32; 2]]) -> f64 {
    let best = |size: &[f32; 2]| anchors.iter().map(|a| shape_iou(*size, *a)).fold(0.0, f32::max);
    sizes.iter().map(|size| f64::from(best(size))).sum::<f64>() / sizes.len().max(1) as f64
}

/// IoU of two shapes `[width, height]`, both centred at 0.
pub(crate) fn shape_iou(a: [f32; 2], b: [f32; 2]) -> f32 {
    let both = a[0].min(b[0]) * a[1].min(b[1]);
    both / (a[0] * a[1] + b[0] * b[1] - both)
}

/// Start centres: one box at random, each further one with probability proportional to its distance from those chosen.
fn spread(sizes: &[[f32; 2]], count: usize, rng: &mut Rng) -> Vec<[f32; 2]> {
    let mut centres = vec![*rng.choose(sizes)];
    while centres.len() < count {
        let far = |size: &[f32; 2]| centres.iter().map(|c| f64::from(1.0 - shape_iou(*size, *c))).fold(1.0, f64::min);
        let weights: Vec<f64> = sizes.iter().map(far).collect();
        centres.push(sizes[rng.weighted(&weights)]);
    }
    centres
}

fn refine(sizes: &[[f32; 2]], centres: &mut [[f32; 2]]) {
    for _ in 0..MOST_ROUNDS {
        let mut members = vec![[Vec::new(), Vec::new()]; centres.len()];
        for size in sizes {
            let nearest =
                (0..centres.len()).fold(0, |best, c| if shape_iou(*size, centres[c]) > shape_iou(*size, centres[best]) { c } else { best });
            (0..2).for_each(|axis| members[nearest][axis].push(size[axis]));
        }
        let old = centres.to_vec();
        for (centre, members) in centres.iter_mut().zip(&mut members) {
            for (side, values) in centre.iter_mut().zip(members) {
                *side = median(values).unwrap_or(*side);
            }
        }
        if old == centres {
            return;
        }
    }
}

fn median(values: &mut [f32]) -> Option<f32> {
    values.sort_by(f32::total_cmp);
    let (low, high) = (values.get(values.len().wrapping_sub(1) / 2)?, values.get(values.len() / 2)?);
    Some((low + high) / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_separate_clusters() {
        let mut rng = Rng::for_item(1, "test/anchors", 0);
        let groups = [[10.0, 12.0], [40.0, 20.0], [90.0, 110.0]];
        let sizes: Vec<[f32; 2]> = (0..600).map(|i| groups[i % 3].map(|side: f64| (side * rng.uniform(0.9, 1.1)) as f32)).collect();
        let fit = kmeans(&sizes, 3, 7).unwrap();
        for (anchor, group) in fit.anchors.iter().zip(groups) {
            assert!(anchor.iter().zip(group).all(|(a, g)| (f64::from(*a) / g - 1.0).abs() < 0.03), "{:?}", fit.anchors);
        }
        assert!(fit.mean_iou > 0.9);
        assert_eq!(fit, kmeans(&sizes, 3, 7).unwrap());
    }

    #[test]
    fn medians_by_hand() {
        assert_eq!(median(&mut [3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(&mut [4.0, 1.0, 2.0, 3.0]), Some(2.5));
        assert_eq!(median(&mut []), None);
    }

    #[test]
    fn fewer_boxes_than_anchors_still_fit() {
        let fit = kmeans(&[[10.0, 10.0], [20.0, 30.0]], 6, 1).unwrap();
        assert_eq!((fit.anchors.len(), fit.mean_iou), (6, 1.0));
    }

    #[test]
    fn no_boxes_and_bad_boxes_are_errors() {
        assert!(kmeans(&[], 9, 0).is_err());
        assert!(kmeans(&[[1.0, f32::NAN]], 9, 0).is_err());
    }
}
