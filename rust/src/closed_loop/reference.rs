//! The reference of a closed loop: positions, velocities and accelerations as pieces of fifth degree.
//!
//! One form for every kind of reference: samples, Fourier series, point to point. Between two knots the piece meets position,
//! velocity and acceleration of both, so that the whole is smooth enough for a feed-forward of acceleration; where an
//! acceleration jumps (bang-bang), the knot is a break and the steps of the simulation end on it. Tested here against the
//! closed forms.

use crate::ground::arrays::MAX_DOF;
use crate::ground::lanes::{Lanes, Plain, Set};
use thiserror::Error;

/// A reference motion that cannot be followed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ReferenceError {
    /// No joints, or too many.
    #[error("a reference has 1 to {max} joints, got {got}")]
    Joints {
        /// Joints given.
        got: usize,
        /// Joints possible.
        max: usize,
    },
    /// Nothing to move between.
    #[error("a reference needs at least two different points, got {got}")]
    TooShort {
        /// Points given.
        got: usize,
    },
    /// Too few samples for differences of five neighbours.
    #[error("a sampled reference needs at least 5 samples, got {got}")]
    TooFewSamples {
        /// Samples given.
        got: usize,
    },
    /// Times that do not increase.
    #[error("the times of a reference must increase: knot {knot} does not come after the one before")]
    Time {
        /// Knot, counted from 1.
        knot: usize,
    },
    /// A list of the wrong length.
    #[error("{what} of the reference needs {want} numbers, got {got}")]
    Length {
        /// Name of the list.
        what: &'static str,
        /// Numbers needed.
        want: usize,
        /// Numbers given.
        got: usize,
    },
    /// A NaN or an infinity.
    #[error("{what} of joint {joint} at knot {knot} of the reference is not a finite number")]
    NotFinite {
        /// Name of the quantity.
        what: &'static str,
        /// Joint, counted from 1.
        joint: usize,
        /// Knot, counted from 1.
        knot: usize,
    },
    /// A limit of zero or less.
    #[error("{what} of joint {joint} must be positive, got {value}")]
    NotPositive {
        /// Name of the quantity.
        what: &'static str,
        /// Joint, counted from 1.
        joint: usize,
        /// Its value.
        value: f64,
    },
}

/// Number of joints in one vector of the evaluation.
const BLOCK: usize = 4;
/// Number of coefficients of a piece.
const DEGREES: usize = 6;
/// Coefficients of a piece for neighbouring joints, from the constant ones; zero beyond the last joint.
type Block = [[f64; BLOCK]; DEGREES];

/// A reference motion of `n` joints.
#[derive(Debug, Clone, PartialEq)]
pub struct Reference {
    n: usize,
    times: Vec<f64>,
    /// Piece by piece, as many blocks as the joints fill.
    coefficients: Vec<Block>,
    breaks: Vec<f64>,
}

/// The reference at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target {
    /// Positions (rad or m).
    pub q: [f64; MAX_DOF],
    /// Velocities.
    pub dq: [f64; MAX_DOF],
    /// Accelerations.
    pub ddq: [f64; MAX_DOF],
}

impl Target {
    /// At rest at zero.
    pub fn zero() -> Self {
        Self { q: [0.0; MAX_DOF], dq: [0.0; MAX_DOF], ddq: [0.0; MAX_DOF] }
    }
}

/// A Fourier series per joint: `offset + sum_k sine_k sin(k w t) + cosine_k cos(k w t)`, `w = 2 pi / period`.
#[derive(Debug, Clone, Copy)]
pub struct Fourier<'a> {
    /// Period (s).
    pub period: f64,
    /// Mean positions, one per joint.
    pub offset: &'a [f64],
    /// Sine amplitudes, `(harmonics, n)` row-major.
    pub sine: &'a [f64],
    /// Cosine amplitudes, likewise.
    pub cosine: &'a [f64],
}

