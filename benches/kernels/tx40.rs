//! What is timed and counted: the TX40, a batch of its samples, and one second of its closed loop.

use didim::closed_loop::control::{Controller, Law, Timing};
use didim::closed_loop::memory::Memory;
use didim::closed_loop::observers::{Cost, Measured};
use didim::closed_loop::reference::{Fourier, Reference};
use didim::closed_loop::schedule::{Plan, Schedule};
use didim::closed_loop::simulate::run_group;
use didim::closed_loop::simulation::{Candidate, Integrator, Outcome, Simulation};
use didim::ground::cancel::Cancel;
use didim::model::inverse::inverse_dynamics;
use didim::model::regressor::regressor;
use didim::robot::parameters::Layout;
use didim::robot::{Friction, Joint, JointKind, Robot};
use std::f64::consts::{FRAC_PI_2, PI};
use std::hint::black_box;

/// Samples of a batch.
pub const SAMPLES: usize = 4096;
/// Samples of the regressor: they fill 264 kB, a buffer that stays in the second-level cache.
pub const FEW: usize = 64;
/// Runge-Kutta steps of [`ClosedLoop`].
pub const STEPS: usize = 1000;

/// Table I, with the coupled wrist.
fn tx40(friction: Friction) -> Robot {
    let rows = [
        (0.0, 0.0, 0.0, 0.0),
        (-FRAC_PI_2, 0.0, -FRAC_PI_2, 0.0),
        (0.0, 0.225, FRAC_PI_2, 0.035),
        (FRAC_PI_2, 0.0, 0.0, 0.225),
        (-FRAC_PI_2, 0.0, 0.0, 0.0),
        (FRAC_PI_2, 0.0, PI, 0.0),
    ];
    let joints = rows
        .iter()
        .map(|&(alpha, d, theta, r)| Joint { kind: JointKind::Revolute, alpha, d, theta, r })
        .collect();
    let coupling: Vec<Vec<f64>> =
        (0..6).map(|m| (0..6).map(|j| f64::from(u8::from(m == j || (m, j) == (5, 4)))).collect()).collect();
    Robot::new(joints, [0.0, 0.0, -9.81], &coupling, friction).expect("Table I is a robot")
}

/// A motion of [`SAMPLES`] samples, parameters, and memory for results.
pub struct Batch {
    pub robot: Robot,
    pub q: Vec<f64>,
    pub dq: Vec<f64>,
    pub ddq: Vec<f64>,
    pub x: Vec<f64>,
    pub tau: Vec<f64>,
    w: Vec<f64>,
}

impl Batch {
    pub fn new() -> Self {
        let robot = tx40(Friction::sign(6));
        let motion = |scale: f64| -> Vec<f64> {
            (0..SAMPLES * 6).map(|k| scale * ((k / 6) as f64 * 0.01 + (k % 6) as f64).sin()).collect()
        };
        let p = Layout::of(&robot).count();
        Self {
            q: motion(1.0),
            dq: motion(2.0),
            ddq: motion(5.0),
            x: (0..p).map(|k| 0.1 + k as f64 * 0.01).collect(),
            tau: vec![0.0; SAMPLES * 6],
            w: vec![0.0; FEW * 6 * p],
            robot,
        }
    }

    /// Torques of all samples.
    pub fn inverse_dynamics(&mut self) {
        let Self { robot, q, dq, ddq, x, tau, .. } = self;
        inverse_dynamics(robot, q, dq, ddq, x, black_box(tau)).expect("shapes fit");
    }

    /// Regressor of the first [`FEW`] samples.
    pub fn regressor(&mut self) {
        let Self { robot, q, dq, ddq, w, .. } = self;
        let few = FEW * 6;
        regressor(robot, &q[..few], &dq[..few], &ddq[..few], black_box(w)).expect("shapes fit");
    }
}

/// One second of the closed loop in [`STEPS`] steps.
pub struct ClosedLoop {
    robot: Robot,
    reference: Reference,
    controller: Controller,
    schedule: Schedule,
    x: Vec<f64>,
    zeros: Vec<f64>,
}

impl ClosedLoop {
    pub fn new() -> Self {
        let robot = tx40(Friction { smoothing: vec![0.01; 6], ..Friction::sign(6) });
        let p = Layout::of(&robot).count();
        let series = Fourier { period: 1.0, offset: &[0.0; 6], sine: &[0.5; 6], cosine: &[0.0; 6] };
        let reference = Reference::fourier(6, series, 1.0, STEPS).expect("a reference");
        let law = Law {
            position: 1000.0,
            velocity: 50.0,
            integral: 0.0,
            acceleration: 0.0,
            reference_velocity: 1.0,
            integrated_position: 1.0,
            integrated_velocity: 0.0,
            limit: f64::INFINITY,
            gain: 1.0,
        };
        let plan = Plan {
            rate: 1000.0,
            records: STEPS + 1,
            period: None,
            coarse: 1e-3,
            fine: &[1e-3; 6],
            slow: &[0.0; 6],
            motion: None,
        };
        let schedule = Schedule::new(&robot, &reference, plan).expect("a schedule");
        assert_eq!(schedule.steps(), STEPS);
        Self {
            controller: Controller::new(vec![law; 6], Timing::Continuous, None).expect("a controller"),
            x: (0..p).map(|k| if k % 14 == 5 || k % 14 == 10 { 1.0 } else { 0.01 }).collect(),
            zeros: vec![0.0; (STEPS + 1) * 6],
            robot,
            reference,
            schedule,
        }
    }

    /// `L` candidates, side by side.
    pub fn run<const L: usize>(&self) {
        let simulation = Simulation {
            robot: &self.robot,
            reference: &self.reference,
            controller: &self.controller,
            schedule: &self.schedule,
            external: None,
            start: None,
            memory: Memory::default(),
            divergence: 100.0,
            integrator: Integrator::RungeKutta,
            servos: None,
        };
        let measured =
            Measured { q: &self.zeros, tau: &self.zeros, weight_q: &[1.0; 6], weight_tau: &[0.0; 6] };
        let candidates = [Candidate { x: &self.x, scale: &[1.0; 6] }; L];
        let mut cost = Cost::new(measured, 6);
        let outcomes = run_group(simulation, &candidates, &Cancel::never(), black_box(&mut cost));
        // A run that ended early would look fast.
        assert_eq!(outcomes, [Outcome::Completed; L]);
    }
}
