//! Equalities `C x = d`, solved for some of the unknowns: `x_p = d_p - T x_free`.

use super::cone::{Cone, ConeError};
use super::problem::Equality;
use nalgebra::{DMatrix, DVector};

/// Coefficients below this share of an equality's largest are rounding.
const ROUNDING: f64 = 1e-11;

/// Unknowns that remain, and the others as functions of them.
#[derive(Debug, Clone)]
pub struct Elimination {
    count: usize,
    /// Unknowns that remain.
    free: Vec<usize>,
    /// Unknowns solved for.
    solved: Vec<usize>,
    /// `T`, a row per unknown solved for, a column per free one.
    slopes: DMatrix<f64>,
    /// `d_p`.
    values: DVector<f64>,
}

impl Elimination {
    /// Solve equalities between `count` unknowns, by Gauss and Jordan with the largest coefficient of a row as pivot.
    pub fn new(count: usize, equalities: &[Equality]) -> Result<Self, ConeError> {
        let mut rows: Vec<(usize, DVector<f64>, f64)> = Vec::new();
        for (equality, given) in equalities.iter().enumerate() {
            if given.coefficients.len() != count {
                let got = given.coefficients.len();
                return Err(ConeError::Size { what: "an equality", want: count, got });
            }
            let mut row = DVector::from_column_slice(&given.coefficients);
            let mut value = given.value;
            if !value.is_finite() || !row.iter().all(|c| c.is_finite()) {
                return Err(ConeError::Number { what: "an equality" });
            }
            let size = row.amax();
            let mut value_size = value.abs();
            for (pivot, other, other_value) in &rows {
                let factor = row[*pivot];
                row.axpy(-factor, other, 1.0);
                row[*pivot] = 0.0;
                value -= factor * other_value;
                value_size = value_size.max((factor * other_value).abs());
            }
            let pivot = row.iamax();
            if row[pivot].abs() <= ROUNDING * size {
                if value.abs() > ROUNDING * value_size.max(f64::MIN_POSITIVE) {
                    return Err(ConeError::Equality { equality });
                }
                continue;
            }
            value /= row[pivot];
            row /= row[pivot];
            for (_, other, other_value) in &mut rows {
                let factor = other[pivot];
                other.axpy(-factor, &row, 1.0);
                other[pivot] = 0.0;
                *other_value -= factor * value;
            }
            rows.push((pivot, row, value));
        }
        let solved: Vec<usize> = rows.iter().map(|(pivot, _, _)| *pivot).collect();
        let free: Vec<usize> = (0..count).filter(|index| !solved.contains(index)).collect();
        let slopes = DMatrix::from_fn(solved.len(), free.len(), |row, column| rows[row].1[free[column]]);
        let values = DVector::from_iterator(rows.len(), rows.iter().map(|(_, _, value)| *value));
        Ok(Self { count, free, solved, slopes, values })
    }

    /// Unknowns that remain.
    pub fn free(&self) -> &[usize] {
        &self.free
    }

    /// A cone in the unknowns that remain.
    pub fn cone(&self, cone: &Cone) -> Cone {
        if self.solved.is_empty() {
            return cone.clone();
        }
        let square = cone.order * cone.order;
        let mut basis: Vec<Option<Vec<f64>>> = vec![None; self.free.len()];
        let mut constant = cone.constant.clone();
        let mut add = |place: usize, matrix: &[f64], factor: f64| {
            if factor != 0.0 {
                let sum = basis[place].get_or_insert_with(|| vec![0.0; square]);
                sum.iter_mut().zip(matrix).for_each(|(sum, entry)| *sum += factor * entry);
            }
        };
        for (&index, matrix) in cone.indices.iter().zip(cone.basis.chunks_exact(square)) {
            if let Ok(place) = self.free.binary_search(&index) {
                add(place, matrix, 1.0);
            } else if let Some(row) = self.solved.iter().position(|&solved| solved == index) {
                constant.iter_mut().zip(matrix).for_each(|(sum, entry)| *sum += self.values[row] * entry);
                for place in 0..self.free.len() {
                    add(place, matrix, -self.slopes[(row, place)]);
                }
            }
        }
        let indices = (0..self.free.len()).filter(|&place| basis[place].is_some()).collect();
        let basis = basis.into_iter().flatten().flatten().collect();
        Cone { indices, basis, constant, ..cone.clone() }
    }

    /// Columns of `A` in the unknowns that remain.
    pub fn columns(&self, a: &DMatrix<f64>) -> DMatrix<f64> {
        if self.solved.is_empty() {
            return a.clone();
        }
        a.select_columns(&self.free) - a.select_columns(&self.solved) * &self.slopes
    }

    /// `A x` of the unknowns solved for while the free ones are zero.
    pub fn offset(&self, a: &DMatrix<f64>) -> DVector<f64> {
        if self.solved.is_empty() {
            DVector::zeros(a.nrows())
        } else {
            a.select_columns(&self.solved) * &self.values
        }
    }

    /// Free unknowns of a full vector.
    pub fn reduced(&self, x: &[f64]) -> DVector<f64> {
        DVector::from_iterator(self.free.len(), self.free.iter().map(|&index| x[index]))
    }

    /// Full vector of free unknowns.
    pub fn full(&self, reduced: &DVector<f64>) -> Vec<f64> {
        let mut x = vec![0.0; self.count];
        for (&index, value) in self.free.iter().zip(reduced) {
            x[index] = *value;
        }
        let solved = &self.values - &self.slopes * reduced;
        for (&index, value) in self.solved.iter().zip(&solved) {
            x[index] = *value;
        }
        x
    }
}