impl Reference {
    /// Fifth-degree pieces through knots; `q`, `dq` and `ddq` are `(knots, n)` row-major.
    pub fn from_knots(
        n: usize,
        times: Vec<f64>,
        q: &[f64],
        dq: &[f64],
        ddq: &[f64],
    ) -> Result<Self, ReferenceError> {
        let knots = times.len();
        if n == 0 || n > MAX_DOF {
            return Err(ReferenceError::Joints { got: n, max: MAX_DOF });
        }
        if knots < 2 {
            return Err(ReferenceError::TooShort { got: knots });
        }
        if let Some(k) = (1..knots).find(|&k| times[k] <= times[k - 1] || !times[k].is_finite()) {
            return Err(ReferenceError::Time { knot: k + 1 });
        }
        for (what, values) in [("position", q), ("velocity", dq), ("acceleration", ddq)] {
            if values.len() != knots * n {
                return Err(ReferenceError::Length { what, want: knots * n, got: values.len() });
            }
            if let Some(at) = values.iter().position(|value| !value.is_finite()) {
                return Err(ReferenceError::NotFinite { what, joint: at % n + 1, knot: at / n + 1 });
            }
        }
        let blocks = n.div_ceil(BLOCK);
        let mut coefficients = vec![Block::default(); (knots - 1) * blocks];
        for (k, piece) in coefficients.chunks_exact_mut(blocks).enumerate() {
            let h = times[k + 1] - times[k];
            for j in 0..n {
                let (a, b) = (k * n + j, (k + 1) * n + j);
                let c = quintic(h, [q[a], dq[a], ddq[a]], [q[b], dq[b], ddq[b]]);
                for (degree, value) in c.into_iter().enumerate() {
                    piece[j / BLOCK][degree][j % BLOCK] = value;
                }
            }
        }
        Ok(Self { n, times, coefficients, breaks: Vec::new() })
    }

    /// Through samples at a constant rate (Hz), `(samples, n)` row-major, the first at time 0.
    ///
    /// Velocities and accelerations at the samples come from differences of five neighbours, exact for polynomials of fourth
    /// degree: what is far away has no influence.
    pub fn sampled(n: usize, rate: f64, q: &[f64]) -> Result<Self, ReferenceError> {
        let samples = q.len() / n.max(1);
        if samples < 5 {
            return Err(ReferenceError::TooFewSamples { got: samples });
        }
        let times = (0..samples).map(|k| k as f64 / rate).collect();
        let (mut dq, mut ddq) = (vec![0.0; q.len()], vec![0.0; q.len()]);
        for k in 0..samples {
            let first = k.saturating_sub(2).min(samples - 5);
            let (velocity, acceleration) = FIVE_POINTS[k - first];
            for j in 0..n {
                let five = |weights: [f64; 5]| -> f64 {
                    weights.iter().enumerate().map(|(i, w)| w * q[(first + i) * n + j]).sum()
                };
                dq[k * n + j] = five(velocity) * rate / 12.0;
                ddq[k * n + j] = five(acceleration) * rate * rate / 12.0;
            }
        }
        Self::from_knots(n, times, q, &dq, &ddq)
    }

    /// A Fourier series, with `knots` pieces over `duration` seconds.
    pub fn fourier(
        n: usize,
        series: Fourier<'_>,
        duration: f64,
        knots: usize,
    ) -> Result<Self, ReferenceError> {
        for (what, values) in [("sine", series.sine), ("cosine", series.cosine)] {
            if n == 0 || !values.len().is_multiple_of(n) || values.len() != series.sine.len() {
                return Err(ReferenceError::Length { what, want: series.sine.len(), got: values.len() });
            }
        }
        if series.offset.len() != n {
            return Err(ReferenceError::Length { what: "offset", want: n, got: series.offset.len() });
        }
        let harmonics = series.sine.len() / n;
        let times: Vec<f64> = (0..=knots).map(|k| duration * k as f64 / knots as f64).collect();
        let size = times.len() * n;
        let (mut q, mut dq, mut ddq) = (Vec::with_capacity(size), vec![0.0; size], vec![0.0; size]);
        for (k, t) in times.iter().enumerate() {
            q.extend_from_slice(series.offset);
            for harmonic in 0..harmonics {
                let w = 2.0 * std::f64::consts::PI * (harmonic + 1) as f64 / series.period;
                let (s, c) = (w * t).sin_cos();
                for j in 0..n {
                    let (a, b) = (series.sine[harmonic * n + j], series.cosine[harmonic * n + j]);
                    q[k * n + j] += a * s + b * c;
                    dq[k * n + j] += w * (a * c - b * s);
                    ddq[k * n + j] -= w * w * (a * s + b * c);
                }
            }
        }
        Self::from_knots(n, times, &q, &dq, &ddq)
    }

    /// Pieces of constant acceleration, given as position, velocity and acceleration of each joint at their starts. Every knot but
    /// the first and the last is a break.
    pub(super) fn of_constant_accelerations(
        n: usize,
        times: Vec<f64>,
        pieces: &[Vec<[f64; 3]>],
    ) -> Result<Self, ReferenceError> {
        let zeros = vec![0.0; times.len() * n];
        let mut reference = Self::from_knots(n, times, &zeros, &zeros, &zeros)?;
        for (coefficients, piece) in reference.coefficients.chunks_exact_mut(n.div_ceil(BLOCK)).zip(pieces) {
            for (j, [q, v, a]) in piece.iter().enumerate() {
                let [c0, c1, c2, ..] = &mut coefficients[j / BLOCK];
                (c0[j % BLOCK], c1[j % BLOCK], c2[j % BLOCK]) = (*q, *v, 0.5 * a);
            }
        }
        reference.breaks = reference.times[1..reference.times.len() - 1].to_vec();
        Ok(reference)
    }

