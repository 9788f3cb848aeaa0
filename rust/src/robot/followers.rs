//! Joints that follow others: `q = G q_a + q_0` with constant `G`, for fingers, telescopes, parallelograms.
//!
//! Only the driven joints `a` have a torque, a controller and a column in a log: `tau_a = G' tau(q, dq, ddq)`, the regressor is
//! `G' W` and the inertia matrix `G' M G`. Driven joints have the first numbers, in names of parameters and in arrays; joints
//! that follow have those behind. The kernels number joints branch by branch. Identities that test it: the models of Pinocchio with
//! `G'` made by hand, in the Python tests; direct after inverse.

use super::description::{Joint, Robot, RobotError};
use super::placement::Mount;
use super::{Coupling, Friction};
use crate::ground::arrays::MAX_DOF;
use crate::ground::lanes::{Lanes, Set};

/// A joint that follows others: `q = sum c_a q_a + q_0`.
#[derive(Debug, Clone, PartialEq)]
pub struct Follower {
    /// Driven joints (from 0) and their factors.
    pub leaders: Vec<(usize, f64)>,
    /// `q_0` (rad or m).
    pub offset: f64,
}

/// `G` and `q_0`, with rows in the order of the kernels.
#[derive(Debug, Clone, PartialEq)]
pub struct Followers {
    rows: Vec<Follower>,
    /// Number of each joint of the kernels among parameters.
    numbers: Vec<usize>,
    driven: usize,
}

impl Followers {
    /// Joints with a motor.
    pub fn n_driven(&self) -> usize {
        self.driven
    }

    /// Number of each joint of the kernels, from 0.
    pub fn numbers(&self) -> &[usize] {
        &self.numbers
    }

    /// Driven joints that move joint `j` of the kernels, with their factors.
    #[inline(always)]
    pub fn leaders(&self, j: usize) -> &[(usize, f64)] {
        &self.rows[j].leaders
    }

    /// `G v` of lanes, and `q_0` for positions.
    #[inline(always)]
    pub fn joints<V: Set>(&self, driven: &[Lanes<V>; MAX_DOF], position: bool) -> [Lanes<V>; MAX_DOF] {
        let mut all = [Lanes::zero(); MAX_DOF];
        for (value, row) in all.iter_mut().zip(&self.rows) {
            *value = Lanes::splat(if position { row.offset } else { 0.0 });
            for &(a, factor) in &row.leaders {
                *value = driven[a].mul_add(Lanes::splat(factor), *value);
            }
        }
        all
    }

    /// `G v` of a row-major batch, and `q_0` for positions.
    pub fn spread(&self, driven: &[f64], position: bool) -> Vec<f64> {
        let samples = driven.chunks_exact(self.driven);
        let value = |row: &Follower, sample: &[f64]| {
            let moved: f64 = row.leaders.iter().map(|&(a, factor)| factor * sample[a]).sum();
            if position { moved + row.offset } else { moved }
        };
        samples.flat_map(|sample| self.rows.iter().map(move |row| value(row, sample))).collect()
    }

    /// `G' v` of blocks of `width` numbers for each joint, sample by sample, into those of the driven joints.
    pub fn gather(&self, all: &[f64], width: usize, driven: &mut [f64]) {
        driven.fill(0.0);
        let samples = all.chunks_exact(self.rows.len() * width);
        for (from, into) in samples.zip(driven.chunks_exact_mut(self.driven * width)) {
            for (row, values) in self.rows.iter().zip(from.chunks_exact(width)) {
                for &(a, factor) in &row.leaders {
                    for (sum, value) in into[a * width..(a + 1) * width].iter_mut().zip(values) {
                        *sum += factor * value;
                    }
                }
            }
        }
    }

    /// `G' A G` of an `(n, n)` matrix, row-major.
    pub fn square(&self, all: &[f64]) -> Vec<f64> {
        let (n, driven) = (self.rows.len(), self.driven);
        let mut left = vec![0.0; driven * n];
        self.gather(all, n, &mut left);
        let mut both = vec![0.0; driven * driven];
        for (row, out) in left.chunks_exact(n).zip(both.chunks_exact_mut(driven)) {
            self.gather(row, 1, out);
        }
        both
    }
}

