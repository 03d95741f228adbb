//! The T cross fitted as a whole: four corners (eight numbers, a homography of the unit square) such that sides pass through
//! the outline's points and diagonals through the arms' points; Gauss-Newton with Tukey weights.
use super::plane::{Line, Point, distance, dot, sub, tukey};
use nalgebra::{SMatrix, SVector};
use tcross_dataset::Quad;

/// A point that lies on the line through two of the corners.
#[derive(Debug, Clone, Copy)]
pub struct Constraint {
    /// Where, in pixels.
    pub at: Point,
    /// The line's corners.
    pub corners: (usize, usize),
    /// True for the outline, false for an arm.
    pub outline: bool,
    /// 0..1.
    pub weight: f64,
}

/// Corners and how well the points agree with them.
#[derive(Debug, Clone)]
pub struct Fit {
    /// Corners in the order given.
    pub corners: [Point; 4],
    /// Robust deviation of the points of the four sides and of the two diagonals, px.
    pub sigmas: [f64; 6],
    /// Share of the weight that kept its vote, for each side.
    pub held: [f64; 4],
}

/// Distance of a constraint's point from its line and the derivative by the line's two corners.
fn residual(corners: &[Point; 4], c: &Constraint) -> Option<(f64, f64, Point)> {
    let (a, b) = (corners[c.corners.0], corners[c.corners.1]);
    let line = Line::through(a, b)?;
    let d = sub(b, a);
    Some((line.distance(c.at), dot(sub(c.at, a), d) / dot(d, d), line.normal))
}

/// Which of the six lines through two corners a constraint is about.
fn line_of(c: &Constraint) -> usize {
    if c.outline { c.corners.0 } else { 4 + c.corners.0 % 2 }
}

/// Robust deviation of each line's points: lines are told apart, since one side may be sharp and the next ragged.
fn deviations(corners: &[Point; 4], constraints: &[Constraint], floor: f64, limit: f64) -> [f64; 6] {
    let mut values: [Vec<f64>; 6] = Default::default();
    for c in constraints {
        if let Some((r, ..)) = residual(corners, c) {
            values[line_of(c)].push(r.abs());
        }
    }
    values.map(|mut v| {
        let middle = v.len() / 2;
        if v.is_empty() { floor } else { (1.483 * *v.select_nth_unstable_by(middle, f64::total_cmp).1).clamp(floor, limit) }
    })
}

/// Fits corners to the constraints, starting at `start`. `None` where the constraints leave a corner free.
#[must_use]
pub fn fit(start: [Point; 4], constraints: &[Constraint]) -> Option<Fit> {
    let mut corners = start;
    let side_px = Quad(start).side_px();
    let (floor, limit) = (0.1 + 0.002 * side_px, 0.03 * side_px + 0.7);
    let mut result = None;
    for _ in 0..5 {
        let sigmas = deviations(&corners, constraints, floor, limit);
        let mut normal = SMatrix::<f64, 8, 8>::identity() * 1e-9;
        let mut right = SVector::<f64, 8>::zeros();
        let (mut held, mut all) = ([0.0; 4], [0.0; 4]);
        for c in constraints {
            let (r, t, n) = residual(&corners, c)?;
            let sigma = sigmas[line_of(c)];
            let vote = tukey(r, 4.5 * sigma);
            if c.outline {
                held[c.corners.0] += vote.sqrt() * c.weight;
                all[c.corners.0] += c.weight;
            }
            let weight = c.weight * vote / (sigma * sigma);
            if weight <= 0.0 {
                continue;
            }
            let (i, j) = (2 * c.corners.0, 2 * c.corners.1);
            let slopes = [(i, -(1.0 - t) * n[0]), (i + 1, -(1.0 - t) * n[1]), (j, -t * n[0]), (j + 1, -t * n[1])];
            for (p, dp) in slopes {
                right[p] -= weight * dp * r;
                for (q, dq) in slopes {
                    normal[(p, q)] += weight * dp * dq;
                }
            }
        }
        let factor = normal.cholesky()?;
        let step = factor.solve(&right);
        for k in 0..4 {
            corners[k] = [corners[k][0] + step[2 * k], corners[k][1] + step[2 * k + 1]];
        }
        let share = std::array::from_fn(|k| if all[k] > 0.0 { held[k] / all[k] } else { 0.0 });
        let still = (0..4).all(|k| distance([0.0; 2], [step[2 * k], step[2 * k + 1]]) < 0.01);
        result = Some(Fit { corners, sigmas, held: share });
        if still {
            break;
        }
    }
    result.filter(|f| f.corners.iter().flatten().all(|v| v.is_finite()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::plane::between;

    #[test]
    fn exact_points_give_exact_corners() {
        let truth = [[12.0, 8.0], [90.0, 20.0], [84.0, 77.0], [5.0, 60.0]];
        let mut constraints = Vec::new();
        for k in 0..4 {
            for i in 1..10 {
                let at = between(truth[k], truth[(k + 1) % 4], f64::from(i) / 10.0);
                constraints.push(Constraint { at, corners: (k, (k + 1) % 4), outline: true, weight: 1.0 });
            }
        }
        constraints.push(Constraint { at: [50.0, 95.0], corners: (2, 3), outline: true, weight: 1.0 });
        let start = truth.map(|p| [p[0] + 1.5, p[1] - 1.0]);
        let got = fit(start, &constraints).unwrap();
        for (corner, truth) in got.corners.iter().zip(truth) {
            assert!(distance(*corner, truth) < 1e-3, "{:?}", got.corners);
        }
        assert!(fit(start, &constraints[..9]).is_none_or(|f| f.held[2] == 0.0));
    }
}
