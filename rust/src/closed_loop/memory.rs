//! Memory of a controller when a run begins: integrators, outputs on their way, positions of its velocity filter.
//!
//! A log rarely begins with the controller: an integrator has wound up against gravity, and a digital controller has torques
//! on their way. Both follow from the first torque. With `tau` that torque and `I` the integral gain of a joint, the law
//! `tau = g (s (P e + D v + I z + A ddq_ref) + tau_ff / g)` gives `z`. Tested in `rust/tests/closed_loop/memory.rs`: a run that is cut in two and
//! resumed from its records has the bits of the whole up to rounding.

use super::control::{Digital, Law};
use super::law::{Instant, law};
use super::reference::Target;
use super::runge_kutta::PerJoint;
use super::sampled::Sampled;
use super::simulation::Simulation;
use crate::ground::arrays::MAX_DOF;
use crate::ground::lanes::{Lanes, Set};
use crate::model::inverse::inverse_dynamics;

/// Where the integrators begin.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Initial<'a> {
    /// At zero.
    #[default]
    Zero,
    /// Where the law gives the torque of gravity and friction at the initial velocity: static balance at rest. Where a torque is fed
    /// forward, which has the inertial part already, that of the acceleration of the reference joins it.
    Balance,
    /// Where the law gives this torque (joint side), one per joint.
    Torque(&'a [f64]),
    /// At these values, one per joint.
    Integrators(&'a [f64]),
}

/// Memory of a controller at time 0.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Memory<'a> {
    /// Integrators.
    pub initial: Initial<'a>,
    /// Torques of a digital controller on their way, `(delay, n)` row-major, the next to act first. By default those of
    /// `initial`: its torque, or zero.
    pub outputs: Option<&'a [f64]>,
    /// Positions that a digital controller has measured before, `(taps, n)` row-major, the newest first. By default the robot has
    /// moved with its initial velocity.
    pub positions: Option<&'a [f64]>,
}

/// The reference at time 0 as the memory of the controller sees it. For a start in balance it is where the robot is, and moves as
/// the robot does, at constant velocity unless a torque is fed forward: no error is a part of the balance.
pub fn aimed_at<V: Set>(simulation: &Simulation<'_>, [q, dq]: [&PerJoint<V>; 2], target: &Target) -> Target {
    let mut seen = *target;
    if simulation.memory.initial == Initial::Balance {
        // All lanes begin in one state.
        for j in 0..simulation.robot.n_dof() {
            (seen.q[j], seen.dq[j]) = (q[j].lane(0), dq[j].lane(0));
        }
        if simulation.controller.feedforward().is_none() {
            seen.ddq = [0.0; MAX_DOF];
        }
    }
    seen
}

/// Torque that the law of every joint is to give first (joint side); None where `initial` leaves it to the integrators.
///
/// `q` and `dq` are the initial state, and `target` is the reference of [`aimed_at`].
pub fn first_torque(
    simulation: &Simulation<'_>,
    [q, dq]: [&[f64]; 2],
    target: &Target,
    x: &[f64],
) -> Option<[f64; MAX_DOF]> {
    let n = simulation.robot.n_dof();
    let mut torque = [0.0; MAX_DOF];
    match simulation.memory.initial {
        Initial::Zero | Initial::Integrators(_) => return None,
        Initial::Torque(given) => torque[..n].copy_from_slice(given),
        Initial::Balance => {
            let mut external = [0.0; MAX_DOF];
            if let Some(signal) = simulation.external {
                signal.at(0.0, &mut external);
            }
            // Lengths have been checked with the candidate.
            let shaped = inverse_dynamics(simulation.robot, q, dq, &target.ddq[..n], x, &mut torque[..n]);
            debug_assert!(shaped.is_ok());
            for (torque, external) in torque.iter_mut().zip(external) {
                *torque -= external;
            }
        }
    }
    Some(torque)
}

/// Integrator with which the law of joint `j` gives a torque; zero where the law does not integrate. Beyond the saturation
/// the integrator of the limit is taken.
#[inline(always)]
pub fn integrator_for<V: Set>(
    one: &Law,
    instant: &Instant<'_, V>,
    j: usize,
    q: Lanes<V>,
    dq: Lanes<V>,
    torque: Lanes<V>,
) -> Lanes<V> {
    if one.integral == 0.0 {
        return Lanes::zero();
    }
    let free = Law { limit: f64::INFINITY, ..*one };
    let (without, _) = law(&free, instant, j, q, dq, Lanes::zero());
    let (wanted, without, scale) = (torque.to_array(), without.to_array(), instant.scale[j].to_array());
    let most = one.limit * one.gain.abs();
    let begin = |l: usize| {
        let per_unit = scale[l] * one.gain * one.integral;
        // A law whose gains are scaled to zero has nothing to remember.
        if per_unit == 0.0 { 0.0 } else { (wanted[l].clamp(-most, most) - without[l]) / per_unit }
    };
    Lanes::each(begin)
}

impl<V: Set> Sampled<V> {
    /// Fills the memory of a digital controller before its first sample, which sees the positions `q`.
    pub fn remember(
        &mut self,
        laws: &[Law],
        digital: &Digital,
        memory: &Memory<'_>,
        instant: &Instant<'_, V>,
        q: &PerJoint<V>,
        first: Option<&PerJoint<V>>,
    ) {
        let n = laws.len();
        if let Some(positions) = memory.positions {
            for (row, given) in self.history.iter_mut().zip(positions.chunks_exact(n)) {
                for (value, &position) in row.iter_mut().zip(given) {
                    *value = Lanes::splat(position);
                }
            }
        }
        for (j, one) in laws.iter().enumerate() {
            match (memory.initial, first) {
                (_, Some(torque)) => {
                    let measured = digital.measured(j, q[j]);
                    let velocity = self.velocity_after(j, measured);
                    self.z[j] = integrator_for(one, instant, j, measured, velocity, torque[j]);
                }
                (Initial::Integrators(given), None) => self.z[j] = Lanes::splat(given[j]),
                _ => {}
            }
        }
        for k in 0..digital.delay {
            // The first to act is the last of the queue.
            let place = digital.delay - 1 - k;
            for (j, one) in laws.iter().enumerate() {
                if let Some(outputs) = memory.outputs {
                    self.queue[place][j] = Lanes::splat(outputs[k * n + j]);
                } else if let Some(torque) = first {
                    let most = one.limit * one.gain.abs();
                    self.queue[place][j] = torque[j].map(|value| value.clamp(-most, most));
                }
            }
        }
    }
}
