//! Derivatives of the columns of rotors and friction, for [`super::adjoint`]: of joints, of coupled motors, of further terms.
//!
//! Identity that tests them: those of the inverse model (`adjoint.rs`), and differences of the regressor.

use super::adjoint::Weights;
use crate::ground::arrays::MAX_DOF;
use crate::ground::lanes::{Lanes, Set};
use crate::model::friction::sign;
use crate::model::friction_terms::position_slope;
use crate::model::motion::State;
use crate::robot::friction_terms::{Law, Term};
use crate::robot::parameters::{FRICTION, IA};
use crate::robot::{Coupling, Robot};

/// Slope of [`sign`], the friction of joint `j`.
#[inline(always)]
fn slope<V: Set>(robot: &Robot, j: usize, dq: Lanes<V>) -> Lanes<V> {
    let (smoothing, dead_zone) = (robot.friction().smoothing[j], robot.friction().dead_zone[j]);
    if smoothing <= 0.0 {
        return Lanes::zero();
    }
    let s = dq.scale(1.0 / smoothing).tanh();
    let slope = s.neg_mul_add(s, Lanes::splat(1.0)).scale(1.0 / smoothing);
    if dead_zone > 0.0 { slope.where_above(dq.abs(), Lanes::splat(dead_zone)) } else { slope }
}

/// Derivative of the column of a further term with respect to the speed. Load friction is not a function of the speed alone:
/// the regressor refuses it.
#[inline(always)]
fn term_slope<V: Set>(robot: &Robot, term: &Term, dq: Lanes<V>) -> Lanes<V> {
    let one = Lanes::splat(1.0);
    let (s, steep) = (sign(robot, term.joint, dq), slope(robot, term.joint, dq));
    match &term.law {
        Law::Rest
        | Law::Dahl { .. }
        | Law::Spring
        | Law::Sine
        | Law::Cosine
        | Law::Cylinder(_)
        | Law::CylinderRate(_) => Lanes::zero(),
        Law::Atan { velocity } => {
            let u = dq.scale(1.0 / velocity);
            Lanes::splat(1.0 / velocity) / u.mul_add(u, one)
        }
        Law::Stribeck { velocity } => {
            let u = dq.scale(1.0 / velocity);
            (steep - (s * u).scale(2.0 / velocity)) * (u * u).exp_minus()
        }
        Law::Root => {
            let root = dq.abs().sqrt();
            // At rest the smooth sign is zero, and so is the column.
            let steeper = dq.map(|dq| if dq == 0.0 { 0.0 } else { 0.5 / dq.abs().sqrt().copysign(dq) });
            steep.mul_add(root, s * steeper)
        }
        Law::Forward => one.where_above(dq, Lanes::zero()),
        Law::Load => steep,
        Law::Table(table) => {
            // Central difference: the table is a cubic, so nine digits are right.
            let (first, last) = table.range();
            let h = 1e-6 * (last - first);
            dq.map(|dq| (table.at(dq + h) - table.at(dq - h)) / (2.0 * h))
        }
    }
}

/// Adds the derivatives of the columns of rotors and friction, joints and coupled motors (the table in [`crate::model::friction`]).
#[inline(always)]
pub(super) fn drives<V: Set>(robot: &Robot, state: &State<V>, weights: &Weights<'_>, found: &mut State<V>) {
    let layout = weights.layout;
    for j in 0..robot.n_joints().min(MAX_DOF) {
        let first = layout.joint(j);
        let own = |k: usize| weights.at(j, first + k);
        found.ddq[j] += own(IA);
        let (dq, steep) = (state.dq[j], slope(robot, j, state.dq[j]));
        if robot.friction().asymmetric {
            let (zero, s) = (Lanes::zero(), sign(robot, j, dq));
            let forward = own(FRICTION).where_above(dq, zero);
            let backward = own(FRICTION + 2).where_above(-dq, zero);
            let coulomb = own(FRICTION + 1).where_above(s, zero) + own(FRICTION + 3).where_above(-s, zero);
            found.dq[j] += coulomb.mul_add(steep, forward + backward);
        } else {
            found.dq[j] += own(FRICTION + 1).mul_add(steep, own(FRICTION));
        }
    }
    for (index, term) in robot.friction().terms.iter().enumerate() {
        let weight: Lanes<V> = weights.at(term.joint, layout.term(index));
        let slope = term_slope(robot, term, state.dq[term.joint]);
        found.dq[term.joint] = weight.mul_add(slope, found.dq[term.joint]);
        if term.law.of_position() {
            let slope = position_slope(term, state.q[term.joint]);
            found.q[term.joint] = weight.mul_add(slope, found.q[term.joint]);
        }
    }
    for (index, coupled) in robot.coupled().iter().enumerate() {
        let m = coupled.motor;
        let (rotor, viscous) = (layout.joint(m) + IA, layout.coupled(index));
        let mut speed = state.dq[m];
        for &(i, c) in &coupled.others {
            speed = state.dq[i].mul_add(Lanes::splat(c), speed);
        }
        let (of_shaft, of_joint) = (slope(robot, m, speed), slope(robot, m, state.dq[m]));
        // Derivatives with respect to the shaft's speed and acceleration, then to those of each joint.
        let own_coulomb: Lanes<V> = weights.at(m, viscous + 1);
        let mut shaft_dq = own_coulomb.mul_add(of_shaft, weights.at(m, viscous));
        let mut shaft_ddq: Lanes<V> = weights.at(m, rotor);
        let mut joint_dq = -own_coulomb.mul_add(of_joint, weights.at(m, viscous));
        // The joint's own block has the rotor's `ddq_m` already.
        found.ddq[m] -= shaft_ddq;
        for &(i, c) in &coupled.others {
            let at = |column: usize| weights.at::<V>(i, column).scale(c);
            let (a, v, f) = (at(rotor), at(viscous), at(viscous + 1));
            shaft_dq += v;
            shaft_ddq += a;
            found.dq[i] -= v.scale(c);
            found.ddq[i] -= a.scale(c);
            match robot.friction().coupling {
                Coupling::Shaft => shaft_dq = f.mul_add(of_shaft, shaft_dq),
                Coupling::Printed => joint_dq = f.mul_add(of_joint, joint_dq),
            }
        }
        found.dq[m] += shaft_dq + joint_dq;
        found.ddq[m] += shaft_ddq;
        for &(i, c) in &coupled.others {
            found.dq[i] = shaft_dq.mul_add(Lanes::splat(c), found.dq[i]);
            found.ddq[i] = shaft_ddq.mul_add(Lanes::splat(c), found.ddq[i]);
        }
    }
}
