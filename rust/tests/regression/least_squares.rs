//! Identities of the least-squares solution, and known answers.

use didim::regression::least_squares::{Dependence, LeastSquaresError, TOLERANCE, solve};
use faer::{Mat, MatRef};
use proptest::prelude::*;

/// Rows that the core folds into the triangle at once (`triangle.rs`).
const BLOCK: usize = 4096;

/// Pseudo-random entries in (-1, 1), column by column of very different size.
fn matrix(rows: usize, columns: usize, seed: u64) -> Mat<f64> {
    let mut state = seed.wrapping_mul(2).wrapping_add(1);
    Mat::from_fn(rows, columns, |_, j| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let unit = (state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0;
        unit * 10.0_f64.powi(i32::try_from(j % 7).expect("small") - 3)
    })
}

fn vector(rows: usize, seed: u64) -> Vec<f64> {
    let column = matrix(rows, 1, seed);
    (0..rows).map(|i| column[(i, 0)] * 1e3).collect()
}

fn largest(a: &Mat<f64>) -> f64 {
    a.norm_max()
}

/// `W` with its columns divided by their norms.
fn unit_columns(w: &Mat<f64>) -> Mat<f64> {
    Mat::from_fn(w.nrows(), w.ncols(), |i, j| w[(i, j)] / w.col(j).norm_l2())
}

fn times(w: MatRef<'_, f64>, columns: &[usize], x: &[f64]) -> Vec<f64> {
    (0..w.nrows()).map(|i| columns.iter().zip(x).map(|(&j, x)| w[(i, j)] * x).sum()).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn residual_is_orthogonal_to_the_columns(columns in 1_usize..30, more in 0_usize..60, seed in 0_u64..1000) {
        let rows = columns + more;
        let (w, y) = (matrix(rows, columns, seed), vector(rows, seed + 7));
        let found = solve(w.as_ref(), &y, TOLERANCE).expect("full rank");
        prop_assert!(found.dependent.is_empty());
        let fit = times(w.as_ref(), &found.independent, &found.solution);
        let residual: Vec<f64> = y.iter().zip(fit).map(|(y, f)| y - f).collect();
        let norm = residual.iter().map(|e| e * e).sum::<f64>().sqrt();
        prop_assert!((norm - found.residual_norm).abs() <= 1e-9 * (1.0 + norm));
        let unit = unit_columns(&w);
        let size = y.iter().map(|y| y * y).sum::<f64>().sqrt();
        // As orthogonal as a small condition number allows.
        let condition = solve(unit.as_ref(), &y, TOLERANCE).expect("full rank").singular_values;
        let condition = condition[0] / condition[columns - 1];
        for j in 0..columns {
            let dot: f64 = (0..rows).map(|i| unit[(i, j)] * residual[i]).sum();
            prop_assert!(dot.abs() < 1e-13 * size * condition.max(10.0), "column {j}: {dot} of {size}");
        }
    }

    #[test]
    fn r_is_the_triangle_of_w(columns in 1_usize..30, more in 0_usize..60, seed in 0_u64..1000) {
        let w = unit_columns(&matrix(columns + more, columns, seed));
        let found = solve(w.as_ref(), &vector(columns + more, 1), TOLERANCE).expect("full rank");
        let gram = w.transpose() * &w;
        prop_assert!(largest(&(found.r.transpose() * &found.r - &gram)) < 1e-13 * columns as f64);
        prop_assert!((0..columns).all(|i| found.r[(i, i)] > 0.0));
        let smallest = found.singular_values[columns - 1];
        let identity = &found.inverse_r * &found.r;
        for i in 0..columns {
            for j in 0..columns {
                let want = if i == j { 1.0 } else { 0.0 };
                prop_assert!((identity[(i, j)] - want).abs() < 1e-12 / smallest);
                prop_assert!(i <= j || (found.r[(i, j)] == 0.0 && found.inverse_r[(i, j)] == 0.0));
            }
        }
    }

    #[test]
    fn dependent_columns_are_named_with_their_factors(
        n in 3_usize..25, first in 0_usize..3, second in 0_usize..3, seed in 0_u64..1000, rows in 40_usize..120,
    ) {
        // Columns n and n + 2 depend, a column of zeros lies between, and one good column follows.
        let good = matrix(rows, n + 1, seed);
        let (a, b) = (2.0 * good[(0, 0)].signum(), 0.5);
        let w = Mat::from_fn(rows, n + 4, |i, j| match j {
            j if j < n => good[(i, j)],
            j if j == n => a * good[(i, first)] + b * good[(i, second)],
            j if j == n + 1 => 0.0,
            j if j == n + 2 => b * good[(i, n - 1)],
            _ => good[(i, n)],
        });
        let y = vector(rows, seed);
        let found = solve(w.as_ref(), &y, TOLERANCE).expect("a solution for the rest");
        let columns: Vec<usize> = found.dependent.iter().map(|d| d.column).collect();
        prop_assert_eq!(columns, vec![n, n + 1, n + 2]);
        for d in &found.dependent {
            let (from, factors): (Vec<usize>, Vec<f64>) = d.coefficients.iter().copied().unzip();
            let combined = times(w.as_ref(), &from, &factors);
            let size = w.col(d.column).norm_max();
            for i in 0..rows {
                prop_assert!((combined[i] - w[(i, d.column)]).abs() <= 1e-8 * size);
            }
        }
        prop_assert!(found.dependent[1].coefficients.is_empty());
        let [(column, factor)] = found.dependent[2].coefficients[..] else {
            return Err(TestCaseError::fail("one column explains the last dependence"));
        };
        prop_assert!(column == n - 1 && (factor - b).abs() < 1e-9);
        // The rest is solved as if the dependent columns had never been there.
        let alone = solve(good.as_ref(), &y, TOLERANCE).expect("full rank");
        prop_assert_eq!(found.solution.len(), n + 1);
        for (f, g) in found.solution.iter().zip(&alone.solution) {
            prop_assert!((f - g).abs() < 1e-8 * (1.0 + g.abs()), "{f} {g}");
        }
    }

    #[test]
    fn noise_free_data_give_the_parameters_back(columns in 1_usize..20, seed in 0_u64..1000) {
        let w = unit_columns(&matrix(3 * columns + 5, columns, seed));
        let x: Vec<f64> = (0..columns).map(|j| 1.0 + j as f64).collect();
        let all: Vec<usize> = (0..columns).collect();
        let found = solve(w.as_ref(), &times(w.as_ref(), &all, &x), TOLERANCE).expect("full rank");
        for (f, want) in found.solution.iter().zip(&x) {
            prop_assert!((f - want).abs() < 1e-11 * columns as f64);
        }
    }
}

