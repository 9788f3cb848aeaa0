//! Exact derivatives of a simulation with respect to its parameters: the tangent of the closed loop.
//!
//! With the torques of the inverse model, `M ddq = tau - N`, a change `dx` of the parameters changes the accelerations by
//!
//! `M d(ddq) = d(tau) - W dx - (d tau/d q) d(q) - (d tau/d dq) d(dq)`,
//!
//! `W` the regressor and the partial derivatives those of the inverse model at the accelerations found. The same Runge-Kutta
//! steps that move the state move its tangents, so that they are the derivatives of the simulated outputs themselves, not
//! of what these approximate. Differences of simulations in lanes are faster (docs/cloe.md); this is what they are checked with.
//! Identity that tests it: central differences.

use super::partials::partials;
use crate::closed_loop::control::{Controller, Digital, Law, Timing};
use crate::closed_loop::law::{Instant, law};
use crate::closed_loop::memory::{Initial, aimed_at, first_torque, integrator_for};
use crate::closed_loop::observers::Trajectory;
use crate::closed_loop::reference::Target;
use crate::closed_loop::runge_kutta::{Point, Stages};
use crate::closed_loop::sampled::Sampled;
use crate::closed_loop::schedule::Segment;
use crate::closed_loop::simulation::SimulationError;
use crate::closed_loop::simulation::{Candidate, Integrator, Outcome, Simulation, check};
use crate::ground::arrays::MAX_DOF;
use crate::ground::cancel::Cancel;
use crate::ground::lanes::{Lanes, Plain};
use crate::ground::parallel;
use crate::model::direct::Direct;
use crate::model::friction::Drives;
use crate::model::links::Links;
use crate::model::regressor::regressor;
use crate::robot::geometry::Geometry;
use crate::robot::parameters::Layout;

/// One number per joint.
type PerJoint = [Lanes<Plain<1>>; MAX_DOF];
/// How often, in segments and in steps within one, a run asks whether it shall stop.
const PATIENCE: usize = 64;

/// Derivatives of the records of a run along directions in the space of standard parameters, one trajectory each.
///
/// `directions` has rows of as many numbers as there are standard parameters. They are shared out among `threads` threads.
/// Quantisation of encoders has no derivative: positions pass as they are. Nor have jumps: where an integrator is stopped or
/// released, that the parameters shift the instant is not seen. A run that does not complete has no derivatives.
pub fn sensitivities(
    simulation: Simulation<'_>,
    candidate: Candidate<'_>,
    directions: &[&[f64]],
    threads: usize,
    cancel: &Cancel<'_>,
) -> Result<(Outcome, Vec<Trajectory>), SimulationError> {
    check(&simulation, &[candidate])?;
    if simulation.integrator != Integrator::RungeKutta || simulation.robot.friction().remembers() {
        return Err(SimulationError::Derivatives);
    }
    let count = Layout::of(simulation.robot).count();
    for direction in directions {
        if direction.len() != count {
            return Err(SimulationError::Length { what: "a direction", want: count, got: direction.len() });
        }
    }
    let share = directions.len().div_ceil(threads.max(1)).max(1);
    let mut parts = parallel::map(directions.len().div_ceil(share), threads, |part| {
        let some = &directions[part * share..((part + 1) * share).min(directions.len())];
        Run::new(simulation, candidate, some).run(cancel)
    });
    let outcome = parts.first().map_or(Outcome::Completed, |part| part.0);
    let trajectories = parts.iter_mut().flat_map(|part| std::mem::take(&mut part.1)).collect();
    Ok((outcome, trajectories))
}

/// The derivative of the state, and of what follows from it, along one direction.
struct Tangent<'a> {
    /// Entries of the direction that are not zero.
    direction: Vec<(usize, f64)>,
    stages: Stages<Plain<1>>,
    tau: PerJoint,
    dz: PerJoint,
    ddq: PerJoint,
    /// Memory of a digital controller.
    sampled: Option<SampledTangent<'a>>,
    record: Trajectory,
}

/// The derivative of [`Sampled`]: what it remembers is linear in what it has measured.
struct SampledTangent<'a> {
    digital: &'a Digital,
    history: Vec<PerJoint>,
    queue: Vec<PerJoint>,
    z: PerJoint,
}

struct Run<'a> {
    simulation: Simulation<'a>,
    candidate: Candidate<'a>,
    geometry: Geometry,
    drives: Drives<'a>,
    links: Links<Plain<1>>,
    scale: PerJoint,
    direct: Direct<Plain<1>>,
    stages: Stages<Plain<1>>,
    /// Torques that the laws are to give first, where the memory of the controller follows from them.
    begun: Option<PerJoint>,
    tau: PerJoint,
    dz: PerJoint,
    target: Target,
    piece: usize,
    feedforward: [f64; MAX_DOF],
    external: [f64; MAX_DOF],
    /// Regressor of the state at hand.
    w: Vec<f64>,
    tangents: Vec<Tangent<'a>>,
}

