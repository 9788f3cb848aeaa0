//! The closed loop, (4) with its controller and reference, by a Runge-Kutta method: one candidate or thousands.
//!
//! Candidates run side by side in the lanes of a register, and groups of lanes on several threads; none sees another, so
//! the bits do not depend on either number. Tested in `rust/tests/closed_loop/`: order four,
//! energy, power balance, a pendulum against its elliptic functions; and against the EMPS in the Python tests.

use crate::closed_loop::additive::Additive;
use crate::closed_loop::control::{Digital, Timing};
use crate::closed_loop::law::{Instant, PlainLaws, law};
use crate::closed_loop::memory::{Initial, aimed_at, first_torque, integrator_for};
use crate::closed_loop::observers::{Observer, Record};
use crate::closed_loop::reference::Target;
use crate::closed_loop::runge_kutta::{PerJoint, Point, Stages};
use crate::closed_loop::sampled::Sampled;
use crate::closed_loop::schedule::Segment;
use crate::closed_loop::servo::ServoLanes;
use crate::closed_loop::simulation::{Candidate, Outcome, Simulation};
use crate::ground::arrays::MAX_DOF;
use crate::ground::cancel::Cancel;
use crate::ground::dispatch::WIDEST;
use crate::ground::lanes::{Lanes, Set};
use crate::model::direct::Direct;
use crate::model::friction::Drives;
use crate::model::links::Links;
use crate::model::remembered::Remembered;
use crate::model::steep::Steep;
use crate::robot::arm::{Arm, Place, outwards};
use crate::robot::geometry::Geometry;

pub use crate::closed_loop::kernels::{portable, run_as_any, run_group};

/// Number of segments between two checks for a request to stop.
const PATIENCE: usize = 256;
/// Number of steps between two such checks within a segment.
const LONG: usize = 4096;
/// Largest angle (rad) for which the sines of `lanes.rs` keep their digits.
const FARTHEST: f64 = 1e5;

/// The state of a run, and its memory: nothing is allocated once it runs.
pub(super) struct Loop<'a, V: Set, S> {
    simulation: Simulation<'a>,
    geometry: Geometry<S>,
    /// Joints with a motor.
    driven: usize,
    drives: Drives<'a>,
    links: Links<V>,
    scale: PerJoint<V>,
    /// The laws, where they are plain; a digital controller asks for its own.
    plain: Option<PlainLaws>,
    /// Servos in the place of the controller.
    servos: Option<Box<ServoLanes<'a, V>>>,
    /// Lane of the group that this one is, where it is one of several.
    first: usize,
    outcomes: V::Of<Outcome>,
    running: usize,
    stages: Stages<V>,
    /// Torques that the laws are to give first, where the memory of the controller follows from them.
    begun: Option<PerJoint<V>>,
    /// Torques of the drives; those of a digital controller hold between its samples.
    tau: PerJoint<V>,
    dz: PerJoint<V>,
    /// The reference, and the time it was evaluated for.
    target: Target,
    aimed: f64,
    piece: usize,
    feedforward: [f64; MAX_DOF],
    external: [f64; MAX_DOF],
    /// Positions, velocities, accelerations and torques for the observer.
    buffers: [[f64; MAX_DOF * WIDEST]; 4],
}

