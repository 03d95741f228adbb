//! Points and lines of the picture's plane, and the robust fit of a line through noisy points.

/// A point or a vector in pixels.
pub type Point = [f64; 2];

/// `a - b`.
#[must_use]
pub fn sub(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

/// `a + t * d`.
#[must_use]
pub fn along(a: Point, d: Point, t: f64) -> Point {
    [a[0] + t * d[0], a[1] + t * d[1]]
}

/// `a + t * (b - a)`.
#[must_use]
pub fn between(a: Point, b: Point, t: f64) -> Point {
    along(a, sub(b, a), t)
}

/// Scalar product.
#[must_use]
pub fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// Length.
#[must_use]
pub fn norm(a: Point) -> f64 {
    dot(a, a).sqrt()
}

/// Distance of two points.
#[must_use]
pub fn distance(a: Point, b: Point) -> f64 {
    norm(sub(a, b))
}

/// A line in normal form: the points with `normal . p = offset`, `normal` of length 1. Unlike slope and intercept it is
/// as well conditioned for steep lines as for flat ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Unit normal.
    pub normal: Point,
    /// Distance from the origin along the normal.
    pub offset: f64,
}

impl Line {
    /// Through two points; the normal is to the left of the way from `a` to `b` as seen, so it points out of a polygon that
    /// runs clockwise. `None` where the points coincide.
    #[must_use]
    pub fn through(a: Point, b: Point) -> Option<Self> {
        let d = sub(b, a);
        let length = norm(d);
        if !(length > 1e-9 && length.is_finite()) {
            return None;
        }
        let normal = [d[1] / length, -d[0] / length];
        Some(Self { normal, offset: dot(normal, a) })
    }

    /// Signed distance of a point, positive on the side of the normal.
    #[must_use]
    pub fn distance(&self, p: Point) -> f64 {
        dot(self.normal, p) - self.offset
    }

    /// Where two lines cross; `None` where they are parallel to within 0.06 degrees.
    #[must_use]
    pub fn crossing(&self, other: &Self) -> Option<Point> {
        let (n, m) = (self.normal, other.normal);
        let det = n[0] * m[1] - n[1] * m[0];
        (det.abs() > 1e-3).then(|| [(self.offset * m[1] - other.offset * n[1]) / det, (other.offset * n[0] - self.offset * m[0]) / det])
    }
}

/// A point with a weight, for fits.
#[derive(Debug, Clone, Copy)]
pub struct Weighted {
    /// Where.
    pub at: Point,
    /// 0 or more.
    pub weight: f64,
}

/// Tukey's weight of a residual: 1 at 0, 0 from `reach` on.
#[must_use]
pub fn tukey(residual: f64, reach: f64) -> f64 {
    let u = residual / reach;
    if u.abs() < 1.0 { (1.0 - u * u).powi(2) } else { 0.0 }
}

/// Total least squares through weighted points; the normal keeps the side of `side`. `None` for fewer than two points or
/// points in one place.
fn fit_once(points: &[Weighted], side: Point) -> Option<Line> {
    let sum = |f: &dyn Fn(&Weighted) -> f64| points.iter().map(|p| p.weight * f(p)).sum::<f64>();
    let total = sum(&|_| 1.0);
    if total <= 1e-9 {
        return None;
    }
    let mean = [sum(&|p| p.at[0]) / total, sum(&|p| p.at[1]) / total];
    let xx = sum(&|p| (p.at[0] - mean[0]).powi(2));
    let yy = sum(&|p| (p.at[1] - mean[1]).powi(2));
    let xy = sum(&|p| (p.at[0] - mean[0]) * (p.at[1] - mean[1]));
    if xx + yy <= 1e-9 {
        return None;
    }
    let theta = 0.5 * (2.0 * xy).atan2(xx - yy);
    let mut normal = [-theta.sin(), theta.cos()];
    if dot(normal, side) < 0.0 {
        normal = [-normal[0], -normal[1]];
    }
    Some(Line { normal, offset: dot(normal, mean) })
}

/// Fits a line by iteratively reweighted least squares (Tukey), starting at `start`; the reach falls from `reach` pixels to
/// three robust deviations, at least `floor` pixels. `None` where nothing holds the line.
#[must_use]
pub fn fit_line(points: &[Weighted], start: Line, reach: f64, floor: f64) -> Option<Line> {
    let mut line = start;
    let mut reach = reach;
    let mut held = points.to_vec();
    let mut residuals: Vec<f64> = Vec::with_capacity(points.len());
    for _ in 0..6 {
        residuals.clear();
        for (h, p) in held.iter_mut().zip(points) {
            let r = line.distance(p.at);
            h.weight = p.weight * tukey(r, reach);
            if h.weight > 0.0 {
                residuals.push(r.abs());
            }
        }
        line = fit_once(&held, start.normal)?;
        if residuals.is_empty() {
            return None;
        }
        let middle = residuals.len() / 2;
        let median = *residuals.select_nth_unstable_by(middle, f64::total_cmp).1;
        reach = (3.0 * 1.483 * median).max(floor).min(reach);
    }
    Some(line)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_cross_where_they_should() {
        let a = Line::through([0.0, 3.0], [10.0, 3.0]).unwrap();
        let b = Line::through([4.0, -5.0], [4.0, 9.0]).unwrap();
        let p = a.crossing(&b).unwrap();
        assert!(distance(p, [4.0, 3.0]) < 1e-12);
        assert!(a.crossing(&Line { offset: 9.0, ..a }).is_none());
        assert!(Line::through([1.0, 1.0], [1.0, 1.0]).is_none());
        // Out of a polygon that runs clockwise as seen: above its upper side.
        assert!(a.distance([5.0, 0.0]) > 0.0);
    }

    #[test]
    fn a_third_of_outliers_does_not_move_a_line() {
        for steep in [[1.0, 0.02], [0.02, 1.0], [0.7, -0.7]] {
            let points: Vec<Weighted> = (0..30)
                .map(|i| {
                    let at = along([50.0, 50.0], steep, f64::from(i));
                    let off = if i % 3 == 0 { 4.0 + f64::from(i % 5) } else { 0.0 };
                    Weighted { at: along(at, [-steep[1], steep[0]], off), weight: 1.0 }
                })
                .collect();
            let truth = Line::through([50.0, 50.0], along([50.0, 50.0], steep, 1.0)).unwrap();
            let tilted = Line::through([50.0, 51.0], along([50.0, 49.5], steep, 30.0)).unwrap();
            let fit = fit_line(&points, tilted, 8.0, 0.5).unwrap();
            assert!(truth.distance([50.0, 50.0]).abs() < 1e-9);
            assert!(fit.distance([50.0, 50.0]).abs() < 0.05 && dot(fit.normal, truth.normal) > 0.9999, "{fit:?} {truth:?}");
        }
    }
}