    /// The same with jumps at these times, in order: steps of a simulation end there.
    #[must_use]
    pub fn with_breaks(self, breaks: Vec<f64>) -> Self {
        Self { breaks, ..self }
    }

    /// Joints.
    pub fn n_dof(&self) -> usize {
        self.n
    }

    /// First and last time (s).
    pub fn span(&self) -> (f64, f64) {
        (self.times[0], self.times[self.times.len() - 1])
    }

    /// Times at which an acceleration jumps.
    pub fn breaks(&self) -> &[f64] {
        &self.breaks
    }

    /// At time `t`; `piece` is where the search starts and is left where it ended, so that a run walks forward without searching.
    /// Beyond the ends the first and last piece go on.
    pub fn at(&self, t: f64, piece: &mut usize, target: &mut Target) {
        self.at_on::<Plain<1>>(t, piece, target);
    }

    /// The same within a kernel that may use fused operations.
    #[inline(always)]
    pub(crate) fn at_on<V: Set>(&self, t: f64, piece: &mut usize, target: &mut Target) {
        let last = self.times.len() - 2;
        while *piece < last && t >= self.times[*piece + 1] {
            *piece += 1;
        }
        while *piece > 0 && t < self.times[*piece] {
            *piece -= 1;
        }
        let blocks = self.n.div_ceil(BLOCK);
        let s = Lanes::<V::Wide>::splat(t - self.times[*piece]);
        for (k, c) in self.coefficients[*piece * blocks..][..blocks].iter().enumerate() {
            // Not `map` of the array: a call, compiled for the oldest processor.
            let of = |degree: usize| Lanes::<V::Wide>::from_slice(&c[degree]);
            let [c0, c1, c2, c3, c4, c5] = [of(0), of(1), of(2), of(3), of(4), of(5)];
            let q = s.mul_add(s.horner([c5, c4, c3, c2, c1]), c0);
            let dq = s.horner([c5.scale(5.0), c4.scale(4.0), c3.scale(3.0), c2.scale(2.0), c1]);
            let ddq = s.horner([c5.scale(20.0), c4.scale(12.0), c3.scale(6.0), c2.scale(2.0)]);
            q.store(&mut target.q[k * BLOCK..]);
            dq.store(&mut target.dq[k * BLOCK..]);
            ddq.store(&mut target.ddq[k * BLOCK..]);
        }
    }
}

/// Five-point difference weights times 12, in units of the step: velocity and acceleration at each of the samples.
const FIVE_POINTS: [([f64; 5], [f64; 5]); 5] = [
    ([-25.0, 48.0, -36.0, 16.0, -3.0], [35.0, -104.0, 114.0, -56.0, 11.0]),
    ([-3.0, -10.0, 18.0, -6.0, 1.0], [11.0, -20.0, 6.0, 4.0, -1.0]),
    ([1.0, -8.0, 0.0, 8.0, -1.0], [-1.0, 16.0, -30.0, 16.0, -1.0]),
    ([-1.0, 6.0, -18.0, 10.0, 3.0], [-1.0, 4.0, 6.0, -20.0, 11.0]),
    ([3.0, -16.0, 36.0, -48.0, 25.0], [11.0, -56.0, 114.0, -104.0, 35.0]),
];

/// The piece of fifth degree that meets position, velocity and acceleration at both ends.
fn quintic(h: f64, [q0, v0, a0]: [f64; 3], [q1, v1, a1]: [f64; 3]) -> [f64; DEGREES] {
    let (d, w0, w1) = (q1 - q0, v0 * h, v1 * h);
    let (b0, b1) = (a0 * h * h, a1 * h * h);
    let c3 = 10.0 * d - 6.0 * w0 - 4.0 * w1 - 1.5 * b0 + 0.5 * b1;
    let c4 = -15.0 * d + 8.0 * w0 + 7.0 * w1 + 1.5 * b0 - b1;
    let c5 = 6.0 * d - 3.0 * (w0 + w1) + 0.5 * (b1 - b0);
    let h3 = h * h * h;
    [q0, v0, 0.5 * a0, c3 / h3, c4 / (h3 * h), c5 / (h3 * h * h)]
}
