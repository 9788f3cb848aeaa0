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
//! Tested against closed forms in `rust/tests/closed_loop/laws.rs` and against the EMPS in the Python tests.

use crate::ground::arrays::MAX_DOF;
use crate::ground::lanes::{Lanes, Set};
use thiserror::Error;

/// Invalid controller.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ControlError {
    /// A NaN or an infinity.
    #[error("{what} of joint {joint} is not a finite number")]
    NotFinite {
        /// Name of the quantity.
        what: &'static str,
        /// Joint, counted from 1.
        joint: usize,
    },
    /// A saturation that lets nothing through.
    #[error("the saturation of joint {joint} must be positive, got {value}")]
    Limit {
        /// Joint, counted from 1.
        joint: usize,
        /// Its value.
        value: f64,
    },
    /// A drive without effect.
    #[error("the drive gain of joint {joint} is zero: its controller has no effect")]
    NoGain {
        /// Joint, counted from 1.
        joint: usize,
    },
    /// A sample time of zero or less.
    #[error("the sample time of the controller must be positive, got {value}")]
    Period {
        /// Its value.
        value: f64,
    },
    /// No smoothing weights, or a NaN among them.
    #[error("the smoothing of the velocity needs one or more finite weights")]
    Smoothing,
    /// Encoder steps that do not fit the joints.
    #[error("the encoder resolution needs {want} entries, one per joint, got {got}")]
    Resolution {
        /// Entries needed.
        want: usize,
        /// Entries given.
        got: usize,
    },
    /// A signal with another number of joints, or none.
    #[error("{what} needs samples of {want} joints, got {got}")]
    Signal {
        /// Name of the signal.
        what: &'static str,
        /// Joints needed.
        want: usize,
        /// Joints given.
        got: usize,
    },
    /// A signal with a NaN.
    #[error("{what} needs a positive rate and finite samples")]
    SignalNotFinite {
        /// Name of the signal.
        what: &'static str,
    },
}

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

impl Digital {
    /// Position of joint `j` as its encoder reads it.
    #[inline(always)]
    pub fn measured<V: Set>(&self, j: usize, q: Lanes<V>) -> Lanes<V> {
        let resolution = self.resolution[j];
        if resolution > 0.0 { q.map(|value| (value / resolution).round() * resolution) } else { q }
    }
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
