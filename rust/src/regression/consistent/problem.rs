//! The constrained problem: checked once, solved for one log or for many draws of it.

use super::cone::{Cone, ConeError};
use super::elimination::Elimination;
use super::interior_point::{Ending, Solution, solve};
use super::quadratic::Quadratic;
use crate::ground::parallel;
use nalgebra::{DMatrix, DVector};

/// Smallest eigenvalue, relative to its size, of a matrix without unknowns that counts as semidefinite.
const ROUNDING: f64 = 1e-12;

/// `c . x = value`.
#[derive(Debug, Clone, PartialEq)]
pub struct Equality {
    /// A coefficient per unknown.
    pub coefficients: Vec<f64>,
    /// Right side.
    pub value: f64,
}

/// Cones and equalities on a number of unknowns.
#[derive(Debug, Clone)]
pub struct Problem {
    count: usize,
    elimination: Elimination,
    /// Cones that depend on unknowns, in those that remain, and their places in the list given.
    cones: Vec<Cone>,
    places: Vec<usize>,
    n_cones: usize,
    /// A cone without unknowns that is not semidefinite.
    contradictory: Option<usize>,
}

impl Problem {
    /// Check the cones and solve the equalities. Every cone gets a log-det term of at least `least_weight` nats.
    pub fn new(
        count: usize,
        cones: &[Cone],
        equalities: &[Equality],
        least_weight: f64,
    ) -> Result<Self, ConeError> {
        if !(least_weight.is_finite() && least_weight > 0.0) {
            return Err(ConeError::Number { what: "the least weight" });
        }
        let elimination = Elimination::new(count, equalities)?;
        let (mut kept, mut places, mut contradictory) = (Vec::new(), Vec::new(), None);
        for (place, cone) in cones.iter().enumerate() {
            cone.check(place, count)?;
            let cone = elimination.cone(cone);
            if cone.indices.is_empty() {
                if contradictory.is_none() && !semidefinite(&cone) {
                    contradictory = Some(place);
                }
            } else {
                kept.push(cone.with_least_weight(least_weight));
                places.push(place);
            }
        }
        Ok(Self { count, elimination, cones: kept, places, n_cones: cones.len(), contradictory })
    }

    /// Solve for rows `a` (row-major, as many columns as unknowns) and right sides `z`, one solution each, on some threads.
    pub fn solve(
        &self,
        a: &[f64],
        z: &[Vec<f64>],
        start: &[f64],
        threads: usize,
    ) -> Result<Vec<Solution>, ConeError> {
        let rows = z.first().map_or(0, Vec::len);
        for (what, want, got) in
            [("the matrix", rows * self.count, a.len()), ("the start", self.count, start.len())]
        {
            if want != got {
                return Err(ConeError::Size { what, want, got });
            }
        }
        if let Some(other) = z.iter().find(|z| z.len() != rows) {
            return Err(ConeError::Size { what: "a right side", want: rows, got: other.len() });
        }
        for (what, numbers) in [("the matrix", a), ("the start", start)] {
            if !numbers.iter().all(|number| number.is_finite()) {
                return Err(ConeError::Number { what });
            }
        }
        if !z.iter().flatten().all(|number| number.is_finite()) {
            return Err(ConeError::Number { what: "a right side" });
        }
        let a = DMatrix::from_row_slice(rows, self.count, a);
        let offset = self.elimination.offset(&a);
        let quadratic = Quadratic::new(self.elimination.columns(&a));
        let start = self.elimination.reduced(start);
        Ok(parallel::map(z.len(), threads, |k| {
            let z = DVector::from_column_slice(&z[k]) - &offset;
            self.translated(solve(&quadratic, &z, &self.cones, start.clone()))
        }))
    }

    /// A solution in all unknowns, with the places of the cones given.
    fn translated(&self, solution: Solution) -> Solution {
        let mut multipliers = vec![Vec::new(); self.n_cones];
        for (&place, multiplier) in self.places.iter().zip(solution.multipliers) {
            multipliers[place] = multiplier;
        }
        let ending = match (self.contradictory, solution.ending) {
            (Some(place), _) => Ending::Contradictory(place),
            (None, Ending::Contradictory(cone)) => Ending::Contradictory(self.places[cone]),
            (None, ending) => ending,
        };
        let x = self.elimination.full(&DVector::from_vec(solution.x));
        Solution { x, ending, multipliers, ..solution }
    }
}

/// A matrix without unknowns has no negative eigenvalue beyond rounding.
fn semidefinite(cone: &Cone) -> bool {
    let matrix = DMatrix::from_row_slice(cone.order, cone.order, &cone.constant);
    let size = matrix.amax();
    matrix.symmetric_eigenvalues().min() >= -ROUNDING * size
}
