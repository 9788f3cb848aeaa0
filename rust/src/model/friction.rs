//! Rotor inertia and friction of joints and of coupled motors, (22) to (24) for any transmission `C`.
//!
//! `Ia_j`, `Fv_j` and `Fc_j` contain what a coupled motor puts on the diagonal of joint `j`, as (24) has it; what is
//! left is written here. Motor `m` turns with `s = c_m . dq`, and joint `i /= m` feels `c_mi` times its torque:
//!
//! | column | row m | row i |
//! |---|---|---|
//! | `Ia_m` | `c_m . ddq` | `c_mi (c_m . ddq) - c_mi^2 ddq_i` |
//! | `Fvm_m` | `s - dq_m` | `c_mi s - c_mi^2 dq_i` |
//! | `Fcm_m` | `sign(s) - sign(dq_m)` | `c_mi sign(s)`; as printed in (23): `c_mi sign(dq_m)` |

use crate::ground::arrays::MAX_DOF;
use crate::ground::dispatch::WIDTH;
use crate::ground::lanes::{Lanes, Set, side_by_side, spread};
use crate::model::friction_terms::column;
use crate::model::links::Links;
use crate::model::motion::State;
use crate::model::remembered::Remembered;
use crate::robot::arm::{Arm, Place, outwards};
use crate::robot::friction_terms::Law;
use crate::robot::geometry::Geometry;
use crate::robot::{CoupledMotor, Coupling, Followers, Robot};

/// `sign`, `sign` with a dead zone, or `tanh(dq / v)`, as joint `j` has it. Between -1 and 1.
#[inline(always)]
pub fn sign<V: Set>(robot: &Robot, j: usize, dq: Lanes<V>) -> Lanes<V> {
    let friction = robot.friction();
    let steepness = if friction.smoothing[j] > 0.0 { 1.0 / friction.smoothing[j] } else { 0.0 };
    smooth_sign(steepness, friction.dead_zone[j], dq)
}

/// The same from the slope of `tanh` (0 for a plain sign) and the dead zone.
#[inline(always)]
fn smooth_sign<V: Set>(steepness: f64, dead_zone: f64, dq: Lanes<V>) -> Lanes<V> {
    if steepness > 0.0 {
        let s = dq.scale(steepness).tanh();
        if dead_zone > 0.0 { s.where_above(dq.abs(), Lanes::splat(dead_zone)) } else { s }
    } else {
        Lanes::splat(1.0).copysign(dq).where_above(dq.abs(), Lanes::splat(dead_zone))
    }
}

/// Columns of the friction parameters of joint `j` in its own row: `Fv Fc Off`, or `Fv+ Fc+ Fv- Fc-`.
#[inline(always)]
pub fn own_columns<V: Set>(robot: &Robot, j: usize, dq: Lanes<V>) -> [Lanes<V>; 4] {
    let s = sign(robot, j, dq);
    if robot.friction().asymmetric {
        let zero = Lanes::zero();
        [dq.max(zero), s.max(zero), dq.min(zero), s.min(zero)]
    } else {
        [dq, s, Lanes::splat(1.0), Lanes::zero()]
    }
}

/// Contribution of a coupled motor to each row: the columns of its `Ia` (without its own joint's part), `Fvm` and `Fcm`.
#[derive(Debug, Clone, Copy)]
pub struct CoupledColumns<V: Set> {
    /// Column of `Ia_m`; in row m without `ddq_m`, which the joint's own block has.
    pub rotor: Lanes<V>,
    /// Column of `Fvm_m`.
    pub viscous: Lanes<V>,
    /// Column of `Fcm_m`.
    pub coulomb: Lanes<V>,
}

/// Speed and acceleration of a coupled motor.
#[derive(Debug, Clone, Copy)]
pub struct Shaft<V: Set> {
    dq: Lanes<V>,
    ddq: Lanes<V>,
    /// Sign of the motor's speed.
    turning: Lanes<V>,
    /// Sign of the speed of the joint it is named after.
    joint_turning: Lanes<V>,
}

