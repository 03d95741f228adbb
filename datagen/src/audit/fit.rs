//! Tests of fit and of independence.
use super::{
    Fit, LEAST, Pair,
    columns::{Column, Law},
};
use crate::dist::Dist;

/// How well a column follows its law; `None` where it has none.
pub(super) fn fit(column: &Column, level: f64) -> Option<Fit> {
    let mut values: Vec<f64> = column.values.iter().flatten().copied().collect();
    values.sort_by(f64::total_cmp);
    let n = values.len() as f64;
    let (statistic, p) = match &column.law {
        Law::None => return None,
        Law::Dist(law) if law.has_atoms() => chi_squared(&values, law),
        Law::Dist(law) => kolmogorov(&values, law),
        Law::Rounded(law) => {
            let (lo, hi) = law.bounds();
            let cell = |k: i64| (k as f64, law.cdf(k as f64 + 0.5) - law.cdf(k as f64 - 0.5));
            categories(&values, &(lo.round() as i64..=hi.round() as i64).map(cell).collect::<Vec<_>>())
        }
        Law::Whole(law) => {
            let (lo, hi) = law.bounds();
            // What lies below a whole number, without the number itself: values that a law gives stand farther apart than this.
            let below = |k: i64| law.cdf(k as f64 - 1e-9);
            let cell = |k: i64| (k as f64, below(k + 1) - below(k));
            categories(&values, &(lo.floor() as i64..=hi.floor() as i64).map(cell).collect::<Vec<_>>())
        }
        Law::Tally { share, some, all } => {
            let cells = vec![(*some, share * all), (all - some, (1.0 - share) * all)];
            if cells.iter().any(|c| c.0 > 0.0 && c.1 <= 0.0) { (f64::INFINITY, 0.0) } else { over_cells(cells) }
        }
        Law::Choice(shares) => categories(&values, &shares.iter().enumerate().map(|(k, s)| (k as f64, s.0)).collect::<Vec<_>>()),
    };
    let (mean, count) = match column.law {
        Law::Tally { some, all, .. } => (some / all, all as usize),
        _ => (values.iter().sum::<f64>() / n, values.len()),
    };
    Some(Fit { name: column.name.into(), key: column.key.into(), asked: column.law.words(), count, mean, statistic, p, good: p >= level })
}

/// Chi-squared over values that have a probability each; any other value is impossible.
fn categories(sorted: &[f64], shares: &[(f64, f64)]) -> (f64, f64) {
    let n = sorted.len() as f64;
    let count = |at: f64| sorted.iter().filter(|v| (**v - at).abs() < 0.5).count() as f64;
    let cells: Vec<(f64, f64)> = shares.iter().map(|(at, share)| (count(*at), share * n)).collect();
    let impossible = cells.iter().any(|c| c.0 > 0.0 && c.1 <= 0.0) || cells.iter().map(|c| c.0).sum::<f64>() < n;
    if impossible { (f64::INFINITY, 0.0) } else { over_cells(cells) }
}

/// Kolmogorov's distance and its p-value (the usual series, with Stephens' correction for small samples).
fn kolmogorov(sorted: &[f64], law: &Dist) -> (f64, f64) {
    let n = sorted.len() as f64;
    let distance = sorted.iter().enumerate().fold(0.0f64, |d, (k, v)| {
        let at = law.cdf(*v);
        d.max((at - k as f64 / n).abs()).max(((k + 1) as f64 / n - at).abs())
    });
    let x = distance * (n.sqrt() + 0.12 + 0.11 / n.sqrt());
    let series: f64 = (1..=100).map(|k| 2.0 * if k % 2 == 1 { 1.0 } else { -1.0 } * (-2.0 * f64::from(k * k) * x * x).exp()).sum();
    (distance, if x < 0.2 { 1.0 } else { series.clamp(0.0, 1.0) })
}

/// Chi-squared over the law's atoms and ten equally likely cells between them; over the degrees of freedom, and its p-value
/// (Wilson and Hilferty).
fn chi_squared(sorted: &[f64], law: &Dist) -> (f64, f64) {
    let n = sorted.len() as f64;
    let close = |a: f64, b: f64| (a - b).abs() < 1e-3;
    let atoms = law.atoms();
    let mut cells: Vec<(f64, f64)> =
        atoms.iter().map(|(at, weight)| (sorted.iter().filter(|v| close(**v, *at)).count() as f64, weight * n)).collect();
    let rest: Vec<f64> = sorted.iter().copied().filter(|v| !atoms.iter().any(|a| close(*v, a.0))).collect();
    let spread = 1.0 - atoms.iter().map(|a| a.1).sum::<f64>();
    if spread > 1e-9 {
        // The cumulative distribution without its atoms turns the rest into uniform numbers.
        let smooth = |x: f64| (law.cdf(x) - atoms.iter().filter(|a| a.0 <= x).map(|a| a.1).sum::<f64>()) / spread;
        let mut counts = [0.0; 10];
        rest.iter().for_each(|v| counts[((smooth(*v) * 10.0) as usize).min(9)] += 1.0);
        cells.extend(counts.map(|c| (c, spread * n / 10.0)));
    } else if !rest.is_empty() {
        return (f64::INFINITY, 0.0);
    }
    over_cells(cells)
}

