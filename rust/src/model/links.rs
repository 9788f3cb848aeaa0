//! The parameters of a candidate as the kernels use them: bodies, friction and rotors, joint by joint.
//!
//! Particles on the axis of a revolute joint move with the link before, so `Szz`, `MZ` and `M` regroup into that link:
//! the base parameters of a link are the other seven, and torques do not change (tested below against the
//! regressor, which knows nothing of it). After that, only sliding links and those that carry them have a mass.

use super::bodies::Body;
use crate::ground::arrays::MAX_DOF;
use crate::ground::lanes::{Lanes, Set};
use crate::robot::Robot;
use crate::robot::arm::{Arm, At, Square, by_twist};
use crate::robot::friction_terms::MAX_TERMS;
use crate::robot::geometry::{Frames, Geometry};
use crate::robot::parameters::{FRICTION, IA, Layout};

/// The parameters of a candidate as the kernels use them.
#[derive(Debug, Clone, Copy)]
pub struct Links<V: Set> {
    /// Links, regrouped.
    pub bodies: [Body<V>; MAX_DOF],
    /// The friction parameters, each of all joints.
    pub friction: [[Lanes<V>; MAX_DOF]; 4],
    /// `Fvm Fcm` of each coupled motor.
    pub coupled: [[Lanes<V>; 2]; MAX_DOF],
    /// Parameters of the further terms of friction.
    pub terms: [Lanes<V>; MAX_TERMS],
    /// Inertias of the rotors, `Ia`.
    pub ia: [Lanes<V>; MAX_DOF],
}

impl<V: Set> Links<V> {
    /// From standard parameters.
    #[inline(always)]
    pub fn of<S: Arm>(robot: &Robot, geometry: &Geometry<S>, x: &[Lanes<V>]) -> Self {
        let layout = Layout::of(robot);
        let zero = Lanes::zero();
        let mut links = Self {
            bodies: [Body::none(); MAX_DOF],
            friction: [[zero; MAX_DOF]; 4],
            coupled: [[zero; 2]; MAX_DOF],
            terms: [zero; MAX_TERMS],
            ia: [zero; MAX_DOF],
        };
        for j in 0..geometry.n() {
            let block = &x[layout.joint(j)..layout.joint(j) + layout.per_joint()];
            links.bodies[j] = Body::of_link(block);
            for (parameters, &value) in links.friction.iter_mut().zip(&block[FRICTION..]) {
                parameters[j] = value;
            }
            links.ia[j] = block[IA];
        }
        for (parameter, &value) in links.terms.iter_mut().zip(&x[layout.term(0)..]) {
            *parameter = value;
        }
        for index in 0..robot.coupled().len() {
            let at = layout.coupled(index);
            links.coupled[index] = [x[at], x[at + 1]];
        }
        links.regroup(geometry);
        links
    }

    /// Contribution of the rotors to the inertia matrix: `Ia`, and the terms of coupled motors off the diagonal (24).
    #[inline(always)]
    pub fn rotors<M: Square<Lanes<V>>>(&self, robot: &Robot) -> M {
        let mut rotors = M::filled(Lanes::zero(), robot.n_joints());
        for j in 0..robot.n_joints().min(MAX_DOF) {
            rotors[j][j] = self.ia[j];
        }
        for coupled in robot.coupled() {
            let (m, ia) = (coupled.motor, self.ia[coupled.motor]);
            for (k, &(i, c)) in coupled.others.iter().enumerate() {
                rotors[m.max(i)][m.min(i)] += ia.scale(c);
                for &(other, factor) in &coupled.others[..k] {
                    rotors[other.max(i)][other.min(i)] += ia.scale(c * factor);
                }
            }
        }
        rotors
    }

    /// From plain standard parameters, the same in each lane.
    #[inline(always)]
    pub fn of_one<S: Arm>(robot: &Robot, geometry: &Geometry<S>, x: &[f64]) -> Self {
        let x: Vec<Lanes<V>> = x.iter().map(|&value| Lanes::splat(value)).collect();
        Self::of(robot, geometry, &x)
    }

    #[inline(always)]
    fn regroup<S: Arm>(&mut self, geometry: &Geometry<S>) {
        let frames = Frames::<V>::new(geometry);
        for j in (0..geometry.n()).rev() {
            let step = &geometry.step(At(j));
            if !step.form.turns {
                continue;
            }
            let axis = self.bodies[j].take_axis();
            if !step.form.root {
                // A turn about the axis changes nothing on it: any angle will do.
                let (s, c, t) = (Lanes::zero(), Lanes::splat(1.0), &frames.shift[j]);
                let moved = by_twist!(step, T => axis.unstepped::<T>(step, s, c, t, true));
                let parent = step.before(At(j));
                self.bodies[parent] = self.bodies[parent].with(&moved);
            }
        }
    }
}