impl<'a> Run<'a> {
    fn new(simulation: Simulation<'a>, candidate: Candidate<'a>, directions: &[&[f64]]) -> Self {
        let Simulation { robot, controller, .. } = simulation;
        let n = robot.n_dof();
        let geometry = Geometry::of(robot);
        let nothing = [Lanes::zero(); MAX_DOF];
        let integrates = controller.laws().iter().any(|law| law.integral != 0.0);
        let tangent = |direction: &&[f64]| Tangent {
            direction: direction.iter().copied().enumerate().filter(|&(_, value)| value != 0.0).collect(),
            stages: Stages::new(integrates),
            tau: nothing,
            dz: nothing,
            ddq: nothing,
            sampled: match controller.timing() {
                Timing::Continuous => None,
                Timing::Digital(digital) => Some(SampledTangent {
                    digital,
                    history: vec![nothing; digital.smoothing.len() + 1],
                    queue: vec![nothing; digital.delay + 1],
                    z: nothing,
                }),
            },
            record: Trajectory::default(),
        };
        let mut this = Self {
            simulation,
            candidate,
            geometry,
            drives: Drives::of(robot),
            links: Links::of_one(robot, &geometry, candidate.x),
            scale: nothing,
            direct: Direct::new(&geometry),
            stages: Stages::new(integrates),
            begun: None,
            tau: nothing,
            dz: nothing,
            target: Target::zero(),
            piece: 0,
            feedforward: [0.0; MAX_DOF],
            external: [0.0; MAX_DOF],
            w: vec![0.0; n * candidate.x.len()],
            tangents: directions.iter().map(tangent).collect(),
        };
        this.aim(0.0);
        for j in 0..n {
            let (q, dq) =
                simulation.start.map_or((this.target.q[j], this.target.dq[j]), |(q, dq)| (q[j], dq[j]));
            this.stages.here.q[j] = Lanes::splat(q);
            this.stages.here.dq[j] = Lanes::splat(dq);
            this.scale[j] = Lanes::splat(candidate.scale[j]);
        }
        this.remember();
        this
    }

    /// Sets the integrators, and their tangents where they follow from the parameters.
    fn remember(&mut self) {
        let n = self.geometry.n();
        let simulation = self.simulation;
        let Point { q, dq, .. } = self.stages.here;
        let plain = |values: &PerJoint| values.map(|value| value.lane(0));
        let (state_q, state_dq) = (plain(&q), plain(&dq));
        let target = aimed_at(&simulation, [&q, &dq], &self.target);
        let torque = first_torque(&simulation, [&state_q[..n], &state_dq[..n]], &target, self.candidate.x);
        self.begun = torque.map(|torque| torque.map(Lanes::splat));
        let instant = Self::instant(simulation.controller, &target, &self.feedforward, &self.scale);
        if simulation.memory.initial == Initial::Balance {
            // The torque of balance is linear in the parameters, with the regressor of the initial state.
            let shaped =
                regressor(simulation.robot, &state_q[..n], &state_dq[..n], &target.ddq[..n], &mut self.w);
            debug_assert!(shaped.is_ok());
        }
        let width = self.candidate.x.len();
        for (j, one) in simulation.controller.laws().iter().enumerate() {
            self.stages.here.z[j] = match (simulation.memory.initial, &self.begun) {
                (_, Some(torque)) => integrator_for(one, &instant, j, q[j], dq[j], torque[j]),
                (Initial::Integrators(given), None) => Lanes::splat(given[j]),
                _ => Lanes::zero(),
            };
            let Some(torque) = &self.begun else { continue };
            // Beyond the limit the torque does not follow the parameters.
            if simulation.memory.initial != Initial::Balance
                || torque[j].lane(0).abs() > one.limit * one.gain.abs()
            {
                continue;
            }
            let per_unit = one.gain * one.integral * self.scale[j].lane(0);
            let row = &self.w[j * width..(j + 1) * width];
            for tangent in &mut self.tangents {
                let change: f64 = tangent.direction.iter().map(|&(k, value)| row[k] * value).sum();
                let z = if per_unit == 0.0 { Lanes::zero() } else { Lanes::splat(change / per_unit) };
                tangent.stages.here.z[j] = z;
                if let Some(memory) = &mut tangent.sampled {
                    memory.z[j] = z;
                    if simulation.memory.outputs.is_none() {
                        for output in &mut memory.queue[..memory.digital.delay] {
                            output[j] = Lanes::splat(change);
                        }
                    }
                }
            }
        }
    }