impl<'a, V: Set, S: Arm> Loop<'a, V, S> {
    #[inline(always)]
    #[allow(clippy::large_stack_arrays)] // a small part of the loop
    pub(super) fn new(
        simulation: Simulation<'a>,
        geometry: &Geometry<S>,
        candidates: &[Candidate<'a>],
        first: usize,
    ) -> Self {
        const { assert!(V::L <= WIDEST, "buffers and costs have room for so many lanes") };
        let n = simulation.robot.n_dof();
        let last = candidates.len().saturating_sub(1);
        // Lanes without a candidate of their own repeat the last one.
        let lane = |pick: fn(&Candidate<'_>, usize) -> f64, k: usize| {
            Lanes::each(|l| pick(&candidates[l.min(last)], k))
        };
        let nothing = [Lanes::zero(); MAX_DOF];
        let x: Vec<Lanes<V>> =
            (0..candidates[0].x.len()).map(|k| lane(|candidate, k| candidate.x[k], k)).collect();
        let integrates = simulation.controller.laws().iter().any(|law| law.integral != 0.0);
        let mut this = Self {
            simulation,
            geometry: *geometry,
            driven: n,
            drives: Drives::of(simulation.robot),
            links: Links::of(simulation.robot, geometry, &x),
            scale: nothing,
            plain: PlainLaws::of(simulation.controller).filter(|_| simulation.servos.is_none()),
            servos: None,
            first,
            outcomes: V::of(|_| Outcome::Completed),
            running: V::L,
            stages: Stages::new(integrates),
            begun: None,
            tau: nothing,
            dz: nothing,
            target: Target::zero(),
            aimed: f64::NAN,
            piece: 0,
            feedforward: [0.0; MAX_DOF],
            external: [0.0; MAX_DOF],
            buffers: [[0.0; MAX_DOF * WIDEST]; 4],
        };
        this.aim(0.0);
        for j in 0..n {
            let (q, dq) =
                simulation.start.map_or((this.target.q[j], this.target.dq[j]), |(q, dq)| (q[j], dq[j]));
            this.stages.here.q[j] = Lanes::splat(q);
            this.stages.here.dq[j] = Lanes::splat(dq);
            this.scale[j] = lane(|candidate, j| candidate.scale[j], j);
        }
        if let Some(servos) = simulation.servos {
            let Point { q, dq, .. } = &mut this.stages.here;
            this.servos = Some(Box::new(ServoLanes::new(servos, candidates, q, dq, &mut this.links)));
        }
        this.remember(candidates);
        this
    }

    /// Number of driven joints. The compiler sees that it is within the arrays.
    #[inline(always)]
    fn n(&self) -> usize {
        if S::KNOWN { self.geometry.n() } else { self.driven.min(MAX_DOF) }
    }

    /// Sets the integrators, and the torques that the memory of a digital controller follows from.
    #[cold]
    fn remember(&mut self, candidates: &[Candidate<'_>]) {
        let n = self.n();
        let simulation = self.simulation;
        let Point { q, dq, .. } = self.stages.here;
        // All lanes begin in one state.
        let state = [q, dq].map(|values| values.map(|value| value.lane(0)));
        let target = aimed_at(&simulation, [&q, &dq], &self.target);
        for l in 0..V::L {
            let x = candidates[l.min(candidates.len().saturating_sub(1))].x;
            let state = [&state[0][..n], &state[1][..n]];
            let Some(torque) = first_torque(&simulation, state, &target, x) else { break };
            let begun = self.begun.get_or_insert([Lanes::zero(); MAX_DOF]);
            for (lanes, value) in begun.iter_mut().zip(torque) {
                lanes.set_lane(l, value);
            }
        }
        let instant = Instant {
            target: &target,
            feedforward: simulation.controller.feedforward().map(|_| &self.feedforward),
            scale: &self.scale,
        };
        for (j, one) in simulation.controller.laws().iter().enumerate() {
            self.stages.here.z[j] = match (simulation.memory.initial, &self.begun) {
                (_, Some(torque)) => integrator_for(one, &instant, j, q[j], dq[j], torque[j]),
                (Initial::Integrators(given), None) => Lanes::splat(given[j]),
                _ => Lanes::zero(),
            };
        }
    }

    /// Memory of a digital controller before its first sample.
    #[cold]
    fn sampled(&self, digital: &Digital) -> Sampled<V> {
        let Simulation { controller, memory, .. } = &self.simulation;
        let Point { q, dq, .. } = &self.stages.here;
        let mut sampled = Sampled::start(digital, q, dq);
        let target = aimed_at(&self.simulation, [q, dq], &self.target);
        let instant = Instant {
            target: &target,
            feedforward: controller.feedforward().map(|_| &self.feedforward),
            scale: &self.scale,
        };
        sampled.remember(controller.laws(), digital, memory, &instant, q, self.begun.as_ref());
        sampled
    }

    /// The whole run. The stages of a step are a loop around the one place that evaluates the model: inlined four times and more
    /// it would take minutes to compile, and fill the cache of instructions.
    #[inline(always)]
    pub(super) fn run<const IMPLICIT: bool>(
        mut self,
        cancel: &Cancel<'_>,
        observer: &mut dyn Observer,
    ) -> V::Of<Outcome> {
        let schedule = self.simulation.schedule;
        let mut sampled = match self.simulation.controller.timing() {
            Timing::Continuous => None,
            Timing::Digital(digital) => Some((digital, self.sampled(digital))),
        };
        // A local variable, not a field of `self`: the compiler then stores no unused value.
        let mut direct = Direct::new(self.simulation.robot, &self.geometry, &self.links);
        let Point { q, dq, .. } = &self.stages.here;
        direct.signs.remembered = Remembered::of(self.simulation.robot, q, dq);
        // The compiler drops what is behind a constant that is false, and nothing less.
        let mut additive =
            IMPLICIT.then(|| Additive::new(self.n(), Steep::of(self.simulation.robot, &self.links)));
        // The last record needs one more evaluation: a segment without length, whose step ends after its first stage.
        let end = schedule.end();
        let last =
            Segment { start: end, step: 0.0, steps: 1, record: true, control: schedule.last_control() };
        let mut records = 0;
        for (index, segment) in schedule.segments().iter().chain(std::iter::once(&last)).enumerate() {
            if index % PATIENCE == 0 && cancel.requested() {
                return self.cancelled(segment.start);
            }
            if index > 0 {
                self.check_tracking(segment.start);
                if self.running == 0 {
                    return self.outcomes;
                }
            }
            if segment.control
                && let Some((digital, sampled)) = &mut sampled
            {
                self.sample(digital, sampled, segment.start);
            }
            for step in 0..segment.steps {
                if step % LONG == LONG - 1 && cancel.requested() {
                    return self.cancelled(segment.start);
                }
                let t = segment.start + step as f64 * segment.step;
                for stage in 0..4 {
                    let time = if IMPLICIT {
                        Additive::<V, S>::time(stage, t, segment.step)
                    } else {
                        Stages::<V>::time(stage, t, segment.step)
                    };
                    self.evaluate(&mut direct, time, stage > 0);
                    if stage == 0 && step == 0 && segment.record {
                        self.hand_over(records, &direct.ddq, observer);
                        records += 1;
                    }
                    if segment.step == 0.0 {
                        break;
                    }
                    if IMPLICIT {
                        self.advance_additive(additive.as_mut(), stage, segment.step, &direct);
                    } else {
                        let n = self.n();
                        self.stages.advance(n, stage, segment.step, &direct.ddq, &self.dz);
                    }
                }
            }
        }
        self.outcomes
    }

    #[inline(always)]
    fn advance_additive(
        &mut self,
        additive: Option<&mut Additive<'a, V, S>>,
        stage: usize,
        h: f64,
        direct: &Direct<V, S>,
    ) {
        if let Some(additive) = additive {
            additive.advance(self.n(), stage, h, direct, &self.dz, &mut self.stages.here);
        }
    }

    /// Gives the observer where the run stands, with the torques and accelerations evaluated there.
    #[inline(always)]
    fn hand_over(&mut self, k: usize, ddq: &PerJoint<V>, observer: &mut dyn Observer) {
        let n = self.n();
        let Point { q, dq, .. } = &self.stages.here;
        outwards!(S, n, place => {
            let j = place.index();
            for (buffer, values) in self.buffers.iter_mut().zip([q, dq, ddq, &self.tau]) {
                values[j].store(&mut buffer[j * V::L..]);
            }
        });
        let [q, dq, ddq, tau] = &self.buffers;
        let (q, dq, ddq, tau) = (&q[..n * V::L], &dq[..n * V::L], &ddq[..n * V::L], &tau[..n * V::L]);
        observer.record(k, &Record { first: self.first, lanes: V::L, q, dq, ddq, tau });
    }

    /// Torques and accelerations at one time; `near` the positions of the evaluation that started the step, or at them.
    #[inline(always)]
    fn evaluate(&mut self, direct: &mut Direct<V, S>, t: f64, near: bool) {
        let Simulation { controller, external, .. } = self.simulation;
        let n = self.n();
        if let Timing::Continuous = controller.timing() {
            self.aim(t);
            let Point { q, dq, z } = &self.stages.here;
            if let Some(laws) = &self.plain {
                laws.torques(&self.geometry, &self.target, &self.scale, q, dq, &mut self.tau);
            } else if let Some(servos) = &mut self.servos {
                servos.torques(t, q, dq, &mut self.tau);
            } else {
                let instant = Instant {
                    target: &self.target,
                    feedforward: controller.feedforward().map(|_| &self.feedforward),
                    scale: &self.scale,
                };
                for (j, one) in controller.laws()[..n].iter().enumerate() {
                    (self.tau[j], self.dz[j]) = law(one, &instant, j, q[j], dq[j], z[j]);
                }
            }
        }
        if let Some(external) = external {
            external.at(t, &mut self.external);
        }
        let Self { geometry, drives, links, stages, tau, .. } = self;
        if let Some(remembered) = &mut direct.signs.remembered {
            remembered.follow(&stages.here.q, !near);
        }
        direct.solve(geometry, drives, links, &stages.here.q, &stages.here.dq, tau, &self.external, near);
        if let Some(servos) = &mut self.servos
            && let Some(soft) = &mut servos.soft
        {
            soft.hold(n, &self.stages.here.dq, direct);
        }
        let mut smallest = direct.pivots[0];
        outwards!(S, n, place => smallest = direct.pivots[place.index()].min(smallest));
        if !smallest.all_above(0.0) {
            let pivots = direct.pivots;
            self.find_indefinite(t, &pivots);
        }
    }

    /// Reference and feed-forward at one time.
    #[inline(always)]
    fn aim(&mut self, t: f64) {
        if t == self.aimed {
            return; // the stages in the middle of a step
        }
        self.aimed = t;
        self.simulation.reference.at_on::<V>(t, &mut self.piece, &mut self.target);
        if let Some(signal) = self.simulation.controller.feedforward() {
            signal.at(t, &mut self.feedforward);
        }
    }

    #[inline(always)]
    fn sample(&mut self, digital: &Digital, sampled: &mut Sampled<V>, t: f64) {
        self.aim(t);
        let controller = self.simulation.controller;
        let instant = Instant {
            target: &self.target,
            feedforward: controller.feedforward().map(|_| &self.feedforward),
            scale: &self.scale,
        };
        self.tau = sampled.step(controller.laws(), digital, &instant, &self.stages.here.q);
    }

    #[cold]
    fn find_indefinite(&mut self, time: f64, pivots: &PerJoint<V>) {
        let n = self.n();
        for l in 0..V::L {
            // Within one step a run can diverge so far that sines mean nothing, nor do the pivots made of them.
            let lost = (0..n).find(|&j| {
                let q = self.stages.here.q[j].lane(l).abs();
                q.is_nan() || q > FARTHEST
            });
            let joint = (0..n).find(|&j| pivots[j].lane(l) <= 0.0);
            if let (Some(joint), Some(_)) = (lost, joint) {
                self.end(l, Outcome::Diverged { time, joint });
            } else if let Some(joint) = joint {
                self.end(l, Outcome::Indefinite { time, joint });
            }
        }
    }

    /// Ends the runs whose tracking error has left the bounds. NaN is beyond any bound.
    #[inline(always)]
    fn check_tracking(&mut self, time: f64) {
        self.aim(time);
        let bound = Lanes::splat(self.simulation.divergence);
        // Sum of the excesses over the bound; an error that is not a number makes the sum one.
        let mut beyond = Lanes::zero();
        for j in 0..self.n() {
            let error = (self.stages.here.q[j] - Lanes::splat(self.target.q[j])).abs();
            beyond += Lanes::zero().max(error - bound);
        }
        if !(-beyond).all_above(-f64::MIN_POSITIVE) {
            self.find_diverged(time);
        }
    }

    #[cold]
    fn find_diverged(&mut self, time: f64) {
        for j in 0..self.n() {
            for l in 0..V::L {
                let error = (self.stages.here.q[j].lane(l) - self.target.q[j]).abs();
                if error.is_nan() || error > self.simulation.divergence {
                    self.end(l, Outcome::Diverged { time, joint: j });
                }
            }
        }
    }

    fn end(&mut self, lane: usize, outcome: Outcome) {
        if self.outcomes[lane] == Outcome::Completed {
            self.outcomes[lane] = outcome;
            self.running -= 1;
        }
    }

    fn cancelled(mut self, time: f64) -> V::Of<Outcome> {
        for lane in 0..V::L {
            self.end(lane, Outcome::Cancelled { time });
        }
        self.outcomes
    }
}
