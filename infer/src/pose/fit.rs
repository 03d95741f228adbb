//! A corner from all that is known of it: the two sides that meet there, the line that ends there, and the box that encloses it. Each of them
//! pulls the corner onto a straight line, as strongly as it is known.
use super::plane::{Point, dot, sub};

/// A line through the corner, and how far from it the corner may be.
#[derive(Debug, Clone, Copy)]
pub struct Pull {
    /// A point of the line, in pixels.
    pub at: Point,
    /// The line's unit normal.
    pub normal: Point,
    /// Deviation in pixels, above 0.
    pub deviation: f64,
}

/// Residuals of so many deviations count half.
const DOUBTED: f64 = 2.5;

/// Where the pulls agree best, and how surely.
#[derive(Debug, Clone, Copy)]
pub struct Corner {
    /// In pixels.
    pub at: Point,
    /// Variances along x, of x with y, and along y, in square pixels.
    pub covariance: [f64; 3],
}

/// Where the pulls agree best, beginning at `start`; a pull far from the others loses its vote. `None` where they leave a direction free.
#[must_use]
pub fn corner(start: Point, pulls: &[Pull]) -> Option<Corner> {
    let (mut at, mut covariance) = (start, [0.0; 3]);
    for round in 0..4 {
        let (mut xx, mut xy, mut yy, mut x, mut y) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for pull in pulls {
            let [a, b] = pull.normal;
            let off = dot(pull.normal, sub(pull.at, at));
            let doubt = if round == 0 { 0.0 } else { off / (DOUBTED * pull.deviation) };
            let weight = 1.0 / ((1.0 + doubt * doubt) * pull.deviation * pull.deviation);
            xx += weight * a * a;
            xy += weight * a * b;
            yy += weight * b * b;
            x += weight * a * off;
            y += weight * b * off;
        }
        let det = xx * yy - xy * xy;
        if !(det > 1e-3 * (xx + yy) * (xx + yy) * 0.25) {
            return None;
        }
        covariance = [yy / det, -xy / det, xx / det];
        at = [at[0] + (yy * x - xy * y) / det, at[1] + (xx * y - xy * x) / det];
    }
    at.iter().all(|v| v.is_finite()).then_some(Corner { at, covariance })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pull(at: Point, normal: Point, deviation: f64) -> Pull {
        let length = normal[0].hypot(normal[1]);
        Pull { at, normal: [normal[0] / length, normal[1] / length], deviation }
    }

    #[test]
    fn two_lines_meet_in_their_corner() {
        let pulls = [pull([0.0, 7.0], [0.1, 1.0], 0.3), pull([5.0, 0.0], [1.0, -0.2], 2.0)];
        let at = corner([0.0, 0.0], &pulls).unwrap().at;
        assert!(pulls.iter().all(|p| dot(p.normal, sub(at, p.at)).abs() < 1e-9), "{at:?}");
        assert!(corner([0.0, 0.0], &pulls[..1]).is_none());
        assert!(corner([0.0, 0.0], &[pulls[0], pulls[0]]).is_none(), "two lines of one direction leave the other free");
        assert!(corner([0.0, 0.0], &[]).is_none());
    }

    #[test]
    fn the_better_known_line_pulls_more_and_a_wrong_one_little() {
        let cross = pull([0.0, 0.0], [0.0, 1.0], 1.0);
        let at = corner([0.0, 0.0], &[cross, pull([0.0, 0.0], [1.0, 0.0], 1.0), pull([1.0, 0.0], [1.0, 0.0], 2.0)]).unwrap().at;
        assert!((at[0] - 0.2).abs() < 0.03 && at[1].abs() < 1e-9, "{at:?}");
        let wrong = pull([30.0, 0.0], [1.0, 0.0], 1.0);
        let at = corner([0.0, 0.0], &[cross, pull([0.0, 0.0], [1.0, 0.0], 1.0), pull([0.4, 0.0], [1.0, 0.0], 1.0), wrong]).unwrap().at;
        assert!(at[0] < 1.5, "{at:?}");
    }
}
