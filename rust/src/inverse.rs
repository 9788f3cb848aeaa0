//! Inverse dynamic model (1) by Newton-Euler: joint torques from positions, velocities and accelerations.
//!
//! `tau = M(q) ddq + N(q, dq)`, rotors and friction included. Identity that tests it: `tau = W x` with the
//! columns of [`crate::regressor`]; independently, Pinocchio's `rnea` in the Python tests.

use crate::error::ShapeError;
use crate::friction::{Shaft, own_columns};
use crate::kinematics::{Angular, Motion, Placement, State};
use crate::lanes::{Kernel, Lanes, dispatch};
use crate::parameters::{FRICTION, IA, INERTIAL, Layout, M, MX, XX};
use crate::robot::{JointKind, MAX_DOF, Robot};
use crate::spatial::Vector;

/// Force and moment on a link at its origin, in its frame.
#[derive(Debug, Clone, Copy)]
pub struct Wrench<const L: usize, const F: bool> {
    force: Vector<L, F>,
    moment: Vector<L, F>,
}

impl<const L: usize, const F: bool> Wrench<L, F> {
    /// No wrench on any link: memory for [`inverse_dynamics_at`].
    #[inline(always)]
    pub fn none() -> [Self; MAX_DOF] {
        [Self { force: Vector::zero(), moment: Vector::zero() }; MAX_DOF]
    }
}

/// What moves a link: `M a + U MS` and `J domega + omega x J omega + MS x a`, for the ten parameters `x` of the link.
#[inline(always)]
fn wrench<const L: usize, const F: bool>(motion: &Motion<L, F>, x: &[Lanes<L, F>]) -> Wrench<L, F> {
    let Motion { omega, domega, a } = *motion;
    let angular = Angular::of(omega, domega);
    let ms = Vector::new(x[MX], x[MX + 1], x[MX + 2]);
    let m = x[M];
    let u = [angular.column(0), angular.column(1), angular.column(2)];
    let force = Vector::new(
        a.x.mul_add(m, u[2].x.mul_add(ms.z, u[1].x.mul_add(ms.y, u[0].x * ms.x))),
        a.y.mul_add(m, u[2].y.mul_add(ms.z, u[1].y.mul_add(ms.y, u[0].y * ms.x))),
        a.z.mul_add(m, u[2].z.mul_add(ms.z, u[1].z.mul_add(ms.y, u[0].z * ms.x))),
    );
    let moment = turn(x, domega) + omega.cross(turn(x, omega)) + ms.cross(a);
    Wrench { force, moment }
}

/// `J v` of the inertia in `x`.
#[inline(always)]
fn turn<const L: usize, const F: bool>(x: &[Lanes<L, F>], v: Vector<L, F>) -> Vector<L, F> {
    let [xx, xy, xz, yy, yz, zz] = [x[XX], x[XX + 1], x[XX + 2], x[XX + 3], x[XX + 4], x[XX + 5]];
    Vector::new(
        v.z.mul_add(xz, v.y.mul_add(xy, v.x * xx)),
        v.z.mul_add(yz, v.y.mul_add(yy, v.x * xy)),
        v.z.mul_add(zz, v.y.mul_add(yz, v.x * xz)),
    )
}

/// Torques of `L` states, with standard parameters `x` of their own in each lane.
#[inline(always)]
pub fn inverse_dynamics_lanes<const L: usize, const F: bool>(
    robot: &Robot,
    state: &State<L, F>,
    x: &[Lanes<L, F>],
) -> [Lanes<L, F>; MAX_DOF] {
    let mut placements = Placement::nowhere();
    Placement::all(robot, &state.q, &mut placements);
    let mut tau = [Lanes::zero(); MAX_DOF];
    inverse_dynamics_at(robot, &placements, state, x, &mut Wrench::none(), &mut tau);
    tau
}

