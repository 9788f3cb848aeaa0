//! When the simulation steps, records and controls: decided before the run, so that all lanes share it.
//!
//! Friction makes the equation stiff where a velocity is near zero, at reversals and at rest: there the step is as fine as
//! the joint needs, elsewhere coarse. Where that is follows from the reference, or from a motion nearer to that of the robot,
//! such as the measured one: a robot reverses later than its reference. Every instant at which something happens (a record, a
//! sample of the controller, a jump of the reference's acceleration) is the end of a step.

use crate::closed_loop::reference::{Reference, Target};
use crate::robot::Robot;
use thiserror::Error;

/// Steps that cannot be taken.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ScheduleError {
    /// A rate or a step of zero or less.
    #[error("{what} must be positive, got {value}")]
    NotPositive {
        /// Name of the quantity.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// Nothing to simulate.
    #[error("a simulation needs at least 2 records, got {got}")]
    TooShort {
        /// Records asked for.
        got: usize,
    },
    /// Another number of joints.
    #[error("the reference and the limits of slow motion need {want} joints, got {got}")]
    Joints {
        /// Joints of the robot.
        want: usize,
        /// Joints given.
        got: usize,
    },
    /// Steps far too small.
    #[error("{got:.1e} steps are too many: the step is too small for the length of the run")]
    TooManySteps {
        /// Steps that it would take.
        got: f64,
    },
    /// A reference that does not last.
    #[error("the reference starts at {first} s and ends at {last} s, before the run, at {end} s")]
    Reference {
        /// First time of the reference.
        first: f64,
        /// Last time of the reference.
        last: f64,
        /// End of the run.
        end: f64,
    },
}

/// Steps of equal length between two instants.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// Time of its start (s).
    pub start: f64,
    /// Length of a step (s).
    pub step: f64,
    /// Number of steps.
    pub steps: usize,
    /// Whether a record is taken at its start.
    pub record: bool,
    /// Whether a digital controller samples at its start.
    pub control: bool,
}

/// Segments of a run, and how it ends.
#[derive(Debug, Clone, PartialEq)]
pub struct Schedule {
    segments: Vec<Segment>,
    end: f64,
    records: usize,
    last_control: bool,
}

/// Settings of a schedule.
#[derive(Debug, Clone, Copy)]
pub struct Plan<'a> {
    /// Records per second; the first is at time 0.
    pub rate: f64,
    /// Number of records; the run ends with the last.
    pub records: usize,
    /// Sample time of a digital controller (s).
    pub period: Option<f64>,
    /// Largest step (s).
    pub coarse: f64,
    /// Largest step where the velocity of a joint, or of its coupled motor, is near zero (s), per joint.
    pub fine: &'a [f64],
    /// Speed that counts as near zero, per joint (rad/s or m/s), for the joint and for its coupled motor.
    pub slow: &'a [f64],
    /// The motion whose velocities count; the reference if None.
    pub motion: Option<&'a Reference>,
}

/// Distance of two instants, as a share of the shortest interval, below which they coincide.
const SAME: f64 = 1e-6;
/// Upper bound of the steps of a run: more are a mistake in the settings.
const MOST_STEPS: f64 = 1e10;

impl Schedule {
    /// Decides the steps.
    pub fn new(robot: &Robot, reference: &Reference, plan: Plan<'_>) -> Result<Self, ScheduleError> {
        for (what, value) in [("rate", plan.rate), ("step", plan.coarse)]
            .into_iter()
            .chain(plan.fine.iter().map(|&fine| ("fine step", fine)))
            .chain(plan.period.map(|p| ("sample time", p)))
        {
            if !(value > 0.0 && value.is_finite()) {
                return Err(ScheduleError::NotPositive { what, value });
            }
        }
        if plan.records < 2 {
            return Err(ScheduleError::TooShort { got: plan.records });
        }
        let motion = plan.motion.unwrap_or(reference);
        for got in [reference.n_dof(), motion.n_dof(), plan.slow.len(), plan.fine.len()] {
            if got != robot.n_dof() {
                return Err(ScheduleError::Joints { want: robot.n_dof(), got });
            }
        }
        let end = (plan.records - 1) as f64 / plan.rate;
        let finest = plan.fine.iter().copied().fold(plan.coarse, f64::min);
        let most = end / finest.min(plan.period.unwrap_or(f64::INFINITY));
        if most.is_nan() || most + plan.records as f64 > MOST_STEPS {
            return Err(ScheduleError::TooManySteps { got: most });
        }
        let slack = SAME / plan.rate;
        for (first, last) in [reference.span(), motion.span()] {
            if first > slack || last < end - slack {
                return Err(ScheduleError::Reference { first, last, end });
            }
        }
        let mut speeds = Speeds { robot, motion, plan, piece: 0 };
        let mut segments = Vec::new();
        let marks = marks(reference, plan, end);
        for pair in marks.windows(2) {
            let (from, to) = (&pair[0], &pair[1]);
            let length = to.time - from.time;
            // Long intervals are looked at in parts no longer than a coarse step.
            let parts = count(length, plan.coarse);
            for part in 0..parts {
                let start = from.time + length * part as f64 / parts as f64;
                let end = if part + 1 == parts {
                    to.time
                } else {
                    from.time + length * (part + 1) as f64 / parts as f64
                };
                let steps = count(end - start, speeds.step(start, end));
                segments.push(Segment {
                    start,
                    step: (end - start) / steps as f64,
                    steps,
                    record: part == 0 && from.record,
                    control: part == 0 && from.control,
                });
            }
        }
        let last_control = marks.last().is_some_and(|mark| mark.control);
        Ok(Self { segments, end, records: plan.records, last_control })
    }

