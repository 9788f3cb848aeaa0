//! The controllers of the closed loop: one linear law per joint, continuous or digital.
//!
//! With `e = q_ref - q` and `v = w dq_ref - dq`,
//!
//! `u = s (P e + D v + I z + A ddq_ref) + tau_ff / g`, `dz/dt = a e + b v`, `tau = g sat(u)`.
//!
//! PD and PID on joints have `a = 1, b = 0`; a cascade of a position loop `kp` around a velocity loop `kv` with integral time
//! `Ti` has `P = kv kp, D = kv, I = kv / Ti, a = kp, b = 1`. `g` is the drive gain and `s` scales the gains of a candidate
//! (gain updating). Integration stops while it would drive a saturated output further. A digital controller computes `u` at its own
//! rate, with velocities from differences of smoothed positions, and holds it, some samples late.
//! Tested against closed forms in `simulate/tests.rs` and against the EMPS in the Python tests.

use crate::error::ControlError;
use crate::geometry::Geometry;
use crate::lanes::{Lanes, WIDTH, side_by_side, spread};
use crate::reference::Target;
use crate::robot::MAX_DOF;
use crate::shape::{Place, Shape, outwards};

/// The law of one joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Law {
    /// `P`, per unit of position error.
    pub position: f64,
    /// `D`, per unit of velocity error.
    pub velocity: f64,
    /// `I`, per unit of `z`.
    pub integral: f64,
    /// `A`, per unit of reference acceleration.
    pub acceleration: f64,
    /// `w`: the share of the reference velocity in the velocity error.
    pub reference_velocity: f64,
    /// `a` of the integrator.
    pub integrated_position: f64,
    /// `b` of the integrator.
    pub integrated_velocity: f64,
    /// Largest `|u|`; infinite without saturation.
    pub limit: f64,
    /// `g`: torque or force per unit of `u`.
    pub gain: f64,
}

/// When the law is evaluated.
#[derive(Debug, Clone, PartialEq)]
pub enum Timing {
    /// At every stage of the integration.
    Continuous,
    /// At its own rate.
    Digital(Digital),
}

/// A sampled controller.
#[derive(Debug, Clone, PartialEq)]
pub struct Digital {
    /// Sample time (s).
    pub period: f64,
    /// Whole samples between a measurement and the output that follows from it.
    pub delay: usize,
    /// Weights of the newest, the one before, ... position in the smoothed position.
    pub smoothing: Vec<f64>,
    /// Step of the encoder per joint (rad or m); 0 for an exact one.
    pub resolution: Vec<f64>,
}

/// Samples at a constant rate, `(samples, n)` row-major, the first at time 0; straight lines between them.
#[derive(Debug, Clone, PartialEq)]
pub struct Signal {
    /// Samples per second.
    pub rate: f64,
    /// Joints.
    pub n: usize,
    /// The samples.
    pub values: Vec<f64>,
}

impl Signal {
    /// At time `t`; the first and the last sample hold beyond the ends.
    #[inline(always)]
    pub fn at(&self, t: f64, out: &mut [f64; MAX_DOF]) {
        let last = self.values.len() / self.n - 1;
        let place = (t * self.rate).clamp(0.0, last as f64);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clamped to the samples
        let k = (place as usize).min(last.saturating_sub(1));
        let part = place - k as f64;
        for j in 0..self.n {
            let (a, b) = (self.values[k * self.n + j], self.values[(k + 1).min(last) * self.n + j]);
            out[j] = a + part * (b - a);
        }
    }
}

/// The controller of a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Controller {
    laws: Vec<Law>,
    timing: Timing,
    feedforward: Option<Signal>,
}

impl Controller {
    /// Checks and stores the laws, one per joint, and a torque that is fed forward (joint side).
    pub fn new(laws: Vec<Law>, timing: Timing, feedforward: Option<Signal>) -> Result<Self, ControlError> {
        let n = laws.len();
        for (j, law) in laws.iter().enumerate() {
            for (what, value) in [
                ("the position gain", law.position),
                ("the velocity gain", law.velocity),
                ("the integral gain", law.integral),
                ("the acceleration gain", law.acceleration),
                ("the share of the reference velocity", law.reference_velocity),
                ("the integrator", law.integrated_position + law.integrated_velocity),
                ("the drive gain", law.gain),
            ] {
                if !value.is_finite() {
                    return Err(ControlError::NotFinite { what, joint: j + 1 });
                }
            }
            if law.limit.is_nan() || law.limit <= 0.0 {
                return Err(ControlError::Limit { joint: j + 1, value: law.limit });
            }
            if law.gain == 0.0 {
                return Err(ControlError::NoGain { joint: j + 1 });
            }
        }
        if let Timing::Digital(digital) = &timing {
            if !(digital.period > 0.0 && digital.period.is_finite()) {
                return Err(ControlError::Period { value: digital.period });
            }
            if digital.smoothing.is_empty() || digital.smoothing.iter().any(|c| !c.is_finite()) {
                return Err(ControlError::Smoothing);
            }
            if digital.resolution.len() != n {
                return Err(ControlError::Resolution { want: n, got: digital.resolution.len() });
            }
        }
        if let Some(signal) = &feedforward {
            check_signal("the torque fed forward", signal, n)?;
        }
        Ok(Self { laws, timing, feedforward })
    }

