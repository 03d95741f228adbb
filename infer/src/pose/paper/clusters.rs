//! From the Hough transform's segments to the marker: four clusters of directions, outline and arms, centre, stem, corners.
use crate::pose::plane::{Line, Point, distance, dot, sub};
use std::f64::consts::PI;

/// A segment with its undirected direction in [0, pi).
#[derive(Debug, Clone, Copy)]
pub struct Segment {
    /// Its ends.
    pub ends: [Point; 2],
    direction: f64,
}

impl Segment {
    /// `None` for a segment without length.
    #[must_use]
    pub fn new(ends: [Point; 2]) -> Option<Self> {
        let d = sub(ends[1], ends[0]);
        (dot(d, d) > 0.0).then(|| Self { ends, direction: d[1].atan2(d[0]).rem_euclid(PI) })
    }

    /// Its length.
    #[must_use]
    pub fn length(&self) -> f64 {
        distance(self.ends[0], self.ends[1])
    }
}

/// What the clusters say, in pixels of the picture they were found in.
#[derive(Debug, Clone)]
pub struct Reading {
    /// Where the arms' mean lines cross.
    pub center: Point,
    /// The stem's free end.
    pub stem: Point,
    /// The four outline lines: two of one direction, two of the other.
    pub sides: [[Line; 2]; 2],
}

/// Cuts segments at the four widest gaps between their directions. Directions lie on a circle: -90 and +90 degrees are one.
#[must_use]
pub fn four_clusters(mut segments: Vec<Segment>) -> Option<[Vec<Segment>; 4]> {
    let n = segments.len();
    if n < 5 {
        return None;
    }
    segments.sort_by(|a, b| a.direction.total_cmp(&b.direction));
    let gap = |i: usize| {
        let next = segments[(i + 1) % n].direction + if i + 1 == n { PI } else { 0.0 };
        next - segments[i].direction
    };
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|a, b| gap(*b).total_cmp(&gap(*a)));
    let mut cuts = order[..4].to_vec();
    cuts.sort_unstable();
    let cluster = |k: usize| {
        let (from, to) = (cuts[k] + 1, if k == 3 { cuts[0] + n } else { cuts[k + 1] });
        (from..=to).map(|i| segments[i % n]).collect()
    };
    Some([cluster(0), cluster(1), cluster(2), cluster(3)])
}

/// The mean line of segments of nearly one direction, weighted by length.
fn mean_line(segments: &[Segment]) -> Option<Line> {
    // Doubled angles make opposite directions the same.
    let sum = |f: &dyn Fn(&Segment) -> f64| segments.iter().map(|s| s.length() * f(s)).sum::<f64>();
    let theta = 0.5 * sum(&|s| (2.0 * s.direction).sin()).atan2(sum(&|s| (2.0 * s.direction).cos()));
    let normal = [-theta.sin(), theta.cos()];
    let total = sum(&|_| 1.0);
    (total > 0.0).then(|| Line { normal, offset: sum(&|s| 0.5 * (dot(normal, s.ends[0]) + dot(normal, s.ends[1]))) / total })
}

/// Offsets of segments along the normal of their mean line.
fn offsets(segments: &[Segment], normal: Point) -> Vec<f64> {
    segments.iter().map(|s| 0.5 * (dot(normal, s.ends[0]) + dot(normal, s.ends[1]))).collect()
}