impl Robot {
    /// A tree of which the last joints follow others.
    ///
    /// Joints may stand on any joint here. `friction` and `transmission` are those of the driven joints; the sign of the speed of a
    /// joint that follows is smoothed as that of its leaders, so that its friction is theirs.
    ///
    /// # Errors
    ///
    /// As [`Self::tree`], and for leaders that are not driven, factors that are not finite, motors that turn with several joints, and
    /// friction that depends on the load or the path.
    pub fn with_followers(
        joints: &[Joint],
        mounts: &[Mount],
        gravity: [f64; 3],
        transmission: &[Vec<f64>],
        mut friction: Friction,
        followers: &[Follower],
    ) -> Result<Self, RobotError> {
        let n = joints.len();
        if mounts.len() != n {
            return Err(RobotError::Length { what: "the placements", want: n, got: mounts.len() });
        }
        let driven = n.saturating_sub(followers.len());
        let wrong =
            |joint: usize, reason: &'static str| Err(RobotError::Follower { joint: joint + 1, reason });
        for (k, follower) in followers.iter().enumerate() {
            let finite = follower.leaders.iter().all(|(_, factor)| factor.is_finite());
            if !(finite && follower.offset.is_finite()) {
                return wrong(driven + k, "its factors and its offset must be finite numbers");
            }
            if follower.leaders.is_empty()
                || follower.leaders.iter().any(|&(a, factor)| a >= driven || factor == 0.0)
            {
                return wrong(driven + k, "it must follow driven joints, with factors other than 0");
            }
        }
        if friction.has_load() || friction.remembers() || friction.coupling == Coupling::Printed {
            return wrong(
                driven,
                "friction of such robots depends on no load and no path, and coupling is 'shaft'",
            );
        }
        let identity =
            |(m, row): (usize, &Vec<f64>)| row.iter().enumerate().all(|(j, &c)| (c != 0.0) == (j == m));
        if transmission.len() != driven || !transmission.iter().enumerate().all(identity) {
            return wrong(driven, "motors of such robots turn with one joint each");
        }
        friction.held = vec![0.0; n];
        for values in [&mut friction.smoothing, &mut friction.dead_zone] {
            if values.len() != driven {
                return Err(RobotError::Length { what: "friction", want: driven, got: values.len() });
            }
            let more = followers.iter().map(|follower| {
                follower.leaders.iter().map(|&(a, factor)| factor.abs() * values[a]).sum::<f64>()
            });
            let more: Vec<f64> = more.collect();
            values.extend(more);
        }
        let order = branch_by_branch(mounts)?;
        let mut numbers = vec![0; n];
        for (place, &number) in order.iter().enumerate() {
            numbers[number] = place;
        }
        let mount = |number: usize| Mount {
            parent: mounts[number].parent.map(|parent| numbers[parent]),
            ..mounts[number]
        };
        let ordered = |values: &[f64]| order.iter().map(|&number| values[number]).collect::<Vec<f64>>();
        friction.smoothing = ordered(&friction.smoothing);
        friction.dead_zone = ordered(&friction.dead_zone);
        for term in &mut friction.terms {
            term.joint = *numbers.get(term.joint).unwrap_or(&n);
        }
        let one =
            (0..n).map(|m| (0..n).map(|j| f64::from(u8::from(m == j))).collect()).collect::<Vec<Vec<f64>>>();
        let robot = Self::tree(
            order.iter().map(|&number| joints[number]).collect(),
            order.iter().map(|&number| mount(number)).collect(),
            gravity,
            &one,
            friction,
        )?;
        let row = |number: usize| {
            let own = || Follower { leaders: vec![(number, 1.0)], offset: 0.0 };
            number.checked_sub(driven).map_or_else(own, |k| followers[k].clone())
        };
        let rows = order.iter().map(|&number| row(number)).collect();
        Ok(robot.following(Followers { rows, numbers: order, driven }))
    }
}

/// Joints in an order in which each branch is whole and each joint stands behind its parent.
fn branch_by_branch(mounts: &[Mount]) -> Result<Vec<usize>, RobotError> {
    let on = |parent: Option<usize>| (0..mounts.len()).rev().filter(move |&j| mounts[j].parent == parent);
    let mut waiting: Vec<usize> = on(None).collect();
    let mut order = Vec::with_capacity(mounts.len());
    while let Some(joint) = waiting.pop() {
        order.push(joint);
        waiting.extend(on(Some(joint)));
    }
    if order.len() == mounts.len() {
        return Ok(order);
    }
    let lost = (0..mounts.len()).find(|j| !order.contains(j)).unwrap_or(0);
    Err(RobotError::Follower { joint: lost + 1, reason: "no joint on the base carries it" })
}
