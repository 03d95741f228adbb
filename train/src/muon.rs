//! Muon (K. Jordan and others, 2024): a kernel moves along its momentum made orthogonal, so that all directions in which it could change are
//! taken with equal strides, not only the few that dominate its gradient. Kernels are read as matrices of a row a filter.
use crate::optimizer::Slot;
use tcross_kernels::matrix::{Matrix, multiply_add};

/// Coefficients of the quintic iteration: they bring singular values near 1 fast, not exactly.
const QUINTIC: [f32; 3] = [3.4445, -4.7750, 2.0315];
/// Iterations.
const STEPS: usize = 5;
/// The root mean square of a step at rate 1, near that of AdamW's, so that one rate serves both (J. Liu and others, 2025).
const MEAN_STEP: f32 = 0.2;

/// Adds a gradient, scaled by `gain`, to a kernel's momentum and returns the direction of its step: `rows` filters.
#[must_use]
pub fn direction(gradient: &[f32], gain: f32, rows: usize, momentum: f32, slot: &mut Slot) -> Vec<f32> {
    slot.first.resize(gradient.len(), 0.0);
    let ahead = slot.first.iter_mut().zip(gradient).map(|(m, g)| {
        *m = momentum * *m + gain * g;
        gain * g + momentum * *m // Nesterov's
    });
    let columns = gradient.len() / rows.max(1);
    let mut step = orthogonal(&ahead.collect::<Vec<f32>>(), rows, columns);
    let scale = MEAN_STEP * (rows.max(columns) as f32).sqrt();
    step.iter_mut().for_each(|v| *v *= scale);
    step
}

/// A matrix of the same singular vectors whose singular values are all near 1; zeros stay zeros. The iteration X <- (a + b G + c G G) X, with
/// G = X X', needs X at its end only: all between are products of the smaller square.
fn orthogonal(matrix: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    let norm = matrix.iter().map(|v| v * v).sum::<f32>().sqrt();
    let x: Vec<f32> = matrix.iter().map(|v| v / (norm + 1e-12)).collect();
    let (flat, side) = (rows <= columns, rows.min(columns));
    let view = Matrix::new(&x, rows, columns);
    let mut gram = if flat { product(view, view.transposed()) } else { product(view.transposed(), view) };
    let [a, b, c] = QUINTIC;
    let mut total: Option<Vec<f32>> = None;
    for step in 0..STEPS {
        let g = Matrix::new(&gram, side, side);
        let mut factor = gram.clone();
        multiply_add(&mut factor, b, c, g, g);
        factor.iter_mut().step_by(side + 1).for_each(|v| *v += a);
        let f = Matrix::new(&factor, side, side);
        if step + 1 < STEPS {
            gram = product(Matrix::new(&product(f, g), side, side), f);
        }
        total = Some(match total {
            None => factor,
            Some(before) => product(f, Matrix::new(&before, side, side)),
        });
    }
    let total = total.unwrap_or_default();
    let t = Matrix::new(&total, side, side);
    if flat { product(t, view) } else { product(view, t) }
}

/// `a b`.
fn product(a: Matrix, b: Matrix) -> Vec<f32> {
    let mut out = vec![0.0; a.rows() * b.columns()];
    multiply_add(&mut out, 0.0, 1.0, a, b);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use tcross_dataset::Rng;

    /// Whatever the singular values were, those of the result lie around 1.
    #[test]
    fn singular_values_come_near_one() {
        for (rows, columns) in [(4, 36), (16, 16), (24, 8), (1, 9)] {
            let mut rng = Rng::for_item(1, "test/muon", rows as u64);
            let matrix: Vec<f32> = (0..rows * columns).map(|k| rng.normal() as f32 * if k % 3 == 0 { 10.0 } else { 0.5 }).collect();
            let x = orthogonal(&matrix, rows, columns);
            let side = rows.min(columns);
            let at = |i: usize, l: usize| if rows <= columns { x[i * columns + l] } else { x[l * columns + i] };
            for i in 0..side {
                let norm: f32 = (0..rows.max(columns)).map(|l| at(i, l) * at(i, l)).sum();
                assert!((0.3..1.7).contains(&norm), "{rows} x {columns}, row {i}: {norm}");
                for j in 0..i {
                    let dot: f32 = (0..rows.max(columns)).map(|l| at(i, l) * at(j, l)).sum();
                    assert!(dot.abs() < 0.45, "{rows} x {columns}, rows {i} and {j}: {dot}");
                }
            }
        }
        assert!(orthogonal(&[0.0; 12], 3, 4).iter().all(|v| *v == 0.0));
    }

    #[test]
    fn the_first_step_has_a_length_that_no_gradient_changes() {
        let gradient: Vec<f32> = (0..8 * 27).map(|k| ((k * 7919) % 13) as f32 - 6.0).collect();
        let step = |gain: f32| direction(&gradient, gain, 8, 0.95, &mut Slot::default());
        let (one, many) = (step(1.0), step(1000.0));
        assert!(one.iter().zip(&many).all(|(a, b)| (a - b).abs() < 1e-3));
        let mean = (one.iter().map(|v| v * v).sum::<f32>() / one.len() as f32).sqrt();
        assert!((0.15..0.25).contains(&mean), "{mean}");
    }
}
