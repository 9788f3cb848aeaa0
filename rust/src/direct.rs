//! Direct dynamic model (4): `M(q) ddq = tau - N(q, dq)`.
//!
//! One pass outwards gives the wrenches of `N`, one inwards everything else, joint by joint from the last: the body that a joint
//! carries, its column of `M`, and the elimination `M = L' D L` of that joint, which needs only what lies further out. So the
//! divisions wait for nothing and nothing waits for them. The pivots `D` tell whether `M` is positive definite.
//! Identity that tests it: direct after inverse is the identity; independently, Pinocchio's `aba`.

use crate::bodies::{Body, Links, Lower, Wrench};
use crate::error::ShapeError;
use crate::friction::Drives;
use crate::geometry::{Frames, Geometry, by_twist};
use crate::inverse::{check_length, link_wrenches};
use crate::kinematics::State;
use crate::lanes::{Kernel, Lanes, dispatch};
use crate::parameters::Layout;
use crate::robot::{MAX_DOF, Robot};

/// Memory of the direct model, and its result: nothing is cleared or copied per call.
#[derive(Debug, Clone, Copy)]
pub struct Direct<const L: usize, const F: bool> {
    frames: Frames<L, F>,
    /// Of the links; then, at each joint, of all that it carries.
    wrenches: [Wrench<L, F>; MAX_DOF],
    /// Column `k` of `M`: the wrench that the body carried by joint `k` needs for a unit acceleration, seen from the frame
    /// at hand.
    columns: [Wrench<L, F>; MAX_DOF],
    /// `L`, unit diagonal not stored.
    factor: Lower<L, F>,
    inverse_pivots: [Lanes<L, F>; MAX_DOF],
    /// Joint accelerations (rad/s^2 or m/s^2).
    pub ddq: [Lanes<L, F>; MAX_DOF],
    /// Pivots `D`, joint by joint: all positive exactly where `M` is positive definite.
    pub pivots: [Lanes<L, F>; MAX_DOF],
}

impl<const L: usize, const F: bool> Direct<L, F> {
    /// Nothing computed yet.
    #[inline(always)]
    pub fn new(geometry: &Geometry) -> Self {
        let zero = [Lanes::zero(); MAX_DOF];
        Self {
            frames: Frames::new(geometry),
            wrenches: [Wrench::none(); MAX_DOF],
            columns: [Wrench::none(); MAX_DOF],
            factor: [zero; MAX_DOF],
            inverse_pivots: zero,
            ddq: zero,
            pivots: zero,
        }
    }

    /// Accelerations of `L` states under torques `tau` of the drives and `external` ones.
    #[inline(always)]
    #[allow(clippy::too_many_arguments)] // the robot in three parts, and the state
    pub fn solve(
        &mut self,
        geometry: &Geometry,
        drives: &Drives<'_>,
        links: &Links<L, F>,
        q: &[Lanes<L, F>; MAX_DOF],
        dq: &[Lanes<L, F>; MAX_DOF],
        tau: &[Lanes<L, F>; MAX_DOF],
        external: &[f64; MAX_DOF],
    ) {
        let n = geometry.n();
        self.frames.place(geometry, q);
        drives.friction(links, dq, &mut self.ddq);
        for j in 0..n {
            self.ddq[j] = (tau[j] + Lanes::splat(external[j])) - self.ddq[j];
        }
        link_wrenches::<L, F, false>(geometry, &links.bodies, &self.frames, dq, dq, &mut self.wrenches);
        let mut body = links.bodies[n - 1];
        for j in (1..n).rev() {
            let step = &geometry.steps[j];
            self.columns[j] = body.unit_wrench(step.turns);
            self.eliminate(n, j, step.turns, &links.rotors);
            body = by_twist!(step, T => self.inwards::<T>(geometry, j, &links.bodies[j - 1], &body));
        }
        let turns = geometry.steps[0].turns;
        self.columns[0] = body.unit_wrench(turns);
        self.eliminate(n, 0, turns, &links.rotors);
        for j in 0..n {
            let mut ddq = self.ddq[j] * self.inverse_pivots[j];
            for i in 0..j {
                ddq = self.factor[j][i].neg_mul_add(self.ddq[i], ddq);
            }
            self.ddq[j] = ddq;
        }
    }

    /// Column `j` of `L' D L` and of `L' y = right`, from the wrenches in frame `j`.
    #[inline(always)]
    fn eliminate(&mut self, n: usize, j: usize, turns: bool, rotors: &Lower<L, F>) {
        // D L, column j.
        let mut scaled = [Lanes::zero(); MAX_DOF];
        let mut right = self.ddq[j] - self.wrenches[j].felt(turns);
        for k in (j..n).rev() {
            let mut entry = rotors[k][j] + self.columns[k].felt(turns);
            for l in k + 1..n {
                entry = self.factor[l][k].neg_mul_add(scaled[l], entry);
            }
            scaled[k] = entry;
            if k > j {
                let factor = entry * self.inverse_pivots[k];
                self.factor[k][j] = factor;
                right = factor.neg_mul_add(self.ddq[k], right);
            }
        }
        self.pivots[j] = scaled[j];
        self.inverse_pivots[j] = Lanes::splat(1.0) / scaled[j];
        self.ddq[j] = right;
    }

    /// Everything from frame `j` to frame `j-1`, where a link more is carried.
    #[inline(always)]
    fn inwards<const T: u8>(
        &mut self,
        geometry: &Geometry,
        j: usize,
        link: &Body<L, F>,
        body: &Body<L, F>,
    ) -> Body<L, F> {
        let step = &geometry.steps[j];
        let (s, c, t) = (self.frames.sine[j], self.frames.cosine[j], &self.frames.shift[j]);
        for column in &mut self.columns[j..geometry.n()] {
            *column = column.unstepped::<T>(step, s, c, t);
        }
        let carried = self.wrenches[j].unstepped::<T>(step, s, c, t);
        self.wrenches[j - 1] = self.wrenches[j - 1].with(&carried);
        let body = body.unstepped::<T>(step, s, c, t, j < geometry.heavy);
        if geometry.steps[j - 1].turns { link.regrouped_with(&body) } else { link.with(&body) }
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
        let geometry = Geometry::of(self.robot);
        let n = geometry.n();
        let drives = Drives::of(self.robot);
        let links = Links::<L, F>::of_one(self.robot, &geometry, self.x);
        let (mut result, mut state) = (Direct::new(&geometry), State::zero());
        for (block, out) in self.ddq.chunks_mut(n * L).enumerate() {
            // The torques travel in the place of the accelerations, which are what is asked for.
            state.load(n, block * L, self.q, self.dq, self.tau);
            result.solve(&geometry, &drives, &links, &state.q, &state.dq, &state.ddq, &[0.0; MAX_DOF]);
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
