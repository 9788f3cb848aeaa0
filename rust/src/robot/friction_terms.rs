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
//! | `Dahl` | its state z, `dz/dq = (s - z) s / h` with `s` the sign of the motion; zero where no state is known | Dahl 1968 |
//! | `Table` | cubic interpolation of values over speed | the user's own law |
//! | `Spring` | `q` | spring on the joint; its rest position is in the offset |
//! | `Sine`, `Cosine` | `sin(q)`, `cos(q)` | a weight that balances gravity |
//! | `Cylinder` | `dl/dq` | force of a cylinder or gas spring between two points |
//! | `CylinderRate` | `(l - l_0) dl/dq` | its stiffness |
//!
//! The length `l` of a cylinder is `l^2 = a^2 + b^2 - 2 a b cos(q + phi)`, with one end at `a` from the axis on the link before and the
//! other at `b` on the joint's own link. Springs are functions of the position; they stand here because they are terms like all others.
//!
//! `s(dq)` is the sign of the Coulomb friction, with its smoothing and dead zone. Each column has one parameter. Identity that
//! tests them: `W x` equals the inverse model, and the direct model undoes it (`model/friction_terms.rs`).

/// Largest number of friction terms of a robot: one at each joint of the largest, such as a spring, and some more.
pub const MAX_TERMS: usize = 120;

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
    /// State of a joint that remembers its reversals; a function of the path, not of the speed.
    Dahl {
        /// Displacement over which it fades by a factor of e (rad or m).
        width: f64,
    },
    /// A law given by its values.
    Table(Table),
    /// `q`: a spring on the joint.
    Spring,
    /// `sin(q)`.
    Sine,
    /// `cos(q)`.
    Cosine,
    /// `dl/dq`: a constant force along a cylinder.
    Cylinder(Cylinder),
    /// `(l - l_0) dl/dq`: the stiffness of the same.
    CylinderRate(Cylinder),
}

impl Law {
    /// Is its column a function of the position alone?
    pub fn of_position(&self) -> bool {
        matches!(self, Self::Spring | Self::Sine | Self::Cosine | Self::Cylinder(_) | Self::CylinderRate(_))
    }
}

/// Where the two ends of a cylinder are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cylinder {
    /// Distance of the end on the link before from the joint's axis (m).
    pub a: f64,
    /// Distance of the end on the joint's own link (m), other than `a`.
    pub b: f64,
    /// Angle between the two at `q = 0` (rad).
    pub phi: f64,
    /// Length without force of the spring (m).
    pub rest: f64,
}

impl Cylinder {
    /// None unless the numbers are finite, the distances above 0 and not the same.
    pub fn new(a: f64, b: f64, phi: f64, rest: f64) -> Option<Self> {
        let sound = [a, b, phi, rest].iter().all(|value| value.is_finite());
        (sound && a > 0.0 && b > 0.0 && a != b).then_some(Self { a, b, phi, rest })
    }
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

    /// Is it zero at all speeds?
    pub fn is_zero(&self) -> bool {
        self.values.iter().all(|&value| value == 0.0)
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