/// The same with the frames already placed, and with memory for the wrenches of the links: nothing is cleared or copied per call.
#[inline(always)]
pub fn inverse_dynamics_at<const L: usize, const F: bool>(
    robot: &Robot,
    placements: &[Placement<L, F>; MAX_DOF],
    state: &State<L, F>,
    x: &[Lanes<L, F>],
    wrenches: &mut [Wrench<L, F>; MAX_DOF],
    tau: &mut [Lanes<L, F>; MAX_DOF],
) {
    let n = robot.n_dof();
    let layout = Layout::of(robot);
    let mut motion = Motion::base(robot);
    for j in 0..n {
        motion = motion.next(robot, j, &placements[j], state.dq[j], state.ddq[j]);
        wrenches[j] = wrench(&motion, &x[layout.joint(j)..layout.joint(j) + INERTIAL]);
    }
    for j in (0..n).rev() {
        let joint = &robot.joints()[j];
        let Wrench { force, moment } = wrenches[j];
        let block = &x[layout.joint(j)..layout.joint(j) + layout.per_joint()];
        tau[j] = match joint.kind {
            JointKind::Revolute => moment.z,
            JointKind::Prismatic => force.z,
        };
        tau[j] = state.ddq[j].mul_add(block[IA], tau[j]);
        let columns = own_columns(robot, j, state.dq[j]);
        for (k, &value) in block[FRICTION..].iter().enumerate() {
            tau[j] = columns[k].mul_add(value, tau[j]);
        }
        if j > 0 {
            let (force, moment) = placements[j].wrench_before(robot, j, force, moment);
            wrenches[j - 1].force = wrenches[j - 1].force + force;
            wrenches[j - 1].moment = wrenches[j - 1].moment + moment;
        }
    }
    for (index, coupled) in robot.coupled().iter().enumerate() {
        let m = coupled.motor;
        let ia = x[layout.joint(m) + IA];
        let (fvm, fcm) = (x[layout.coupled(index)], x[layout.coupled(index) + 1]);
        let shaft = Shaft::of(robot, coupled, state);
        tau[m] += shaft.own_row(m, state).torque(ia, fvm, fcm);
        for &(i, c) in &coupled.others {
            tau[i] += shaft.other_row(robot, i, c, state).torque(ia, fvm, fcm);
        }
    }
}

struct Batch<'a> {
    robot: &'a Robot,
    q: &'a [f64],
    dq: &'a [f64],
    ddq: &'a [f64],
    x: &'a [f64],
    tau: &'a mut [f64],
}

impl Kernel for Batch<'_> {
    type Output = ();
    #[inline(always)]
    fn run<const L: usize, const F: bool>(self) {
        let n = self.robot.n_dof();
        let x: Vec<Lanes<L, F>> = self.x.iter().map(|&value| Lanes::splat(value)).collect();
        for (block, out) in self.tau.chunks_mut(n * L).enumerate() {
            let state = State::<L, F>::gather(n, block * L, self.q, self.dq, self.ddq);
            let tau = inverse_dynamics_lanes(self.robot, &state, &x);
            for (l, row) in out.chunks_mut(n).enumerate() {
                for j in 0..n {
                    row[j] = tau[j].0[l];
                }
            }
        }
    }
}

/// Torques (N.m or N, joint side) of a batch, row-major `(n_samples, n_dof)`, with all standard parameters `x`.
pub fn inverse_dynamics(
    robot: &Robot,
    q: &[f64],
    dq: &[f64],
    ddq: &[f64],
    x: &[f64],
    tau: &mut [f64],
) -> Result<(), ShapeError> {
    for (what, array) in [("q", q), ("dq", dq), ("ddq", ddq)] {
        check_length(what, array, tau.len())?;
    }
    check_length("x", x, Layout::of(robot).count())?;
    if !tau.is_empty() {
        dispatch(Batch { robot, q, dq, ddq, x, tau });
    }
    Ok(())
}

/// `array` has `want` numbers, or the error that says so.
pub(crate) fn check_length(what: &'static str, array: &[f64], want: usize) -> Result<(), ShapeError> {
    if array.len() == want { Ok(()) } else { Err(ShapeError::Length { what, want, got: array.len() }) }
}
