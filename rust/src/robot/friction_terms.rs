//! Friction beyond viscous, Coulomb and offset: terms that a robot file or an experiment chooses joint by joint.
//!
//! | law | column in the joint's row | source |
//! |---|---|---|
//! | `Rest` | 1 where `abs(dq) <= dead zone`, for a dead zone above 0 | stiction at standstill |
//! | `Atan` | `atan(dq / v)` | concave in speed |
//! | `Stribeck` | `s(dq) exp(-(dq / v)^2)` | Stribeck |
//! | `Root` | `sqrt(abs(dq)) s(dq)` | concave in speed, without a velocity to choose |
//! | `Forward` | `max(dq, 0)` | viscous friction that differs by direction |
//! | `Load` | `abs(tau_r) s(dq)`, `tau_r = M(q) ddq + N` without friction | Hamon, Gautier, Garrec 2010 |
//! | `Table` | cubic interpolation of values over speed | the user's own law |
//!
//! `s(dq)` is the sign of the Coulomb friction, with its smoothing and dead zone. Each column has one parameter. Identity that
//! tests them: `W x` equals the inverse model, and the direct model undoes it (`model/friction_terms.rs`).

/// Most terms that a robot can have: five at each joint.
pub const MAX_TERMS: usize = 60;

/// How the torque of a term follows from the speed of its joint.
#[derive(Debug, Clone, PartialEq)]
pub enum Law {
    /// Constant torque at standstill; without a dead zone there is none. So simulations leave it out: their smooth sign holds a
    /// joint at rest.
    Rest,
    /// `atan(dq / velocity)`.
    Atan {
        /// Speed at which half of the torque is reached (rad/s or m/s).
        velocity: f64,
    },
    /// `s(dq) exp(-(dq / velocity)^2)`.
    Stribeck {
        /// Speed at which the torque has fallen to 1/e (rad/s or m/s).
        velocity: f64,
    },
    /// `sqrt(abs(dq)) s(dq)`.
    Root,
    /// `max(dq, 0)`.
    Forward,
    /// `abs(tau_r) s(dq)`, where `tau_r` is the torque of links and rotors.
    Load,
    /// A law given by its values.
    Table(Table),
}

/// One term: a law at a joint.
#[derive(Debug, Clone, PartialEq)]
pub struct Term {
    /// Joint, from 0.
    pub joint: usize,
    /// Its law.
    pub law: Law,
    /// Name of the parameter without the joint's number, such as `Fa`.
    pub name: String,
}

/// Values of a column at equidistant speeds, with a cubic between neighbours; beyond the ends the straight line goes on.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    first: f64,
    step: f64,
    values: Vec<f64>,
    slopes: Vec<f64>,
}

impl Table {
    /// A table of at least four values, at speeds from `first` on, `step` apart (rad/s or m/s). None if a number is not finite, the step
    /// not positive, or there are fewer values.
    pub fn new(first: f64, step: f64, values: Vec<f64>) -> Option<Self> {
        let sound = first.is_finite() && step.is_finite() && step > 0.0 && values.len() >= 4;
        if !sound || values.iter().any(|value| !value.is_finite()) {
            return None;
        }
        let n = values.len();
        // Slopes of the parabola through three neighbours: second order at the ends too.
        let slopes = (0..n)
            .map(|k| {
                let slope = match k {
                    0 => -1.5 * values[0] + 2.0 * values[1] - 0.5 * values[2],
                    k if k == n - 1 => 1.5 * values[k] - 2.0 * values[k - 1] + 0.5 * values[k - 2],
                    k => 0.5 * (values[k + 1] - values[k - 1]),
                };
                slope / step
            })
            .collect();
        Some(Self { first, step, values, slopes })
    }

    /// Speeds between which there are values: the first and the last (rad/s or m/s).
    pub fn range(&self) -> (f64, f64) {
        (self.first, self.first + self.step * (self.values.len() - 1) as f64)
    }

    /// The value at a speed.
    #[inline]
    pub fn at(&self, dq: f64) -> f64 {
        let last = self.values.len() - 1;
        let place = (dq - self.first) / self.step;
        if place <= 0.0 {
            return self.values[0] + self.slopes[0] * (dq - self.first);
        }
        if place >= last as f64 {
            return self.values[last] + self.slopes[last] * (dq - self.range().1);
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // 0 < place < last; NaN becomes 0
        let k = (place as usize).min(last - 1);
        let (u, h) = (place - k as f64, self.step);
        let (a, b, c, d) = (self.values[k], self.values[k + 1], h * self.slopes[k], h * self.slopes[k + 1]);
        let v = 1.0 - u;
        a * ((1.0 + 2.0 * u) * v * v) + b * (u * u * (3.0 - 2.0 * u)) + u * v * (c * v - d * u)
    }
}