    fn run(mut self, cancel: &Cancel<'_>) -> (Outcome, Vec<Trajectory>) {
        let schedule = self.simulation.schedule;
        let mut sampled = match self.simulation.controller.timing() {
            Timing::Continuous => None,
            Timing::Digital(digital) => {
                let Simulation { controller, memory, .. } = &self.simulation;
                let Point { q, dq, .. } = &self.stages.here;
                let mut sampled = Sampled::start(digital, q, dq);
                let target = aimed_at(&self.simulation, [q, dq], &self.target);
                let instant = Self::instant(controller, &target, &self.feedforward, &self.scale);
                sampled.remember(controller.laws(), digital, memory, &instant, q, self.begun.as_ref());
                Some(sampled)
            }
        };
        let end = schedule.end();
        let last =
            Segment { start: end, step: 0.0, steps: 1, record: true, control: schedule.last_control() };
        for (index, segment) in schedule.segments().iter().chain(std::iter::once(&last)).enumerate() {
            if index % PATIENCE == 0 && cancel.requested() {
                return (Outcome::Cancelled { time: segment.start }, Vec::new());
            }
            if segment.control
                && let Some(sampled) = &mut sampled
            {
                self.sample(sampled, segment.start);
            }
            for step in 0..segment.steps {
                if step % PATIENCE == PATIENCE - 1 && cancel.requested() {
                    return (Outcome::Cancelled { time: segment.start }, Vec::new());
                }
                let t = segment.start + step as f64 * segment.step;
                for stage in 0..4 {
                    let time = Stages::<Plain<1>>::time(stage, t, segment.step);
                    if let Some(joint) = self.evaluate(time) {
                        return (Outcome::Indefinite { time, joint }, Vec::new());
                    }
                    if stage == 0 && step == 0 && segment.record {
                        self.record();
                    }
                    if segment.step == 0.0 {
                        break;
                    }
                    self.stages.advance(self.geometry.n(), stage, segment.step, &self.direct.ddq, &self.dz);
                    for tangent in &mut self.tangents {
                        tangent.stages.advance(
                            self.geometry.n(),
                            stage,
                            segment.step,
                            &tangent.ddq,
                            &tangent.dz,
                        );
                    }
                }
            }
            let lost = (0..self.geometry.n()).find(|&j| {
                let error = (self.stages.here.q[j].lane(0) - self.target.q[j]).abs();
                error.is_nan() || error > self.simulation.divergence
            });
            if let Some(joint) = lost {
                return (Outcome::Diverged { time: segment.start, joint }, Vec::new());
            }
        }
        (Outcome::Completed, self.tangents.into_iter().map(|tangent| tangent.record).collect())
    }

    fn record(&mut self) {
        let n = self.geometry.n();
        for Tangent { stages, ddq, tau, record, .. } in &mut self.tangents {
            let all = [
                (&mut record.q, &stages.here.q),
                (&mut record.dq, &stages.here.dq),
                (&mut record.ddq, &*ddq),
                (&mut record.tau, &*tau),
            ];
            for (out, values) in all {
                out.extend(values[..n].iter().map(|value| value.lane(0)));
            }
        }
    }

    fn aim(&mut self, t: f64) {
        self.simulation.reference.at(t, &mut self.piece, &mut self.target);
        if let Some(signal) = self.simulation.controller.feedforward() {
            signal.at(t, &mut self.feedforward);
        }
    }

