//! Position servos, `tau = sat(kp (r - q) - kv dq)`, whose gains, limits, references and initial states differ between candidates.
//!
//! A reference that is held from sample to sample enters each step as its mean over that step. Where a jump ends a step this is exact. A
//! jump within a step of length `h`, that of a candidate with another delay, keeps its impulse and misses the position at the end of the
//! step by at most `h^2/8` times the acceleration of the jump.
//!
//! Coulomb friction may be soft, as `MuJoCo`'s `frictionloss` is: `-k (ddq + b dq)` between `-Fc` and `Fc`, whose slope `k` has the unit of an
//! inertia and whose rate `b` that of a frequency. It depends on the acceleration, so that `(M + k) ddq = tau - N - k b dq` where a joint
//! sticks; which joints do is found by Newton's method, for the friction is the gradient of a convex function of `ddq`. A simulator that takes
//! velocities at the end of its step adds to the inertia, but not while a servo saturates: so a lead `l` (s) adds `l kv` there. Tested in
//! `rust/tests/closed_loop/servo.rs`: against the law of `control.rs`, jumps within steps against steps that end on them, and a joint that
//! sticks against its closed form.

use super::additive::solve;
use super::runge_kutta::PerJoint;
use super::schedule::Schedule;
use super::simulation::{Candidate, SimulationError};
use crate::ground::arrays::MAX_DOF;
use crate::ground::lanes::{Lanes, Set};
use crate::model::direct::Direct;
use crate::model::links::Links;
use crate::robot::arm::{Any, Arm, Square, for_joints};

/// Number of values per joint in the row of a candidate: gains, limit, shift of the reference, initial position and velocity, slope and rate of
/// its friction, and lead.
const NUMBERS: usize = 9;
/// Largest number of Newton steps of soft friction: a few are usual.
const MOST: usize = 16;

/// What position servos follow: means of held references over the steps of a schedule.
#[derive(Debug, Clone)]
pub struct Servos<'a> {
    n: usize,
    edges: Vec<f64>,
    targets: &'a [f64],
}

impl<'a> Servos<'a> {
    /// `targets` is `(references, steps, n)` row-major, with the steps of the schedule.
    pub fn new(n: usize, schedule: &Schedule, targets: &'a [f64]) -> Result<Self, SimulationError> {
        let edges = schedule.edges();
        let size = (edges.len() - 1) * n;
        if targets.is_empty() || !targets.len().is_multiple_of(size) {
            return Err(SimulationError::Length {
                what: "the reference of the servos",
                want: size,
                got: targets.len(),
            });
        }
        Ok(Self { n, edges, targets })
    }

    /// Numbers in the row of a candidate: `kp`, `kv`, limit of the torque, shift of the reference, initial position and velocity, slope and
    /// rate of the friction and lead of the joints, each `n`, then the number of its reference. Friction is that of the robot where all
    /// slopes are 0.
    pub fn width(&self) -> usize {
        NUMBERS * self.n + 1
    }

    fn size(&self) -> usize {
        (self.edges.len() - 1) * self.n
    }

    /// The reference of a row, from 0; None if there is none of that number.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a number that is none fails the comparison
    pub(super) fn reference(&self, row: &[f64]) -> Option<&'a [f64]> {
        let number = row[NUMBERS * self.n].max(0.0) as usize;
        self.targets.get(number * self.size()..(number + 1) * self.size())
    }
}

/// The servos of the candidates of one group of lanes.
#[derive(Debug)]
pub(super) struct ServoLanes<'a, V: Set> {
    servos: &'a Servos<'a>,
    /// `kp`, `kv`, limit and shift.
    law: [PerJoint<V>; 4],
    references: V::Of<&'a [f64]>,
    /// Means over the step, shift taken off.
    target: PerJoint<V>,
    step: usize,
    /// Step that `target` holds for.
    held: usize,
    /// Friction in the place of the robot's Coulomb friction, and inertia while servos saturate.
    pub(super) soft: Option<Soft<V>>,
}

