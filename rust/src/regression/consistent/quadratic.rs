//! The quadratic `1/2 |A x - z|^2` of a log, without the unknowns that no row of it touches.
//!
//! Of the standard parameters of a robot a third to a half regroup in others: their columns of `A` are zero, and stand first.

use nalgebra::{DMatrix, DVector};

/// `A` and its curvature, which many solutions share.
#[derive(Debug, Clone)]
pub struct Quadratic {
    /// Leading columns that are zero.
    first: usize,
    a: DMatrix<f64>,
    /// Sizes of the entries of `A`.
    a_sizes: DMatrix<f64>,
    /// `A^T A`, lower triangle, and the roots of its diagonal.
    curvature: DMatrix<f64>,
    sizes: DVector<f64>,
}

impl Quadratic {
    /// The quadratic of the rows `A`.
    pub fn new(a: DMatrix<f64>) -> Self {
        let first = a.column_iter().take_while(|column| column.iter().all(|entry| *entry == 0.0)).count();
        let mut sizes = DVector::zeros(a.ncols());
        let a = a.remove_columns(0, first);
        let mut curvature = DMatrix::zeros(a.ncols(), a.ncols());
        for column in 0..a.ncols() {
            for row in column..a.ncols() {
                curvature[(row, column)] = a.column(row).dot(&a.column(column));
            }
            sizes[first + column] = curvature[(column, column)].sqrt();
        }
        Self { first, a_sizes: a.abs(), a, curvature, sizes }
    }

    /// `A x`.
    pub fn rows(&self, x: &DVector<f64>) -> DVector<f64> {
        &self.a * x.rows(self.first, self.a.ncols())
    }

    /// Sums of the sizes of the terms of `A x`.
    pub fn terms(&self, x: &DVector<f64>) -> DVector<f64> {
        &self.a_sizes * x.rows(self.first, self.a.ncols()).abs()
    }

    /// `A^T v`.
    pub fn transposed(&self, v: &DVector<f64>) -> DVector<f64> {
        let mut product = DVector::zeros(self.sizes.len());
        product.rows_mut(self.first, self.a.ncols()).gemv_tr(1.0, &self.a, v, 0.0);
        product
    }

    /// Overwrite the lower triangle of a matrix with `A^T A`.
    pub fn curvature(&self, matrix: &mut DMatrix<f64>) {
        matrix.as_mut_slice().fill(0.0);
        matrix.view_range_mut(self.first.., self.first..).copy_from(&self.curvature);
    }

    /// Norms of the columns of `A`.
    pub fn sizes(&self) -> &DVector<f64> {
        &self.sizes
    }
}
