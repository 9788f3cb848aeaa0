//! The parts of a simulation: a robot, its reference, controller and schedule, the candidates, and how their runs end.

use super::control::{ControlError, Controller, Signal, Timing, check_signal};
use super::memory::{Initial, Memory};
use super::reference::Reference;
use super::schedule::Schedule;
use super::servo::Servos;
use crate::model::steep::unfit;
use crate::robot::Robot;
use crate::robot::parameters::Layout;
use thiserror::Error;

/// A simulation whose parts do not fit together.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SimulationError {
    /// A list of the wrong length.
    #[error("{what} has {got} entries where {want} are needed")]
    Length {
        /// Name of the list.
        what: &'static str,
        /// Entries needed.
        want: usize,
        /// Entries given.
        got: usize,
    },
    /// Friction that the integrator does not take.
    #[error("integrator \"imex\" is not for this robot: {0}")]
    Integrator(&'static str),
    /// A candidate that follows nothing.
    #[error("a servo follows a reference that is not there")]
    Reference,
    /// A schedule made for another controller.
    #[error("the schedule was made for another controller: only one of them is digital")]
    Schedule,
    /// Invalid signal.
    #[error(transparent)]
    Signal(#[from] ControlError),
}

/// Method of the integration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Integrator {
    /// The classical Runge-Kutta method ([`super::runge_kutta`]).
    #[default]
    RungeKutta,
    /// A method that takes steep friction implicitly ([`super::additive`]).
    Additive,
}

/// A closed loop to simulate; candidates differ only in their parameters and the scale of their gains.
#[derive(Clone, Copy)]
pub struct Simulation<'a> {
    /// The robot.
    pub robot: &'a Robot,
    /// Motion that the controller follows.
    pub reference: &'a Reference,
    /// Its controller.
    pub controller: &'a Controller,
    /// Steps, records and control instants.
    pub schedule: &'a Schedule,
    /// External torque on the joints, joint side.
    pub external: Option<&'a Signal>,
    /// Positions and velocities at time 0; those of the reference if None.
    pub start: Option<(&'a [f64], &'a [f64])>,
    /// What the controller remembers at time 0.
    pub memory: Memory<'a>,
    /// Tracking error (rad or m) that counts as divergence.
    pub divergence: f64,
    /// How it is integrated.
    pub integrator: Integrator,
    /// Position servos in the place of the controller, whose numbers differ between candidates.
    pub servos: Option<&'a Servos<'a>>,
}

/// One candidate.
#[derive(Debug, Clone, Copy)]
pub struct Candidate<'a> {
    /// Standard parameters.
    pub x: &'a [f64],
    /// Scale of the gains, one per joint; the row of [`Servos::width`] numbers where servos take the controller's place.
    pub scale: &'a [f64],
}

/// How the run of a candidate ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Outcome {
    /// With the last record.
    Completed,
    /// With a tracking error above its bound, or one that is not a number.
    Diverged {
        /// When (s).
        time: f64,
        /// Joint, from 0.
        joint: usize,
    },
    /// With an inertia matrix that is not positive definite.
    Indefinite {
        /// When (s).
        time: f64,
        /// Joint whose pivot is not positive, from 0.
        joint: usize,
    },
    /// On request.
    Cancelled {
        /// When (s).
        time: f64,
    },
}

/// Everything fits together.
pub(crate) fn check(
    simulation: &Simulation<'_>,
    candidates: &[Candidate<'_>],
) -> Result<(), SimulationError> {
    let n = simulation.robot.n_dof();
    let count = Layout::of(simulation.robot).count();
    let length = |what, want, got| {
        if want == got { Ok(()) } else { Err(SimulationError::Length { what, want, got }) }
    };
    length("the reference", n, simulation.reference.n_dof())?;
    length("the controller", n, simulation.controller.laws().len())?;
    if let Some((q, dq)) = simulation.start {
        length("the initial positions", n, q.len())?;
        length("the initial velocities", n, dq.len())?;
    }
    if let Initial::Torque(given) | Initial::Integrators(given) = simulation.memory.initial {
        length("the initial state of the controller", n, given.len())?;
    }
    if let Timing::Digital(digital) = simulation.controller.timing() {
        let Memory { outputs, positions, .. } = simulation.memory;
        let (queued, seen) = (digital.delay * n, digital.smoothing.len() * n);
        length("the outputs on their way", queued, outputs.map_or(queued, <[f64]>::len))?;
        length("the positions before the start", seen, positions.map_or(seen, <[f64]>::len))?;
    }
    if let Some(external) = simulation.external {
        check_signal("the external torque", external, n)?;
    }
    if simulation.integrator == Integrator::Additive
        && let Some(reason) = unfit(simulation.robot)
    {
        return Err(SimulationError::Integrator(reason));
    }
    if simulation.controller.period().is_some() != simulation.schedule.segments().iter().any(|s| s.control) {
        return Err(SimulationError::Schedule);
    }
    for candidate in candidates {
        length("x", count, candidate.x.len())?;
        length("the scale of the gains", simulation.servos.map_or(n, Servos::width), candidate.scale.len())?;
        if simulation.servos.is_some_and(|servos| servos.reference(candidate.scale).is_none()) {
            return Err(SimulationError::Reference);
        }
    }
    Ok(())
}
