//! Direct dynamic model (4): `M(q) ddq = tau - N(q, dq)`.
//!
//! `M` by composite bodies, `N` as the inverse model without acceleration, and an `L D L'` factorisation whose pivots tell
//! whether `M` is positive definite. Identity that tests it: direct after inverse is the identity; independently, Pinocchio's `aba`.

use crate::error::ShapeError;
use crate::inertia::{Lower, inertia_matrix_lanes};
use crate::inverse::{check_length, inverse_dynamics_at};
use crate::kinematics::{Placement, State};
use crate::lanes::{Kernel, Lanes, dispatch};
use crate::parameters::Layout;
use crate::robot::{MAX_DOF, Robot};

/// Accelerations, and the pivots of `M = L D L'`: all positive exactly where `M` is positive definite.
#[derive(Debug, Clone, Copy)]
pub struct Accelerations<const L: usize, const F: bool> {
    /// Joint accelerations (rad/s^2 or m/s^2).
    pub ddq: [Lanes<L, F>; MAX_DOF],
    /// Pivots, joint by joint.
    pub pivots: [Lanes<L, F>; MAX_DOF],
}

/// Accelerations of `L` states under torques `tau`; `state.ddq` is not read.
#[inline(always)]
pub fn direct_dynamics_lanes<const L: usize, const F: bool>(
    robot: &Robot,
    state: &State<L, F>,
    tau: &[Lanes<L, F>; MAX_DOF],
    x: &[Lanes<L, F>],
) -> Accelerations<L, F> {
    let placements = Placement::all(robot, &state.q);
    let still = State { ddq: [Lanes::zero(); MAX_DOF], ..*state };
    let bias = inverse_dynamics_at(robot, &placements, &still, x);
    let matrix = inertia_matrix_lanes(robot, &placements, x);
    let mut right = *tau;
    for j in 0..robot.n_dof() {
        right[j] -= bias[j];
    }
    solve(robot.n_dof(), matrix, right)
}

/// `M ddq = right` by `L D L'`, without square roots.
#[inline(always)]
fn solve<const L: usize, const F: bool>(
    n: usize,
    mut m: Lower<L, F>,
    mut right: [Lanes<L, F>; MAX_DOF],
) -> Accelerations<L, F> {
    let mut pivots = [Lanes::splat(1.0); MAX_DOF];
    for k in 0..n {
        let pivot = m[k][k];
        pivots[k] = pivot;
        let inverse = Lanes::splat(1.0) / pivot;
        for i in k + 1..n {
            let factor = m[i][k] * inverse;
            for j in k + 1..=i {
                m[i][j] -= factor * m[j][k];
            }
            right[i] -= factor * right[k];
        }
        for i in k + 1..n {
            m[i][k] = m[i][k] * inverse;
        }
        right[k] = right[k] * inverse;
    }
    for k in (0..n).rev() {
        for i in k + 1..n {
            let term = m[i][k] * right[i];
            right[k] -= term;
        }
    }
    Accelerations { ddq: right, pivots }
}

/// A sample whose inertia matrix is not positive definite.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Indefinite {
    /// Sample, from 0.
    pub sample: usize,
    /// Joint whose pivot is not positive, from 0.
    pub joint: usize,
}

struct Batch<'a> {
    robot: &'a Robot,
    q: &'a [f64],
    dq: &'a [f64],
    tau: &'a [f64],
    x: &'a [f64],
    ddq: &'a mut [f64],
}

impl Kernel for Batch<'_> {
    type Output = Option<Indefinite>;
    #[inline(always)]
    fn run<const L: usize, const F: bool>(self) -> Option<Indefinite> {
        let n = self.robot.n_dof();
        let x: Vec<Lanes<L, F>> = self.x.iter().map(|&value| Lanes::splat(value)).collect();
        for (block, out) in self.ddq.chunks_mut(n * L).enumerate() {
            // The torques travel in the place of the accelerations, which are what is asked for.
            let state = State::<L, F>::gather(n, block * L, self.q, self.dq, self.tau);
            let result = direct_dynamics_lanes(self.robot, &state, &state.ddq, &x);
            for (l, row) in out.chunks_mut(n).enumerate() {
                for j in 0..n {
                    let pivot = result.pivots[j].0[l];
                    if pivot <= 0.0 || pivot.is_nan() {
                        return Some(Indefinite { sample: block * L + l, joint: j });
                    }
                    row[j] = result.ddq[j].0[l];
                }
            }
        }
        None
    }
}

/// Accelerations of a batch, row-major `(n_samples, n_dof)`, joint side; the first sample with an indefinite `M`, if there is one.
pub fn direct_dynamics(
    robot: &Robot,
    q: &[f64],
    dq: &[f64],
    tau: &[f64],
    x: &[f64],
    ddq: &mut [f64],
) -> Result<Option<Indefinite>, ShapeError> {
    for (what, array) in [("q", q), ("dq", dq), ("tau", tau)] {
        check_length(what, array, ddq.len())?;
    }
    check_length("x", x, Layout::of(robot).count())?;
    Ok(if ddq.is_empty() { None } else { dispatch(Batch { robot, q, dq, tau, x, ddq }) })
}
