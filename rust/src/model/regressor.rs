//! Regressor of the inverse dynamic model (2): `tau = IDM(q, dq, ddq) x`, linear in the standard parameters.
//!
//! The links (`walk.rs`) move by the same outward pass as in [`crate::model::inverse`]. Identity that tests it: `W x` equals its
//! torques; independently, Pinocchio's `computeJointTorqueRegressor` in the Python tests.

use crate::ground::arrays::{MAX_DOF, ShapeError, check_length};
use crate::ground::dispatch::{Kernel, dispatch};
use crate::ground::lanes::{Lanes, Set};
use crate::model::friction::{Shaft, own_columns, sign};
use crate::model::friction_terms::column;
use crate::model::motion::State;
use crate::model::walk::{Entries, Walk};
use crate::robot::Robot;
use crate::robot::friction_terms::Law;
use crate::robot::geometry::Geometry;
use crate::robot::parameters::{FRICTION, IA, INERTIAL, Layout};

/// Number of samples in one batch for coupled joints: the rows of all joints are larger than those of the driven ones.
const TOGETHER: usize = 64;

/// Hands over every entry of the regressor that is not zero by structure. `load`: torques of links and rotors (N.m or N), which
/// only the columns of load friction need.
#[inline(always)]
fn regressor_lanes<V: Set>(
    robot: &Robot,
    geometry: &Geometry,
    walk: &mut Walk<V>,
    state: &State<V>,
    load: &[Lanes<V>; MAX_DOF],
    entries: &mut impl Entries<V>,
) {
    let layout = Layout::of(robot);
    walk.start(geometry, &state.q);
    if geometry.is_chain() {
        for j in 0..geometry.n() {
            walk.step::<true>(geometry, j, state);
            walk.link_rows::<true>(geometry, j, layout.joint(j), entries);
        }
    } else {
        for j in 0..geometry.n() {
            walk.step::<false>(geometry, j, state);
            walk.link_rows::<false>(geometry, j, layout.joint(j), entries);
        }
    }
    drive_lanes(robot, state, load, entries);
}

/// The same for the columns of rotors and friction, joints and coupled motors.
#[inline(always)]
pub(crate) fn drive_lanes<V: Set>(
    robot: &Robot,
    state: &State<V>,
    load: &[Lanes<V>; MAX_DOF],
    entries: &mut impl Entries<V>,
) {
    let layout = Layout::of(robot);
    for (index, term) in robot.friction().terms.iter().enumerate() {
        let (q, dq) = (state.q[term.joint], state.dq[term.joint]);
        let value = column(robot, term, q, dq, || sign(robot, term.joint, dq));
        let value = if term.law == Law::Load { value * load[term.joint].abs() } else { value };
        entries.put(term.joint, layout.term(index), value);
    }
    for j in 0..robot.n_joints() {
        let first = layout.joint(j);
        let [a, b, c, d] = own_columns(robot, j, state.dq[j]);
        entries.put_drive(j, first + IA, [state.ddq[j], a, b, c]);
        if layout.per_joint() > FRICTION + 3 {
            entries.put(j, first + FRICTION + 3, d);
        }
    }
    for (index, coupled) in robot.coupled().iter().enumerate() {
        let m = coupled.motor;
        let shaft = Shaft::of(robot, coupled, state);
        let first = layout.coupled(index);
        let own = shaft.own_row(m, state);
        entries.put(m, layout.joint(m) + IA, own.rotor + state.ddq[m]);
        entries.put(m, first, own.viscous);
        entries.put(m, first + 1, own.coulomb);
        for &(i, c) in &coupled.others {
            let row = shaft.other_row(robot, i, c, state);
            entries.put(i, layout.joint(m) + IA, row.rotor);
            entries.put(i, first, row.viscous);
            entries.put(i, first + 1, row.coulomb);
        }
    }
}

/// Entries go to the rows of each of the samples, row-major.
struct Rows<'a, V: Set> {
    samples: V::Of<&'a mut [f64]>,
    /// Entries of a row.
    p: usize,
}

