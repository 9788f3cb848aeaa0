//! Least squares by Householder QR: the solution of (7), and what its covariance (8) to (10) is made of.
//!
//! ```text
//! W = Q R        R x = Q' y        (W' W)^-1 = R^-1 R^-T        cond W = s_max / s_min
//! ```
//!
//! The columns keep their order and are scaled to unit norm first, so that units do not decide what counts as dependent.
//! Column i depends on the columns before it when what they leave of it, `|R_ii|`, is below a tolerance. Such a column must
//! leave before the next one is judged: otherwise its rounding noise passes for a direction of its own.
//!
//! `Y` rides along as the last column of `W`, which gives `Q' y` without `Q`; and the rows are taken in blocks under the `R` so
//! far, which needs no second copy of a long `W` and keeps a block in cache. All of it runs on one thread, so the bits of a
//! solution do not depend on the machine's number of threads.
//!
//! Tested here: `W' (y - W x) = 0`, `R' R = W' W`, known singular values, and known dependences that are named.

use super::triangle::{BLOCK, triangle_of_rows, without_column};
use faer::linalg::triangular_inverse::invert_upper_triangular;
use faer::linalg::triangular_solve::solve_upper_triangular_in_place;
use faer::{Mat, MatMut, MatRef, Par};

/// Share of a unit column that earlier columns must leave of it, for it to count as independent.
pub const TOLERANCE: f64 = 1e-10;

/// Share of the largest column below which a column is rounding noise around zero, such as that of a parameter that no
/// motion shows. Units alone do not make columns differ that much.
pub const NOISE: f64 = 1e-13;

/// A column that earlier columns combine to.
#[derive(Clone, Debug, PartialEq)]
pub struct Dependence {
    /// Index of the dependent column.
    pub column: usize,
    /// Earlier independent columns with their factors; empty for a column of zeros or noise. Contributions below the tolerance, as a
    /// share of the column's norm, are left out.
    pub coefficients: Vec<(usize, f64)>,
}

/// The least-squares solution and its factors, in the units of `W`.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Indices of the independent columns: what the fields below, but for the singular values, are about.
    pub independent: Vec<usize>,
    /// Columns that depend on earlier ones; a caller that wants a full-rank `W` refuses them.
    pub dependent: Vec<Dependence>,
    /// `x`, one value per independent column.
    pub solution: Vec<f64>,
    /// `R`, upper triangular with a positive diagonal: `R' R = W' W`.
    pub r: Mat<f64>,
    /// `R^-1`, upper triangular.
    pub inverse_r: Mat<f64>,
    /// Singular values of the whole `W`, unscaled, in descending order.
    pub singular_values: Vec<f64>,
    /// `|y - W x|`.
    pub residual_norm: f64,
}

/// A least-squares problem that has no solution to speak of.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LeastSquaresError {
    /// Fewer equations than unknowns, or no unknowns.
    #[error(
        "least squares needs at least one column and as many rows as columns, got {rows} rows and {columns} columns"
    )]
    Shape {
        /// Rows of `W`.
        rows: usize,
        /// Columns of `W`.
        columns: usize,
    },
    /// `W` and `y` of different length.
    #[error("the observation matrix has {rows} rows but y has {length} values")]
    Length {
        /// Rows of `W`.
        rows: usize,
        /// Values of `y`.
        length: usize,
    },
    /// NaN or infinity in `W`.
    #[error("row {row}, column {column} of the observation matrix is not a finite number")]
    MatrixNotFinite {
        /// Row, counted from 0.
        row: usize,
        /// Column, counted from 0.
        column: usize,
    },
    /// NaN or infinity in `y`.
    #[error("value {row} of y is not a finite number")]
    VectorNotFinite {
        /// Position, counted from 0.
        row: usize,
    },
    /// Numbers too large to be squared and summed.
    #[error("the numbers of the observation matrix are too large: its singular values cannot be computed")]
    SingularValues,
}

