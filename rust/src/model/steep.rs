//! The steep part of friction: Coulomb friction of joints and coupled motors as `tanh`, whose slope at reversals is `Fc / v`, and viscous
//! friction of both, which is steep where a light link has a strong gear.
//!
//! It is the gradient of a convex function of the velocities: coefficients that are negative, which no robot has, count as zero.
//! Of friction that falls with speed (Stribeck) the level at rest belongs to it, so that what is left of friction is not steep.
//! Tested in `rust/tests/closed_loop/additive.rs`, and here: its torques are those of the model, its matrix their slopes.

use super::links::Links;
use crate::ground::arrays::MAX_DOF;
use crate::ground::lanes::{Lanes, Set};
use crate::robot::arm::{Square, for_joints};
use crate::robot::friction_terms::Law;
use crate::robot::parameters::Layout;
use crate::robot::{CoupledMotor, Coupling, Robot};

/// One number per joint, on lanes.
type PerJoint<V> = [Lanes<V>; MAX_DOF];

/// Coulomb and viscous friction of candidates.
#[derive(Debug, Clone, Copy)]
pub struct Steep<'a, V: Set> {
    /// Coulomb (N.m or N) and viscous (N.m.s/rad or N.s/m) coefficients of the joints, forwards and backwards.
    coulomb: [PerJoint<V>; 2],
    viscous: [PerJoint<V>; 2],
    /// Reciprocals of the smoothing velocities.
    pub steepness: [f64; MAX_DOF],
    coupled: &'a [CoupledMotor],
    /// Viscous and Coulomb coefficients of the coupled motors.
    shafts: [PerJoint<V>; 2],
}

/// Why a robot's friction has no such part, or another one than [`Steep`] takes; None where it has it.
pub fn unfit(robot: &Robot) -> Option<&'static str> {
    let friction = robot.friction();
    if friction.smoothing.iter().any(|&velocity| velocity <= 0.0) {
        return Some("it needs friction as tanh at every joint");
    }
    if friction.dead_zone.iter().any(|&zone| zone > 0.0) {
        return Some("it takes no dead zone of friction");
    }
    if friction.held.iter().any(|&width| width > 0.0) {
        return Some("it takes no sign of friction that is kept through rest");
    }
    if friction.has_load() {
        return Some("it takes no friction that depends on the load");
    }
    if friction.coupling == Coupling::Printed && !robot.coupled().is_empty() {
        return Some(
            "it takes coupled motors that rub with the speed of their shafts alone (coupling = \"shaft\")",
        );
    }
    None
}

impl<'a, V: Set> Steep<'a, V> {
    /// Of a robot that is not [`unfit`], with the parameters of `links`.
    #[inline(always)]
    pub fn of(robot: &'a Robot, links: &Links<V>) -> Self {
        let nothing = Lanes::zero();
        let friction = robot.friction();
        let [slow, dry, slow_back, dry_back] = &links.friction;
        let [slow_back, dry_back] = if friction.asymmetric { [slow_back, dry_back] } else { [slow, dry] };
        let (mut coulomb, mut viscous) = ([*dry, *dry_back], [*slow, *slow_back]);
        for (term, &parameter) in friction.terms.iter().zip(&links.terms) {
            if let Law::Stribeck { .. } = term.law {
                for direction in &mut coulomb {
                    direction[term.joint] += parameter;
                }
            }
        }
        let mut shafts = [[nothing; MAX_DOF]; 2];
        for (index, coupled) in robot.coupled().iter().enumerate() {
            // The motor rubs with the speed of its shaft in the place of those of the joints whose coefficients contain it.
            let [slow, dry] = links.coupled[index].map(|coefficient| coefficient.max(nothing));
            (shafts[0][index], shafts[1][index]) = (slow, dry);
            for direction in 0..2 {
                coulomb[direction][coupled.motor] -= dry;
                viscous[direction][coupled.motor] -= slow;
                for &(i, c) in &coupled.others {
                    viscous[direction][i] = slow.neg_mul_add(Lanes::splat(c * c), viscous[direction][i]);
                }
            }
        }
        let mut steepness = [0.0; MAX_DOF];
        for (j, velocity) in friction.smoothing.iter().enumerate() {
            steepness[j] = 1.0 / velocity;
            for direction in coulomb.iter_mut().chain(&mut viscous) {
                direction[j] = direction[j].max(nothing);
            }
        }
        if let Some(followers) = robot.followers() {
            // Where a joint has one leader, its friction is that of the leader; of several the rest of the step takes it.
            let (mut dry, mut slow, mut steep) =
                ([[nothing; MAX_DOF]; 2], [[nothing; MAX_DOF]; 2], [0.0; MAX_DOF]);
            for j in 0..robot.n_joints() {
                if let [(a, factor)] = *followers.leaders(j) {
                    for direction in 0..2 {
                        let own = if factor > 0.0 { direction } else { 1 - direction };
                        dry[direction][a] += coulomb[own][j].scale(factor.abs());
                        slow[direction][a] += viscous[own][j].scale(factor * factor);
                    }
                    if Layout::of(robot).number(j) == a {
                        steep[a] = steepness[j];
                    }
                }
            }
            (coulomb, viscous, steepness) = (dry, slow, steep);
        }
        Self { coulomb, viscous, steepness, coupled: robot.coupled(), shafts }
    }

    /// Slope of a joint's own Coulomb friction at rest, the larger one of both directions (N.m.s/rad or N.s/m).
    #[inline(always)]
    pub fn slope(&self, j: usize) -> Lanes<V> {
        self.coulomb[0][j].max(self.coulomb[1][j]).scale(self.steepness[j])
    }

