//! From the marker's cells to a first quadrilateral: convex hull, the four-sided polygon of least area around it, and a
//! robust line through the outline's cells along each side.
use super::{
    crop::Coarse,
    plane::{Line, Point, Weighted, between, distance, fit_line, sub},
    segment::Mask,
};
use tcross_dataset::Quad;

/// Andrew's monotone chain: the hull's vertices, clockwise as seen, no three on a line.
fn hull(points: &mut [Point]) -> Vec<Point> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let turn = |o: Point, a: Point, b: Point| {
        let (u, v) = (sub(a, o), sub(b, o));
        u[0] * v[1] - u[1] * v[0]
    };
    let mut chain: Vec<Point> = Vec::new();
    let mut extend = |points: &mut dyn Iterator<Item = Point>| {
        let base = chain.len();
        for p in points {
            while chain.len() >= base + 2 && turn(chain[chain.len() - 2], chain[chain.len() - 1], p) <= 0.0 {
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
    };
    extend(&mut points.iter().copied());
    extend(&mut points.iter().rev().copied());
    chain
}

/// Takes away, again and again, the side whose removal (its neighbours prolonged until they meet) adds the least area,
/// until four are left. `None` where that is impossible.
fn four_sides(mut polygon: Vec<Point>) -> Option<[Point; 4]> {
    while polygon.len() > 4 {
        let n = polygon.len();
        let mut best: Option<(f64, usize, Point)> = None;
        for i in 0..n {
            let (a, b, c, d) = (polygon[(i + n - 1) % n], polygon[i], polygon[(i + 1) % n], polygon[(i + 2) % n]);
            let (before, after, side) = (Line::through(a, b)?, Line::through(d, c)?, Line::through(b, c)?);
            let Some(meet) = before.crossing(&after) else { continue };
            let height = side.distance(meet);
            if height < 0.0 {
                continue; // the neighbours run apart
            }
            let area = 0.5 * height * distance(b, c);
            if best.is_none_or(|(least, ..)| area < least) {
                best = Some((area, i, meet));
            }
        }
        let (_, i, meet) = best?;
        polygon[i] = meet;
        polygon.remove((i + 1) % n);
    }
    polygon.try_into().ok()
}

/// The corners where neighbouring sides cross: `sides[k]` runs from corner k to corner k + 1.
#[must_use]
pub fn corners_of(sides: &[Line; 4]) -> Option<[Point; 4]> {
    let mut corners = [[0.0; 2]; 4];
    for k in 0..4 {
        corners[k] = sides[(k + 3) % 4].crossing(&sides[k])?;
    }
    Some(corners)
}

/// True for four finite corners that run clockwise as seen, turn everywhere the same way and stay away from a triangle
/// or a needle.
#[must_use]
pub fn is_sound(corners: &[Point; 4]) -> bool {
    let quad = Quad(*corners);
    let area = quad.signed_area();
    let longest = (0..4).map(|k| distance(corners[k], corners[(k + 1) % 4])).fold(0.0, f64::max);
    area.is_finite()
        && area > 0.02 * longest * longest
        && (0..4).all(|k| {
            let (u, v) = (sub(corners[(k + 1) % 4], corners[k]), sub(corners[(k + 2) % 4], corners[(k + 1) % 4]));
            u[0] * v[1] - u[1] * v[0] > 0.08 * area
        })
}

/// The first quadrilateral in source pixels, clockwise as seen; `None` where the mask is nothing like one.
#[must_use]
pub fn quadrilateral(view: &Coarse, mask: &Mask) -> Option<[Point; 4]> {
    let mut outline: Vec<Point> = mask.boundary().into_iter().map(|(x, y)| [x as f64 + 0.5, y as f64 + 0.5]).collect();
    if outline.len() < 8 {
        return None;
    }
    let first = four_sides(hull(&mut outline))?;
    let mut corners = first;
    for reach in [0.10, 0.06] {
        let side_px = Quad(corners).side_px();
        let reach = (reach * side_px).max(1.5);
        let mut sides = [None; 4];
        for k in 0..4 {
            let (a, b) = (corners[k], corners[(k + 1) % 4]);
            let line = Line::through(a, b)?;
            let length = distance(a, b);
            let direction = sub(b, a);
            let near: Vec<Weighted> = outline
                .iter()
                .filter(|p| {
                    let t = super::plane::dot(sub(**p, a), direction) / (length * length);
                    (0.06..0.94).contains(&t) && line.distance(**p).abs() < reach
                })
                .map(|p| Weighted { at: *p, weight: 1.0 })
                .collect();
            sides[k] = Some(if near.len() >= 4 { fit_line(&near, line, reach, 0.7)? } else { line });
        }
        let [Some(a), Some(b), Some(c), Some(d)] = sides else { return None };
        // Middles of the outline's cells lie half a cell inside the outline.
        corners = corners_of(&[a, b, c, d].map(|l| Line { offset: l.offset + 0.25, ..l }))?;
        if !is_sound(&corners) {
            corners = first;
            break;
        }
    }
    is_sound(&corners).then(|| corners.map(|p| view.to_source(p)))
}

/// A point on the side from corner `k` to corner `k + 1`.
#[must_use]
pub fn on_side(corners: &[Point; 4], k: usize, t: f64) -> Point {
    between(corners[k], corners[(k + 1) % 4], t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cut_square_becomes_whole_again() {
        let octagon = vec![[1.0, 0.0], [9.0, 0.0], [10.0, 1.0], [10.0, 9.0], [9.0, 10.0], [1.0, 10.0], [0.0, 9.0], [0.0, 1.0]];
        let quad = four_sides(octagon).unwrap();
        assert!((Quad(quad).signed_area() - 100.0).abs() < 1e-9, "{quad:?}");
        assert!(four_sides(vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]).is_none());
    }

    #[test]
    fn hulls_run_clockwise() {
        let mut points = vec![[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0], [2.0, 2.0], [2.0, 0.0], [1.0, 3.0]];
        let h = hull(&mut points);
        assert_eq!(h.len(), 4);
        assert!(tcross_dataset::geom::quad::polygon_area(&h) > 0.0);
    }

    #[test]
    fn needles_and_bow_ties_are_unsound() {
        assert!(is_sound(&[[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]]));
        assert!(!is_sound(&[[0.0, 0.0], [10.0, 10.0], [10.0, 0.0], [0.0, 10.0]]));
        assert!(!is_sound(&[[0.0, 0.0], [100.0, 0.0], [100.0, 0.5], [0.0, 0.5]]));
        assert!(!is_sound(&[[f64::NAN; 2]; 4]));
    }
}
