//! COCO's average precision and recall of boxes, in the arithmetic of pycocotools.
//!
//! Detections of an image and category are taken by falling score, a hundred at most, each to the free truth of highest IoU
//! at or above the threshold; truths outside the area range, and crowds, are ignored with whatever matches them. Precision
//! is made monotone and read at 101 points of recall; averages leave out categories without truth.
use rayon::prelude::*;
use serde::Serialize;
use std::sync::atomic::{AtomicU32, Ordering};

/// A truth: `[x, y, width, height]` in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CocoTruth {
    /// Left, upper, width, height.
    pub bbox: [f64; 4],
    /// By which it is small, medium or large.
    pub area: f64,
    /// True for a region of many objects: it can be matched often and never counts.
    pub crowd: bool,
}

/// A claim: `[x, y, width, height]` in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CocoClaim {
    /// Left, upper, width, height.
    pub bbox: [f64; 4],
    /// 0..1.
    pub score: f64,
}

/// COCO's twelve numbers. What has no truth is absent.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct CocoScores {
    /// Mean over IoU 0.50 to 0.95.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ap: Option<f64>,
    /// At IoU 0.50.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ap50: Option<f64>,
    /// At IoU 0.75.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ap75: Option<f64>,
    /// Of truths below 32 x 32 px.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ap_small: Option<f64>,
    /// Of truths between 32 x 32 and 96 x 96 px.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ap_medium: Option<f64>,
    /// Of truths above 96 x 96 px.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ap_large: Option<f64>,
    /// Recall with one detection an image and category.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ar1: Option<f64>,
    /// Recall with ten.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ar10: Option<f64>,
    /// Recall with a hundred.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ar100: Option<f64>,
    /// The last of small truths.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ar_small: Option<f64>,
    /// Of medium truths.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ar_medium: Option<f64>,
    /// Of large truths.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ar_large: Option<f64>,
}

/// Number of IoU thresholds.
const IOUS: usize = 10;
/// All, small, medium, large, in px squared, both ends inside.
const AREAS: [[f64; 2]; 4] = [[0.0, 1e10], [0.0, 1024.0], [1024.0, 9216.0], [9216.0, 1e10]];
const MAX_DETECTIONS: [usize; 3] = [1, 10, 100];
const KEPT: usize = MAX_DETECTIONS[2];

/// What numpy's `linspace(0.5, 0.95, 10)` holds, to the last bit.
fn iou_thresholds() -> [f64; IOUS] {
    let step = (0.95 - 0.5) / 9.0;
    let mut out: [f64; IOUS] = std::array::from_fn(|k| k as f64 * step + 0.5);
    out[IOUS - 1] = 0.95;
    out
}

/// One image and category after matching. Bit `area * 10 + threshold` of a mask belongs to that pair.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CocoCell {
    /// Score, matched mask, ignored mask; by falling score.
    claims: Vec<(f64, u64, u64)>,
    /// Truths that count, an area.
    truths: [u32; AREAS.len()],
}

/// Matches one image and category at every threshold and area.
#[must_use]
pub fn match_cell(truths: &[CocoTruth], claims: &[CocoClaim]) -> CocoCell {
    let mut order: Vec<usize> = (0..claims.len()).collect();
    order.sort_by(|&a, &b| (claims[b].score + 0.0).total_cmp(&(claims[a].score + 0.0)));
    order.truncate(KEPT);
    let mut cell = CocoCell { claims: order.iter().map(|&k| (claims[k].score, 0, 0)).collect(), truths: [0; AREAS.len()] };
    let outside = |area: f64, [lo, hi]: [f64; 2]| area < lo || area > hi;
    let overlaps: Vec<f64> = order.iter().flat_map(|&k| truths.iter().map(move |t| overlap(&claims[k].bbox, t))).collect();
    let thresholds = iou_thresholds();
    // A claim that no truth overlaps enough for the lowest threshold matches nothing, whatever the others do.
    let row = |d: usize| &overlaps[d * truths.len()..(d + 1) * truths.len()];
    let near: Vec<bool> = (0..order.len()).map(|d| row(d).iter().any(|iou| *iou >= thresholds[0])).collect();
    let any_near = near.contains(&true);
    let mut free = vec![true; truths.len()];
    for (a, range) in AREAS.into_iter().enumerate() {
        let ignored = |t: &CocoTruth| t.crowd || outside(t.area, range);
        // Truths that count come first.
        let mut sorted: Vec<usize> = (0..truths.len()).collect();
        sorted.sort_by_key(|&g| ignored(&truths[g]));
        let counting = truths.iter().filter(|t| !ignored(t)).count();
        cell.truths[a] = counting as u32;
        let all_bits = ((1u64 << IOUS) - 1) << (a * IOUS);
        for (d, &k) in order.iter().enumerate().filter(|(d, _)| !near[*d]) {
            cell.claims[d].2 |= if outside(claims[k].bbox[2] * claims[k].bbox[3], range) { all_bits } else { 0 };
        }
        if !any_near {
            continue;
        }
        for (t, threshold) in thresholds.into_iter().enumerate() {
            let bit = 1u64 << (a * IOUS + t);
            free.fill(true);
            for (d, &k) in order.iter().enumerate().filter(|(d, _)| near[*d]) {
                let slot = &mut cell.claims[d];
                match best_truth(row(d), &sorted, counting, truths, &free, threshold) {
                    Some((position, g)) => {
                        free[g] = false;
                        slot.1 |= bit;
                        slot.2 |= if position >= counting { bit } else { 0 };
                    }
                    None if outside(claims[k].bbox[2] * claims[k].bbox[3], range) => slot.2 |= bit,
                    None => {}
                }
            }
        }
    }
    cell
}