impl<'a, V: Set> ServoLanes<'a, V> {
    /// Servos of the candidates, whose rows have been checked; their initial positions and velocities go to `q` and `dq`, and soft friction
    /// takes the coefficients of the Coulomb friction from `links`.
    #[cold]
    pub(super) fn new(
        servos: &'a Servos<'a>,
        candidates: &[Candidate<'a>],
        q: &mut PerJoint<V>,
        dq: &mut PerJoint<V>,
        links: &mut Links<V>,
    ) -> Self {
        let n = servos.n;
        let row = |l: usize| candidates[l.min(candidates.len() - 1)].scale;
        let lanes = |part: usize| {
            let mut found = [Lanes::zero(); MAX_DOF];
            for (j, lanes) in found.iter_mut().enumerate().take(n) {
                *lanes = Lanes::each(|l| row(l)[part * n + j]);
            }
            found
        };
        (*q, *dq) = (lanes(4), lanes(5));
        let [slope, rate, lead] = [6, 7, 8].map(lanes);
        let any = |lanes: &PerJoint<V>| lanes[..n].iter().any(|&one| (0..V::L).any(|l| one.lane(l) != 0.0));
        let zero = [Lanes::zero(); MAX_DOF];
        let coulomb = if any(&slope) { std::mem::replace(&mut links.friction[1], zero) } else { zero };
        let mut added = zero;
        for j in 0..n {
            added[j] = lead[j] * lanes(1)[j];
        }
        let soft = (any(&slope) || any(&lead)).then_some(Soft {
            coulomb,
            slope,
            rate,
            added,
            beyond: zero,
            sticks: zero,
            last: *dq,
            free: zero,
            change: zero,
            matrix: Square::filled(Lanes::zero(), n),
        });
        Self {
            servos,
            law: [lanes(0), lanes(1), lanes(2), lanes(3)],
            references: V::of(|l| servos.reference(row(l)).unwrap_or(&[])),
            target: [Lanes::zero(); MAX_DOF],
            step: 0,
            held: usize::MAX,
            soft,
        }
    }

    /// Torques at a time within a step.
    #[inline(always)]
    pub(super) fn torques(&mut self, t: f64, q: &PerJoint<V>, dq: &PerJoint<V>, tau: &mut PerJoint<V>) {
        let Servos { n, edges, .. } = self.servos;
        while self.step + 2 < edges.len() && t >= edges[self.step + 1] {
            self.step += 1;
        }
        let [kp, kv, limit, shift] = &self.law;
        if self.held != self.step {
            self.held = self.step;
            for j in 0..*n {
                let place = self.step * n + j;
                self.target[j] = Lanes::each(|l| self.references[l][place]) - shift[j];
            }
        }
        for j in 0..*n {
            let u = (self.target[j] - q[j]) * kp[j] - dq[j] * kv[j];
            tau[j] = u.max(-limit[j]).min(limit[j]);
            if let Some(soft) = &mut self.soft {
                soft.beyond[j] = Lanes::splat(1.0).where_above(u.abs(), limit[j]);
            }
        }
    }
}

/// Friction that is soft where a joint sticks, and inertia where its servo saturates.
#[derive(Debug)]
pub(super) struct Soft<V: Set> {
    coulomb: PerJoint<V>,
    slope: PerJoint<V>,
    rate: PerJoint<V>,
    /// Inertia that a saturated servo adds, and 1 where one is.
    added: PerJoint<V>,
    beyond: PerJoint<V>,
    /// 1 where a joint sticks, and the torque that it would stick by, as they were last.
    sticks: PerJoint<V>,
    last: PerJoint<V>,
    /// Memory for velocities over the time of the friction, with the accelerations at hand, and for what changes these.
    free: PerJoint<V>,
    change: PerJoint<V>,
    /// Memory for the matrix of a Newton step.
    matrix: <Any as Arm>::Square<Lanes<V>>,
}

impl<V: Set> Soft<V> {
    /// Adds to the accelerations at hand what friction and added inertia make of them at velocities `dq`.
    #[inline(always)]
    pub(super) fn hold<S: Arm>(&mut self, n: usize, dq: &PerJoint<V>, direct: &mut Direct<V, S>) {
        let one = Lanes::splat(1.0);
        let Self { coulomb, slope, rate, added, beyond, sticks, last, free, change, matrix } = self;
        for_joints!(j in n => free[j] = rate[j].mul_add(dq[j], direct.ddq[j]));
        for _ in 0..MOST {
            direct.inertia(n, matrix);
            for_joints!(j in n => {
                let within = slope[j] * sticks[j];
                let heavier = added[j] * beyond[j];
                let friction = within.mul_add(free[j], (one - sticks[j]) * coulomb[j].copysign(last[j]));
                change[j] = heavier.mul_add(direct.ddq[j], friction);
                matrix[j][j] += within + heavier;
            });
            solve(n, matrix, change);
            let mut turned = Lanes::zero();
            for_joints!(j in n => {
                let felt = slope[j] * (free[j] + change[j]);
                let within = one.where_above(coulomb[j], felt.abs());
                // A joint that would slide the other way sticks first: from one slope of zero to the other Newton's method cycles.
                let opposed = (one - sticks[j]) * one.where_above(Lanes::zero(), felt * last[j]);
                let within = within.max(opposed);
                turned = turned.max((within - sticks[j]).abs());
                (sticks[j], last[j]) = (within, felt);
            });
            if (one - turned).all_above(0.5) {
                break;
            }
        }
        for_joints!(j in n => direct.ddq[j] += change[j]);
    }
}
