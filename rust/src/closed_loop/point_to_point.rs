//! References from point to point: bang-bang accelerations, and all joints of a move start and arrive together.
//!
//! Tested in `rust/tests/closed_loop/reference.rs`: limits are kept and points are met.

use crate::closed_loop::reference::{Reference, ReferenceError};

/// Positions to visit, each reached with bang-bang acceleration and, where the way is long enough, a stretch of constant velocity.
#[derive(Debug, Clone, Copy)]
pub struct PointToPoint<'a> {
    /// Positions, `(points, n)` row-major.
    pub points: &'a [f64],
    /// Largest speeds, one per joint.
    pub velocity: &'a [f64],
    /// Accelerations, one per joint.
    pub acceleration: &'a [f64],
    /// Rest at each point (s), the first and the last too.
    pub dwell: f64,
}

impl Reference {
    /// Point to point; all joints of a move start and arrive together, the slowest at its limits.
    pub fn point_to_point(n: usize, moves: PointToPoint<'_>) -> Result<Self, ReferenceError> {
        let PointToPoint { points, velocity, acceleration, dwell } = moves;
        let count = points.len() / n.max(1);
        if count < 2 {
            return Err(ReferenceError::TooShort { got: count });
        }
        for (what, values) in [("velocity", velocity), ("acceleration", acceleration)] {
            if values.len() != n {
                return Err(ReferenceError::Length { what, want: n, got: values.len() });
            }
            if let Some(j) = values.iter().position(|&value| value.is_nan() || value <= 0.0) {
                return Err(ReferenceError::NotPositive { what, joint: j + 1, value: values[j] });
            }
        }
        let mut motion = Moves::from(points[..n].to_vec());
        motion.rest(dwell);
        for move_ in points.windows(2 * n).step_by(n) {
            let (from, to) = move_.split_at(n);
            let profiles: Vec<Trapezium> =
                (0..n).map(|j| Trapezium::between(from[j], to[j], velocity[j], acceleration[j])).collect();
            motion.travel(&profiles, to);
            motion.rest(dwell);
        }
        motion.into_reference(n)
    }
}

/// Trapezoidal velocity of one joint on one move.
#[derive(Debug, Clone, Copy)]
struct Trapezium {
    /// Signed acceleration.
    acceleration: f64,
    /// Time of acceleration, and of braking.
    ramp: f64,
    /// Time at constant velocity.
    cruise: f64,
}

impl Trapezium {
    fn between(from: f64, to: f64, velocity: f64, acceleration: f64) -> Self {
        let way = to - from;
        let ramp = (velocity / acceleration).min((way.abs() / acceleration).sqrt());
        let cruise = if ramp > 0.0 { (way.abs() / (acceleration * ramp) - ramp).max(0.0) } else { 0.0 };
        Self { acceleration: acceleration.copysign(way), ramp, cruise }
    }

    fn duration(&self) -> f64 {
        2.0 * self.ramp + self.cruise
    }

    /// The same way in a longer time.
    fn stretched(self, duration: f64) -> Self {
        if self.duration() <= 0.0 {
            return self;
        }
        let factor = duration / self.duration();
        Self {
            acceleration: self.acceleration / (factor * factor),
            ramp: self.ramp * factor,
            cruise: self.cruise * factor,
        }
    }

    fn acceleration_in(&self, t: f64) -> f64 {
        if t < self.ramp {
            self.acceleration
        } else if t < self.ramp + self.cruise {
            0.0
        } else {
            -self.acceleration
        }
    }
}

/// Pieces of constant acceleration, joint by joint.
struct Moves {
    times: Vec<f64>,
    /// Per piece: position, velocity and acceleration of each joint at its start.
    pieces: Vec<Vec<[f64; 3]>>,
    position: Vec<f64>,
}

impl Moves {
    fn from(position: Vec<f64>) -> Self {
        Self { times: vec![0.0], pieces: Vec::new(), position }
    }

    fn push(&mut self, duration: f64, piece: Vec<[f64; 3]>) {
        self.times.push(self.times[self.times.len() - 1] + duration);
        self.pieces.push(piece);
    }

    fn rest(&mut self, duration: f64) {
        if duration > 0.0 {
            self.push(duration, self.position.iter().map(|&q| [q, 0.0, 0.0]).collect());
        }
    }

    fn travel(&mut self, profiles: &[Trapezium], to: &[f64]) {
        let duration = profiles.iter().map(Trapezium::duration).fold(0.0, f64::max);
        let profiles: Vec<Trapezium> = profiles.iter().map(|p| p.stretched(duration)).collect();
        let mut switches: Vec<f64> =
            profiles.iter().flat_map(|p| [p.ramp, p.ramp + p.cruise]).chain([duration]).collect();
        switches.sort_by(f64::total_cmp);
        let mut state: Vec<[f64; 2]> = self.position.iter().map(|&q| [q, 0.0]).collect();
        let mut start = 0.0;
        for end in switches {
            let h = end - start;
            // Joints that switch at the same time differ by rounding: no piece for that.
            if h <= 1e-12 * duration {
                continue;
            }
            let middle = 0.5 * (start + end);
            let piece: Vec<[f64; 3]> = profiles
                .iter()
                .zip(&state)
                .map(|(p, s)| [s[0], s[1], if p.ramp > 0.0 { p.acceleration_in(middle) } else { 0.0 }])
                .collect();
            for (s, [_, v, a]) in state.iter_mut().zip(&piece) {
                s[0] += h * (v + 0.5 * h * a);
                s[1] += h * a;
            }
            self.push(h, piece);
            start = end;
        }
        self.position.copy_from_slice(to);
    }

    fn into_reference(self, n: usize) -> Result<Reference, ReferenceError> {
        if self.pieces.is_empty() {
            return Err(ReferenceError::TooShort { got: 1 });
        }
        Reference::of_constant_accelerations(n, self.times, &self.pieces)
    }
}
