//! The parameters of a candidate as the kernels use them: bodies, friction and rotors, joint by joint.
//!
//! Particles on the axis of a revolute joint move with the link before, so `Szz`, `MZ` and `M` regroup into that link:
//! the base parameters of a link are the other seven, and torques do not change (tested below against the
//! regressor, which knows nothing of it). After that, only sliding links and those that carry them have a mass.

use super::bodies::Body;
use crate::ground::arrays::MAX_DOF;
use crate::ground::lanes::Lanes;
use crate::robot::Robot;
use crate::robot::arm::{Arm, At, by_twist};
use crate::robot::friction_terms::MAX_TERMS;
use crate::robot::geometry::{Frames, Geometry};
use crate::robot::parameters::{FRICTION, IA, Layout};

/// A symmetric matrix on lanes; only entries with `row >= column` are used.
pub type Lower<const L: usize, const F: bool> = [[Lanes<L, F>; MAX_DOF]; MAX_DOF];

/// The parameters of a candidate as the kernels use them.
#[derive(Debug, Clone, Copy)]
pub struct Links<const L: usize, const F: bool> {
    /// Links, regrouped.
    pub bodies: [Body<L, F>; MAX_DOF],
    /// The friction parameters, each of all joints.
    pub friction: [[Lanes<L, F>; MAX_DOF]; 4],
    /// `Fvm Fcm` of each coupled motor.
    pub coupled: [[Lanes<L, F>; 2]; MAX_DOF],
    /// Parameters of the further terms of friction.
    pub terms: [Lanes<L, F>; MAX_TERMS],
    /// What rotors add to the inertia matrix: `Ia`, and off the diagonal what coupled ones put there (24).
    pub rotors: Lower<L, F>,
}

impl<const L: usize, const F: bool> Links<L, F> {
    /// From standard parameters.
    #[inline(always)]
    pub fn of<S: Arm>(robot: &Robot, geometry: &Geometry<S>, x: &[Lanes<L, F>]) -> Self {
        let layout = Layout::of(robot);
        let zero = Lanes::zero();
        let mut links = Self {
            bodies: [Body::none(); MAX_DOF],
            friction: [[zero; MAX_DOF]; 4],
            coupled: [[zero; 2]; MAX_DOF],
            terms: [zero; MAX_TERMS],
            rotors: [[zero; MAX_DOF]; MAX_DOF],
        };
        for j in 0..geometry.n() {
            let block = &x[layout.joint(j)..layout.joint(j) + layout.per_joint()];
            links.bodies[j] = Body::of_link(block);
            for (parameters, &value) in links.friction.iter_mut().zip(&block[FRICTION..]) {
                parameters[j] = value;
            }
            links.rotors[j][j] = block[IA];
        }
        for (parameter, &value) in links.terms.iter_mut().zip(&x[layout.term(0)..]) {
            *parameter = value;
        }
        for (index, coupled) in robot.coupled().iter().enumerate() {
            let (m, at) = (coupled.motor, layout.coupled(index));
            links.coupled[index] = [x[at], x[at + 1]];
            let ia = x[layout.joint(m) + IA];
            for (k, &(i, c)) in coupled.others.iter().enumerate() {
                links.rotors[m.max(i)][m.min(i)] += ia.scale(c);
                for &(other, factor) in &coupled.others[..k] {
                    links.rotors[other.max(i)][other.min(i)] += ia.scale(c * factor);
                }
            }
        }
        links.regroup(geometry);
        links
    }

    /// From plain standard parameters, the same in each lane.
    #[inline(always)]
    pub fn of_one<S: Arm>(robot: &Robot, geometry: &Geometry<S>, x: &[f64]) -> Self {
        let x: Vec<Lanes<L, F>> = x.iter().map(|&value| Lanes::splat(value)).collect();
        Self::of(robot, geometry, &x)
    }

