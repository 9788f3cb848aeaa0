//! One constraint `F(x) = K + sum_i x_i B_i >= 0`, as the caller states it.

use thiserror::Error;

/// Rows of the largest cone: six joints that share their motors.
pub const MAX_ORDER: usize = 6;

/// Weight of the log-det term of a cone that has none, in nats: far below what a log or a prior says, and enough for a unique
/// solution.
pub const LEAST_WEIGHT: f64 = 1e-7;

/// A constraint. Matrices are row-major; entries are of order one where the caller can choose the scale.
#[derive(Debug, Clone, PartialEq)]
pub struct Cone {
    /// Rows of the matrix, 1 to [`MAX_ORDER`].
    pub order: usize,
    /// Unknowns that the matrix depends on.
    pub indices: Vec<usize>,
    /// `B_i` of each of them, `order * order` numbers each.
    pub basis: Vec<f64>,
    /// `K`.
    pub constant: Vec<f64>,
    /// Weight `gamma` (nats) of the term `-log det F + tr(Q F)`; 0 for a plain constraint.
    pub weight: f64,
    /// `Q` of that term.
    pub slope: Vec<f64>,
}

/// Faults of a problem.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ConeError {
    /// A size that no block has.
    #[error("cone {cone} has {got} rows; 1 to {MAX_ORDER} are possible")]
    Order {
        /// Which cone, from 0.
        cone: usize,
        /// Its rows.
        got: usize,
    },
    /// An array of another length.
    #[error("cone {cone}: {what} has {got} numbers, {want} are needed")]
    Length {
        /// Which cone, from 0.
        cone: usize,
        /// Which array.
        what: &'static str,
        /// Numbers needed.
        want: usize,
        /// Numbers given.
        got: usize,
    },
    /// An unknown that does not exist.
    #[error("cone {cone} names unknown {index} of {count}")]
    Index {
        /// Which cone, from 0.
        cone: usize,
        /// Its unknown.
        index: usize,
        /// Number of unknowns.
        count: usize,
    },
    /// A number that is not finite, or a negative weight.
    #[error("{what} has a value that is not a finite number, or a negative weight")]
    Number {
        /// Name of the array.
        what: &'static str,
    },
    /// Rows, columns or start of another size.
    #[error("{what} has size {got}, {want} is needed")]
    Size {
        /// Name of the array.
        what: &'static str,
        /// Size needed.
        want: usize,
        /// Size given.
        got: usize,
    },
    /// Equalities without a common solution.
    #[error("equality {equality} contradicts those before it")]
    Equality {
        /// Which equality, from 0.
        equality: usize,
    },
}

impl Cone {
    /// Check sizes and numbers of cone number `cone` in a problem of `count` unknowns.
    pub(super) fn check(&self, cone: usize, count: usize) -> Result<(), ConeError> {
        if self.order == 0 || self.order > MAX_ORDER {
            return Err(ConeError::Order { cone, got: self.order });
        }
        let square = self.order * self.order;
        for (what, want, got) in [
            ("basis", self.indices.len() * square, self.basis.len()),
            ("constant", square, self.constant.len()),
            ("slope", square, self.slope.len()),
        ] {
            if want != got {
                return Err(ConeError::Length { cone, what, want, got });
            }
        }
        if let Some(&index) = self.indices.iter().find(|&&index| index >= count) {
            return Err(ConeError::Index { cone, index, count });
        }
        let mut numbers = self.basis.iter().chain(&self.constant).chain(&self.slope);
        let finite = numbers.all(|number| number.is_finite()) && self.weight.is_finite();
        if !(finite && self.weight >= 0.0) {
            return Err(ConeError::Number { what: "a cone" });
        }
        Ok(())
    }

    /// The same cone with a log-det term of at least `least`.
    pub(super) fn with_least_weight(mut self, least: f64) -> Self {
        if self.weight < least {
            self.weight = least;
            let order = self.order;
            self.slope = (0..order * order).map(|k| if k % (order + 1) == 0 { 1.0 } else { 0.0 }).collect();
        }
        self
    }
}
