//! The law of `control.rs` on lanes: torque of each joint, and growth of its integrator.

use super::control::{Controller, Law};
use super::reference::Target;
use crate::ground::arrays::MAX_DOF;
use crate::ground::dispatch::WIDTH;
use crate::ground::lanes::{Lanes, Set, side_by_side, spread};
use crate::robot::arm::{Arm, Place, outwards};
use crate::robot::geometry::Geometry;

/// Inputs of a controller at one instant, on lanes.
#[derive(Debug, Clone, Copy)]
pub struct Instant<'a, V: Set> {
    /// Reference.
    pub target: &'a Target,
    /// Torque fed forward.
    pub feedforward: Option<&'a [f64; MAX_DOF]>,
    /// Scale of the gains of each candidate.
    pub scale: &'a [Lanes<V>; MAX_DOF],
}

/// Torque (joint side) and growth of the integrator of joint `j`.
#[inline(always)]
pub fn law<V: Set>(
    law: &Law,
    instant: &Instant<'_, V>,
    j: usize,
    q: Lanes<V>,
    dq: Lanes<V>,
    z: Lanes<V>,
) -> (Lanes<V>, Lanes<V>) {
    let target = instant.target;
    let e = Lanes::splat(target.q[j]) - q;
    let v = Lanes::splat(law.reference_velocity * target.dq[j]) - dq;
    let mut u = e.mul_add(
        Lanes::splat(law.position),
        v.mul_add(Lanes::splat(law.velocity), Lanes::splat(law.acceleration * target.ddq[j])),
    );
    let mut dz = Lanes::zero();
    if law.integral != 0.0 {
        u = z.mul_add(Lanes::splat(law.integral), u);
        dz = e.mul_add(Lanes::splat(law.integrated_position), v.scale(law.integrated_velocity));
    }
    u = u * instant.scale[j];
    if let Some(feedforward) = instant.feedforward {
        u += Lanes::splat(feedforward[j] / law.gain);
    }
    if law.limit < f64::INFINITY {
        let limit = Lanes::splat(law.limit);
        let clipped = u.max(-limit).min(limit);
        if law.integral != 0.0 {
            // Where u is beyond the limit and dz drives it further, the product is positive.
            let further = (u - clipped) * dz.scale(law.integral);
            dz = dz - dz.where_above(further, Lanes::zero());
        }
        u = clipped;
    }
    (u.scale(law.gain), dz)
}

/// The laws of a controller that only compares: no integrator, no limit, nothing fed forward. Joint by joint in arrays.
#[derive(Debug, Clone, Copy)]
pub struct PlainLaws {
    position: [f64; MAX_DOF],
    velocity: [f64; MAX_DOF],
    acceleration: [f64; MAX_DOF],
    reference_velocity: [f64; MAX_DOF],
    gain: [f64; MAX_DOF],
}

impl PlainLaws {
    /// The laws of a controller, or None if one of them needs more.
    pub fn of(controller: &Controller) -> Option<Self> {
        let plain = |law: &Law| law.integral == 0.0 && law.limit == f64::INFINITY;
        if controller.feedforward().is_some() || !controller.laws().iter().all(plain) {
            return None;
        }
        let all = |pick: fn(&Law) -> f64| std::array::from_fn(|j| controller.laws().get(j).map_or(0.0, pick));
        Some(Self {
            position: all(|law| law.position),
            velocity: all(|law| law.velocity),
            acceleration: all(|law| law.acceleration),
            reference_velocity: all(|law| law.reference_velocity),
            gain: all(|law| law.gain),
        })
    }

    /// Torques (joint side), to the bits of [`law`].
    #[inline(always)]
    pub fn torques<V: Set, S: Arm>(
        &self,
        geometry: &Geometry<S>,
        target: &Target,
        scale: &[Lanes<V>; MAX_DOF],
        q: &[Lanes<V>; MAX_DOF],
        dq: &[Lanes<V>; MAX_DOF],
        tau: &mut [Lanes<V>; MAX_DOF],
    ) {
        if V::L == 1 && V::FUSED {
            // A single lane takes its joints side by side.
            for first in (0..geometry.n()).step_by(WIDTH) {
                let block = |values: &[f64; MAX_DOF]| Lanes::<V::Wide>::from_slice(&values[first..]);
                // Not `map` of an array: a call, compiled for the oldest processor.
                let (q, dq, scale) =
                    (side_by_side(q, first), side_by_side(dq, first), side_by_side(scale, first));
                let gains = [block(&self.position), block(&self.velocity), block(&self.acceleration)];
                let aim = [
                    block(&target.q),
                    block(&self.reference_velocity) * block(&target.dq),
                    block(&target.ddq),
                ];
                spread(compared(gains, aim, q, dq) * scale * block(&self.gain), tau, first);
            }
            return;
        }
        outwards!(S, geometry.n(), place => {
            let j = place.index();
            let gains = [self.position[j], self.velocity[j], self.acceleration[j]].map(Lanes::splat);
            let aim = [target.q[j], self.reference_velocity[j] * target.dq[j], target.ddq[j]].map(Lanes::splat);
            tau[j] = (compared(gains, aim, q[j], dq[j]) * scale[j]).scale(self.gain[j]);
        });
    }
}