    #[inline(always)]
    fn regroup<S: Arm>(&mut self, geometry: &Geometry<S>) {
        let frames = Frames::<L, F>::new(geometry);
        for j in (0..geometry.n()).rev() {
            let step = &geometry.step(At(j));
            if !step.form.turns {
                continue;
            }
            let axis = self.bodies[j].take_axis();
            if j > 0 {
                // A turn about the axis changes nothing on it: any angle will do.
                let (s, c, t) = (Lanes::zero(), Lanes::splat(1.0), &frames.shift[j]);
                let moved = by_twist!(step, T => axis.unstepped::<T>(step, s, c, t, true));
                self.bodies[j - 1] = self.bodies[j - 1].with(&moved);
            }
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use crate::model::direct::direct_dynamics;
    use crate::model::inverse::inverse_dynamics;
    use crate::model::regressor::regressor;
    use crate::robot::parameters::Layout;
    use crate::robot::{Friction, Joint, JointKind, Robot};
    use std::f64::consts::FRAC_PI_2;

    /// Every kind of step; `slides` says which joints are prismatic.
    pub(crate) fn robot(slides: &[bool]) -> Robot {
        let n = slides.len();
        let alphas = [0.2, FRAC_PI_2, 0.0, -FRAC_PI_2, 0.7, 2.0 * FRAC_PI_2];
        let joint = |j: usize| Joint {
            kind: if slides[j] { JointKind::Prismatic } else { JointKind::Revolute },
            alpha: alphas[(j + usize::from(slides[0])) % 6],
            d: [0.0, 0.3, -0.2][j % 3],
            theta: 0.1 * j as f64,
            r: [0.4, 0.0][j % 2],
        };
        let coupling: Vec<Vec<f64>> = (0..n)
            .map(|m| {
                (0..n)
                    .map(|j| {
                        if m == j {
                            1.0
                        } else if m == n - 1 && j + 2 >= n {
                            0.5
                        } else {
                            0.0
                        }
                    })
                    .collect()
            })
            .collect();
        let friction = Friction { smoothing: vec![0.3; n], ..Friction::sign(n) };
        Robot::new((0..n).map(joint).collect(), [1.0, 2.0, -9.81], &coupling, friction).unwrap()
    }

    /// Each link a body that exists, seen from a distance.
    pub(crate) fn parameters(robot: &Robot) -> Vec<f64> {
        let link = [0.5, 0.05, -0.03, 0.6, 0.04, 0.4, 0.3, -0.2, 0.1, 2.0, 0.2, 0.4, 0.3, 0.1];
        let (joints, count) = (14 * robot.n_dof(), Layout::of(robot).count());
        (0..count).map(|k| if k < joints { link[k % 14] } else { 0.1 }).collect()
    }

    /// A slider along an axis that turns, and parameters with which `M(q)` is `diag(inertia + mass q2^2, mass + rotor)`.
    pub(crate) fn polar([inertia, mass, rotor]: [f64; 3]) -> (Robot, Vec<f64>) {
        let joint = |kind, alpha| Joint { kind, alpha, d: 0.0, theta: 0.0, r: 0.0 };
        let joints = vec![joint(JointKind::Revolute, 0.0), joint(JointKind::Prismatic, FRAC_PI_2)];
        let identity = [vec![1.0, 0.0], vec![0.0, 1.0]];
        let robot = Robot::new(joints, [0.0; 3], &identity, Friction::sign(2)).unwrap();
        let mut x = vec![0.0; 28];
        (x[5], x[14 + 9], x[14 + 10]) = (inertia, mass, rotor);
        (robot, x)
    }

    #[test]
    fn regrouping_changes_no_torque_and_the_direct_model_is_the_inverse() {
        let (o, i) = (false, true);
        for slides in [
            vec![o],
            vec![i],
            vec![i, o],
            vec![o, i, o],
            vec![i, i, i],
            vec![o; 6],
            vec![i, o, o, i, o, o],
            vec![o; 7],
            vec![o, o, i, o, o, i, o, o],
        ] {
            let robot = robot(&slides);
            let (n, p, samples) = (slides.len(), Layout::of(&robot).count(), 6);
            let motion =
                |a: f64| (0..samples * n).map(|k| (a * k as f64 + a).sin() * 2.0).collect::<Vec<_>>();
            let (q, dq, ddq) = (motion(1.1), motion(0.7), motion(1.7));
            let x = parameters(&robot);
            let (mut tau, mut w) = (vec![0.0; samples * n], vec![0.0; samples * n * p]);
            inverse_dynamics(&robot, &q, &dq, &ddq, &x, &mut tau).unwrap();
            regressor(&robot, &q, &dq, &ddq, &mut w).unwrap();
            for (tau, row) in tau.iter().zip(w.chunks_exact(p)) {
                let want: f64 = row.iter().zip(&x).map(|(w, x)| w * x).sum();
                assert!((tau - want).abs() < 1e-11 * (1.0 + want.abs()), "{slides:?}: {tau} {want}");
            }
            let mut back = vec![0.0; samples * n];
            assert_eq!(direct_dynamics(&robot, &q, &dq, &tau, &x, &mut back).unwrap(), None);
            for (back, want) in back.iter().zip(&ddq) {
                assert!((back - want).abs() < 1e-9, "{slides:?}: {back} {want}");
            }
        }
    }
}
