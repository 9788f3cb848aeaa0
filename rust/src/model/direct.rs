//! Direct dynamic model (4): `M(q) ddq = tau - N(q, dq)`.
//!
//! One pass outwards gives the wrenches of `N`, one inwards everything else, joint by joint from the last: the body that a joint
//! carries, its column of `M`, and the elimination `M = L' D L` of that joint, which needs only what lies further out. So the
//! divisions wait for nothing and nothing waits for them. Between branches `M` and `L` are zero, unless a motor turns with joints of
//! both. The pivots `D` tell whether `M` is positive definite.
//! Identity that tests it: direct after inverse is the identity; independently, Pinocchio's `aba`.

use crate::ground::arrays::MAX_DOF;
use crate::ground::arrays::ShapeError;
use crate::ground::arrays::check_length;
use crate::ground::dispatch::{Kernel, dispatch};
use crate::ground::lanes::{Lanes, Set};
use crate::model::bodies::{Body, Wrench};
use crate::model::friction::{Drives, Signs};
use crate::model::inertia::inertia_matrix_lanes;
use crate::model::inverse::{carry, link_wrenches};
use crate::model::links::Links;
use crate::model::motion::State;
use crate::robot::arm::{Arm, At, Place, Square, inwards, outwards};
use crate::robot::arm::{for_joints, unrolled};
use crate::robot::geometry::{Anchor, Frames, Geometry, Pose, Step};
use crate::robot::parameters::Layout;
use crate::robot::{Followers, Robot};

/// Memory of the direct model, and its result: nothing is cleared or copied per call.
#[derive(Debug)]
pub struct Direct<V: Set, S: Arm> {
    frames: Frames<V>,
    /// The last positions that were not near others.
    anchor: Anchor<V>,
    /// Wrench of each link; on the way inwards, that of all links that a joint carries.
    wrenches: [Wrench<V>; MAX_DOF],
    /// Column `k` of `M`: the wrench that the body carried by joint `k` needs for a unit acceleration, seen from the frame
    /// at hand.
    columns: [Wrench<V>; MAX_DOF],
    /// `L`, unit diagonal not stored.
    factor: S::Square<Lanes<V>>,
    /// Contribution of the rotors to `M`.
    rotors: S::Square<Lanes<V>>,
    /// Where joints follow others: `M` of all joints, and that of the driven ones.
    square: Option<[S::Square<Lanes<V>>; 2]>,
    /// All that the joint at hand carries, its own link included, unless that is all.
    carried: Body<V>,
    /// The same of a joint that carries several branches, as far as they have been added.
    composites: [Body<V>; MAX_DOF],
    /// Signs of the speeds; a closed loop puts the states of its friction there.
    pub signs: Signs<V>,
    /// Column of `D L` at hand.
    scaled: [Lanes<V>; MAX_DOF],
    inverse_pivots: [Lanes<V>; MAX_DOF],
    /// Joint accelerations (rad/s^2 or m/s^2).
    pub ddq: [Lanes<V>; MAX_DOF],
    /// Pivots `D`, joint by joint: all positive exactly where `M` is positive definite.
    pub pivots: [Lanes<V>; MAX_DOF],
}

impl<V: Set, S: Arm> Direct<V, S> {
    /// Nothing computed yet.
    #[inline(always)]
    pub fn new(robot: &Robot, geometry: &Geometry<S>, links: &Links<V>) -> Self {
        let zero = [Lanes::zero(); MAX_DOF];
        Self {
            frames: Frames::new(geometry),
            anchor: [zero; 3],
            wrenches: [Wrench::none(); MAX_DOF],
            columns: [Wrench::none(); MAX_DOF],
            factor: Square::filled(Lanes::zero(), geometry.n()),
            rotors: links.rotors(robot),
            square: None,
            carried: Body::none(),
            composites: [Body::none(); MAX_DOF],
            signs: Signs::none(),
            scaled: zero,
            inverse_pivots: zero,
            ddq: zero,
            pivots: zero,
        }
    }