#[test]
fn known_singular_values() {
    // Orthogonal columns (a 4 x 4 Hadamard matrix) of norms 6, 4, 2.
    let w = faer::mat![[3.0, 2.0, 1.0], [3.0, -2.0, 1.0], [3.0, 2.0, -1.0], [3.0, -2.0, -1.0_f64]];
    let found = solve(w.as_ref(), &[1.0, 2.0, 3.0, 4.0], TOLERANCE).expect("full rank");
    for (got, want) in found.singular_values.iter().zip([6.0, 4.0, 2.0]) {
        assert!((got - want).abs() < 1e-14);
    }
    for (i, want) in [6.0, 4.0, 2.0].into_iter().enumerate() {
        assert!((found.r[(i, i)] - want).abs() < 1e-14);
    }
    // Projections of y on the columns; what is left is the fourth Hadamard column, whose share of y is 0.
    for (got, want) in found.solution.iter().zip([10.0 / 12.0, -0.25, -1.0]) {
        assert!((got - want).abs() < 1e-14);
    }
    assert!(found.residual_norm < 1e-13);
}

#[test]
fn many_blocks_of_rows_are_one_matrix() {
    // The last column appears in the last block only, and one that is dependent in each block is not in the whole.
    let rows = 2 * BLOCK + 11;
    let good = matrix(rows, 5, 3);
    let w = Mat::from_fn(rows, 5, |i, j| match j {
        2 if i < BLOCK => good[(i, 1)],
        2 => 2.0 * good[(i, 1)],
        4 if i < 2 * BLOCK => 0.0,
        _ => good[(i, j)],
    });
    let found = solve(w.as_ref(), &vector(rows, 5), TOLERANCE).expect("full rank");
    assert!(found.dependent.is_empty());
    let gram = w.transpose() * &w;
    let error = found.r.transpose() * &found.r - &gram;
    for i in 0..5 {
        for j in 0..5 {
            assert!(error[(i, j)].abs() < 1e-13 * (gram[(i, i)] * gram[(j, j)]).sqrt());
        }
    }
    // Row-major storage gives the same bits.
    let transposed = w.transpose().to_owned();
    let again = solve(transposed.transpose(), &vector(rows, 5), TOLERANCE).expect("full rank");
    assert_eq!(again.solution, found.solution);
}

#[test]
fn rounding_noise_is_no_column() {
    for unit in [1e-9, 1.0, 1e9] {
        let noisy = matrix(60, 4, 2);
        let w = Mat::from_fn(60, 4, |i, j| unit * noisy[(i, j)] * if j == 1 { 1e-15 } else { 1.0 });
        let found = solve(w.as_ref(), &vector(60, 3), TOLERANCE).expect("a solution for the rest");
        assert_eq!(found.dependent, [Dependence { column: 1, coefficients: Vec::new() }]);
        assert_eq!(found.independent, [0, 2, 3]);
    }
    let nothing = Mat::zeros(9, 2);
    let found = solve(nothing.as_ref(), &vector(9, 3), TOLERANCE).expect("nothing to solve");
    assert!(found.independent.is_empty() && found.solution.is_empty());
}

#[test]
fn wrong_input_is_told() {
    let w = matrix(4, 5, 1);
    let error = solve(w.as_ref(), &[0.0; 4], TOLERANCE).expect_err("too few rows");
    assert_eq!(error, LeastSquaresError::Shape { rows: 4, columns: 5 });
    assert!(solve(matrix(4, 0, 1).as_ref(), &[0.0; 4], TOLERANCE).is_err());
    let mut w = matrix(9, 5, 1);
    let error = solve(w.as_ref(), &[0.0; 4], TOLERANCE).expect_err("short y");
    assert_eq!(error.to_string(), "the observation matrix has 9 rows but y has 4 values");
    let mut y = vec![0.0; 9];
    y[3] = f64::INFINITY;
    let error = solve(w.as_ref(), &y, TOLERANCE).expect_err("infinite");
    assert_eq!(error.to_string(), "value 3 of y is not a finite number");
    w[(7, 2)] = f64::NAN;
    let error = solve(w.as_ref(), &[0.0; 9], TOLERANCE).expect_err("NaN");
    assert_eq!(error.to_string(), "row 7, column 2 of the observation matrix is not a finite number");
}