    /// One law per joint.
    pub fn laws(&self) -> &[Law] {
        &self.laws
    }

    /// Continuous or digital.
    pub fn timing(&self) -> &Timing {
        &self.timing
    }

    /// Torque fed forward.
    pub fn feedforward(&self) -> Option<&Signal> {
        self.feedforward.as_ref()
    }

    /// Sample time of a digital controller.
    pub fn period(&self) -> Option<f64> {
        match &self.timing {
            Timing::Continuous => None,
            Timing::Digital(digital) => Some(digital.period),
        }
    }
}

/// A signal has samples, `n` joints and finite numbers.
pub fn check_signal(what: &'static str, signal: &Signal, n: usize) -> Result<(), ControlError> {
    if signal.n != n || signal.values.is_empty() || !signal.values.len().is_multiple_of(n) {
        return Err(ControlError::Signal { what, want: n, got: signal.n });
    }
    if !(signal.rate > 0.0 && signal.rate.is_finite()) || signal.values.iter().any(|v| !v.is_finite()) {
        return Err(ControlError::SignalNotFinite { what });
    }
    Ok(())
}

/// What a controller sees and gives at one instant, on lanes.
#[derive(Debug, Clone, Copy)]
pub struct Instant<'a, const L: usize, const F: bool> {
    /// Reference.
    pub target: &'a Target,
    /// Torque fed forward.
    pub feedforward: Option<&'a [f64; MAX_DOF]>,
    /// Scale of the gains of each candidate.
    pub scale: &'a [Lanes<L, F>; MAX_DOF],
}