    /// Accelerations of `L` states under torques `tau` of the drives and `external` ones. `near`: the positions lie near those of
    /// the last call that was not, as those of the later stages of a step do; only the time depends on how near.
    #[inline(always)]
    #[allow(clippy::too_many_arguments)] // the robot in three parts, and the state
    pub fn solve(
        &mut self,
        geometry: &Geometry<S>,
        drives: &Drives<'_>,
        links: &Links<V>,
        q: &[Lanes<V>; MAX_DOF],
        dq: &[Lanes<V>; MAX_DOF],
        tau: &[Lanes<V>; MAX_DOF],
        external: &[f64; MAX_DOF],
        near: bool,
    ) {
        if const { !S::KNOWN }
            && let Some(followers) = drives.followers()
        {
            return self.solve_driven(geometry, drives, links, followers, [q, dq, tau], external, near);
        }
        let n = geometry.n();
        if near {
            self.frames.follow(geometry, q, &self.anchor);
        } else {
            self.frames.anchor(geometry, q, &mut self.anchor);
        }
        drives.friction(geometry, links, q, dq, &mut self.signs, &mut self.ddq);
        outwards!(S, n, place => {
            let j = place.index();
            self.ddq[j] = (tau[j] + Lanes::splat(external[j])) - self.ddq[j];
        });
        if drives.has_load() {
            unload(n, &drives.load_coefficients(links, &self.signs), &mut self.ddq);
        }
        link_wrenches::<V, false, S>(geometry, &links.bodies, &self.frames, dq, dq, &mut self.wrenches);
        inwards!(S, n, place => {
            let (step, j) = (geometry.step(place), place.index());
            self.columns[j] = self.carried(links, &step, j).unit_wrench(step.form.turns);
            self.eliminate(place, geometry, step.form.turns);
            if !step.form.root {
                let (at, parent) = (self.frames.pose(j), step.before(place));
                columns_inwards(place, &step, at, &mut self.columns[..geometry.end(place)]);
                self.wrenches[parent] =
                    self.wrenches[parent].with(&self.wrenches[j].moved_in(place, &step, at));
                let link = if step.form.joins { &self.composites[parent] } else { &links.bodies[parent] };
                self.carried = self.carried(links, &step, j).moved_in(place, &step, at, link);
                if step.form.branches {
                    self.composites[parent] = self.carried;
                }
            }
        });
        outwards!(S, n, place => self.substitute(place, geometry.first(place)));
    }

    /// The same where joints follow others: `G' M G` by composite bodies, and its factor; velocities and torques of driven joints.
    #[inline(always)]
    #[allow(clippy::too_many_arguments)] // as above
    fn solve_driven(
        &mut self,
        geometry: &Geometry<S>,
        drives: &Drives<'_>,
        links: &Links<V>,
        followers: &Followers,
        [q, dq, tau]: [&[Lanes<V>; MAX_DOF]; 3],
        external: &[f64; MAX_DOF],
        near: bool,
    ) {
        let (n, driven) = (geometry.n(), followers.n_driven().min(MAX_DOF));
        let (q, dq) = (followers.joints(q, true), followers.joints(dq, false));
        if near {
            self.frames.follow(geometry, &q, &self.anchor);
        } else {
            self.frames.anchor(geometry, &q, &mut self.anchor);
        }
        drives.friction(geometry, links, &q, &dq, &mut self.signs, &mut self.ddq);
        link_wrenches::<V, false, S>(geometry, &links.bodies, &self.frames, &dq, &dq, &mut self.wrenches);
        carry::<V, S, false>(geometry, &self.frames, &mut self.wrenches, &mut self.ddq);
        let mut right = [Lanes::zero(); MAX_DOF];
        for a in 0..driven {
            right[a] = tau[a] + Lanes::splat(external[a]);
        }
        let [mut whole, mut matrix] = self
            .square
            .take()
            .unwrap_or_else(|| [self.rotors.clone(), Square::filled(Lanes::zero(), driven)]);
        inertia_matrix_lanes(
            geometry,
            &links.bodies,
            &self.rotors,
            &self.frames,
            &mut self.composites,
            &mut whole,
        );
        for j in 0..driven {
            for k in 0..=j {
                matrix[j][k] = Lanes::zero();
            }
        }
        for j in 0..n {
            for &(a, factor) in followers.leaders(j) {
                right[a] = self.ddq[j].neg_mul_add(Lanes::splat(factor), right[a]);
                for i in (0..=j).filter(|&i| geometry.carries(i, j)) {
                    for &(b, other) in followers.leaders(i) {
                        // Off the diagonal of `M` an entry stands for its mirror image too.
                        let share = factor * other * if i == j { 0.5 } else { 1.0 };
                        let both = if a == b { 2.0 * share } else { share };
                        matrix[a.max(b)][a.min(b)] += whole[j][i].scale(both);
                    }
                }
            }
        }
        self.ddq = right;
        for j in (0..driven).rev() {
            for k in (j..driven).rev() {
                self.reduce(k, j, matrix[k][j], driven);
            }
            self.pivots[j] = self.scaled[j];
            self.inverse_pivots[j] = Lanes::splat(1.0) / self.scaled[j];
        }
        for j in 0..driven {
            self.substitute(At(j), 0);
        }
        self.square = Some([whole, matrix]);
    }

