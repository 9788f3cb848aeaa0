//! The transmission (22): rotor speeds in joint-side units are `C dq`, and its rows are motors.

use super::description::RobotError;
use nalgebra::DMatrix;

/// Which equation the Coulomb friction of a coupled motor follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Coupling {
    /// On the motor shaft, along the speed `C dq`: it can only dissipate.
    Shaft,
    /// Equation (23) as printed: `sign(dq6)` on joint 5. It can create energy.
    Printed,
}

/// A motor that turns with more than its own joint: its speed is `dq_m + sum c_i dq_i`.
#[derive(Debug, Clone, PartialEq)]
pub struct CoupledMotor {
    /// The motor, and the joint it is named after (from 0).
    pub motor: usize,
    /// The other joints and their coefficients in the motor's speed.
    pub others: Vec<(usize, f64)>,
}

/// `C` with rows scaled to a unit diagonal.
pub(super) fn normalised(n: usize, transmission: &[Vec<f64>]) -> Result<Vec<Vec<f64>>, RobotError> {
    if transmission.len() != n {
        return Err(RobotError::Length { what: "transmission", want: n, got: transmission.len() });
    }
    for (m, row) in transmission.iter().enumerate() {
        if row.len() != n {
            return Err(RobotError::Length { what: "a row of transmission", want: n, got: row.len() });
        }
        if row.iter().any(|c| !c.is_finite()) {
            return Err(RobotError::NotFinite { what: "transmission", joint: m + 1 });
        }
    }
    let singular = DMatrix::from_fn(n, n, |m, j| transmission[m][j]).singular_values();
    if singular.min() <= 1e-12 * singular.max() {
        return Err(RobotError::SingularTransmission);
    }
    transmission
        .iter()
        .enumerate()
        .map(|(m, row)| match row[m] {
            0.0 => Err(RobotError::DetachedMotor { motor: m + 1 }),
            diagonal => Ok(row.iter().map(|c| c / diagonal).collect()),
        })
        .collect()
}

/// The motors that turn with more than one joint.
pub(super) fn coupled_motors(transmission: &[Vec<f64>]) -> Vec<CoupledMotor> {
    let others = |m: usize, row: &[f64]| -> Vec<(usize, f64)> {
        row.iter().copied().enumerate().filter(|&(j, c)| j != m && c != 0.0).collect()
    };
    transmission
        .iter()
        .enumerate()
        .map(|(motor, row)| CoupledMotor { motor, others: others(motor, row) })
        .filter(|coupled| !coupled.others.is_empty())
        .collect()
}
