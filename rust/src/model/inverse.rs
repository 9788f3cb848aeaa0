//! Inverse dynamic model (1) by Newton-Euler: joint torques from positions, velocities and accelerations.
//!
//! `tau = M(q) ddq + N(q, dq)`, rotors and friction included. Identity that tests it: `tau = W x` with the
//! columns of [`crate::model::regressor`], whose links move by the same outward pass; independently, the textbook recursion of
//! `rust/tests/common/partials.rs`, and Pinocchio's `rnea` in the Python tests.

use crate::ground::arrays::{MAX_DOF, ShapeError, check_length};
use crate::ground::dispatch::{Kernel, dispatch};
use crate::ground::lanes::{Lanes, Set};
use crate::model::bodies::{Body, Wrench};
use crate::model::friction::{Drives, Signs};
use crate::model::links::Links;
use crate::model::motion::{Link, State};
use crate::robot::Robot;
use crate::robot::arm::{Arm, At, Place, inwards, outwards};
use crate::robot::geometry::{Frames, Geometry, Step};
use crate::robot::parameters::Layout;

/// Wrench that moves each link, at its origin and in its frame; of a link on the base only the component along its joint. Without rotors.
///
/// Link `j` moves with the accelerations `a + U p` of its points: `a` is carried outwards, `U` follows from the angular velocity
/// and acceleration. Gravity enters as an acceleration of the base. Without `MOVING`, joint accelerations are zero.
#[inline(always)]
pub fn link_wrenches<V: Set, const MOVING: bool, S: Arm>(
    geometry: &Geometry<S>,
    bodies: &[Body<V>; MAX_DOF],
    frames: &Frames<V>,
    dq: &[Lanes<V>; MAX_DOF],
    ddq: &[Lanes<V>; MAX_DOF],
    wrenches: &mut [Wrench<V>; MAX_DOF],
) {
    let mut link = Link::base(geometry.gravity);
    if geometry.is_chain() {
        outwards!(S, geometry.n(), place => {
            let (step, j) = (geometry.step(place), place.index());
            link.move_on::<_, MOVING>(place, &step, frames.pose(j), dq[j], ddq[j]);
            load::<V, MOVING>(&link, &step, &bodies[j], ddq[j], &mut wrenches[j]);
        });
        return;
    }
    for j in 0..geometry.n() {
        let mut k = j;
        if geometry.step(At(j)).form.branches {
            // Another branch begins anew at the base: the links between are few, and none has to be remembered.
            (link, k) = (Link::base(geometry.gravity), 0);
        }
        loop {
            if k == j || geometry.carries(k, j) {
                let step = geometry.step(At(k));
                link.move_on::<_, MOVING>(At(k), &step, frames.pose(k), dq[k], ddq[k]);
            }
            if k == j {
                break;
            }
            k += 1;
        }
        load::<V, MOVING>(&link, &geometry.step(At(j)), &bodies[j], ddq[j], &mut wrenches[j]);
    }
}

/// The wrench that moves a link; of one on the base only what its joint feels.
#[inline(always)]
fn load<V: Set, const MOVING: bool>(
    link: &Link<V>,
    step: &Step<'_>,
    body: &Body<V>,
    ddq: Lanes<V>,
    wrench: &mut Wrench<V>,
) {
    let (a, u) = (link.a, &link.u);
    if !step.form.root {
        *wrench = if step.form.turns { body.regrouped_wrench(u, a) } else { body.wrench(u, a) };
    } else if step.form.turns {
        let moment = body.h.x.mul_sub(a.y, body.h.y * a.x);
        wrench.moment.z = if MOVING { (body.xx + body.yy).mul_add(ddq, moment) } else { moment };
    } else {
        wrench.force.z = body.m * a.z;
    }
}

/// Adds up the wrenches from the last to the first, and what each joint feels of them to `tau`.
#[inline(always)]
pub(super) fn carry<V: Set, S: Arm, const CHAIN: bool>(
    geometry: &Geometry<S>,
    frames: &Frames<V>,
    wrenches: &mut [Wrench<V>; MAX_DOF],
    tau: &mut [Lanes<V>; MAX_DOF],
) {
    inwards!(S, geometry.n(), place => {
        let (step, j) = (geometry.step(place), place.index());
        tau[j] += wrenches[j].felt(step.form.turns);
        let standing = if CHAIN { j > 0 } else { !step.form.root };
        if standing {
            let parent = if CHAIN { j - 1 } else { step.before(place) };
            wrenches[parent] = wrenches[parent].with(&wrenches[j].moved_in(place, &step, frames.pose(j)));
        }
    });
}

/// Memory of the inverse model, and its result: nothing is cleared or copied per call.
#[derive(Debug, Clone, Copy)]
pub struct Inverse<V: Set> {
    frames: Frames<V>,
    wrenches: [Wrench<V>; MAX_DOF],
    signs: Signs<V>,
    /// Joint torques (N.m or N).
    pub tau: [Lanes<V>; MAX_DOF],
}

impl<V: Set> Inverse<V> {
    /// Nothing computed yet.
    #[inline(always)]
    pub fn new<S: Arm>(geometry: &Geometry<S>) -> Self {
        Self {
            frames: Frames::new(geometry),
            wrenches: [Wrench::none(); MAX_DOF],
            signs: Signs::none(),
            tau: [Lanes::zero(); MAX_DOF],
        }
    }

    /// Torques of `L` states.
    #[inline(always)]
    pub fn solve<S: Arm>(
        &mut self,
        geometry: &Geometry<S>,
        drives: &Drives<'_>,
        links: &Links<V>,
        state: &State<V>,
    ) {
        let Self { frames, wrenches, signs, tau } = self;
        frames.place(geometry, &state.q);
        drives.friction(geometry, links, &state.q, &state.dq, signs, tau);
        // Load friction needs the torque of links and rotors by itself.
        let friction = drives.has_load().then(|| std::mem::replace(tau, [Lanes::zero(); MAX_DOF]));
        drives.rotors(links, &state.ddq, tau);
        link_wrenches::<V, true, S>(geometry, &links.bodies, frames, &state.dq, &state.ddq, wrenches);
        if geometry.is_chain() {
            carry::<V, S, true>(geometry, frames, wrenches, tau);
        } else {
            carry::<V, S, false>(geometry, frames, wrenches, tau);
        }
        if let Some(friction) = friction {
            let load = drives.load_coefficients(links, signs);
            for j in 0..geometry.n() {
                tau[j] = load[j].mul_add(tau[j].abs(), tau[j]) + friction[j];
            }
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
    fn run<V: Set>(self) {
        // A copy: the compiler then sees that no result is written into it, and keeps its numbers in registers.
        let geometry = *self.robot.geometry();
        let n = geometry.n();
        let drives = Drives::of(self.robot);
        let links = Links::<V>::of_one(self.robot, &geometry, self.x);
        let mut result = Inverse::new(&geometry);
        let mut state = State::zero();
        for (block, out) in self.tau.chunks_mut(n * V::L).enumerate() {
            state.load(n, block * V::L, self.q, self.dq, self.ddq);
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
    if tau.is_empty() {
        return Ok(());
    }
    if let Some(followers) = robot.followers() {
        let [q, dq, ddq] = [(q, true), (dq, false), (ddq, false)].map(|(v, at)| followers.spread(v, at));
        let mut all = vec![0.0; q.len()];
        dispatch(Batch { robot, q: &q, dq: &dq, ddq: &ddq, x, tau: &mut all });
        followers.gather(&all, 1, tau);
    } else {
        dispatch(Batch { robot, q, dq, ddq, x, tau });
    }
    Ok(())
}
