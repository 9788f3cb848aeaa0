//! The part of a cone in the primal-dual iteration: slack, multiplier, their scaling and their directions.
//!
//! `S` is the slack that stands for `F(x)` until both agree, `Z` its multiplier; both stay positive definite. At the solution
//! `S Z = gamma I`. With `R` such that `R^-1 S R^-T = R^T Z R = diag(lambda)` (Nesterov and Todd) the linearised condition is
//!
//! ```text
//! dS + dZ = X,    X_ik = 2 T_ik / (lambda_i + lambda_k),    T = (gamma + tau) I - diag(lambda)^2 - second order
//! ```
//!
//! in scaled directions, where `tau` is the barrier that the step aims at.

use super::cone::Cone;
use super::small::{Small, cholesky, diagonal, eigen, inverse_lower, smallest_eigenvalue, symmetric};
use nalgebra::{DMatrix, DVector};

/// Smallest eigenvalue that `F` needs at the start to be its own slack.
const INSIDE: f64 = 1e-3;

/// Smallest eigenvalue of the slack of a start outside.
const MOVED_INSIDE: f64 = 0.1;

/// Smallest eigenvalue of the slack around a start that need not be inside, and as a share of the largest.
const AROUND: f64 = 0.03;
const SHARE_AROUND: f64 = 0.1;

/// A slack this near to `F(x)`, as a share of its scaled size, is replaced by it.
const NEAR: f64 = 0.1;

/// Rounding of `F(x)` relative to its terms: few of them are rounded as far as they can be.
const ROUNDING: f64 = 0.02 * f64::EPSILON;

/// Longest step that is looked for: no step taken is longer than 1.
const FARTHEST: f64 = 1.1;

/// A centring correction moves eigenvalues of `S Z` into this share of the target, and its inverse.
const CENTRED: f64 = 0.1;

/// Operations that the iteration needs of a constraint of any size.
pub trait Block {
    /// Rows of the matrix.
    fn order(&self) -> usize;
    /// Choose slack and `Z = S^-1` at a start that should be inside.
    fn begin(&mut self, x: &DVector<f64>);
    /// Choose slack and `Z = S^-1` around a start that need not be inside.
    fn begin_around(&mut self, x: &DVector<f64>);
    /// Add the negative eigenvalues of `F(x)` and their derivatives by `x`.
    fn outside(&self, x: &DVector<f64>, list: &mut Vec<(f64, DVector<f64>)>);
    /// Multiply the multiplier.
    fn scale_multiplier(&mut self, factor: f64);
    /// Multiply the multiplier by a barrier, to which the weight of the cone is added.
    fn weigh_multiplier(&mut self, barrier: f64);
    /// Find the scaling at `x`; false where slack or multiplier is not positive definite in floating point.
    fn factor(&mut self, x: &DVector<f64>) -> bool;
    /// Add `gamma tr(Q B_i)`.
    fn add_slope(&self, gradient: &mut DVector<f64>);
    /// Add `factor tr(Z B_i)`.
    fn add_multiplier(&self, factor: f64, gradient: &mut DVector<f64>);
    /// Add the sizes of the terms of `tr(Z B_i)`.
    fn add_multiplier_size(&self, sizes: &mut DVector<f64>);
    /// Add the squares `|B_i|^2` of the scaled basis.
    fn add_squares(&self, diagonal: &mut DVector<f64>);
    /// Add the products `<B_i, B_k>` of the scaled basis to the lower triangle.
    fn add_products(&self, matrix: &mut DMatrix<f64>);
    /// Add `sum_k <B_i, B_k> dx_k` of the scaled basis.
    fn add_product(&self, dx: &DVector<f64>, sum: &mut DVector<f64>);
    /// `|F(x) - S|^2`, scaled.
    fn residual_square(&self) -> f64;
    /// Add `<B_i, F(x) - S>`, scaled.
    fn add_residual(&self, sum: &mut DVector<f64>);
    /// Sum of `|lambda^2 - gamma|`.
    fn distance(&self) -> f64;
    /// Largest `|lambda^2 - gamma|`.
    fn complementarity(&self) -> f64;
    /// What rounding of `F(x)` leaves of the complementarity.
    fn rounding(&self) -> f64;
    /// `|F(x) - S|`, relative to the terms of `F`.
    fn infeasibility(&self) -> f64;
    /// Aim at `S Z = (gamma + tau) I`, after `corrected` with the second order of the last directions; add to the right side.
    fn aim(&mut self, tau: f64, corrected: bool, right: &mut DVector<f64>);
    /// Directions of slack and multiplier that belong to a direction of `x`.
    fn direct(&mut self, dx: &DVector<f64>);
    /// Longest steps along them that keep slack and multiplier semidefinite.
    fn longest(&self) -> (f64, f64);
    /// Aim at products near the target after steps of these lengths (Gondzio 1996); add to the right side.
    fn centre(&mut self, tau: f64, steps: (f64, f64), right: &mut DVector<f64>);
    /// Directions as they were before the last centring.
    fn restore(&mut self);
    /// Take steps of these lengths.
    fn advance(&mut self, steps: (f64, f64));
    /// Go back to slack and multiplier before the last steps.
    fn retreat(&mut self);
    /// `tr(K Z)`.
    fn constant_product(&self) -> f64;
    /// Multiplier, row-major.
    fn multiplier(&self) -> Vec<f64>;
}

