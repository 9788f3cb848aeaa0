//! A digital controller at work: measured positions, outputs on their way, integrators.

use super::control::{Digital, Law};
use super::law::{Instant, law};
use crate::ground::arrays::MAX_DOF;
use crate::ground::lanes::{Lanes, Set};

/// Memory of a digital controller on lanes.
#[derive(Debug, Clone)]
pub struct Sampled<V: Set> {
    /// Measured positions, newest first.
    pub(super) history: Vec<[Lanes<V>; MAX_DOF]>,
    /// Outputs on their way, newest first.
    pub(super) queue: Vec<[Lanes<V>; MAX_DOF]>,
    /// Integrators.
    pub(super) z: [Lanes<V>; MAX_DOF],
    differences: Vec<f64>,
}

impl<V: Set> Sampled<V> {
    /// Before the first sample: the robot has moved with its initial velocity so far, and the outputs were zero.
    pub fn start(digital: &Digital, q: &[Lanes<V>; MAX_DOF], dq: &[Lanes<V>; MAX_DOF]) -> Self {
        let taps = digital.smoothing.len();
        let before = |k: usize| std::array::from_fn(|j| q[j] - dq[j].scale(digital.period * k as f64));
        let weight = |k: usize| digital.smoothing.get(k).copied().unwrap_or(0.0);
        Self {
            // The first sample pushes all of them one place back.
            history: (1..=taps + 1).map(before).collect(),
            queue: vec![[Lanes::zero(); MAX_DOF]; digital.delay + 1],
            z: [Lanes::zero(); MAX_DOF],
            differences: (0..=taps)
                .map(|k| (weight(k) - if k > 0 { weight(k - 1) } else { 0.0 }) / digital.period)
                .collect(),
        }
    }

    /// Velocity of joint `j` that the next sample sees, once it has measured a position.
    pub fn velocity_after(&self, j: usize, measured: Lanes<V>) -> Lanes<V> {
        let mut velocity = measured.mul_add(Lanes::splat(self.differences[0]), Lanes::zero());
        for (difference, positions) in self.differences[1..].iter().zip(&self.history) {
            velocity = positions[j].mul_add(Lanes::splat(*difference), velocity);
        }
        velocity
    }

    /// Velocity of joint `j` as the last sample saw it.
    #[inline(always)]
    fn velocity(&self, j: usize) -> Lanes<V> {
        let mut velocity = Lanes::zero();
        for (difference, positions) in self.differences.iter().zip(&self.history) {
            velocity = positions[j].mul_add(Lanes::splat(*difference), velocity);
        }
        velocity
    }

    /// One sample: takes the positions, and returns the torques that act until the next.
    #[inline(always)]
    pub fn step(
        &mut self,
        laws: &[Law],
        digital: &Digital,
        instant: &Instant<'_, V>,
        q: &[Lanes<V>; MAX_DOF],
    ) -> [Lanes<V>; MAX_DOF] {
        self.history.rotate_right(1);
        self.queue.rotate_right(1);
        for (j, one) in laws.iter().enumerate() {
            let measured = digital.measured(j, q[j]);
            self.history[0][j] = measured;
            let velocity = self.velocity(j);
            let (torque, dz) = law(one, instant, j, measured, velocity, self.z[j]);
            self.z[j] = dz.mul_add(Lanes::splat(digital.period), self.z[j]);
            self.queue[0][j] = torque;
        }
        self.queue[digital.delay]
    }
}