impl<V: Set> Shaft<V> {
    /// Of one motor.
    #[inline(always)]
    pub fn of(robot: &Robot, coupled: &CoupledMotor, state: &State<V>) -> Self {
        let m = coupled.motor;
        let (mut dq, mut ddq) = (state.dq[m], state.ddq[m]);
        for &(i, c) in &coupled.others {
            dq = state.dq[i].mul_add(Lanes::splat(c), dq);
            ddq = state.ddq[i].mul_add(Lanes::splat(c), ddq);
        }
        Self { dq, ddq, turning: sign(robot, m, dq), joint_turning: sign(robot, m, state.dq[m]) }
    }

    /// Entries in the motor's own row.
    #[inline(always)]
    pub fn own_row(&self, motor: usize, state: &State<V>) -> CoupledColumns<V> {
        CoupledColumns {
            rotor: self.ddq - state.ddq[motor],
            viscous: self.dq - state.dq[motor],
            coulomb: self.turning - self.joint_turning,
        }
    }

    /// Entries in the row of another joint `i` with coefficient `c`.
    #[inline(always)]
    pub fn other_row(&self, robot: &Robot, i: usize, c: f64, state: &State<V>) -> CoupledColumns<V> {
        let sign = match robot.friction().coupling {
            Coupling::Shaft => self.turning,
            Coupling::Printed => self.joint_turning,
        };
        CoupledColumns {
            rotor: (self.ddq - state.ddq[i].scale(c)).scale(c),
            viscous: (self.dq - state.dq[i].scale(c)).scale(c),
            coulomb: sign.scale(c),
        }
    }
}

/// Memory of [`Drives::friction`]: nothing is cleared per call.
#[derive(Debug, Clone, Copy)]
pub struct Signs<V: Set> {
    /// Signs of the joints' speeds.
    joints: [Lanes<V>; MAX_DOF],
    /// Of a single lane: speeds of the joints and of the coupled motors, then their signs.
    together: [f64; 2 * MAX_DOF],
    /// States of friction that remembers; a path has them, a sample alone does not.
    pub remembered: Option<Remembered<V>>,
}

impl<V: Set> Signs<V> {
    /// Nothing computed yet.
    #[inline(always)]
    pub fn none() -> Self {
        Self { joints: [Lanes::zero(); MAX_DOF], together: [0.0; 2 * MAX_DOF], remembered: None }
    }
}

/// The drives as the kernels use them: divisions done, once per run.
#[derive(Debug, Clone)]
pub struct Drives<'a> {
    robot: &'a Robot,
    /// Does a term depend on the load?
    has_load: bool,
    coupled: &'a [CoupledMotor],
    coupling: Coupling,
    asymmetric: bool,
    n: usize,
    /// Reciprocal of the smoothing velocity, 0 for a plain sign; dead zone.
    signs: [(f64, f64); MAX_DOF],
    /// Reciprocals of the smoothing velocities of the joints, then of the coupled motors, where none is a plain sign and
    /// there is no dead zone.
    steepness: Option<[f64; 2 * MAX_DOF]>,
}

impl<'a> Drives<'a> {
    /// Constants of a robot's friction.
    pub fn of(robot: &'a Robot) -> Self {
        let friction = robot.friction();
        let mut signs = [(0.0, 0.0); MAX_DOF];
        for (sign, (&velocity, &dead_zone)) in
            signs.iter_mut().zip(friction.smoothing.iter().zip(&friction.dead_zone))
        {
            *sign = (if velocity > 0.0 { 1.0 / velocity } else { 0.0 }, dead_zone);
        }
        let (coupling, asymmetric, n) = (friction.coupling, friction.asymmetric, robot.n_joints());
        let smooth = signs[..n].iter().all(|&(steepness, dead_zone)| steepness > 0.0 && dead_zone == 0.0);
        let mut steepness = [0.0; 2 * MAX_DOF];
        for j in 0..n {
            steepness[j] = signs[j].0;
        }
        for (index, coupled) in robot.coupled().iter().enumerate() {
            steepness[n + index] = signs[coupled.motor].0;
        }
        let steepness = smooth.then_some(steepness);
        let has_load = friction.has_load();
        Self { robot, has_load, coupled: robot.coupled(), coupling, asymmetric, n, signs, steepness }
    }