    /// In order of time.
    pub fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// Time of the last record (s).
    pub fn end(&self) -> f64 {
        self.end
    }

    /// Number of records.
    pub fn records(&self) -> usize {
        self.records
    }

    /// Whether a digital controller samples at the end.
    pub fn last_control(&self) -> bool {
        self.last_control
    }

    /// Times at which the steps begin, and the end.
    pub fn edges(&self) -> Vec<f64> {
        let of = |s: &Segment| {
            let Segment { start, step, steps, .. } = *s;
            (0..steps).map(move |k| (k as f64).mul_add(step, start))
        };
        self.segments.iter().flat_map(of).chain(std::iter::once(self.end)).collect()
    }

    /// Steps in all.
    pub fn steps(&self) -> usize {
        self.segments.iter().map(|segment| segment.steps).sum()
    }

    /// The same with every step divided into `parts`.
    #[must_use]
    pub fn divided(&self, parts: usize) -> Self {
        let segments = self
            .segments
            .iter()
            .map(|s| Segment { step: s.step / parts as f64, steps: s.steps * parts, ..*s })
            .collect();
        Self { segments, ..*self }
    }
}

/// Steps of at most `step` in `length`.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // `MOST_STEPS` has been checked
fn count(length: f64, step: f64) -> usize {
    ((length / step - SAME).ceil() as usize).max(1)
}

/// An instant at which something happens.
struct Mark {
    time: f64,
    record: bool,
    control: bool,
}

fn marks(reference: &Reference, plan: Plan<'_>, end: f64) -> Vec<Mark> {
    let mut marks: Vec<Mark> = (0..plan.records)
        .map(|k| Mark { time: k as f64 / plan.rate, record: true, control: false })
        .collect();
    let shortest = plan.period.unwrap_or(f64::INFINITY).min(1.0 / plan.rate);
    if let Some(period) = plan.period {
        let samples = count(end, period) + 1;
        let times = (0..samples).map(|k| k as f64 * period).filter(|&t| t <= end + SAME * shortest);
        marks.extend(times.map(|time| Mark { time, record: false, control: true }));
    }
    let inside = reference.breaks().iter().filter(|&&t| t > 0.0 && t < end);
    marks.extend(inside.map(|&time| Mark { time, record: false, control: false }));
    marks.sort_by(|a, b| a.time.total_cmp(&b.time));
    let mut merged: Vec<Mark> = Vec::with_capacity(marks.len());
    for mark in marks {
        match merged.last_mut() {
            Some(before) if mark.time - before.time < SAME * shortest => {
                before.record |= mark.record;
                before.control |= mark.control;
            }
            _ => merged.push(mark),
        }
    }
    merged
}

/// The speeds of joints and coupled motors in a motion.
struct Speeds<'a> {
    robot: &'a Robot,
    motion: &'a Reference,
    plan: Plan<'a>,
    piece: usize,
}

impl Speeds<'_> {
    /// Largest step between two times: that of the joint that needs the smallest, of those near zero or passing through it.
    fn step(&mut self, start: f64, end: f64) -> f64 {
        let (mut a, mut b) = (Target::zero(), Target::zero());
        self.motion.at(start, &mut self.piece, &mut a);
        self.motion.at(end, &mut self.piece, &mut b);
        let Plan { slow, fine, coarse, .. } = self.plan;
        let mut step = coarse;
        let mut look = |j: usize, before: f64, after: f64| {
            let near = before.abs().min(after.abs()) <= slow[j] || (before > 0.0) != (after > 0.0);
            if slow[j] > 0.0 && near {
                step = step.min(fine[j]);
            }
        };
        for j in 0..self.robot.n_dof() {
            look(j, a.dq[j], b.dq[j]);
        }
        for coupled in self.robot.coupled() {
            let m = coupled.motor;
            let speed = |target: &Target| {
                coupled.others.iter().fold(target.dq[m], |sum, &(i, c)| c.mul_add(target.dq[i], sum))
            };
            look(m, speed(&a), speed(&b));
        }
        step
    }
}
