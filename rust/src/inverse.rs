//! Inverse dynamic model (1) by Newton-Euler: joint torques from positions, velocities and accelerations.
//!
//! `tau = M(q) ddq + N(q, dq)`, rotors and friction included. Identity that tests it: `tau = W x` with the
//! columns of [`crate::regressor`]; independently, Pinocchio's `rnea` in the Python tests.

use crate::bodies::{Body, Links, Wrench};
use crate::error::ShapeError;
use crate::friction::Drives;
use crate::geometry::{Frames, Geometry, by_twist};
use crate::kinematics::{Angular, State};
use crate::lanes::{Kernel, Lanes, dispatch};
use crate::parameters::Layout;
use crate::robot::{MAX_DOF, Robot};
use crate::spatial::Vector;

/// What moves each link, at its origin and in its frame; of the first one only what its joint feels. Rotors are not in it.
///
/// Link `j` moves with the accelerations `a + U p` of its points: `a` is carried outwards, `U` follows from the angular velocity
/// and acceleration. Gravity enters as an acceleration of the base. Without `MOVING`, joint accelerations are zero.
#[inline(always)]
pub fn link_wrenches<const L: usize, const F: bool, const MOVING: bool>(
    geometry: &Geometry,
    bodies: &[Body<L, F>; MAX_DOF],
    frames: &Frames<L, F>,
    dq: &[Lanes<L, F>; MAX_DOF],
    ddq: &[Lanes<L, F>; MAX_DOF],
    wrenches: &mut [Wrench<L, F>; MAX_DOF],
) {
    let n = geometry.n();
    let [x, y, z] = geometry.gravity;
    let (mut omega, mut domega, mut a) = (Vector::zero(), Vector::zero(), Vector::splat([-x, -y, -z]));
    for j in 0..n {
        let (step, body) = (&geometry.steps[j], &bodies[j]);
        let (s, c) = (frames.sine[j], frames.cosine[j]);
        let u;
        if j == 0 {
            // The base does not turn.
            a = by_twist!(step, T => a.stepped::<T>(step, s, c));
            if step.turns {
                omega.z = dq[0];
                if MOVING {
                    domega.z = ddq[0];
                }
                u = Angular::about_z(omega.z, domega.z);
                let moment = body.h.x.mul_sub(a.y, body.h.y * a.x);
                wrenches[0].moment.z =
                    if MOVING { (body.xx + body.yy).mul_add(ddq[0], moment) } else { moment };
            } else {
                if MOVING {
                    a.z += ddq[0];
                }
                u = Angular::none();
                wrenches[0].force.z = body.m * a.z;
            }
        } else {
            (omega, domega, a) = by_twist!(step, T =>
                (omega.stepped::<T>(step, s, c), domega.stepped::<T>(step, s, c), a.stepped::<T>(step, s, c)));
            if step.turns {
                domega.x = omega.y.mul_add(dq[j], domega.x);
                domega.y = omega.x.neg_mul_add(dq[j], domega.y);
                omega.z += dq[j];
                if MOVING {
                    domega.z += ddq[j];
                }
                u = Angular::of(omega, domega);
                wrenches[j] = body.regrouped_wrench(&u, a);
            } else {
                let twice = dq[j] + dq[j];
                a.x = omega.y.mul_add(twice, a.x);
                a.y = omega.x.neg_mul_add(twice, a.y);
                if MOVING {
                    a.z += ddq[j];
                }
                u = Angular::of(omega, domega);
                wrenches[j] = body.wrench(&u, a);
            }
        }
        if j + 1 < n {
            a = u.displaced(a, &geometry.steps[j + 1].shifted, &frames.shift[j + 1]);
        }
    }
}

/// Carries the wrenches in `wrenches` inwards and adds what each joint feels to `tau`.
#[inline(always)]
fn carry<const L: usize, const F: bool>(
    geometry: &Geometry,
    frames: &Frames<L, F>,
    wrenches: &[Wrench<L, F>; MAX_DOF],
    tau: &mut [Lanes<L, F>; MAX_DOF],
) {
    let n = geometry.n();
    let mut carried = wrenches[n - 1];
    for j in (1..n).rev() {
        let step = &geometry.steps[j];
        let (s, c, t) = (frames.sine[j], frames.cosine[j], &frames.shift[j]);
        tau[j] += carried.felt(step.turns);
        carried = by_twist!(step, T => carried.unstepped::<T>(step, s, c, t)).with(&wrenches[j - 1]);
    }
    tau[0] += carried.felt(geometry.steps[0].turns);
}

/// Memory of the inverse model, and its result: nothing is cleared or copied per call.
#[derive(Debug, Clone, Copy)]
pub struct Inverse<const L: usize, const F: bool> {
    frames: Frames<L, F>,
    wrenches: [Wrench<L, F>; MAX_DOF],
    /// Joint torques (N.m or N).
    pub tau: [Lanes<L, F>; MAX_DOF],
}

impl<const L: usize, const F: bool> Inverse<L, F> {
    /// Nothing computed yet.
    #[inline(always)]
    pub fn new(geometry: &Geometry) -> Self {
        Self {
            frames: Frames::new(geometry),
            wrenches: [Wrench::none(); MAX_DOF],
            tau: [Lanes::zero(); MAX_DOF],
        }
    }

    /// Torques of `L` states.
    #[inline(always)]
    pub fn solve(
        &mut self,
        geometry: &Geometry,
        drives: &Drives<'_>,
        links: &Links<L, F>,
        state: &State<L, F>,
    ) {
        let Self { frames, wrenches, tau } = self;
        frames.place(geometry, &state.q);
        drives.friction(links, &state.dq, tau);
        drives.rotors(links, &state.ddq, tau);
        link_wrenches::<L, F, true>(geometry, &links.bodies, frames, &state.dq, &state.ddq, wrenches);
        carry(geometry, frames, wrenches, tau);
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
        let geometry = Geometry::of(self.robot);
        let n = geometry.n();
        let drives = Drives::of(self.robot);
        let links = Links::<L, F>::of_one(self.robot, &geometry, self.x);
        let (mut result, mut state) = (Inverse::new(&geometry), State::zero());
        for (block, out) in self.tau.chunks_mut(n * L).enumerate() {
            state.load(n, block * L, self.q, self.dq, self.ddq);
            result.solve(&geometry, &drives, &links, &state);
            Lanes::scatter(&result.tau[..n], out, n);
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