    /// Joints that follow others, where there are any.
    #[inline(always)]
    pub fn followers(&self) -> Option<&'a Followers> {
        self.robot.followers()
    }

    /// Does a term depend on the load?
    #[inline(always)]
    pub fn has_load(&self) -> bool {
        self.has_load
    }

    /// Adds the further terms that depend on position and speed alone.
    #[inline(always)]
    fn further_terms<V: Set>(
        &self,
        links: &Links<V>,
        q: &[Lanes<V>; MAX_DOF],
        dq: &[Lanes<V>; MAX_DOF],
        signs: &[Lanes<V>; MAX_DOF],
        tau: &mut [Lanes<V>; MAX_DOF],
    ) {
        for (term, &parameter) in self.robot.friction().terms.iter().zip(&links.terms) {
            // Memory has been added with its state.
            if !matches!(term.law, Law::Load | Law::Dahl { .. }) {
                let j = term.joint;
                tau[j] = column(self.robot, term, q[j], dq[j], || signs[j]).mul_add(parameter, tau[j]);
            }
        }
    }

    /// Signed coefficient `Fl s` of the load friction of each joint, `s` of the last [`Self::friction`]: its torque is this times
    /// `abs(tau_r)`.
    #[inline(always)]
    pub fn load_coefficients<V: Set>(&self, links: &Links<V>, signs: &Signs<V>) -> [Lanes<V>; MAX_DOF] {
        let mut coefficients = [Lanes::zero(); MAX_DOF];
        for (term, &parameter) in self.robot.friction().terms.iter().zip(&links.terms) {
            if term.law == Law::Load {
                coefficients[term.joint] = parameter * signs.joints[term.joint];
            }
        }
        coefficients
    }

    /// [`sign`] without its division.
    #[inline(always)]
    fn sign<V: Set>(&self, j: usize, dq: Lanes<V>) -> Lanes<V> {
        let (steepness, dead_zone) = self.signs[j];
        smooth_sign(steepness, dead_zone, dq)
    }

    /// Torques of friction and springs at positions `q` and speeds `dq`, into `tau`.
    #[inline(always)]
    #[allow(clippy::too_many_arguments)] // as `Direct::solve`
    pub fn friction<V: Set, S: Arm>(
        &self,
        geometry: &Geometry<S>,
        links: &Links<V>,
        q: &[Lanes<V>; MAX_DOF],
        dq: &[Lanes<V>; MAX_DOF],
        memory: &mut Signs<V>,
        tau: &mut [Lanes<V>; MAX_DOF],
    ) {
        let zero = Lanes::zero();
        let n = geometry.n();
        let Signs { joints: signs, together: memory, remembered } = memory;
        // A single lane takes its joints and coupled motors side by side, to the same bits.
        let together = match &self.steepness {
            Some(steepness) if V::L == 1 && V::FUSED => {
                self.signs_together(n, steepness, dq, memory);
                Some(&*memory)
            }
            _ => None,
        };
        if let Some(together) = together {
            for j in 0..n {
                signs[j] = Lanes::splat(together[j]);
            }
        } else {
            outwards!(S, n, place => {
                let j = place.index();
                signs[j] = match &self.steepness {
                    Some(steepness) => dq[j].scale(steepness[j]).tanh(),
                    None => self.sign(j, dq[j]),
                };
            });
        }
        let [a, b, c, d] = &links.friction;
        if self.asymmetric {
            for j in 0..n {
                let forward = dq[j].max(zero).mul_add(a[j], signs[j].max(zero) * b[j]);
                tau[j] = dq[j].min(zero).mul_add(c[j], signs[j].min(zero).mul_add(d[j], forward));
            }
        } else if V::L == 1 && V::FUSED {
            for first in (0..n).step_by(WIDTH) {
                let [a, b, c] = [side_by_side(a, first), side_by_side(b, first), side_by_side(c, first)];
                let (dq, s) = (side_by_side(dq, first), side_by_side(signs, first));
                spread(dq.mul_add(a, s.mul_add(b, c)), tau, first);
            }
        } else {
            outwards!(S, n, place => {
                let j = place.index();
                tau[j] = dq[j].mul_add(a[j], signs[j].mul_add(b[j], c[j]));
            });
        }
        for (index, (coupled, &[fvm, fcm])) in self.coupled.iter().zip(&links.coupled).enumerate() {
            let m = coupled.motor;
            let speed = shaft_speed(coupled, dq);
            let turning = match together {
                Some(signs) => Lanes::splat(signs[n + index]),
                None => self.sign(m, speed),
            };
            tau[m] = (speed - dq[m]).mul_add(fvm, (turning - signs[m]).mul_add(fcm, tau[m]));
            let sign = match self.coupling {
                Coupling::Shaft => turning,
                Coupling::Printed => signs[m],
            };
            for &(i, c) in &coupled.others {
                let torque = (speed - dq[i].scale(c)).mul_add(fvm, sign * fcm);
                tau[i] = torque.mul_add(Lanes::splat(c), tau[i]);
            }
        }
        if let Some(remembered) = remembered {
            remembered.rub(links, signs, tau);
        }
        self.further_terms(links, q, dq, signs, tau);
    }

    /// Signs of the speeds of the joints, then of the coupled motors.
    #[inline(always)]
    fn signs_together<V: Set>(
        &self,
        n: usize,
        steepness: &[f64; 2 * MAX_DOF],
        dq: &[Lanes<V>; MAX_DOF],
        signs: &mut [f64; 2 * MAX_DOF],
    ) {
        let count = (n + self.coupled.len()).min(2 * MAX_DOF);
        for j in 0..n {
            signs[j] = dq[j].lane(0);
        }
        for (index, coupled) in self.coupled.iter().enumerate() {
            signs[n + index] = shaft_speed(coupled, dq).lane(0);
        }
        for first in (0..count).step_by(WIDTH) {
            let speed = Lanes::<V::Wide>::from_slice(&signs[first..]);
            let steepness = Lanes::<V::Wide>::from_slice(&steepness[first..]);
            (speed * steepness).tanh().store(&mut signs[first..]);
        }
    }

    /// Adds what the rotors need for accelerations `ddq`.
    #[inline(always)]
    pub fn rotors<V: Set>(&self, links: &Links<V>, ddq: &[Lanes<V>; MAX_DOF], tau: &mut [Lanes<V>; MAX_DOF]) {
        for j in 0..self.n.min(MAX_DOF) {
            tau[j] = links.ia[j].mul_add(ddq[j], tau[j]);
        }
        for coupled in self.coupled {
            let m = coupled.motor;
            let ia = links.ia[m];
            let mut others = Lanes::zero();
            for &(i, c) in &coupled.others {
                others = ddq[i].mul_add(Lanes::splat(c), others);
            }
            tau[m] = ia.mul_add(others, tau[m]);
            let all = ddq[m] + others;
            for &(i, c) in &coupled.others {
                tau[i] = ia.scale(c).mul_add(all - ddq[i].scale(c), tau[i]);
            }
        }
    }
}