/// Position (in `sorted`) and index of the truth a claim takes: of equals the last, as pycocotools has it; one that counts
/// before one that is ignored.
fn best_truth(
    row: &[f64],
    sorted: &[usize],
    counting: usize,
    truths: &[CocoTruth],
    free: &[bool],
    threshold: f64,
) -> Option<(usize, usize)> {
    let mut iou = threshold.min(1.0 - 1e-10);
    let mut best = None;
    for (position, &g) in sorted.iter().enumerate() {
        if !free[g] && !truths[g].crowd {
            continue;
        }
        if position >= counting && best.is_some_and(|(p, _)| p < counting) {
            break;
        }
        if row[g] >= iou {
            iou = row[g];
            best = Some((position, g));
        }
    }
    best
}

/// Intersection over union in the order of operations of pycocotools; with a crowd, over the claim's own area.
fn overlap(d: &[f64; 4], truth: &CocoTruth) -> f64 {
    let g = &truth.bbox;
    let w = (d[2] + d[0]).min(g[2] + g[0]) - d[0].max(g[0]);
    let h = (d[3] + d[1]).min(g[3] + g[1]) - d[1].max(g[1]);
    if w <= 0.0 || h <= 0.0 {
        return 0.0;
    }
    let (common, claimed) = (w * h, d[2] * d[3]);
    common / if truth.crowd { claimed } else { claimed + g[2] * g[3] - common }
}

/// Recall at the end and precision at 101 points of recall, of one category.
struct Curve {
    /// `[area][IoU][points]`: sum over the points is what averages need.
    precision_sum: [[f64; IOUS]; AREAS.len()],
    /// `[maximum of detections][area][IoU]`.
    recall: [[[f64; IOUS]; AREAS.len()]; MAX_DETECTIONS.len()],
    /// Areas that have truth.
    counts: [bool; AREAS.len()],
}

/// The twelve numbers over all categories; each category's cells come in order of their images.
#[must_use]
pub fn score(categories: &[Vec<CocoCell>]) -> CocoScores {
    let curves: Vec<Curve> = categories.par_iter().map(|cells| accumulate(cells)).collect();
    let ap = |area: usize, ious: std::ops::Range<usize>| {
        mean(curves.iter().filter(|c| c.counts[area]).flat_map(|c| ious.clone().map(move |t| c.precision_sum[area][t] / 101.0)))
    };
    let ar = |most: usize, area: usize| mean(curves.iter().filter(|c| c.counts[area]).flat_map(|c| c.recall[most][area]));
    CocoScores {
        ap: ap(0, 0..IOUS),
        ap50: ap(0, 0..1),
        ap75: ap(0, 5..6),
        ap_small: ap(1, 0..IOUS),
        ap_medium: ap(2, 0..IOUS),
        ap_large: ap(3, 0..IOUS),
        ar1: ar(0, 0),
        ar10: ar(1, 0),
        ar100: ar(2, 0),
        ar_small: ar(2, 1),
        ar_medium: ar(2, 2),
        ar_large: ar(2, 3),
    }
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, n) = values.fold((0.0, 0usize), |(s, n), v| (s + v, n + 1));
    (n > 0).then(|| sum / n as f64)
}

