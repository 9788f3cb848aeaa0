//! Direct dynamic model (4): `M(q) ddq = tau - N(q, dq)`.
//!
//! `M` by composite bodies, `N` as the inverse model without acceleration, and an `L D L'` factorisation whose pivots tell
//! whether `M` is positive definite. Identity that tests it: direct after inverse is the identity; independently, Pinocchio's `aba`.

use crate::error::ShapeError;
use crate::inertia::{Lower, inertia_matrix_lanes, no_matrix};
use crate::inverse::{Wrench, check_length, inverse_dynamics_at};
use crate::kinematics::{Placement, State};
use crate::lanes::{Kernel, Lanes, dispatch};
use crate::parameters::Layout;
use crate::robot::{MAX_DOF, Robot};

/// Memory of the direct model, and its result: nothing is cleared or copied per call.
#[derive(Debug, Clone, Copy)]
pub struct Direct<const L: usize, const F: bool> {
    placements: [Placement<L, F>; MAX_DOF],
    wrenches: [Wrench<L, F>; MAX_DOF],
    matrix: Lower<L, F>,
    bias: [Lanes<L, F>; MAX_DOF],
    /// Joint accelerations (rad/s^2 or m/s^2).
    pub ddq: [Lanes<L, F>; MAX_DOF],
    /// Pivots of `M = L D L'`, joint by joint: all positive exactly where `M` is positive definite.
    pub pivots: [Lanes<L, F>; MAX_DOF],
}

impl<const L: usize, const F: bool> Default for Direct<L, F> {
    #[inline(always)]
    fn default() -> Self {
        Self::new()
    }
}

impl<const L: usize, const F: bool> Direct<L, F> {
    /// Nothing computed yet.
    #[inline(always)]
    pub fn new() -> Self {
        Self {
            placements: Placement::nowhere(),
            wrenches: Wrench::none(),
            matrix: no_matrix(),
            bias: [Lanes::zero(); MAX_DOF],
            ddq: [Lanes::zero(); MAX_DOF],
            pivots: [Lanes::splat(1.0); MAX_DOF],
        }
    }

    /// Accelerations of `L` states under torques `tau`. `still` has no acceleration.
    #[inline(always)]
    pub fn solve(
        &mut self,
        robot: &Robot,
        still: &State<L, F>,
        tau: &[Lanes<L, F>; MAX_DOF],
        x: &[Lanes<L, F>],
    ) {
        Placement::all(robot, &still.q, &mut self.placements);
        inverse_dynamics_at(robot, &self.placements, still, x, &mut self.wrenches, &mut self.bias);
        inertia_matrix_lanes(robot, &self.placements, x, &mut self.matrix);
        for j in 0..robot.n_dof() {
            self.ddq[j] = tau[j] - self.bias[j];
        }
        self.factor_and_solve(robot.n_dof());
    }

    /// `M ddq = right` by `L D L'`, without square roots; `right` stands in `ddq`.
    #[inline(always)]
    fn factor_and_solve(&mut self, n: usize) {
        let (m, right) = (&mut self.matrix, &mut self.ddq);
        for k in 0..n {
            let pivot = m[k][k];
            self.pivots[k] = pivot;
            let inverse = Lanes::splat(1.0) / pivot;
            for i in k + 1..n {
                let factor = m[i][k] * inverse;
                for j in k + 1..=i {
                    m[i][j] = factor.neg_mul_add(m[j][k], m[i][j]);
                }
                right[i] = factor.neg_mul_add(right[k], right[i]);
            }
            for i in k + 1..n {
                m[i][k] = m[i][k] * inverse;
            }
            right[k] = right[k] * inverse;
        }
        for k in (0..n).rev() {
            for i in k + 1..n {
                right[k] = m[i][k].neg_mul_add(right[i], right[k]);
            }
        }
    }
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
        let mut result = Direct::<L, F>::new();
        for (block, out) in self.ddq.chunks_mut(n * L).enumerate() {
            // The torques travel in the place of the accelerations, which are what is asked for.
            let mut state = State::<L, F>::gather(n, block * L, self.q, self.dq, self.tau);
            let tau = std::mem::replace(&mut state.ddq, [Lanes::zero(); MAX_DOF]);
            result.solve(self.robot, &state, &tau, &x);
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