fn spread(segments: &[Segment]) -> Option<f64> {
    let values = offsets(segments, mean_line(segments)?.normal);
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    Some((values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt())
}

/// Cuts a cluster of outline segments at its widest gap into the two parallel sides.
fn two_sides(segments: &[Segment]) -> Option<[Line; 2]> {
    let normal = mean_line(segments)?.normal;
    let mut sorted: Vec<(f64, Segment)> = offsets(segments, normal).into_iter().zip(segments.iter().copied()).collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let cut = (1..sorted.len()).max_by(|a, b| (sorted[*a].0 - sorted[*a - 1].0).total_cmp(&(sorted[*b].0 - sorted[*b - 1].0)))?;
    let part = |range: &[(f64, Segment)]| mean_line(&range.iter().map(|p| p.1).collect::<Vec<_>>());
    Some([part(&sorted[..cut])?, part(&sorted[cut..])?])
}

/// Reads the four clusters: of the pairs 1+3 and 2+4 the outline is the one that does not hold the least spread of offsets
/// (both edges of a drawn line lie close together).
#[must_use]
pub fn read(clusters: &[Vec<Segment>; 4]) -> Option<Reading> {
    let spreads = [0, 1, 2, 3].map(|k| spread(&clusters[k]).unwrap_or(f64::INFINITY));
    let least = (0..4).min_by(|a, b| spreads[*a].total_cmp(&spreads[*b]))?;
    let (inner, outer) = ([least % 2, least % 2 + 2], [1 - least % 2, 3 - least % 2]);
    let center = mean_line(&clusters[inner[0]])?.crossing(&mean_line(&clusters[inner[1]])?)?;
    let longest = |k: usize| clusters[k].iter().max_by(|a, b| a.length().total_cmp(&b.length()));
    let (a, b) = (longest(inner[0])?, longest(inner[1])?);
    let stem = if a.length() < b.length() { a } else { b };
    let [p, q] = stem.ends;
    let stem = if distance(p, center) > distance(q, center) { p } else { q };
    Some(Reading { center, stem, sides: [two_sides(&clusters[outer[0]])?, two_sides(&clusters[outer[1]])?] })
}

impl Reading {
    /// The corners, clockwise as seen, the one nearest to the stem's direction first; sides pushed outwards by `grow` px.
    #[must_use]
    pub fn corners(&self, grow: f64) -> Option<[Point; 4]> {
        let push = |l: &Line| Line { offset: l.offset + grow * (l.offset - dot(l.normal, self.center)).signum(), ..*l };
        let [[a, b], [c, d]] = self.sides.map(|pair| pair.map(|l| push(&l)));
        let mut corners = [a.crossing(&c)?, a.crossing(&d)?, b.crossing(&d)?, b.crossing(&c)?];
        if tcross_dataset::Quad(corners).signed_area() < 0.0 {
            corners.reverse();
        }
        let towards = sub(self.stem, self.center);
        let agreement = |p: Point| {
            let d = sub(p, self.center);
            dot(d, towards) / (dot(d, d) * dot(towards, towards)).sqrt().max(1e-9)
        };
        let first = (0..4).max_by(|i, j| agreement(corners[*i]).total_cmp(&agreement(corners[*j])))?;
        corners.rotate_left(first);
        Some(corners)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drawn_t_cross_is_read_at_every_turn() {
        for degrees in (0..360).step_by(7) {
            let (s, c) = f64::from(degrees).to_radians().sin_cos();
            let turn = |[x, y]: Point| [50.0 + c * x - s * y, 50.0 + s * x + c * y];
            let mut segments = Vec::new();
            let mut add = |a: Point, b: Point| segments.push(Segment::new([turn(a), turn(b)]).unwrap());
            let r = 30.0;
            for (a, b) in [([-r, -r], [r, -r]), ([r, -r], [r, r]), ([r, r], [-r, r]), ([-r, r], [-r, -r])] {
                add(a, b);
            }
            // Both edges of the diagonal from the right top to the left bottom, and of the stem to the left top.
            for off in [-1.5, 1.5] {
                add([r + off, -r + off], [-r + off, r + off]);
                add([off, -off], [-r + off, -r - off]);
            }
            let reading = read(&four_clusters(segments).unwrap()).unwrap();
            assert!(distance(reading.center, [50.0, 50.0]) < 0.1);
            let corners = reading.corners(0.0).unwrap();
            assert!(distance(corners[0], turn([-r, -r])) < 0.1, "{degrees}: {corners:?}");
            assert!(distance(corners[1], turn([r, -r])) < 0.1);
        }
    }
}