fn accumulate(cells: &[CocoCell]) -> Curve {
    let mut precision = precision_at_hits(&Ranked::new(cells));
    let recalled = hits_among_first(cells);
    let mut curve = Curve {
        precision_sum: [[0.0; IOUS]; AREAS.len()],
        recall: [[[0.0; IOUS]; AREAS.len()]; MAX_DETECTIONS.len()],
        counts: [false; AREAS.len()],
    };
    for a in 0..AREAS.len() {
        let truths: u64 = cells.iter().map(|c| u64::from(c.truths[a])).sum();
        curve.counts[a] = truths > 0;
        for t in 0..if truths > 0 { IOUS } else { 0 } {
            curve.precision_sum[a][t] = sum_over_recall(&mut precision[a * IOUS + t], truths as f64);
            for (m, hits) in recalled.iter().enumerate() {
                curve.recall[m][a][t] = hits[a * IOUS + t] as f64 / truths as f64;
            }
        }
    }
    curve
}

/// A claim that matches a truth at some threshold and area.
struct Match {
    score: f64,
    /// Position among all claims in order of the cells: of equal scores the first counts first.
    position: usize,
    matched: u64,
    ignored: u64,
}

/// The claims that match something, by falling score, and of all others, which are most, only how many come before each.
struct Ranked {
    matches: Vec<Match>,
    /// Claims that match nothing and are not ignored in an area, between a match and the one before it; one a match, and one behind.
    misses: Vec<[AtomicU32; AREAS.len()]>,
}

impl Ranked {
    fn new(cells: &[CocoCell]) -> Self {
        let starts: Vec<usize> = cells.iter().scan(0, |at, c| Some(std::mem::replace(at, *at + c.claims.len()))).collect();
        let claims = |k: usize| cells[k].claims.iter().enumerate().map(move |(rank, c)| (rank, c.0 + 0.0, c.1, c.2));
        let matches = (0..cells.len()).into_par_iter().flat_map_iter(|k| {
            let start = starts[k];
            let found = claims(k).filter(|(_, _, matched, _)| *matched != 0);
            found.map(move |(rank, score, matched, ignored)| Match { score, position: start + rank, matched, ignored })
        });
        let mut matches: Vec<Match> = matches.collect();
        matches.par_sort_unstable_by(|a, b| b.score.total_cmp(&a.score).then(a.position.cmp(&b.position)));
        let misses: Vec<[AtomicU32; AREAS.len()]> = (0..=matches.len()).map(|_| Default::default()).collect();
        (0..cells.len()).into_par_iter().for_each(|k| {
            for (rank, score, _, ignored) in claims(k).filter(|(_, _, matched, _)| *matched == 0) {
                let before = |m: &Match| m.score > score || (m.score == score && m.position < starts[k] + rank);
                let place = &misses[matches.partition_point(before)];
                let counting = place.iter().enumerate().filter(|(a, _)| of_area(ignored, *a) == 0);
                counting.for_each(|(_, count)| _ = count.fetch_add(1, Ordering::Relaxed));
            }
        });
        Self { matches, misses }
    }
}

/// The bits of a mask that belong to an area.
fn of_area(mask: u64, area: usize) -> u64 {
    mask >> (area * IOUS) & ((1 << IOUS) - 1)
}

/// For every area and threshold the precision at each hit, by falling score.
fn precision_at_hits(ranked: &Ranked) -> Vec<Vec<f64>> {
    let mut out: Vec<Vec<f64>> = vec![Vec::new(); AREAS.len() * IOUS];
    let mut misses = [0u64; AREAS.len() * IOUS];
    let mut misses_everywhere = [0u64; AREAS.len()];
    for (Match { matched, ignored, .. }, between) in ranked.matches.iter().zip(&ranked.misses) {
        for (a, everywhere) in misses_everywhere.iter_mut().enumerate() {
            *everywhere += u64::from(between[a].load(Ordering::Relaxed));
            if of_area(*matched, a) == 0 {
                *everywhere += u64::from(of_area(*ignored, a) == 0);
                continue;
            }
            for k in (a * IOUS..(a + 1) * IOUS).filter(|k| ignored >> k & 1 == 0) {
                if matched >> k & 1 == 0 {
                    misses[k] += 1;
                } else {
                    let hits = out[k].len() as u64 + 1;
                    out[k].push(hits as f64 / ((misses[k] + *everywhere + hits) as f64 + f64::EPSILON));
                }
            }
        }
    }
    out
}

/// For every maximum of detections, area and threshold: hits among the first so many of each cell.
fn hits_among_first(cells: &[CocoCell]) -> [[u64; AREAS.len() * IOUS]; MAX_DETECTIONS.len()] {
    let mut hits = [[0; AREAS.len() * IOUS]; MAX_DETECTIONS.len()];
    for (rank, (_, matched, ignored)) in cells.iter().flat_map(|c| c.claims.iter().enumerate()) {
        let counted = matched & !ignored;
        for k in (0..AREAS.len() * IOUS).filter(|k| counted != 0 && counted >> k & 1 == 1) {
            for (m, most) in MAX_DETECTIONS.into_iter().enumerate() {
                hits[m][k] += u64::from(rank < most);
            }
        }
    }
    hits
}

