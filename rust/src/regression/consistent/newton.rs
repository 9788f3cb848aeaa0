//! The Newton system `(A^T A + sum_j <B_ji, B_jk>) dx = r`: Cholesky's factor, and what it rounds away.
//!
//! A log that is nearly free of noise says 1e15 times more on some unknowns than on others. Cholesky's factor of the scaled matrix
//! then does not see the weak ones: with it alone they move by a fraction of their way in every iteration, and the gradient in
//! units of the strong ones is small long before they have arrived. Conjugate gradients with the factor as preconditioner restore
//! them, with products by `A` and `A^T`, which hold the weak directions.

use super::interior_point::Iterate;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Ridges on the unit diagonal, tried in turn.
const RIDGES: [f64; 5] = [1e-14, 1e-12, 1e-10, 1e-8, 1e-6];

/// Steps of conjugate gradients at most: one for each direction that the factor does not see.
const REFINEMENTS: usize = 10;

/// Square of the relative error, in the norm of the matrix, that ends them.
const REFINED: f64 = 1e-20;

/// Pivots of the scaled matrix above this need no refinement: no direction is near its rounding.
const CLEAR: f64 = 1e-8;

/// Factor of the scaled matrix.
pub struct System {
    factor: Cholesky<f64, Dyn>,
    /// All pivots are above [`CLEAR`].
    clear: bool,
}

impl Iterate<'_> {
    /// Cholesky factor of the scaled matrix, with the smallest ridge that it needs.
    pub(super) fn factored(&self) -> Option<System> {
        let n = self.x.len();
        RIDGES.into_iter().find_map(|ridge| {
            let mut scaled = DMatrix::zeros(n, n);
            for column in 0..n {
                for row in column..n {
                    scaled[(row, column)] = self.matrix[(row, column)] * self.scale[row] * self.scale[column];
                }
                scaled[(column, column)] += ridge;
            }
            let factor = Cholesky::new(scaled)?;
            let clear = factor.l_dirty().diagonal().iter().all(|root| root * root > CLEAR);
            Some(System { factor, clear })
        })
    }

    /// Solution for a right side.
    pub(super) fn solved(&self, system: &System, right: &DVector<f64>) -> DVector<f64> {
        let mut dx = self.preconditioned(system, right);
        if system.clear {
            return dx;
        }
        let size = right.dot(&dx);
        let mut rest = right - self.product(&dx);
        let mut step = self.preconditioned(system, &rest);
        let mut square = rest.dot(&step);
        let mut towards = step.clone();
        for _ in 0..REFINEMENTS {
            if square.is_nan() || square <= REFINED * size {
                break;
            }
            let product = self.product(&towards);
            let curvature = towards.dot(&product);
            if curvature.is_nan() || curvature <= 0.0 {
                break;
            }
            let length = square / curvature;
            dx.axpy(length, &towards, 1.0);
            rest.axpy(-length, &product, 1.0);
            step = self.preconditioned(system, &rest);
            let next = rest.dot(&step);
            towards *= next / square;
            towards += &step;
            square = next;
        }
        dx
    }

    /// The solution by the factor alone.
    pub(super) fn preconditioned(&self, system: &System, right: &DVector<f64>) -> DVector<f64> {
        let mut scaled = right.component_mul(&self.scale);
        system.factor.solve_mut(&mut scaled);
        scaled.component_mul(&self.scale)
    }

    /// Product with the matrix, by its parts.
    fn product(&self, dx: &DVector<f64>) -> DVector<f64> {
        let mut sum = self.quadratic.transposed(&self.quadratic.rows(dx));
        self.blocks.iter().for_each(|block| block.add_product(dx, &mut sum));
        sum
    }
}
