//! Friction that remembers in a closed loop: Dahl's state, a lane each, exact in displacement and so never stiff.
//!
//! Between two reversals `z = s - (s - z_0) exp(-abs(q - q_0) / h)` with `s` the sign of the motion (Dahl, 1968). The states of a stage
//! follow from the start of its step; they move on with the step itself. Tested in `rust/tests/closed_loop/remembered.rs`.

use super::runge_kutta::PerJoint;
use crate::ground::arrays::MAX_DOF;
use crate::ground::lanes::{Lanes, Set};
use crate::model::links::Links;
use crate::robot::Robot;
use crate::robot::friction_terms::Law;

/// Joints that remember: each with the term and the reciprocal of its width.
#[derive(Debug, Clone, Copy)]
pub struct Remembered<V: Set> {
    terms: [(usize, usize, f64); MAX_DOF],
    count: usize,
    /// Positions and states at the start of a step, term by term.
    origin: PerJoint<V>,
    start: PerJoint<V>,
}

impl<V: Set> Remembered<V> {
    /// At rest, with nothing to remember; None where no friction of the robot does.
    pub fn of(robot: &Robot, q: &PerJoint<V>) -> Option<Self> {
        let mut terms = [(0, 0, 0.0); MAX_DOF];
        let (mut count, mut origin) = (0, *q);
        for (index, term) in robot.friction().terms.iter().enumerate() {
            if let Law::Dahl { width } = term.law
                && count < MAX_DOF
            {
                origin[count] = q[term.joint];
                terms[count] = (index, term.joint, 1.0 / width);
                count += 1;
            }
        }
        (count > 0).then_some(Self { terms, count, origin, start: [Lanes::zero(); MAX_DOF] })
    }

    /// Torques of the drives less those of the memory, at positions of a stage; `first` where the step starts there.
    #[inline(always)]
    pub fn felt(&mut self, links: &Links<V>, q: &PerJoint<V>, tau: &PerJoint<V>, first: bool) -> PerJoint<V> {
        let mut felt = *tau;
        for (k, &(index, j, steepness)) in self.terms[..self.count].iter().enumerate() {
            let way = q[j] - self.origin[k];
            let sign = Lanes::splat(1.0).copysign(way);
            let fades = way.abs().scale(steepness).exp_minus();
            let z = sign - (sign - self.start[k]) * fades;
            if first {
                (self.origin[k], self.start[k]) = (q[j], z);
            }
            felt[j] = links.terms[index].neg_mul_add(z, felt[j]);
        }
        felt
    }
}