/// Sum over 101 points of recall of the precision, made monotone from the right. Between hits precision only falls, so its
/// values at the hits are enough.
fn sum_over_recall(precision: &mut [f64], truths: f64) -> f64 {
    for k in (1..precision.len()).rev() {
        precision[k - 1] = precision[k - 1].max(precision[k]);
    }
    let mut sum = 0.0;
    let mut k = 0;
    for r in 0..=100 {
        let wanted = if r == 100 { 1.0 } else { f64::from(r) * 0.01 };
        while k < precision.len() && ((k + 1) as f64 / truths) < wanted {
            k += 1;
        }
        sum += precision.get(k).copied().unwrap_or(0.0);
    }
    sum
}

#[cfg(test)]
mod reference {
    //! Average precision by its definition, one category: every recall point searches all detections.
    use super::*;

    /// `[(score, right)]` of one image at one IoU threshold, truths without crowds, all areas.
    fn matched(truths: &[CocoTruth], claims: &[CocoClaim], threshold: f64) -> Vec<(f64, bool)> {
        let mut sorted = claims.to_vec();
        sorted.sort_by(|a, b| b.score.partial_cmp(&a.score).unwrap());
        let mut free: Vec<&CocoTruth> = truths.iter().collect();
        let mut take = |c: &CocoClaim| {
            let best = free.iter().enumerate().map(|(k, t)| (overlap(&c.bbox, t), k)).filter(|(iou, _)| *iou >= threshold);
            let best = best.max_by(|a, b| a.0.partial_cmp(&b.0).unwrap());
            best.map(|(_, k)| free.remove(k)).is_some()
        };
        sorted.iter().take(100).map(|c| (c.score, take(c))).collect()
    }

    pub fn average_precision(images: &[(Vec<CocoTruth>, Vec<CocoClaim>)], threshold: f64) -> f64 {
        let truths: usize = images.iter().map(|i| i.0.len()).sum();
        let mut all: Vec<(f64, bool)> = images.iter().flat_map(|(t, c)| matched(t, c, threshold)).collect();
        all.sort_by(|a, b| b.0.partial_cmp(&a.0).unwrap());
        let hits = |n: usize| all[..n].iter().filter(|d| d.1).count() as f64;
        let at =
            |recall: f64| (1..=all.len()).filter(|&n| hits(n) / truths as f64 >= recall).map(|n| hits(n) / n as f64).fold(0.0, f64::max);
        // numpy's points: 70 * 0.01 is a little more than 0.7.
        (0..=100).map(|r| at(f64::from(r) * 0.01)).sum::<f64>() / 101.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tcross_dataset::Rng;

    #[test]
    fn equals_the_definition_on_random_images() {
        for case in 0..60 {
            let mut rng = Rng::for_item(5, "eval/test/coco", case);
            let mut draw = |n: i64| -> Vec<[f64; 4]> {
                let n = rng.int(0, n);
                (0..n).map(|_| [0, 0, 10, 10].map(|lo| (lo + rng.int(0, 12)) as f64)).collect()
            };
            let images: Vec<(Vec<CocoTruth>, Vec<CocoClaim>)> = (0..6)
                .map(|i| {
                    let truths = draw(4).into_iter().map(|bbox| CocoTruth { bbox, area: bbox[2] * bbox[3], crowd: false }).collect();
                    // Scores differ, so that the order is the same whatever the sort.
                    let score = |k: usize| ((k * 37 + i * 11) % 101) as f64 / 101.0 + i as f64 * 1e-4;
                    let claims = draw(9).into_iter().enumerate().map(|(k, bbox)| CocoClaim { bbox, score: score(k) }).collect();
                    (truths, claims)
                })
                .collect();
            let cells = images.iter().map(|(t, c)| match_cell(t, c)).collect();
            let got = score(&[cells]);
            if images.iter().all(|i| i.0.is_empty()) {
                assert_eq!(got.ap, None);
                continue;
            }
            let each: Vec<f64> = iou_thresholds().iter().map(|t| reference::average_precision(&images, *t)).collect();
            assert!((got.ap50.unwrap() - each[0]).abs() < 1e-9 && (got.ap75.unwrap() - each[5]).abs() < 1e-9, "case {case}");
            assert!((got.ap.unwrap() - each.iter().sum::<f64>() / 10.0).abs() < 1e-9, "case {case}");
        }
    }

    #[test]
    fn thresholds_are_numpys() {
        assert_eq!(iou_thresholds()[5], 0.75);
        assert_eq!(iou_thresholds()[9], 0.95);
    }
}