/// Output of a law without integrator, from its gains of position, velocity and acceleration and their targets.
#[inline(always)]
fn compared<V: Set>(
    [position, velocity, acceleration]: [Lanes<V>; 3],
    [aim_q, aim_dq, aim_ddq]: [Lanes<V>; 3],
    q: Lanes<V>,
    dq: Lanes<V>,
) -> Lanes<V> {
    (aim_q - q).mul_add(position, (aim_dq - dq).mul_add(velocity, acceleration * aim_ddq))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::closed_loop::control::Timing;
    use crate::ground::dispatch::{Kernel, dispatch, dispatch_single};
    use crate::robot::{Friction, Joint, JointKind, Robot};

    const PD: Law = Law {
        position: 0.0,
        velocity: 0.0,
        integral: 0.0,
        acceleration: 0.0,
        reference_velocity: 1.0,
        integrated_position: 1.0,
        integrated_velocity: 0.0,
        limit: f64::INFINITY,
        gain: 1.0,
    };

    /// Torques by [`law`] and by [`PlainLaws`].
    struct Both<'a> {
        controller: &'a Controller,
        target: &'a Target,
        numbers: &'a [f64],
    }

    impl Kernel for Both<'_> {
        type Output = [Vec<Vec<f64>>; 2];
        #[inline(always)]
        fn run<V: Set>(self) -> Self::Output {
            let n = self.controller.laws().len();
            let joints = vec![Joint { kind: JointKind::Revolute, alpha: 0.0, d: 0.0, theta: 0.0, r: 0.0 }; n];
            let unit: Vec<Vec<f64>> =
                (0..n).map(|i| (0..n).map(|j| f64::from(u8::from(i == j))).collect()).collect();
            let robot = Robot::new(joints, [0.0; 3], &unit, Friction::sign(n)).unwrap();
            let lanes = |part: usize| -> [Lanes<V>; MAX_DOF] {
                std::array::from_fn(|j| Lanes::each(|l| self.numbers[(part * 12 + j % 12) * 4 + l % 4]))
            };
            let [q, dq, scale] = [0, 1, 2].map(lanes);
            let mut plain = [Lanes::zero(); MAX_DOF];
            PlainLaws::of(self.controller).unwrap().torques(
                robot.geometry(),
                self.target,
                &scale,
                &q,
                &dq,
                &mut plain,
            );
            let instant = Instant { target: self.target, feedforward: None, scale: &scale };
            let by_law =
                |j: usize| law(&self.controller.laws()[j], &instant, j, q[j], dq[j], Lanes::zero()).0;
            [
                (0..n).map(|j| plain[j].to_array().as_ref().to_vec()).collect(),
                (0..n).map(|j| by_law(j).to_array().as_ref().to_vec()).collect(),
            ]
        }
    }

    #[test]
    fn plain_laws_have_the_bits_of_laws() {
        let number = |k: usize| (1.3 * k as f64 + 0.2).sin() * 3.0;
        let numbers: Vec<f64> = (0..144).map(number).collect();
        for n in [1, 4, 6, 7, 12] {
            let one = |j: usize| Law {
                position: 100.0 * number(j),
                velocity: 10.0 * number(j + 12),
                acceleration: number(j + 24),
                reference_velocity: number(j + 36),
                gain: number(j + 48),
                ..PD
            };
            let laws: Vec<Law> = (0..n).map(one).collect();
            let controller = Controller::new(laws.clone(), Timing::Continuous, None).unwrap();
            let mut target = Target::zero();
            for j in 0..n {
                (target.q[j], target.dq[j], target.ddq[j]) = (number(j + 60), number(j + 72), number(j + 84));
            }
            let both = || Both { controller: &controller, target: &target, numbers: &numbers };
            let [plain, by_law] = dispatch_single(both());
            assert_eq!(plain, by_law);
            let [plain, by_law] = dispatch(both());
            assert_eq!(plain, by_law);
            assert!(plain.iter().flatten().any(|u| u.abs() > 1.0));
            let mut limited = laws;
            limited[n - 1].limit = 5.0;
            assert!(PlainLaws::of(&Controller::new(limited, Timing::Continuous, None).unwrap()).is_none());
        }
    }
}