impl<V: Set> Entries<V> for Rows<'_, V> {
    #[inline(always)]
    fn put(&mut self, row: usize, column: usize, value: Lanes<V>) {
        for (sample, &value) in self.samples.as_mut().iter_mut().zip(value.to_array().as_ref()) {
            sample[row * self.p + column] = value;
        }
    }

    /// In three vectors per sample; the last begins before the second has ended.
    #[inline(always)]
    fn put_link(&mut self, row: usize, first: usize, v: &[Lanes<V>; INERTIAL]) {
        let parts = [[v[0], v[1], v[2], v[3]], [v[4], v[5], v[6], v[7]], [v[6], v[7], v[8], v[9]]];
        let [a, b, c] = [Lanes::turned(parts[0]), Lanes::turned(parts[1]), Lanes::turned(parts[2])];
        let start = row * self.p + first;
        for (l, sample) in self.samples.as_mut().iter_mut().enumerate() {
            let out = &mut sample[start..start + INERTIAL];
            out[..4].copy_from_slice(&a[l]);
            out[4..8].copy_from_slice(&b[l]);
            out[6..].copy_from_slice(&c[l]);
        }
    }

    #[inline(always)]
    fn put_drive(&mut self, row: usize, first: usize, values: [Lanes<V>; 4]) {
        let values = Lanes::turned(values);
        let start = row * self.p + first;
        for (sample, values) in self.samples.as_mut().iter_mut().zip(values.as_ref()) {
            sample[start..start + 4].copy_from_slice(values);
        }
    }
}

struct Batch<'a> {
    robot: &'a Robot,
    q: &'a [f64],
    dq: &'a [f64],
    ddq: &'a [f64],
    load: &'a [f64],
    w: &'a mut [f64],
}

impl Kernel for Batch<'_> {
    type Output = ();
    #[inline(always)]
    fn run<V: Set>(self) {
        let geometry = self.robot.geometry();
        let (n, p) = (geometry.n(), Layout::of(self.robot).count());
        let sample = n * p;
        // Samples that do not fill the last block go through a block of their own.
        let mut spare = vec![0.0; if self.w.len().is_multiple_of(sample * V::L) { 0 } else { sample * V::L }];
        let mut walk = Walk::<V>::new(geometry);
        let mut state = State::zero();
        let mut load = [Lanes::zero(); MAX_DOF];
        for (block, out) in self.w.chunks_mut(sample * V::L).enumerate() {
            state.load(n, block * V::L, self.q, self.dq, self.ddq);
            let whole = out.len() == sample * V::L;
            let rows = if whole { &mut *out } else { &mut spare[..] };
            rows.fill(0.0);
            gather_load(self.load, n, block * V::L, &mut load);
            let mut rest = rows;
            let samples = V::of(|_| {
                let (one, others) = std::mem::take(&mut rest).split_at_mut(sample);
                rest = others;
                one
            });
            regressor_lanes(self.robot, geometry, &mut walk, &state, &load, &mut Rows { samples, p });
            if !whole {
                out.copy_from_slice(&spare[..out.len()]);
            }
        }
    }
}

/// Takes torques of links and rotors of `L` samples; none where none are given, which only load friction would need.
#[inline(always)]
pub(crate) fn gather_load<V: Set>(load: &[f64], n: usize, row: usize, lanes: &mut [Lanes<V>; MAX_DOF]) {
    if !load.is_empty() {
        for (j, lane) in lanes.iter_mut().enumerate().take(n) {
            *lane = Lanes::gather(load, n, row, j);
        }
    }
}

/// The torques of links and rotors that a robot's columns need, checked: one per entry of `q`, or none without load friction.
pub(crate) fn check_load(robot: &Robot, load: &[f64], want: usize) -> Result<(), ShapeError> {
    match (robot.friction().has_load(), load.is_empty()) {
        (true, true) if want > 0 => Err(ShapeError::Load),
        (_, true) => Ok(()),
        _ => check_length("load", load, want),
    }
}

/// Regressor of a batch: `w` is row-major `(n_samples, n_dof, n_parameters)`, joint side. For robots without load friction.
pub fn regressor(robot: &Robot, q: &[f64], dq: &[f64], ddq: &[f64], w: &mut [f64]) -> Result<(), ShapeError> {
    regressor_under_load(robot, q, dq, ddq, &[], w)
}