/// Torque (joint side) and growth of the integrator of joint `j`.
#[inline(always)]
pub fn law<const L: usize, const F: bool>(
    law: &Law,
    instant: &Instant<'_, L, F>,
    j: usize,
    q: Lanes<L, F>,
    dq: Lanes<L, F>,
    z: Lanes<L, F>,
) -> (Lanes<L, F>, Lanes<L, F>) {
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
    /// Of a controller, if it is such a one.
    pub fn of(controller: &Controller) -> Option<Self> {
        let plain = |law: &Law| law.integral == 0.0 && law.limit == f64::INFINITY;
        if controller.feedforward.is_some() || !controller.laws.iter().all(plain) {
            return None;
        }
        let all = |pick: fn(&Law) -> f64| std::array::from_fn(|j| controller.laws.get(j).map_or(0.0, pick));
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
    pub fn torques<const L: usize, const F: bool, S: Shape>(
        &self,
        geometry: &Geometry<S>,
        target: &Target,
        scale: &[Lanes<L, F>; MAX_DOF],
        q: &[Lanes<L, F>; MAX_DOF],
        dq: &[Lanes<L, F>; MAX_DOF],
        tau: &mut [Lanes<L, F>; MAX_DOF],
    ) {
        if L == 1 && F {
            // A single lane takes its joints side by side.
            for first in (0..geometry.n()).step_by(WIDTH) {
                let block = |values: &[f64; MAX_DOF]| Lanes::<WIDTH, F>::from_slice(&values[first..]);
                let [q, dq, scale] = [q, dq, scale].map(|values| side_by_side(values, first));
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

/// What a law without integrator asks for: gains of position, velocity and acceleration, and what they aim at.
#[inline(always)]
fn compared<const L: usize, const F: bool>(
    [position, velocity, acceleration]: [Lanes<L, F>; 3],
    [aim_q, aim_dq, aim_ddq]: [Lanes<L, F>; 3],
    q: Lanes<L, F>,
    dq: Lanes<L, F>,
) -> Lanes<L, F> {
    (aim_q - q).mul_add(position, (aim_dq - dq).mul_add(velocity, acceleration * aim_ddq))
}

/// Memory of a digital controller on lanes.
#[derive(Debug, Clone)]
pub struct Sampled<const L: usize, const F: bool> {
    /// Measured positions, newest first.
    history: Vec<[Lanes<L, F>; MAX_DOF]>,
    /// Outputs on their way, newest first.
    queue: Vec<[Lanes<L, F>; MAX_DOF]>,
    z: [Lanes<L, F>; MAX_DOF],
    differences: Vec<f64>,
}

impl<const L: usize, const F: bool> Sampled<L, F> {
    /// Before the first sample: the robot has moved with its initial velocity so far, and the outputs were zero.
    pub fn start(digital: &Digital, q: &[Lanes<L, F>; MAX_DOF], dq: &[Lanes<L, F>; MAX_DOF]) -> Self {
        let taps = digital.smoothing.len();
        let before = |k: usize| std::array::from_fn(|j| q[j] - dq[j].scale(digital.period * k as f64));
        let weight = |k: usize| digital.smoothing.get(k).copied().unwrap_or(0.0);
        Self {
            // The first sample pushes all of them one place back.
            history: (1..=taps + 1).map(before).collect(),
            queue: vec![[Lanes::zero(); MAX_DOF]; digital.delay + 1],
            z: [Lanes::zero(); MAX_DOF],
            differences: (0..=taps)
                .map(|k| (weight(k) - if k > 0 { weight(k - 1) } else { 0.0 }) / digital.period)
                .collect(),
        }
    }

    /// Integrators of the joints.
    pub fn integrators(&self) -> [Lanes<L, F>; MAX_DOF] {
        self.z
    }

    /// Weights of the newest, the one before, ... position in the velocity.
    pub fn differences(&self) -> &[f64] {
        &self.differences
    }

    /// Position and velocity of joint `j` as the last sample saw them.
    #[inline(always)]
    pub fn measured(&self, j: usize) -> (Lanes<L, F>, Lanes<L, F>) {
        let mut velocity = Lanes::zero();
        for (difference, positions) in self.differences.iter().zip(&self.history) {
            velocity = positions[j].mul_add(Lanes::splat(*difference), velocity);
        }
        (self.history[0][j], velocity)
    }

    /// One sample: takes the positions, and returns the torques that act until the next.
    #[inline(always)]
    pub fn step(
        &mut self,
        laws: &[Law],
        digital: &Digital,
        instant: &Instant<'_, L, F>,
        q: &[Lanes<L, F>; MAX_DOF],
    ) -> [Lanes<L, F>; MAX_DOF] {
        self.history.rotate_right(1);
        self.queue.rotate_right(1);
        for (j, one) in laws.iter().enumerate() {
            let resolution = digital.resolution[j];
            let measured = if resolution > 0.0 {
                q[j].map(|value| (value / resolution).round() * resolution)
            } else {
                q[j]
            };
            self.history[0][j] = measured;
            let (_, velocity) = self.measured(j);
            let (torque, dz) = law(one, instant, j, measured, velocity, self.z[j]);
            self.z[j] = dz.mul_add(Lanes::splat(digital.period), self.z[j]);
            self.queue[0][j] = torque;
        }
        self.queue[digital.delay]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::{Kernel, dispatch_on};
    use crate::robot::{Friction, Joint, JointKind, Robot};
    use crate::simulate::tests::PD;

    fn digital() -> Digital {
        Digital { period: 1e-3, delay: 0, smoothing: vec![1.0], resolution: vec![0.0; 2] }
    }

    /// Torques by [`law`] and by [`PlainLaws`].
    struct Both<'a> {
        controller: &'a Controller,
        target: &'a Target,
        numbers: &'a [f64],
    }

    impl Kernel for Both<'_> {
        type Output = [Vec<Vec<f64>>; 2];
        #[inline(always)]
        fn run<const L: usize, const F: bool>(self) -> Self::Output {
            let n = self.controller.laws.len();
            let joints = vec![Joint { kind: JointKind::Revolute, alpha: 0.0, d: 0.0, theta: 0.0, r: 0.0 }; n];
            let unit: Vec<Vec<f64>> =
                (0..n).map(|i| (0..n).map(|j| f64::from(u8::from(i == j))).collect()).collect();
            let geometry = Geometry::of(&Robot::new(joints, [0.0; 3], &unit, Friction::sign(n)).unwrap());
            let lanes = |part: usize| -> [Lanes<L, F>; MAX_DOF] {
                std::array::from_fn(|j| Lanes(std::array::from_fn(|l| self.numbers[(part * 12 + j) * 4 + l])))
            };
            let [q, dq, scale] = [0, 1, 2].map(lanes);
            let mut plain = [Lanes::zero(); MAX_DOF];
            PlainLaws::of(self.controller).unwrap().torques(
                &geometry,
                self.target,
                &scale,
                &q,
                &dq,
                &mut plain,
            );
            let instant = Instant { target: self.target, feedforward: None, scale: &scale };
            let by_law = |j: usize| law(&self.controller.laws[j], &instant, j, q[j], dq[j], Lanes::zero()).0;
            [
                (0..n).map(|j| plain[j].to_array().to_vec()).collect(),
                (0..n).map(|j| by_law(j).to_array().to_vec()).collect(),
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
            let [plain, by_law] = dispatch_on::<1, _>(both());
            assert_eq!(plain, by_law);
            let [plain, by_law] = dispatch_on::<WIDTH, _>(both());
            assert_eq!(plain, by_law);
            assert!(plain.iter().flatten().any(|u| u.abs() > 1.0));
            let mut limited = laws;
            limited[n - 1].limit = 5.0;
            assert!(PlainLaws::of(&Controller::new(limited, Timing::Continuous, None).unwrap()).is_none());
        }
    }

    #[test]
    fn wrong_controllers_say_what_is_wrong() {
        let message = |second: Law, timing: Timing, feedforward: Option<Signal>| {
            Controller::new(vec![PD, second], timing, feedforward).unwrap_err().to_string()
        };
        let law = |second: Law| message(second, Timing::Continuous, None);
        assert_eq!(
            law(Law { velocity: f64::NAN, ..PD }),
            "the velocity gain of joint 2 is not a finite number"
        );
        assert_eq!(
            law(Law { integrated_velocity: f64::INFINITY, ..PD }),
            "the integrator of joint 2 is not a finite number"
        );
        assert_eq!(law(Law { limit: 0.0, ..PD }), "the saturation of joint 2 must be positive, got 0");
        assert!(law(Law { limit: f64::NAN, ..PD }).starts_with("the saturation of joint 2"));
        assert!(law(Law { gain: 0.0, ..PD }).starts_with("the drive gain of joint 2 is zero"));
        let timing = |digital: Digital| message(PD, Timing::Digital(digital), None);
        assert!(timing(Digital { period: -1.0, ..digital() }).ends_with("must be positive, got -1"));
        let no_weights = timing(Digital { smoothing: vec![], ..digital() });
        assert_eq!(no_weights, "the smoothing of the velocity needs one or more finite weights");
        assert_eq!(timing(Digital { smoothing: vec![1.0, f64::NAN], ..digital() }), no_weights);
        assert!(timing(Digital { resolution: vec![0.0], ..digital() }).ends_with("one per joint, got 1"));
        let signal = |signal: Signal| message(PD, Timing::Continuous, Some(signal));
        assert_eq!(
            signal(Signal { rate: 1.0, n: 1, values: vec![0.0; 2] }),
            "the torque fed forward needs samples of 2 joints, got 1"
        );
        for (rate, value) in [(0.0, 0.0), (1.0, f64::NAN)] {
            assert_eq!(
                signal(Signal { rate, n: 2, values: vec![0.0, value] }),
                "the torque fed forward needs a positive rate and finite samples"
            );
        }
    }

    #[test]
    fn a_signal_is_straight_between_its_samples_and_holds_beyond_them() {
        let signal = Signal { rate: 2.0, n: 2, values: vec![1.0, 10.0, 3.0, 20.0, -1.0, 0.0] };
        let mut out = [0.0; MAX_DOF];
        for (t, want) in [
            (-1.0, [1.0, 10.0]),
            (0.25, [2.0, 15.0]),
            (0.5, [3.0, 20.0]),
            (0.875, [0.0, 5.0]),
            (1.0, [-1.0, 0.0]),
            (9.0, [-1.0, 0.0]),
        ] {
            signal.at(t, &mut out);
            assert_eq!(out[..2], want, "{t}");
        }
        let one = Signal { rate: 2.0, n: 1, values: vec![4.0] };
        one.at(3.0, &mut out);
        assert_eq!(out[0], 4.0);
    }

    #[test]
    fn only_a_digital_controller_has_a_period() {
        let of = |timing| Controller::new(vec![PD; 2], timing, None).unwrap().period();
        assert_eq!(of(Timing::Continuous), None);
        assert_eq!(of(Timing::Digital(digital())), Some(1e-3));
    }
}