/// Chi-squared over its degrees of freedom, and its p-value, of cells (found, asked).
fn over_cells(cells: Vec<(f64, f64)>) -> (f64, f64) {
    // Cells that expect less than five are thrown together.
    let (small, mut large): (Vec<_>, Vec<_>) = cells.into_iter().partition(|c| c.1 < 5.0);
    let sum = small.iter().fold((0.0, 0.0), |s, c| (s.0 + c.0, s.1 + c.1));
    if sum.1 > 0.0 {
        large.push(sum);
    }
    let freedom = (large.len() as f64 - 1.0).max(1.0);
    let chi: f64 = large.iter().map(|(found, asked)| (found - asked).powi(2) / asked.max(1e-9)).sum();
    let z = ((chi / freedom).cbrt() - (1.0 - 2.0 / (9.0 * freedom))) / (2.0 / (9.0 * freedom)).sqrt();
    (chi / freedom, if large.len() < 2 { 1.0 } else { upper_normal(z) })
}

/// Pairs that are tied by design.
fn tied(a: &str, b: &str) -> bool {
    let pair = |x: &str, y: &str| (a, b) == (x, y) || (b, a) == (x, y);
    // How many strokes there are, and so how finely the share of those with a gap is stepped, depends on what is drawn how.
    let strokes = ["shape", "medium", "line_medium", "aspect", "hatched", "hatch_spacing", "hatch_deg", "outlined", "retraced"];
    // How much is visible depends on what covers it and on the size, which decides what the border cuts.
    a == "visible" || b == "visible"
        || strokes.iter().any(|x| pair(x, "gaps"))
        // How many lines there are.
        || pair("shape", "retraced")
        // An image without a marker is one for which none was asked.
        || pair("markers", "empty")
        // The paper's coloured variants take both colours from the same draws.
        || pair("fill_level", "line_level")
}

/// How two columns go together; `None` where too few images have both.
pub(super) fn pair(a: &Column, b: &Column, level: f64) -> Option<Pair> {
    let both: (Vec<f64>, Vec<f64>) = a.values.iter().zip(&b.values).filter_map(|(x, y)| Some(((*x)?, (*y)?))).unzip();
    let n = both.0.len();
    if n < LEAST {
        return None;
    }
    // An angle is seen as its sine and cosine; two angles also as the sine and cosine of their difference and sum.
    let views = |c: &Column, v: &[f64]| -> Vec<Vec<f64>> {
        if c.angle {
            vec![v.iter().map(|d| d.to_radians().sin()).collect(), v.iter().map(|d| d.to_radians().cos()).collect()]
        } else {
            vec![v.to_vec()]
        }
    };
    let (first, second) = (views(a, &both.0), views(b, &both.1));
    let mut best = 0.0f64;
    for x in &first {
        for y in &second {
            let r = spearman(x, y);
            if r.abs() > best.abs() {
                best = r;
            }
        }
    }
    let tests = (first.len() * second.len()) as f64;
    let p = (2.0 * upper_normal(best.abs() * (n as f64 - 1.0).sqrt()) * tests).min(1.0);
    Some(Pair { a: a.name.into(), b: b.name.into(), correlation: best, p, flagged: p < level && !tied(a.name, b.name) })
}

/// Rank correlation; ties share their mean rank.
fn spearman(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (ranks(a), ranks(b));
    let mean = (a.len() as f64 - 1.0) / 2.0;
    let sum = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(u, v)| (u - mean) * (v - mean)).sum::<f64>();
    let scale = (sum(&a, &a) * sum(&b, &b)).sqrt();
    if scale > 0.0 { sum(&a, &b) / scale } else { 0.0 }
}

fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|i, j| values[*i].total_cmp(&values[*j]));
    let mut ranks = vec![0.0; values.len()];
    let mut k = 0;
    while k < order.len() {
        let same = order[k..].iter().take_while(|i| values[**i] == values[order[k]]).count();
        order[k..k + same].iter().for_each(|i| ranks[*i] = k as f64 + (same as f64 - 1.0) / 2.0);
        k += same;
    }
    ranks
}

/// The normal distribution's upper tail (Abramowitz and Stegun 7.1.26 through the complementary error function).
fn upper_normal(z: f64) -> f64 {
    libm::erfc(z / std::f64::consts::SQRT_2) / 2.0
}