    /// All that joint `j`, the one at hand, carries.
    #[inline(always)]
    fn carried<'a>(&'a self, links: &'a Links<V>, step: &Step<'_>, j: usize) -> &'a Body<V> {
        if step.form.leaf { &links.bodies[j] } else { &self.carried }
    }

    /// Column `j` of `L' D L` and of `L' y = right`, from the wrenches in frame `j`.
    #[inline(always)]
    #[allow(clippy::absurd_extreme_comparisons)] // one of the constants is zero
    fn eliminate<P: Place>(&mut self, place: P, geometry: &Geometry<S>, turns: bool) {
        let j = place.index();
        self.ddq[j] -= self.wrenches[j].felt(turns);
        if const { P::FORM.is_some() } {
            unrolled!(K in 5 4 3 2 1 0 => if const { K >= P::INDEX } {
                let mut entry = self.rotors[K][j] + self.columns[K].felt(turns);
                unrolled!(I in 5 4 3 2 1 => if const { I > K } {
                    entry = self.factor[I][K].neg_mul_add(self.scaled[I], entry);
                });
                self.scale_entry(K, j, entry);
            });
        } else {
            let end = geometry.end(place);
            // Other branches, where a motor turns with joints of several.
            for k in (end..geometry.fill(j)).rev() {
                self.reduce(k, j, self.rotors[k][j], geometry.fill(k));
            }
            for k in (j..end).rev() {
                self.reduce(k, j, self.rotors[k][j] + self.columns[k].felt(turns), geometry.fill(k));
            }
        }
        self.pivots[j] = self.scaled[j];
        self.inverse_pivots[j] = Lanes::splat(1.0) / self.scaled[j];
    }

    /// Entry `(k, j)` of `M`, less what the joints further out, before `fill`, take from it.
    #[inline(always)]
    fn reduce(&mut self, k: usize, j: usize, mut entry: Lanes<V>, fill: usize) {
        // The compiler sees that `i` is within the rows.
        let rows = &self.factor.as_ref()[..fill];
        for i in (k + 1..fill).rev() {
            entry = rows[i][k].neg_mul_add(self.scaled[i], entry);
        }
        self.scale_entry(k, j, entry);
    }

    #[inline(always)]
    fn scale_entry(&mut self, k: usize, j: usize, entry: Lanes<V>) {
        self.scaled[k] = entry;
        if k > j {
            let factor = entry * self.inverse_pivots[k];
            self.factor[k][j] = factor;
            self.ddq[j] = factor.neg_mul_add(self.ddq[k], self.ddq[j]);
        }
    }

    /// `ddq` of a joint from `L ddq = y / D`, once that of those before is known.
    #[inline(always)]
    fn substitute<P: Place>(&mut self, place: P, first: usize) {
        let j = place.index();
        let mut ddq = self.ddq[j] * self.inverse_pivots[j];
        if const { P::FORM.is_some() } {
            unrolled!(I in 0 1 2 3 4 => if const { I < P::INDEX } {
                ddq = self.factor[P::INDEX][I].neg_mul_add(self.ddq[I], ddq);
            });
        } else {
            let row = &self.factor[j];
            for i in first..j {
                ddq = row[i].neg_mul_add(self.ddq[i], ddq);
            }
        }
        self.ddq[j] = ddq;
    }

    /// `M` of the state solved last, from its factors.
    #[inline(always)]
    pub fn inertia(&self, n: usize, matrix: &mut impl Square<Lanes<V>>) {
        for_joints!(k in n => {
            matrix[k][k] = self.pivots[k];
            for_joints!(j in n => if j < k {
                let entry = self.factor[k][j] * self.pivots[k];
                matrix[k][j] = entry;
                for_joints!(i in n => if i <= j {
                    matrix[j][i] = entry.mul_add(self.factor[k][i], matrix[j][i]);
                });
            });
        });
    }

    /// Puts the accelerations that torques cause by themselves in their place, at the state solved last.
    #[inline(always)]
    pub fn respond(&self, n: usize, tau: &mut [Lanes<V>; MAX_DOF]) {
        for_joints!(last in n => {
            let k = n - 1 - last;
            for_joints!(j in n => if j < k {
                tau[j] = self.factor[k][j].neg_mul_add(tau[k], tau[j]);
            });
        });
        for_joints!(j in n => {
            tau[j] = tau[j] * self.inverse_pivots[j];
            for_joints!(i in n => if i < j {
                tau[j] = self.factor[j][i].neg_mul_add(tau[i], tau[j]);
            });
        });
    }
}