/// The block of a checked cone.
pub fn block(cone: &Cone) -> Box<dyn Block> {
    match cone.order {
        1 => Box::new(Fixed::<1>::new(cone)),
        2 => Box::new(Fixed::<2>::new(cone)),
        3 => Box::new(Fixed::<3>::new(cone)),
        4 => Box::new(Fixed::<4>::new(cone)),
        5 => Box::new(Fixed::<5>::new(cone)),
        _ => Box::new(Fixed::<6>::new(cone)),
    }
}

/// A block of fixed size.
struct Fixed<const M: usize> {
    indices: Vec<usize>,
    basis: Vec<Small<M>>,
    constant: Small<M>,
    weight: f64,
    slope: Small<M>,
    slack: Small<M>,
    multiplier: Small<M>,
    /// Slack and multiplier before the last steps.
    before: (Small<M>, Small<M>),
    /// Inverse of `R`, and `lambda`.
    unscaling: Small<M>,
    lambda: [f64; M],
    /// `R^-1 B_i R^-T`.
    scaled: Vec<Small<M>>,
    /// `|B_i|`.
    norms: Vec<f64>,
    /// `F(x) - S`, and scaled; its norm relative to the terms, and what rounding makes of it; the slack's norm at the start.
    missing: Small<M>,
    residual: Small<M>,
    infeasibility: f64,
    rounding: f64,
    size: f64,
    /// `X - residual`, and the scaled directions of slack and multiplier.
    aims: Aims<M>,
    /// The same before the last centring.
    saved: Aims<M>,
}

#[derive(Clone, Copy)]
struct Aims<const M: usize> {
    sum: Small<M>,
    slack: Small<M>,
    multiplier: Small<M>,
    /// Direction of the slack without its scaling, which would round it.
    change: Small<M>,
}

impl<const M: usize> Fixed<M> {
    fn new(cone: &Cone) -> Self {
        let zero = Small::<M>::zeros();
        let aims = Aims { sum: zero, slack: zero, multiplier: zero, change: zero };
        let square = |values: &[f64]| symmetric(&Small::<M>::from_row_slice(values));
        let basis: Vec<_> = cone.basis.chunks_exact(M * M).map(square).collect();
        Self {
            indices: cone.indices.clone(),
            norms: basis.iter().map(Small::<M>::norm).collect(),
            basis,
            constant: square(&cone.constant),
            weight: cone.weight,
            slope: square(&cone.slope),
            slack: zero,
            multiplier: zero,
            before: (zero, zero),
            unscaling: zero,
            lambda: [0.0; M],
            scaled: vec![zero; cone.indices.len()],
            missing: zero,
            residual: zero,
            infeasibility: 0.0,
            rounding: 0.0,
            size: 1.0,
            aims,
            saved: aims,
        }
    }

    /// `sum_i x_i B_i` in a basis.
    fn combine(&self, basis: &[Small<M>], x: &DVector<f64>) -> Small<M> {
        let mut sum = Small::<M>::zeros();
        for (&index, basis) in self.indices.iter().zip(basis) {
            sum += basis * x[index];
        }
        sum
    }

    /// `F(x)`.
    fn value(&self, x: &DVector<f64>) -> Small<M> {
        self.constant + self.combine(&self.basis, x)
    }

    /// Size and `Z = S^-1` of a chosen slack.
    fn begin_with_slack(&mut self) {
        self.size = 1.0 + self.slack.norm();
        // Without a factor the slack is not finite, which `factor` finds next.
        let root = cholesky(&self.slack).unwrap_or_else(Small::<M>::identity);
        let inverse = inverse_lower(&root);
        self.multiplier = inverse.transpose() * inverse;
    }