/// Speed of a coupled motor.
#[inline(always)]
fn shaft_speed<V: Set>(coupled: &CoupledMotor, dq: &[Lanes<V>; MAX_DOF]) -> Lanes<V> {
    let mut speed = dq[coupled.motor];
    for &(i, c) in &coupled.others {
        speed = dq[i].mul_add(Lanes::splat(c), speed);
    }
    speed
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ground::lanes::Plain;
    use crate::robot::{Friction, Joint, JointKind};

    fn one_joint(friction: Friction) -> Robot {
        let joint = Joint { kind: JointKind::Prismatic, alpha: 0.0, d: 0.0, theta: 0.0, r: 0.0 };
        Robot::new(vec![joint], [0.0; 3], &[vec![1.0]], friction).unwrap()
    }

    #[test]
    fn the_sign_is_zero_at_rest_and_in_the_dead_zone() {
        let robot = one_joint(Friction { dead_zone: vec![0.1], ..Friction::sign(1) });
        let s = sign(&robot, 0, Lanes::<Plain<4>>::from_slice(&[0.0, 0.1, -0.2, 0.3]));
        assert_eq!(s.to_array(), [0.0, 0.0, -1.0, 1.0]);
        let s = sign(&one_joint(Friction::sign(1)), 0, Lanes::<Plain<2>>::from_slice(&[-0.0, 1e-300]));
        assert_eq!(s.to_array(), [0.0, 1.0]);
    }

    #[test]
    fn asymmetric_columns_split_by_direction() {
        let robot = one_joint(Friction { asymmetric: true, ..Friction::sign(1) });
        let columns = own_columns(&robot, 0, Lanes::<Plain<2>>::from_slice(&[2.0, -3.0]));
        assert_eq!(columns.map(Lanes::to_array), [[2.0, 0.0], [1.0, 0.0], [0.0, -3.0], [0.0, -1.0]]);
    }
}