/// Torque that is left for links and rotors where friction takes `c abs(tau_r)` of it: `tau_r + c abs(tau_r) = u` has the closed
/// solution `tau_r = u / (1 + c sign(u))` as long as `abs(c) < 1`.
#[inline(always)]
fn unload<V: Set>(n: usize, coefficients: &[Lanes<V>; MAX_DOF], tau: &mut [Lanes<V>; MAX_DOF]) {
    let one = Lanes::splat(1.0);
    for j in 0..n {
        tau[j] = tau[j] / (one + coefficients[j] * one.copysign(tau[j]));
    }
}

/// The columns of `M` from a joint to the last that it carries, one frame inwards.
#[inline(always)]
#[allow(clippy::absurd_extreme_comparisons)] // one of the constants is zero
fn columns_inwards<P: Place, V: Set>(place: P, step: &Step<'_>, at: Pose<'_, V>, columns: &mut [Wrench<V>]) {
    if const { P::FORM.is_some() } {
        unrolled!(K in 0 1 2 3 4 5 => if const { K >= P::INDEX } {
            columns[K] = columns[K].moved_in(place, step, at);
        });
    } else {
        for column in &mut columns[place.index()..] {
            *column = column.moved_in(place, step, at);
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
    fn run<V: Set>(self) -> Option<Indefinite> {
        let geometry = *self.robot.geometry(); // a copy, as in the inverse model
        let n = self.robot.n_dof();
        let drives = Drives::of(self.robot);
        let links = Links::<V>::of_one(self.robot, &geometry, self.x);
        let (mut result, mut state) = (Direct::new(self.robot, &geometry, &links), State::zero());
        for (block, out) in self.ddq.chunks_mut(n * V::L).enumerate() {
            // The torques travel in the place of the accelerations, which are what is asked for.
            state.load(n, block * V::L, self.q, self.dq, self.tau);
            result.solve(&geometry, &drives, &links, &state.q, &state.dq, &state.ddq, &[0.0; MAX_DOF], false);
            if (0..n).any(|j| !result.pivots[j].all_above(0.0)) {
                // Lanes past the end repeat the last sample: one that is asked for is among those.
                let lanes = (0..V::L).flat_map(|l| (0..n).map(move |joint| (l, joint)));
                let mut wrong = lanes.filter(|&(l, joint)| {
                    let pivot = result.pivots[joint].lane(l);
                    pivot <= 0.0 || pivot.is_nan()
                });
                return wrong.next().map(|(l, joint)| Indefinite { sample: block * V::L + l, joint });
            }
            Lanes::scatter(&result.ddq[..n], out, n);
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