/// Solves `min |y - W x|` for the columns of `W` that do not depend on earlier ones.
///
/// `tolerance` is usually [`TOLERANCE`]; rounding sets a floor of about 1.5e-11.
pub fn solve(w: MatRef<'_, f64>, y: &[f64], tolerance: f64) -> Result<Solution, LeastSquaresError> {
    let (rows, columns) = w.shape();
    if columns == 0 || rows < columns {
        return Err(LeastSquaresError::Shape { rows, columns });
    }
    if y.len() != rows {
        return Err(LeastSquaresError::Length { rows, length: y.len() });
    }
    if let Some(row) = y.iter().position(|value| !value.is_finite()) {
        return Err(LeastSquaresError::VectorNotFinite { row });
    }
    let norms = column_norms(w)?;
    let whole = triangle_of_rows(w, y, &norms);
    let singular_values = singular_values(&whole, &norms)?;

    // faer itself passes over pivots below 16 eps times the rows of a block; what it passes over must count as dependent.
    let floor = 16.0 * f64::EPSILON * (BLOCK + columns + 1) as f64;
    let tolerance = tolerance.max(floor);
    let mut triangle = whole;
    let mut independent: Vec<usize> = (0..columns).collect();
    let mut dependent = Vec::new();
    while let Some(pivot) = (0..independent.len()).find(|&i| triangle[(i, i)].abs() < tolerance) {
        let column = independent[pivot];
        dependent.push(Dependence {
            column,
            coefficients: combination(&triangle, pivot, &independent, &norms, tolerance),
        });
        independent.remove(pivot);
        triangle = without_column(&triangle, pivot);
    }

    let n = independent.len();
    let mut solution: Vec<f64> = (0..n).map(|i| triangle[(i, n)]).collect();
    let scaled = triangle.as_ref().submatrix(0, 0, n, n);
    solve_upper_triangular_in_place(
        scaled,
        MatMut::from_column_major_slice_mut(&mut solution, n, 1),
        Par::Seq,
    );
    let mut inverse_r = Mat::zeros(n, n);
    invert_upper_triangular(inverse_r.as_mut(), scaled, Par::Seq);

    // Back to the units of W, with a positive diagonal.
    let sign = |i: usize| triangle[(i, i)].signum();
    let norm = |i: usize| norms[independent[i]];
    for (i, value) in solution.iter_mut().enumerate() {
        *value /= norm(i);
    }
    let r = Mat::from_fn(n, n, |i, j| if i <= j { sign(i) * triangle[(i, j)] * norm(j) } else { 0.0 });
    let inverse_r =
        Mat::from_fn(n, n, |i, j| if i <= j { inverse_r[(i, j)] * sign(j) / norm(i) } else { 0.0 });
    Ok(Solution {
        residual_norm: residual_norm(w, y, &independent, &solution),
        independent,
        dependent,
        solution,
        r,
        inverse_r,
        singular_values,
    })
}

/// Norm of each column. A column of noise gets the largest norm, so that it stays small when it is divided by it.
fn column_norms(w: MatRef<'_, f64>) -> Result<Vec<f64>, LeastSquaresError> {
    let (rows, columns) = w.shape();
    // Summed row by row whatever the storage, so that both storage orders give the same bits.
    let mut norms = vec![0.0_f64; columns];
    for row in 0..rows {
        for (column, norm) in norms.iter_mut().enumerate() {
            let value = w[(row, column)];
            *norm += value * value;
        }
    }
    for norm in &mut norms {
        *norm = norm.sqrt();
    }
    if norms.iter().any(|norm| !norm.is_finite()) {
        for row in 0..rows {
            if let Some(column) = (0..columns).find(|&column| !w[(row, column)].is_finite()) {
                return Err(LeastSquaresError::MatrixNotFinite { row, column });
            }
        }
        return Err(LeastSquaresError::SingularValues);
    }
    let largest = norms.iter().copied().fold(0.0, f64::max);
    for norm in &mut norms {
        if *norm <= NOISE * largest {
            *norm = if largest > 0.0 { largest } else { 1.0 };
        }
    }
    Ok(norms)
}

/// Coefficients of the earlier columns in the column at `pivot`, unscaled.
fn combination(
    triangle: &Mat<f64>,
    pivot: usize,
    independent: &[usize],
    norms: &[f64],
    smallest: f64,
) -> Vec<(usize, f64)> {
    let mut factors: Vec<f64> = (0..pivot).map(|i| triangle[(i, pivot)]).collect();
    solve_upper_triangular_in_place(
        triangle.as_ref().submatrix(0, 0, pivot, pivot),
        MatMut::from_column_major_slice_mut(&mut factors, pivot, 1),
        Par::Seq,
    );
    let norm = norms[independent[pivot]];
    let scaled = independent.iter().zip(factors);
    scaled
        .filter(|(_, factor)| factor.abs() > smallest)
        .map(|(&column, factor)| (column, factor * norm / norms[column]))
        .collect()
}

/// Singular values of the unscaled triangle without its last column, which are those of `W`.
fn singular_values(triangle: &Mat<f64>, norms: &[f64]) -> Result<Vec<f64>, LeastSquaresError> {
    let n = norms.len();
    let unscaled = Mat::from_fn(n, n, |i, j| triangle[(i, j)] * norms[j]);
    unscaled.singular_values().map_err(|_| LeastSquaresError::SingularValues)
}

/// `|y - W x|`, from the data themselves.
fn residual_norm(w: MatRef<'_, f64>, y: &[f64], columns: &[usize], x: &[f64]) -> f64 {
    let squares: f64 = (0..w.nrows())
        .map(|row| {
            let fit: f64 = columns.iter().zip(x).map(|(&j, x)| w[(row, j)] * x).sum();
            (y[row] - fit).powi(2)
        })
        .sum();
    squares.sqrt()
}
