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

/// A matrix of the same singular vectors whose singular values are all near 1; zeros stay zeros.
fn orthogonal(matrix: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    let norm = matrix.iter().map(|v| v * v).sum::<f32>().sqrt();
    let mut x: Vec<f32> = matrix.iter().map(|v| v / (norm + 1e-12)).collect();
    // The smaller square is cheaper: X X' for a flat matrix, X' X for a tall one.
    let flat = rows <= columns;
    let side = rows.min(columns);
    let [a, b, c] = QUINTIC;
    let (mut square, mut next) = (vec![0.0; side * side], vec![0.0; x.len()]);
    for _ in 0..STEPS {
        let view = Matrix::new(&x, rows, columns);
        let (left, right) = if flat { (view, view.transposed()) } else { (view.transposed(), view) };
        multiply_add(&mut square, 0.0, 1.0, left, right);
        let mut factor = square.clone();
        let own = Matrix::new(&square, side, side);
        multiply_add(&mut factor, b, c, own, own);
        next.copy_from_slice(&x);
        let factor = Matrix::new(&factor, side, side);
        let (left, right) = if flat { (factor, view) } else { (view, factor) };
        multiply_add(&mut next, a, 1.0, left, right);
        std::mem::swap(&mut x, &mut next);
    }
    x
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