    /// Solution `X` of `diag(lambda) X + X diag(lambda) = 2 T`.
    fn divided(&self, target: &Small<M>) -> Small<M> {
        Small::<M>::from_fn(|i, k| 2.0 * target[(i, k)] / (self.lambda[i] + self.lambda[k]))
    }

    fn add_aim(&self, right: &mut DVector<f64>) {
        for (&index, basis) in self.indices.iter().zip(&self.scaled) {
            right[index] += self.aims.sum.dot(basis);
        }
    }

    /// Find the scaling of slack and multiplier at `x`.
    fn scale_at(&mut self, x: &DVector<f64>) -> bool {
        let Some(root) = cholesky(&self.slack) else { return false };
        let (squares, vectors) = eigen(&symmetric(&(root.transpose() * self.multiplier * root)));
        if !squares.iter().all(|square| square.is_finite() && *square > 0.0) {
            return false;
        }
        self.lambda = squares.map(f64::sqrt);
        let quarter = self.lambda.map(f64::sqrt);
        let unscaling = vectors.transpose() * inverse_lower(&root);
        self.unscaling = Small::<M>::from_fn(|i, k| unscaling[(i, k)] * quarter[i]);
        let residual = self.value(x) - self.slack;
        let terms = self.indices.iter().zip(&self.norms).map(|(&index, norm)| (x[index] * norm).abs());
        let terms = terms.sum::<f64>();
        self.missing = residual;
        self.infeasibility = residual.norm() / (self.size + terms);
        self.rounding = ROUNDING * terms * self.multiplier.norm();
        self.residual = symmetric(&(self.unscaling * residual * self.unscaling.transpose()));
        for (scaled, basis) in self.scaled.iter_mut().zip(&self.basis) {
            *scaled = symmetric(&(self.unscaling * basis * self.unscaling.transpose()));
        }
        true
    }

    /// Longest step from `diag(lambda)` along a scaled direction, [`FARTHEST`] at most.
    fn longest_along(&self, direction: &Small<M>) -> f64 {
        let relative =
            Small::<M>::from_fn(|i, k| direction[(i, k)] / (self.lambda[i] * self.lambda[k]).sqrt());
        // Most blocks allow a whole step, and a factorisation, which costs less than eigenvalues, says so.
        if cholesky(&(Small::<M>::identity() + relative * FARTHEST)).is_some() {
            return FARTHEST;
        }
        (-1.0 / smallest_eigenvalue(&relative)).min(FARTHEST)
    }
}

impl<const M: usize> Block for Fixed<M> {
    fn order(&self) -> usize {
        M
    }

    fn begin(&mut self, x: &DVector<f64>) {
        self.slack = self.value(x);
        let smallest = smallest_eigenvalue(&self.slack);
        if smallest < INSIDE {
            self.slack += Small::<M>::identity() * (MOVED_INSIDE - smallest);
        }
        self.begin_with_slack();
    }

    fn begin_around(&mut self, x: &DVector<f64>) {
        let (values, vectors) = eigen(&symmetric(&self.value(x)));
        let largest = values.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
        let moved = values.map(|value| value.abs().max(SHARE_AROUND * largest).max(AROUND));
        self.slack = symmetric(&(vectors * diagonal(&moved) * vectors.transpose()));
        self.begin_with_slack();
    }

    fn outside(&self, x: &DVector<f64>, list: &mut Vec<(f64, DVector<f64>)>) {
        let (values, vectors) = eigen(&symmetric(&self.value(x)));
        for (k, &value) in values.iter().enumerate().filter(|(_, value)| **value < 0.0) {
            let vector = vectors.column(k);
            let mut slope = DVector::zeros(x.len());
            for (&index, basis) in self.indices.iter().zip(&self.basis) {
                slope[index] += vector.dot(&(basis * vector));
            }
            list.push((value, slope));
        }
    }

    fn scale_multiplier(&mut self, factor: f64) {
        self.multiplier *= factor;
    }

    fn weigh_multiplier(&mut self, barrier: f64) {
        self.multiplier *= barrier + self.weight;
    }

    fn factor(&mut self, x: &DVector<f64>) -> bool {
        if !self.scale_at(x) {
            return false;
        }
        let least = self.lambda.iter().copied().fold(f64::INFINITY, f64::min);
        if self.infeasibility > 0.0 && self.residual.norm() <= NEAR * least {
            // From here on the slack is F(x), and its directions add no rounding to it.
            let before = self.slack;
            self.slack += self.missing;
            if !self.scale_at(x) {
                self.slack = before;
                return self.scale_at(x);
            }
        }
        true
    }