    /// Adds `w` times the torques at speeds `dq` to `tau`, and their slopes to `matrix`; of Coulomb friction alone unless `SLOW`.
    #[inline(always)]
    pub fn add<const SLOW: bool>(
        &self,
        n: usize,
        w: f64,
        dq: &PerJoint<V>,
        tau: &mut PerJoint<V>,
        matrix: &mut impl Square<Lanes<V>>,
    ) {
        let one = Lanes::splat(1.0);
        let ([dry, dry_back], [slow, slow_back]) = (&self.coulomb, &self.viscous);
        for_joints!(j in n => {
            let s = dq[j].scale(self.steepness[j]).tanh();
            let coefficient = dry[j].or_where_not_above(dry_back[j], s).scale(w);
            tau[j] = coefficient.mul_add(s, tau[j]);
            let slope = coefficient.scale(self.steepness[j]);
            matrix[j][j] = slope.mul_add(s.neg_mul_add(s, one), matrix[j][j]);
            if SLOW {
                let coefficient = slow[j].or_where_not_above(slow_back[j], dq[j]).scale(w);
                tau[j] = coefficient.mul_add(dq[j], tau[j]);
                matrix[j][j] += coefficient;
            }
        });
        for (index, coupled) in self.coupled.iter().enumerate() {
            let m = coupled.motor;
            let mut speed = dq[m];
            for &(i, c) in &coupled.others {
                speed = dq[i].mul_add(Lanes::splat(c), speed);
            }
            let s = speed.scale(self.steepness[m]).tanh();
            let coefficient = self.shafts[1][index].scale(w);
            let mut torque = coefficient * s;
            let mut slope = coefficient.scale(self.steepness[m]) * s.neg_mul_add(s, one);
            if SLOW {
                let coefficient = self.shafts[0][index].scale(w);
                torque = coefficient.mul_add(speed, torque);
                slope += coefficient;
            }
            tau[m] += torque;
            matrix[m][m] += slope;
            for (k, &(i, c)) in coupled.others.iter().enumerate() {
                tau[i] = torque.mul_add(Lanes::splat(c), tau[i]);
                matrix[i][i] += slope.scale(c * c);
                matrix[m.max(i)][m.min(i)] += slope.scale(c);
                for &(other, factor) in &coupled.others[..k] {
                    matrix[other.max(i)][other.min(i)] += slope.scale(c * factor);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ground::lanes::Plain;
    use crate::robot::arm::{Any, Arm};
    use crate::robot::{Friction, Joint, JointKind};

    /// Three joints without inertia, whose last motor turns with all of them.
    fn robot() -> Robot {
        let joint = Joint { kind: JointKind::Revolute, alpha: 0.4, d: 0.1, theta: 0.0, r: 0.0 };
        let transmission = [vec![1.0, 0.0, 0.0], vec![0.0, 1.0, 0.0], vec![0.5, -0.3, 1.0]];
        let friction = Friction { asymmetric: true, smoothing: vec![0.2, 0.3, 0.4], ..Friction::sign(3) };
        Robot::new(vec![joint; 3], [0.0; 3], &transmission, friction).unwrap()
    }

    #[test]
    fn it_is_the_friction_of_each_direction_and_its_slopes() {
        let robot = robot();
        let layout = Layout::of(&robot);
        let mut x = vec![0.0; layout.count()];
        for (j, [forward, backward]) in [[1.0, 0.3], [0.8, 2.0], [3.0, 2.5]].into_iter().enumerate() {
            let first = layout.joint(j) + crate::robot::parameters::FRICTION;
            (x[first + 1], x[first + 3]) = (forward, backward);
            (x[first], x[first + 2]) = if j < 2 { (0.4, 0.2) } else { (0.9, 0.9) };
        }
        (x[layout.coupled(0)], x[layout.coupled(0) + 1]) = (0.6, 1.5);
        let links = Links::<Plain<1>>::of_one(&robot, robot.geometry(), &x);
        let steep = Steep::of(&robot, &links);
        let zero = [Lanes::zero(); MAX_DOF];
        let at = |dq: [f64; 3], matrix: &mut <Any as Arm>::Square<_>| {
            let (mut speeds, mut tau) = (zero, zero);
            speeds[..3].copy_from_slice(&dq.map(Lanes::splat));
            steep.add::<true>(3, 0.7, &speeds, &mut tau, matrix);
            [0, 1, 2].map(|j: usize| tau[j].lane(0) / 0.7)
        };
        for dq in [[0.1, -0.2, 0.3], [-0.3, 0.05, -0.1], [0.02, 0.2, -0.4]] {
            let (mut matrix, mut spare) =
                (Square::filled(Lanes::zero(), 3), Square::filled(Lanes::zero(), 3));
            let found = at(dq, &mut matrix);
            let mut want = [0.0; 3];
            let still = [0.0; 3];
            crate::model::inverse::inverse_dynamics(&robot, &still, &dq, &still, &x, &mut want).unwrap();
            for j in 0..3 {
                assert!((found[j] - want[j]).abs() < 1e-14, "{found:?} {want:?}");
                for k in 0..=j {
                    let moved = |by: f64| {
                        let mut dq = dq;
                        dq[k] += by;
                        dq
                    };
                    let slope = (at(moved(1e-6), &mut spare)[j] - at(moved(-1e-6), &mut spare)[j]) / 2e-6;
                    let got = matrix[j][k].lane(0) / 0.7;
                    assert!((got - slope).abs() < 1e-8, "{j} {k}: {got} {slope}");
                }
            }
        }
    }
}
