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

/// What a schedule is made of.
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
    /// What near zero is, per joint (rad/s or m/s): of the joint's speed, and of the speed of its coupled motor.
    pub slow: &'a [f64],
    /// The motion whose velocities count; the reference if None.
    pub motion: Option<&'a Reference>,
}

/// Instants closer than this share of the shortest interval are one.
const SAME: f64 = 1e-6;
/// Most steps of a run: beyond, the plan is a mistake.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::closed_loop::point_to_point::PointToPoint;
    use crate::robot::{Friction, Joint, JointKind};

    fn robot() -> Robot {
        let joint = Joint { kind: JointKind::Prismatic, alpha: 0.0, d: 0.0, theta: 0.0, r: 0.0 };
        Robot::new(vec![joint], [0.0; 3], &[vec![1.0]], Friction::sign(1)).unwrap()
    }

    /// 1 s at rest, 0 to 1 in 0.25 + 1.75 + 0.25 s, 1 s at rest.
    fn reference() -> Reference {
        let moves = PointToPoint { points: &[0.0, 1.0], velocity: &[0.5], acceleration: &[2.0], dwell: 1.0 };
        Reference::point_to_point(1, moves).unwrap()
    }

    fn plan(slow: &[f64]) -> Plan<'_> {
        Plan { rate: 100.0, records: 426, period: None, coarse: 5e-3, fine: &[1e-3], slow, motion: None }
    }

    #[test]
    fn segments_follow_each_other_and_end_with_the_last_record() {
        let schedule = Schedule::new(&robot(), &reference(), plan(&[0.05])).unwrap();
        let mut t = 0.0;
        for segment in schedule.segments() {
            assert!((segment.start - t).abs() < 1e-12);
            t = segment.start + segment.step * segment.steps as f64;
        }
        assert!((t - schedule.end()).abs() < 1e-12 && (t - 4.25).abs() < 1e-12);
        assert_eq!(schedule.segments().iter().filter(|s| s.record).count() + 1, 426);
        assert_eq!(schedule.divided(2).steps(), 2 * schedule.steps());
    }

    #[test]
    fn rest_has_fine_steps_and_motion_coarse_ones() {
        let schedule = Schedule::new(&robot(), &reference(), plan(&[0.05])).unwrap();
        let step_at = |t: f64| schedule.segments().iter().rfind(|s| s.start <= t).map(|s| s.step).unwrap();
        assert!((step_at(0.5) - 1e-3).abs() < 1e-12);
        assert!((step_at(2.0) - 5e-3).abs() < 1e-12);
        assert!((step_at(4.0) - 1e-3).abs() < 1e-12);
        let coarse = Schedule::new(&robot(), &reference(), plan(&[0.0])).unwrap();
        assert_eq!(coarse.steps(), 850);
    }

    #[test]
    fn the_motion_decides_where_steps_are_fine_and_the_joint_how_fine() {
        // The same 2.25 s of motion, half a second later than the reference; two joints, of which only the first moves.
        let joint = Joint { kind: JointKind::Prismatic, alpha: 0.0, d: 0.0, theta: 0.0, r: 0.0 };
        let robot =
            Robot::new(vec![joint, joint], [0.0; 3], &[vec![1.0, 0.0], vec![0.0, 1.0]], Friction::sign(2))
                .unwrap();
        let moves = |dwell: f64| {
            let points = [0.0, 0.0, 1.0, 1.0];
            let moves = PointToPoint { points: &points, velocity: &[0.5; 2], acceleration: &[2.0; 2], dwell };
            Reference::point_to_point(2, moves).unwrap()
        };
        let (reference, motion) = (moves(1.0), moves(1.5));
        let plan = |fine, slow| Plan { fine, slow, motion: Some(&motion), ..plan(&[]) };
        let step_at = |schedule: &Schedule, t: f64| {
            schedule.segments().iter().rfind(|s| s.start <= t).map(|s| s.step).unwrap()
        };
        let schedule = Schedule::new(&robot, &reference, plan(&[2e-3, 1e-3], &[0.05, 0.0])).unwrap();
        // The reference moves, the motion does not yet; 5 ms are divided into steps of at most 2 ms.
        assert!((step_at(&schedule, 1.4) - 5e-3 / 3.0).abs() < 1e-12);
        assert!((step_at(&schedule, 2.0) - 5e-3).abs() < 1e-12);
        let both = Schedule::new(&robot, &reference, plan(&[2e-3, 1e-3], &[0.05, 0.05])).unwrap();
        assert!((step_at(&both, 1.4) - 1e-3).abs() < 1e-12);
        assert!(Schedule::new(&robot, &reference, plan(&[1e-3], &[0.05, 0.05])).is_err());
    }

    #[test]
    fn records_and_controller_may_have_any_rates() {
        let plan = Plan { period: Some(0.003), ..plan(&[0.0]) };
        let schedule = Schedule::new(&robot(), &reference(), plan).unwrap();
        let controls: Vec<f64> = schedule.segments().iter().filter(|s| s.control).map(|s| s.start).collect();
        assert_eq!(controls.len() + usize::from(schedule.last_control()), 1417);
        assert!(controls.iter().enumerate().all(|(k, t)| (t - 0.003 * k as f64).abs() < 1e-9));
        assert!(schedule.segments().iter().all(|s| s.step <= 5e-3 + 1e-12 && s.step > 1e-7));
        // 0.03 s and its multiples are both.
        assert!(schedule.segments().iter().any(|s| s.record && s.control && (s.start - 0.03).abs() < 1e-12));
    }

    #[test]
    fn wrong_plans_say_what_is_wrong() {
        let message = |plan: Plan<'_>| Schedule::new(&robot(), &reference(), plan).unwrap_err().to_string();
        assert!(
            message(Plan { records: 600, ..plan(&[0.0]) })
                .contains("ends at 4.25 s, before the run, at 5.99 s")
        );
        assert!(message(Plan { coarse: 0.0, ..plan(&[0.0]) }).contains("step must be positive, got 0"));
        assert!(message(Plan { fine: &[1e-15], ..plan(&[0.0]) }).contains("steps"));
        assert!(message(Plan { records: 1, ..plan(&[0.0]) }).contains("at least 2 records"));
    }
}