    fn instant<'b>(
        controller: &Controller,
        target: &'b Target,
        feedforward: &'b [f64; MAX_DOF],
        scale: &'b PerJoint,
    ) -> Instant<'b, Plain<1>> {
        Instant { target, feedforward: controller.feedforward().map(|_| feedforward), scale }
    }

    /// Torques, accelerations and their tangents at one time; the joint whose pivot is not positive, if there is one.
    fn evaluate(&mut self, t: f64) -> Option<usize> {
        let Simulation { robot, controller, external, .. } = self.simulation;
        let n = self.geometry.n();
        self.aim(t);
        let Point { q, dq, z } = self.stages.here;
        if let Timing::Continuous = controller.timing() {
            let instant = Self::instant(controller, &self.target, &self.feedforward, &self.scale);
            for (j, one) in controller.laws().iter().enumerate() {
                (self.tau[j], self.dz[j]) = law(one, &instant, j, q[j], dq[j], z[j]);
                for tangent in &mut self.tangents {
                    let Point { q: q_, dq: dq_, z: z_ } = &tangent.stages.here;
                    (tangent.tau[j], tangent.dz[j]) =
                        law_tangent(one, &instant, j, [q[j], dq[j], z[j]], [q_[j], dq_[j], z_[j]]);
                }
            }
        }
        if let Some(external) = external {
            external.at(t, &mut self.external);
        }
        self.direct.solve(
            &self.geometry,
            &self.drives,
            &self.links,
            &q,
            &dq,
            &self.tau,
            &self.external,
            false,
        );
        let indefinite = (0..n).find(|&j| !self.direct.pivots[j].all_above(0.0));
        if indefinite.is_some() {
            return indefinite;
        }
        let plain = |values: &PerJoint| values.map(|value| value.lane(0));
        let (q, dq, ddq) = (plain(&q), plain(&dq), plain(&self.direct.ddq));
        let of_state = partials(robot, self.candidate.x, &q[..n], &dq[..n], &ddq[..n]);
        // Shapes have been checked with the candidate.
        let shaped = regressor(robot, &q[..n], &dq[..n], &ddq[..n], &mut self.w);
        debug_assert!(shaped.is_ok());
        let width = self.candidate.x.len();
        for tangent in &mut self.tangents {
            let Point { q: q_, dq: dq_, .. } = &tangent.stages.here;
            let mut torque = tangent.tau;
            for i in 0..n {
                let row = &self.w[i * width..(i + 1) * width];
                let mut sum: f64 = tangent.direction.iter().map(|&(k, value)| row[k] * value).sum();
                for j in 0..n {
                    sum += of_state.position[i][j] * q_[j].lane(0) + of_state.velocity[i][j] * dq_[j].lane(0);
                }
                torque[i] -= Lanes::splat(sum);
            }
            tangent.ddq = self.direct.respond(n, &torque);
        }
        None
    }

    /// One sample of a digital controller, and its tangents.
    fn sample(&mut self, sampled: &mut Sampled<Plain<1>>, t: f64) {
        self.aim(t);
        let controller = self.simulation.controller;
        let instant = Self::instant(controller, &self.target, &self.feedforward, &self.scale);
        let q = self.stages.here.q;
        for tangent in &mut self.tangents {
            let Some(memory) = &mut tangent.sampled else { continue };
            memory.history.rotate_right(1);
            memory.history[0] = tangent.stages.here.q;
        }
        let Timing::Digital(digital) = controller.timing() else { return };
        let before = sampled.integrators();
        self.tau = sampled.step(controller.laws(), digital, &instant, &q);
        for tangent in &mut self.tangents {
            let Some(memory) = &mut tangent.sampled else { continue };
            memory.queue.rotate_right(1);
            for (j, one) in controller.laws().iter().enumerate() {
                let (measured, velocity) = sampled.measured(j);
                let mut velocity_ = Lanes::zero();
                for (difference, positions) in sampled.differences().iter().zip(&memory.history) {
                    velocity_ = positions[j].mul_add(Lanes::splat(*difference), velocity_);
                }
                let state = [measured, velocity, before[j]];
                let (tau, dz) =
                    law_tangent(one, &instant, j, state, [memory.history[0][j], velocity_, memory.z[j]]);
                memory.z[j] = dz.mul_add(Lanes::splat(digital.period), memory.z[j]);
                memory.queue[0][j] = tau;
            }
            tangent.tau = memory.queue[memory.digital.delay];
        }
    }
}

/// Derivative of [`law`] at a state `[q, dq, z]` along a change of it.
fn law_tangent(
    one: &Law,
    instant: &Instant<'_, Plain<1>>,
    j: usize,
    state: [Lanes<Plain<1>>; 3],
    change: [Lanes<Plain<1>>; 3],
) -> (Lanes<Plain<1>>, Lanes<Plain<1>>) {
    let [q_, dq_, z_] = change;
    let mut u = -(q_.scale(one.position) + dq_.scale(one.velocity));
    let mut dz = Lanes::zero();
    if one.integral != 0.0 {
        u += z_.scale(one.integral);
        dz = -(q_.scale(one.integrated_position) + dq_.scale(one.integrated_velocity));
    }
    u = u * instant.scale[j];
    if one.limit < f64::INFINITY {
        let [q, dq, z] = state;
        let free = law(&Law { limit: f64::INFINITY, ..*one }, instant, j, q, dq, z);
        let held = law(one, instant, j, q, dq, z);
        if free.0 != held.0 {
            u = Lanes::zero();
        }
        if free.1 != held.1 {
            dz = Lanes::zero();
        }
    }
    (u.scale(one.gain), dz)
}
