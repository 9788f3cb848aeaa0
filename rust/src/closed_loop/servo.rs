//! Position servos, `tau = sat(kp (r - q) - kv dq)`, whose gains, limits, references and initial states differ between candidates.
//!
//! A reference that is held from sample to sample enters each step as its mean over that step. Where a jump ends a step this is exact. A
//! jump within a step of length `h`, that of a candidate with another delay, keeps its impulse and misses the position at the end of the
//! step by at most `h^2/8` times the acceleration of the jump. Tested in `rust/tests/closed_loop/servo.rs`: against the law of
//! `control.rs`, and jumps within steps against steps that end on them.

use super::runge_kutta::PerJoint;
use super::schedule::Schedule;
use super::simulation::{Candidate, SimulationError};
use crate::ground::arrays::MAX_DOF;
use crate::ground::lanes::{Lanes, Set};

/// Number of values per joint in the row of a candidate: gains, limit, shift of the reference, initial position and velocity.
const NUMBERS: usize = 6;

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

    /// Numbers in the row of a candidate: `kp`, `kv`, limit of the torque, shift of the reference, initial position and velocity of the
    /// joints, each `n`, then the number of its reference.
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
}

impl<'a, V: Set> ServoLanes<'a, V> {
    /// Servos of the candidates, whose rows have been checked; their initial positions and velocities go to `q` and `dq`.
    #[cold]
    pub(super) fn new(
        servos: &'a Servos<'a>,
        candidates: &[Candidate<'a>],
        q: &mut PerJoint<V>,
        dq: &mut PerJoint<V>,
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
        Self {
            servos,
            law: [lanes(0), lanes(1), lanes(2), lanes(3)],
            references: V::of(|l| servos.reference(row(l)).unwrap_or(&[])),
            target: [Lanes::zero(); MAX_DOF],
            step: 0,
            held: usize::MAX,
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
        }
    }
}
