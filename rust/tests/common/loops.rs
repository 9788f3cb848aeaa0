//! Closed loops: robots with a reference and a controller, and their runs.

use didim::closed_loop::control::{Controller, Law, Timing};
use didim::closed_loop::groups::simulate;
use didim::closed_loop::memory::Memory;
use didim::closed_loop::observers::{Trajectories, Trajectory};
use didim::closed_loop::reference::{Fourier, Reference};
use didim::closed_loop::schedule::{Plan, Schedule};
use didim::closed_loop::simulation::{Candidate, Integrator, Outcome, Simulation};
use didim::ground::cancel::Cancel;
use didim::robot::parameters::Layout;
use didim::robot::{Friction, Joint, JointKind, Robot};

pub const PD: Law = Law {
    position: 0.0,
    velocity: 0.0,
    integral: 0.0,
    acceleration: 0.0,
    reference_velocity: 1.0,
    integrated_position: 1.0,
    integrated_velocity: 0.0,
    limit: f64::INFINITY,
    gain: 1.0,
};

pub fn rest(seconds: f64) -> Reference {
    Reference::from_knots(1, vec![0.0, seconds], &[0.0; 2], &[0.0; 2], &[0.0; 2]).unwrap()
}

/// Two bent revolute joints, whose motors are coupled, and a sliding one.
pub fn robot(smoothing: f64) -> Robot {
    let joint = |kind, alpha, d| Joint { kind, alpha, d, theta: 0.1, r: 0.2 };
    let joints = vec![
        joint(JointKind::Revolute, 0.3, 0.0),
        joint(JointKind::Revolute, -1.1, 0.4),
        joint(JointKind::Prismatic, 0.7, 0.3),
    ];
    let coupling = [vec![1.0, 0.0, 0.0], vec![1.0, 1.0, 0.0], vec![0.0, 0.0, 1.0]];
    let friction = Friction { smoothing: vec![smoothing; 3], ..Friction::sign(3) };
    Robot::new(joints, [0.0, 0.0, -9.81], &coupling, friction).unwrap()
}

/// Bodies that exist; friction and rotors too.
pub fn parameters(robot: &Robot, factor: f64) -> Vec<f64> {
    let one = [0.5, 0.05, -0.03, 0.6, 0.04, 0.4, 0.3, -0.2, 0.1, 2.0, 0.2, 0.4, 0.3, 0.1];
    let mut x: Vec<f64> = (0..3).flat_map(|_| one.map(|value| value * factor)).collect();
    x.resize(Layout::of(robot).count(), 0.1);
    x
}

pub fn reference() -> Reference {
    let series = Fourier {
        period: 2.0,
        offset: &[0.3, -0.2, 0.1],
        sine: &[0.4, 0.3, 0.1, -0.1, 0.1, 0.05],
        cosine: &[0.1, -0.2, 0.1, 0.1, 0.05, -0.05],
    };
    Reference::fourier(3, series, 1.0, 1000).unwrap()
}

pub fn pd(kp: f64, kv: f64) -> Controller {
    Controller::new(vec![Law { position: kp, velocity: kv, ..PD }; 3], Timing::Continuous, None).unwrap()
}

pub fn schedule(robot: &Robot, reference: &Reference, step: f64) -> Schedule {
    let plan = Plan {
        rate: 20.0,
        records: 21,
        period: None,
        coarse: step,
        fine: &[step; 3],
        slow: &[0.0; 3],
        motion: None,
    };
    Schedule::new(robot, reference, plan).unwrap()
}

pub fn run(simulation: Simulation<'_>, xs: &[Vec<f64>], threads: usize) -> (Vec<Outcome>, Vec<Trajectory>) {
    let scale = vec![1.0; simulation.robot.n_dof()];
    let candidates: Vec<Candidate<'_>> = xs.iter().map(|x| Candidate { x, scale: &scale }).collect();
    let records = simulation.schedule.records();
    let groups = simulate(simulation, &candidates, threads, &Cancel::never(), |lanes| {
        Trajectories::new(lanes, records, simulation.robot.n_dof())
    })
    .unwrap();
    let (mut outcomes, mut trajectories) = (Vec::new(), Vec::new());
    for (group, observer) in groups {
        outcomes.extend(group);
        trajectories.extend(observer.lanes);
    }
    (outcomes, trajectories)
}

pub fn whole<'a>(
    robot: &'a Robot,
    reference: &'a Reference,
    controller: &'a Controller,
    schedule: &'a Schedule,
) -> Simulation<'a> {
    Simulation {
        robot,
        reference,
        controller,
        schedule,
        external: None,
        start: None,
        memory: Memory::default(),
        divergence: 100.0,
        integrator: Integrator::RungeKutta,
        servos: None,
    }
}

pub fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// A sliding mass without friction: closed forms exist.
pub fn slider() -> (Robot, Vec<f64>) {
    let joint = Joint { kind: JointKind::Prismatic, alpha: 0.0, d: 0.0, theta: 0.0, r: 0.0 };
    let robot = Robot::new(vec![joint], [0.0; 3], &[vec![1.0]], Friction::sign(1)).unwrap();
    let mut x = vec![0.0; 14];
    x[9] = 2.0;
    (robot, x)
}