    fn add_slope(&self, gradient: &mut DVector<f64>) {
        for (&index, basis) in self.indices.iter().zip(&self.basis) {
            gradient[index] += self.weight * self.slope.dot(basis);
        }
    }

    fn add_multiplier(&self, factor: f64, gradient: &mut DVector<f64>) {
        for (&index, basis) in self.indices.iter().zip(&self.basis) {
            gradient[index] += factor * self.multiplier.dot(basis);
        }
    }

    fn add_multiplier_size(&self, sizes: &mut DVector<f64>) {
        for (&index, basis) in self.indices.iter().zip(&self.basis) {
            sizes[index] += self.multiplier.component_mul(basis).abs().sum();
        }
    }

    fn add_squares(&self, diagonal: &mut DVector<f64>) {
        for (&index, basis) in self.indices.iter().zip(&self.scaled) {
            diagonal[index] += basis.norm_squared();
        }
    }

    fn add_products(&self, matrix: &mut DMatrix<f64>) {
        for (place, (&i, first)) in self.indices.iter().zip(&self.scaled).enumerate() {
            for (&k, second) in self.indices[..=place].iter().zip(&self.scaled) {
                matrix[(i.max(k), i.min(k))] += first.dot(second);
            }
        }
    }

    fn add_product(&self, dx: &DVector<f64>, sum: &mut DVector<f64>) {
        let moved = self.combine(&self.scaled, dx);
        for (&index, basis) in self.indices.iter().zip(&self.scaled) {
            sum[index] += moved.dot(basis);
        }
    }

    fn residual_square(&self) -> f64 {
        self.residual.norm_squared()
    }

    fn add_residual(&self, sum: &mut DVector<f64>) {
        for (&index, basis) in self.indices.iter().zip(&self.scaled) {
            sum[index] += self.residual.dot(basis);
        }
    }

    fn distance(&self) -> f64 {
        self.lambda.iter().map(|l| l.mul_add(*l, -self.weight).abs()).sum()
    }

    fn complementarity(&self) -> f64 {
        self.lambda.iter().map(|l| l.mul_add(*l, -self.weight).abs()).fold(0.0, f64::max)
    }

    fn rounding(&self) -> f64 {
        self.rounding
    }

    fn infeasibility(&self) -> f64 {
        self.infeasibility
    }

    fn aim(&mut self, tau: f64, corrected: bool, right: &mut DVector<f64>) {
        let mut target = diagonal(&self.lambda.map(|l| self.weight + tau - l * l));
        if corrected {
            target -= symmetric(&(self.aims.slack * self.aims.multiplier));
        }
        self.aims.sum = self.divided(&target) - self.residual;
        self.add_aim(right);
    }

    fn direct(&mut self, dx: &DVector<f64>) {
        let moved = self.combine(&self.scaled, dx);
        self.aims.slack = moved + self.residual;
        self.aims.change = self.combine(&self.basis, dx) + self.missing;
        self.aims.multiplier = self.aims.sum - moved;
    }

    fn longest(&self) -> (f64, f64) {
        (self.longest_along(&self.aims.slack), self.longest_along(&self.aims.multiplier))
    }

    fn centre(&mut self, tau: f64, steps: (f64, f64), right: &mut DVector<f64>) {
        self.saved = self.aims;
        let lambda = diagonal(&self.lambda);
        let product = (lambda + self.aims.slack * steps.0) * (lambda + self.aims.multiplier * steps.1);
        let (values, vectors) = eigen(&symmetric(&product));
        let target = self.weight + tau;
        let wide = target / CENTRED;
        let shifts = values.map(|value| (value.clamp(CENTRED * target, wide) - value).max(-wide));
        self.aims.sum += self.divided(&symmetric(&(vectors * diagonal(&shifts) * vectors.transpose())));
        self.add_aim(right);
    }

    fn restore(&mut self) {
        self.aims = self.saved;
    }

    fn advance(&mut self, steps: (f64, f64)) {
        self.before = (self.slack, self.multiplier);
        let multiplier = self.unscaling.transpose() * self.aims.multiplier * self.unscaling;
        self.slack += self.aims.change * steps.0;
        self.multiplier += symmetric(&multiplier) * steps.1;
    }

    fn retreat(&mut self) {
        (self.slack, self.multiplier) = self.before;
    }

    fn constant_product(&self) -> f64 {
        self.constant.dot(&self.multiplier)
    }

    fn multiplier(&self) -> Vec<f64> {
        // Symmetric: by columns and by rows alike.
        self.multiplier.as_slice().to_vec()
    }
}
