//! The classical Runge-Kutta method for positions, velocities and integrators, with the sums of velocities written out:
//!
//! `q <- q + h dq + h^2/6 (a1 + a2 + a3)`, `dq <- dq + h/6 (a1 + 2 a2 + 2 a3 + a4)`.

use crate::ground::arrays::MAX_DOF;
use crate::ground::lanes::{Lanes, Set};
use crate::robot::arm::for_joints;

/// One number per joint, on lanes.
pub type PerJoint<V> = [Lanes<V>; MAX_DOF];

/// State of a simulation.
#[derive(Debug, Clone, Copy)]
#[repr(align(32))] // as `Vector`
pub struct Point<V: Set> {
    /// Positions.
    pub q: PerJoint<V>,
    /// Velocities.
    pub dq: PerJoint<V>,
    /// Integrators of the controller.
    pub z: PerJoint<V>,
}

/// One step: where the next evaluation is due, where the step started, and the sums so far.
#[derive(Debug, Clone, Copy)]
pub struct Stages<V: Set> {
    /// State at which the model is evaluated next.
    pub here: Point<V>,
    start: Point<V>,
    /// Sum of the first three accelerations.
    first_three: PerJoint<V>,
    /// Sums weighted 1 2 2 1.
    weighted: PerJoint<V>,
    weighted_z: PerJoint<V>,
    /// Does a controller integrate?
    integrates: bool,
}

impl<V: Set> Stages<V> {
    /// At rest at zero.
    #[inline(always)]
    pub fn new(integrates: bool) -> Self {
        let zero = [Lanes::zero(); MAX_DOF];
        let point = Point { q: zero, dq: zero, z: zero };
        Self { here: point, start: point, first_three: zero, weighted: zero, weighted_z: zero, integrates }
    }

    /// Time of a stage; those at the ends lie just inside the step, so that a jump of the reference's acceleration there is seen
    /// from within.
    #[inline(always)]
    pub fn time(stage: usize, t: f64, h: f64) -> f64 {
        t + h * [1e-9, 0.5, 0.5, 1.0 - 1e-9][stage]
    }

    /// Takes the derivatives at a stage and moves on to the next, or to the end of the step.
    #[inline(always)]
    pub fn advance(&mut self, n: usize, stage: usize, h: f64, ddq: &PerJoint<V>, dz: &PerJoint<V>) {
        let Self { here, start, first_three, weighted, weighted_z, .. } = self;
        if stage == 3 {
            let (whole, sixth, square) = (Lanes::splat(h), Lanes::splat(h / 6.0), Lanes::splat(h * h / 6.0));
            for_joints!(j in n => {
                let way = whole.mul_add(start.dq[j], start.q[j]);
                here.q[j] = square.mul_add(first_three[j], way);
                here.dq[j] = sixth.mul_add(weighted[j] + ddq[j], start.dq[j]);
            });
            if self.integrates {
                for j in 0..n {
                    here.z[j] = sixth.mul_add(weighted_z[j] + dz[j], start.z[j]);
                }
            }
            return;
        }
        let way = Lanes::splat(h * [0.5, 0.5, 1.0][stage]);
        if stage == 0 {
            for_joints!(j in n => {
                (start.q[j], start.dq[j]) = (here.q[j], here.dq[j]);
                (first_three[j], weighted[j]) = (ddq[j], ddq[j]);
                // The velocity of this stage carries the position to the next.
                here.q[j] = way.mul_add(here.dq[j], here.q[j]);
                here.dq[j] = way.mul_add(ddq[j], here.dq[j]);
            });
        } else {
            for_joints!(j in n => {
                first_three[j] += ddq[j];
                weighted[j] += ddq[j] + ddq[j];
                here.q[j] = way.mul_add(here.dq[j], start.q[j]);
                here.dq[j] = way.mul_add(ddq[j], start.dq[j]);
            });
        }
        if self.integrates {
            for j in 0..n {
                if stage == 0 {
                    (start.z[j], weighted_z[j]) = (here.z[j], dz[j]);
                } else {
                    weighted_z[j] += dz[j] + dz[j];
                }
                here.z[j] = way.mul_add(dz[j], start.z[j]);
            }
        }
    }
}
