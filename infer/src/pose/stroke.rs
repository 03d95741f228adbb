//! A stroke drawn by hand as a smooth curve beside its chord: where it runs, and how well that is known.
use nalgebra::{SMatrix, SVector};

/// An offset, a turn and three waves that vanish at the chord's ends.
const TERMS: usize = 5;

/// The fitted curve.
#[derive(Debug, Clone)]
pub struct Stroke {
    coefficients: SVector<f64, TERMS>,
    spread: SMatrix<f64, TERMS, TERMS>,
    /// Root mean square of the places' distance from the curve.
    pub wobble: f64,
}

fn basis(t: f64) -> SVector<f64, TERMS> {
    let wave = |n: f64| (n * std::f64::consts::PI * t).sin();
    SVector::from([1.0, 2.0 * t - 1.0, wave(1.0), wave(2.0), wave(3.0)])
}

impl Stroke {
    /// Fits places `(t, off)`: `t` from 0 to 1 along the chord, `off` beside it with deviation `noise`. `prior` says how far from nothing each
    /// term may be. `None` where the numbers make no sense.
    #[must_use]
    pub fn fit(places: impl Iterator<Item = (f64, f64)> + Clone, noise: f64, prior: &[f64; TERMS]) -> Option<Self> {
        let mut normal = SMatrix::from_diagonal(&SVector::from(prior.map(|s| (noise / s).powi(2))));
        let mut right = SVector::<f64, TERMS>::zeros();
        for (t, off) in places.clone() {
            let b = basis(t);
            normal += b * b.transpose();
            right += b * off;
        }
        let inverse = normal.cholesky()?.inverse();
        let coefficients = inverse * right;
        let (sum, count) = places.fold((0.0, 1e-9), |(sum, n), (t, off)| (sum + (coefficients.dot(&basis(t)) - off).powi(2), n + 1.0));
        Some(Self { coefficients, spread: inverse * (noise * noise), wobble: (sum / count).sqrt() })
    }

    /// How far the curve is from its chord at `t`.
    #[must_use]
    pub fn at(&self, t: f64) -> f64 {
        self.coefficients.dot(&basis(t))
    }

    /// The deviation of [`Stroke::at`].
    #[must_use]
    pub fn deviation(&self, t: f64) -> f64 {
        let b = basis(t);
        b.dot(&(self.spread * b)).max(0.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bowed_stroke_is_followed_to_its_ends() {
        let bowed = |t: f64| 0.010 + 0.020 * (std::f64::consts::PI * t).sin();
        let places: Vec<(f64, f64)> = (0..16).map(|i| 0.1 + 0.05 * f64::from(i)).map(|t| (t, bowed(t))).collect();
        let stroke = Stroke::fit(places.into_iter(), 0.002, &[0.05, 0.05, 0.02, 0.01, 0.006]).unwrap();
        assert!((stroke.at(0.5) - bowed(0.5)).abs() < 0.001, "{}", stroke.at(0.5));
        // The ends are extrapolated: they are known less well, and say so.
        for end in [0.0, 1.0] {
            assert!((stroke.at(end) - bowed(end)).abs() < 3.0 * stroke.deviation(end), "{} {}", stroke.at(end), stroke.deviation(end));
            assert!(stroke.deviation(end) > 2.0 * stroke.deviation(0.5));
        }
        assert!(stroke.wobble < 0.001);
    }

    #[test]
    fn without_places_the_prior_is_left() {
        let stroke = Stroke::fit(std::iter::empty(), 0.01, &[0.03, 0.04, 0.01, 0.01, 0.01]).unwrap();
        assert!(stroke.at(0.3).abs() < 1e-12 && (stroke.deviation(1.0) - 0.05).abs() < 1e-9);
    }
}