/// The same with the torques of links and rotors (N.m or N, as `q`), which the columns of load friction need; empty without it.
pub fn regressor_under_load(
    robot: &Robot,
    q: &[f64],
    dq: &[f64],
    ddq: &[f64],
    load: &[f64],
    w: &mut [f64],
) -> Result<(), ShapeError> {
    for (what, array) in [("dq", dq), ("ddq", ddq)] {
        check_length(what, array, q.len())?;
    }
    check_load(robot, load, q.len())?;
    check_length("w", w, q.len() * Layout::of(robot).count())?;
    if q.is_empty() {
        return Ok(());
    }
    let Some(followers) = robot.followers() else {
        dispatch(Batch { robot, q, dq, ddq, load, w });
        return Ok(());
    };
    let (n, p) = (robot.n_dof(), Layout::of(robot).count());
    let mut all = vec![0.0; TOGETHER * robot.n_joints() * p];
    for (k, w) in w.chunks_mut(TOGETHER * n * p).enumerate() {
        let rows = k * TOGETHER * n..(k * TOGETHER * n + w.len() / p);
        let [q, dq, ddq] = [(q, true), (dq, false), (ddq, false)]
            .map(|(values, at)| followers.spread(&values[rows.clone()], at));
        let all = &mut all[..q.len() * p];
        dispatch(Batch { robot, q: &q, dq: &dq, ddq: &ddq, load: &[], w: all });
        followers.gather(all, p, w);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ground::lanes::Plain;
    use crate::robot::{Friction, Joint, JointKind};

    /// Entries one by one, as the trait hands them over by itself; the rotor of a coupled motor comes twice, and the last one holds.
    struct OneByOne(Vec<Option<f64>>, usize);

    impl<V: Set> Entries<V> for OneByOne {
        fn put(&mut self, row: usize, column: usize, value: Lanes<V>) {
            self.0[row * self.1 + column] = Some(value.lane(0));
        }
    }

    /// The second joint slides; the motor of the fourth moves with the third.
    fn robot() -> Robot {
        let joint = |j: usize| Joint {
            kind: if j == 1 { JointKind::Prismatic } else { JointKind::Revolute },
            alpha: 0.4 * j as f64,
            d: 0.1 * j as f64,
            theta: 0.3,
            r: 0.2,
        };
        let mut transmission: Vec<Vec<f64>> =
            (0..4).map(|m| (0..4).map(|j| f64::from(u8::from(m == j))).collect()).collect();
        transmission[3][2] = 0.5;
        Robot::new((0..4).map(joint).collect(), [1.0, 2.0, -9.81], &transmission, Friction::sign(4)).unwrap()
    }

    #[test]
    fn entries_that_are_not_handed_over_are_zero() {
        let robot = robot();
        let (n, p) = (4, Layout::of(&robot).count());
        let motion = |a: f64| (0..n).map(|k| (a * k as f64 + a).sin() * 2.0).collect::<Vec<_>>();
        let (q, dq, ddq) = (motion(1.1), motion(0.7), motion(1.7));
        let mut entries = OneByOne(vec![None; n * p], p);
        let mut state = State::<Plain<1>>::zero();
        state.load(n, 0, &q, &dq, &ddq);
        let geometry = robot.geometry();
        let mut walk = Walk::new(geometry);
        regressor_lanes(&robot, geometry, &mut walk, &state, &[Lanes::zero(); MAX_DOF], &mut entries);
        let mut w = vec![0.0; n * p];
        Batch { robot: &robot, q: &q, dq: &dq, ddq: &ddq, load: &[], w: &mut w }.run::<Plain<1>>();
        for (entry, want) in entries.0.iter().zip(&w) {
            assert_eq!(entry.unwrap_or(0.0), *want);
        }
        // Ten columns of link j in rows up to j, four of each drive, and Ia, Fvm and Fcm of the coupled motor in the other row.
        assert_eq!(entries.0.iter().flatten().count(), 10 * (1 + 2 + 3 + 4) + 4 * n + 5);
    }
}
