//! Plain products of row-major matrices, in the calling thread.
use gemm::Parallelism;

/// A matrix as it lies in memory, row by row.
#[derive(Debug, Clone, Copy)]
pub struct Matrix<'a> {
    values: &'a [f32],
    rows: usize,
    columns: usize,
    strides: [usize; 2],
}

impl<'a> Matrix<'a> {
    /// # Panics
    /// If there are not as many values as places.
    #[must_use]
    pub fn new(values: &'a [f32], rows: usize, columns: usize) -> Self {
        assert_eq!(values.len(), rows * columns, "a {rows} x {columns} matrix");
        Self { values, rows, columns, strides: [columns, 1] }
    }

    /// Number of rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// The same values with rows for columns.
    #[must_use]
    pub fn transposed(self) -> Self {
        let [row, column] = self.strides;
        Self { rows: self.columns, columns: self.rows, strides: [column, row], ..self }
    }
}

/// `out = keep * out + by * (a b)`; `out` is row-major, of `a`'s rows and `b`'s columns.
///
/// # Panics
/// If the shapes do not fit.
pub fn multiply_add(out: &mut [f32], keep: f32, by: f32, a: Matrix, b: Matrix) {
    let (m, k, n) = (a.rows, a.columns, b.columns);
    assert_eq!(b.rows, k, "the rows of the second factor");
    assert_eq!(out.len(), m * n, "the places of the product");
    let ([a_row, a_column], [b_row, b_column]) = (a.strides.map(|s| s as isize), b.strides.map(|s| s as isize));
    let (out, a, b) = (out.as_mut_ptr(), a.values.as_ptr(), b.values.as_ptr());
    // SAFETY: the strides and sizes of each matrix stay within its slice (checked by `Matrix::new` and above), and `out`, borrowed
    // mutably, overlaps neither factor.
    unsafe {
        let read = keep != 0.0;
        gemm::gemm(
            m,
            n,
            k,
            out,
            1,
            n as isize,
            read,
            a,
            a_column,
            a_row,
            b,
            b_column,
            b_row,
            keep,
            by,
            false,
            false,
            false,
            Parallelism::None,
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_are_sums_of_products() {
        for [m, k, n] in [[1, 1, 1], [2, 3, 4], [7, 5, 3], [33, 17, 65]] {
            let values = |count: usize, seed: usize| -> Vec<f32> { (0..count).map(|i| ((i * 37 + seed) % 11) as f32 - 5.0).collect() };
            let (a, b, bt) = (values(m * k, 1), values(k * n, 2), values(n * k, 3));
            for transposed in [false, true] {
                let mut out = values(m * n, 4);
                let old = out.clone();
                let second = if transposed { Matrix::new(&bt, n, k).transposed() } else { Matrix::new(&b, k, n) };
                multiply_add(&mut out, 0.5, 2.0, Matrix::new(&a, m, k), second);
                for (i, j) in (0..m).flat_map(|i| (0..n).map(move |j| (i, j))) {
                    let at = |l: usize| if transposed { bt[j * k + l] } else { b[l * n + j] };
                    let sum: f32 = (0..k).map(|l| a[i * k + l] * at(l)).sum();
                    assert!((out[i * n + j] - (0.5 * old[i * n + j] + 2.0 * sum)).abs() < 1e-3, "{m} {k} {n} ({i}, {j})");
                }
            }
        }
    }
}
