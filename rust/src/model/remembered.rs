//! Friction that remembers: Dahl's state, and the sign of the last motion, a lane each, exact in displacement.
//!
//! Between two reversals `z = s - (s - z_0) exp(-abs(q - q_0) / h)` with `s` the sign of the motion (Dahl, 1968). A sign that is kept
//! through rest is such a state with a displacement below that of any presliding, in the place of the sign of the speed. The states of
//! a stage follow from the start of its step; they move on with the step itself. Tested in `rust/tests/closed_loop/remembered.rs`.

use crate::ground::arrays::MAX_DOF;
use crate::ground::lanes::{Lanes, Set};
use crate::model::friction::sign;
use crate::model::links::Links;
use crate::robot::Robot;
use crate::robot::friction_terms::Law;

/// One number per joint, on lanes.
type PerJoint<V> = [Lanes<V>; MAX_DOF];

/// Distance of a state from the sign of the motion below which it is that sign: rounding.
const BUILT: f64 = 1e-15;

/// States of one kind, one a joint at most.
#[derive(Debug, Clone, Copy)]
struct States<V: Set> {
    /// Joint, number of the term, reciprocal of the width.
    of: [(usize, usize, f64); MAX_DOF],
    count: usize,
    /// Positions and states at the start of a step.
    origin: PerJoint<V>,
    start: PerJoint<V>,
    /// States at the stage at hand.
    z: PerJoint<V>,
}

impl<V: Set> States<V> {
    fn none() -> Self {
        let zero = [Lanes::zero(); MAX_DOF];
        Self { of: [(0, 0, 0.0); MAX_DOF], count: 0, origin: zero, start: zero, z: zero }
    }

    fn push(&mut self, joint: usize, term: usize, width: f64, q: Lanes<V>, z: Lanes<V>) {
        let k = self.count;
        self.of[k] = (joint, term, 1.0 / width);
        (self.origin[k], self.start[k], self.z[k]) = (q, z, z);
        self.count += 1;
    }

    #[inline(always)]
    fn follow(&mut self, q: &PerJoint<V>, first: bool) {
        for (k, &(j, _, steepness)) in self.of[..self.count].iter().enumerate() {
            let way = q[j] - self.origin[k];
            let sign = Lanes::splat(1.0).copysign(way);
            let gap = sign - self.start[k];
            // Where a joint slides on nothing is left to fade: most of the time there is no exponential to compute.
            let built = Lanes::splat(BUILT) - gap.abs();
            let z = if built.all_above(0.0) {
                sign
            } else {
                let faded = sign - gap * way.abs().scale(steepness).exp_minus();
                sign.or_where_not_above(faded, built)
            };
            self.z[k] = z;
            if first {
                (self.origin[k], self.start[k]) = (q[j], z);
            }
        }
    }
}

/// The states of a robot.
#[derive(Debug, Clone, Copy)]
pub struct Remembered<V: Set> {
    dahl: States<V>,
    held: States<V>,
    asymmetric: bool,
}

impl<V: Set> Remembered<V> {
    /// States that joints have that came from afar: the signs of their speeds. None where no friction of the robot remembers.
    pub fn of(robot: &Robot, q: &PerJoint<V>, dq: &PerJoint<V>) -> Option<Self> {
        let friction = robot.friction();
        let mut this = Self { dahl: States::none(), held: States::none(), asymmetric: friction.asymmetric };
        for (index, term) in friction.terms.iter().enumerate() {
            if let Law::Dahl { width } = term.law
                && this.dahl.count < MAX_DOF
            {
                this.dahl.push(
                    term.joint,
                    index,
                    width,
                    q[term.joint],
                    sign(robot, term.joint, dq[term.joint]),
                );
            }
        }
        for (j, &width) in friction.held.iter().enumerate() {
            if width > 0.0 {
                this.held.push(j, 0, width, q[j], sign(robot, j, dq[j]));
            }
        }
        friction.remembers().then_some(this)
    }

    /// Moves the states on to the positions of a stage; `first` where the step starts there.
    #[inline(always)]
    pub fn follow(&mut self, q: &PerJoint<V>, first: bool) {
        self.dahl.follow(q, first);
        self.held.follow(q, first);
    }

    /// Puts the signs that are kept in the place of those of the speeds, whose Coulomb friction is in `tau`, and adds Dahl's torques.
    #[inline(always)]
    pub fn rub(&self, links: &Links<V>, signs: &mut PerJoint<V>, tau: &mut PerJoint<V>) {
        let [_, b, _, d] = &links.friction;
        let zero = Lanes::zero();
        for (&(j, ..), &z) in self.held.of[..self.held.count].iter().zip(&self.held.z) {
            let s = std::mem::replace(&mut signs[j], z);
            tau[j] = if self.asymmetric {
                let forward = (z.max(zero) - s.max(zero)).mul_add(b[j], tau[j]);
                (z.min(zero) - s.min(zero)).mul_add(d[j], forward)
            } else {
                (z - s).mul_add(b[j], tau[j])
            };
        }
        for (&(j, index, _), &z) in self.dahl.of[..self.dahl.count].iter().zip(&self.dahl.z) {
            tau[j] = links.terms[index].mul_add(z, tau[j]);
        }
    }
}
