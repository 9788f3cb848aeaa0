//! Exact derivatives of a simulation against differences of simulations.

use crate::common::loops::{PD, parameters, reference, robot, slider, whole};
use didim::closed_loop::control::{Controller, Digital, Law, Signal, Timing};
use didim::closed_loop::groups::simulate;
use didim::closed_loop::memory::{Initial, Memory};
use didim::closed_loop::observers::{Trajectories, Trajectory};
use didim::closed_loop::point_to_point::PointToPoint;
use didim::closed_loop::reference::Reference;
use didim::closed_loop::schedule::{Plan, Schedule};
use didim::closed_loop::simulation::{Candidate, Outcome, Simulation};
use didim::ground::cancel::Cancel;
use didim::robot::Robot;
use didim::robot::parameters::{FRICTION, IA, Layout, M};
use didim::tangent::closed_loop::sensitivities;

const LAW: Law = Law { position: 300.0, velocity: 30.0, ..PD };

/// A second in steps of 2 ms.
fn schedule(robot: &Robot, reference: &Reference, controller: &Controller) -> Schedule {
    let plan = Plan {
        rate: 50.0,
        records: 51,
        period: controller.period(),
        coarse: 2e-3,
        fine: &[2e-3; 3],
        slow: &[0.0; 3],
        motion: None,
    };
    Schedule::new(robot, reference, plan).unwrap()
}

/// Exact derivatives along every parameter against central differences of the simulation, relative to the norm of the column.
fn worst(controller: &Controller, external: Option<&Signal>) -> f64 {
    worst_from(controller, external, Memory::default())
}

fn worst_from(controller: &Controller, external: Option<&Signal>, memory: Memory<'_>) -> f64 {
    let (robot, reference) = (robot(0.5), reference());
    let schedule = schedule(&robot, &reference, controller);
    let start = ([0.35, -0.1, 0.1], [0.2, -0.1, 0.0]);
    let simulation = Simulation {
        external,
        start: Some((&start.0, &start.1)),
        memory,
        ..whole(&robot, &reference, controller, &schedule)
    };
    let (x, scale) = (parameters(&robot, 1.0), [1.1, 0.9, 1.0]);
    let units: Vec<Vec<f64>> =
        (0..x.len()).map(|k| (0..x.len()).map(|i| if i == k { 1.0 } else { 0.0 }).collect()).collect();
    let directions: Vec<&[f64]> = units.iter().map(Vec::as_slice).collect();
    let candidate = Candidate { x: &x, scale: &scale };
    let run = |threads| sensitivities(simulation, candidate, &directions, threads, &Cancel::never()).unwrap();
    let (outcome, exact) = run(1);
    assert_eq!(outcome, Outcome::Completed);
    assert_eq!(run(2).1, exact);
    let at = |k: usize, by: f64| {
        let mut moved = x.clone();
        moved[k] += by;
        let candidates = [Candidate { x: &moved, scale: &scale }];
        let mut found =
            simulate(simulation, &candidates, 1, &Cancel::never(), |lanes| Trajectories::new(lanes, 51, 3))
                .unwrap();
        found.remove(0).1.lanes.remove(0)
    };
    let h = 1e-4;
    let mut worst: f64 = 0.0;
    for (k, column) in exact.iter().enumerate() {
        // Fourth order: the error of plain central differences would be as large as what is looked for.
        let runs = [at(k, 2.0 * h), at(k, h), at(k, -h), at(k, -2.0 * h)];
        let outputs: [fn(&Trajectory) -> &Vec<f64>; 4] = [|r| &r.q, |r| &r.dq, |r| &r.ddq, |r| &r.tau];
        for output in outputs {
            let (mut apart, mut size) = (0.0_f64, 0.0);
            for (i, value) in output(column).iter().enumerate() {
                let [a, b, c, d] = [0, 1, 2, 3].map(|run: usize| output(&runs[run])[i]);
                let difference = (8.0 * (b - c) - (a - d)) / (12.0 * h);
                apart += (difference - value).powi(2);
                size += value * value;
            }
            if size > 1e-18 {
                worst = worst.max((apart / size).sqrt());
            }
        }
    }
    worst
}

#[test]
fn continuous_control() {
    let feedforward = Signal { rate: 10.0, n: 3, values: (0..33).map(|k| f64::from(k).sin()).collect() };
    let pd = Controller::new(vec![LAW; 3], Timing::Continuous, Some(feedforward.clone())).unwrap();
    assert!(worst(&pd, Some(&feedforward)) < 1e-6, "{}", worst(&pd, Some(&feedforward)));
}

#[test]
fn integrators_and_saturation() {
    let cascade = Law { integral: 200.0, integrated_position: 10.0, integrated_velocity: 1.0, ..LAW };
    // The first joint is at its limit now and then.
    let limited = Law { limit: 18.0, ..LAW };
    let controller = Controller::new(vec![limited, cascade, LAW], Timing::Continuous, None).unwrap();
    let found = worst(&controller, None);
    assert!(found < 1e-3, "{found}"); // differences see the steps in which a limit is left
    let free = Controller::new(vec![cascade; 3], Timing::Continuous, None).unwrap();
    assert!(worst(&free, None) < 1e-6);
}

#[test]
fn the_derivative_of_an_integrator_waits_with_it() {
    // The reference accelerates more than the limit allows: when it is reached and left does not depend on the parameters.
    let law = Law { position: 20.0, velocity: 4.0, integral: 40.0, acceleration: 4.0, limit: 3.0, ..PD };
    let controller = Controller::new(vec![law], Timing::Continuous, None).unwrap();
    let moves = PointToPoint { points: &[0.0, 0.5], velocity: &[0.5], acceleration: &[2.0], dwell: 0.1 };
    let reference = Reference::point_to_point(1, moves).unwrap();
    let (robot, mut x) = slider();
    x[FRICTION] = 0.5;
    let plan = Plan {
        rate: 100.0,
        records: 141,
        period: None,
        coarse: 1e-3,
        fine: &[1e-3],
        slow: &[0.0],
        motion: None,
    };
    let schedule = Schedule::new(&robot, &reference, plan).unwrap();
    let simulation = whole(&robot, &reference, &controller, &schedule);
    let run = |x: &[f64]| {
        let candidate = [Candidate { x, scale: &[1.0] }];
        simulate(simulation, &candidate, 1, &Cancel::never(), |_| Trajectories::new(1, 141, 1))
            .unwrap()
            .remove(0)
            .1
            .lanes
            .remove(0)
    };
    let held = run(&x).tau.iter().filter(|tau| tau.abs() == 3.0).count();
    assert!((40..60).contains(&held), "{held}"); // twice a quarter of a second
    for column in [M, FRICTION] {
        let mut direction = vec![0.0; x.len()];
        direction[column] = 1.0;
        let candidate = Candidate { x: &x, scale: &[1.0] };
        let exact =
            sensitivities(simulation, candidate, &[&direction], 1, &Cancel::never()).unwrap().1.remove(0);
        let moved = |by: f64| {
            let mut x = x.clone();
            x[column] += by;
            run(&x)
        };
        let (ahead, behind) = (moved(1e-4), moved(-1e-4));
        let largest = exact.q.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
        for (k, value) in exact.q.iter().enumerate() {
            let difference = (ahead.q[k] - behind.q[k]) / 2e-4;
            assert!((difference - value).abs() < 1e-5 * largest, "{column} {k}: {difference} {value}");
        }
    }
}

#[test]
fn digital_control() {
    let digital =
        Digital { period: 4e-3, delay: 1, smoothing: vec![0.5, 0.3, 0.2], resolution: vec![0.0; 3] };
    let law = Law { integral: 50.0, gain: 2.0, position: 150.0, velocity: 10.0, ..LAW };
    let controller = Controller::new(vec![law; 3], Timing::Digital(digital), None).unwrap();
    let found = worst(&controller, None);
    assert!(found < 1e-6, "{found}");
}

#[test]
fn a_start_in_balance_depends_on_the_parameters() {
    let balance = Memory { initial: Initial::Balance, ..Memory::default() };
    let law = Law { integral: 50.0, gain: 2.0, position: 150.0, velocity: 10.0, ..LAW };
    let push = Signal { rate: 10.0, n: 3, values: (0..33).map(|k| f64::from(k).cos()).collect() };
    let digital = Digital { period: 4e-3, delay: 2, smoothing: vec![0.5, 0.5], resolution: vec![0.0; 3] };
    for timing in [Timing::Continuous, Timing::Digital(digital)] {
        let controller = Controller::new(vec![law; 3], timing, None).unwrap();
        let found = worst_from(&controller, Some(&push), balance);
        assert!(found < 1e-6, "{found}");
    }
}

#[test]
fn a_run_that_ends_has_no_derivatives() {
    let (robot, reference) = (robot(0.5), reference());
    let controller = Controller::new(vec![LAW; 3], Timing::Continuous, None).unwrap();
    let schedule = schedule(&robot, &reference, &controller);
    let simulation = whole(&robot, &reference, &controller, &schedule);
    let mut x = parameters(&robot, 1.0);
    x[Layout::of(&robot).joint(2) + IA] = -10.0;
    let direction = vec![1.0; x.len()];
    let candidate = Candidate { x: &x, scale: &[1.0; 3] };
    let (outcome, found) = sensitivities(simulation, candidate, &[&direction], 1, &Cancel::never()).unwrap();
    assert!(matches!(outcome, Outcome::Indefinite { joint: 2, .. }), "{outcome:?}");
    assert!(found.is_empty());
    let short = sensitivities(simulation, candidate, &[&direction[1..]], 1, &Cancel::never());
    assert!(short.unwrap_err().to_string().contains("a direction has 43 entries where 44 are needed"));
    // A loop that pushes away from its reference.
    let x = parameters(&robot, 1.0);
    let candidate = Candidate { x: &x, scale: &[1.0; 3] };
    let away = Law { position: -3e4, velocity: -10.0, ..PD };
    let controller = Controller::new(vec![away; 3], Timing::Continuous, None).unwrap();
    let simulation = Simulation { controller: &controller, ..simulation };
    let (outcome, found) = sensitivities(simulation, candidate, &[&direction], 1, &Cancel::never()).unwrap();
    assert!(matches!(outcome, Outcome::Diverged { time, .. } if time > 0.0 && time < 1.0), "{outcome:?}");
    assert!(found.is_empty());
}

#[test]
fn a_request_to_stop_is_heard_before_and_within_a_segment() {
    let (robot, reference) = (robot(0.5), reference());
    // 500 steps from the first record to the second.
    let plan = Plan {
        rate: 2.0,
        records: 3,
        period: None,
        coarse: 0.5,
        fine: &[1e-3; 3],
        slow: &[10.0; 3],
        motion: None,
    };
    let schedule = Schedule::new(&robot, &reference, plan).unwrap();
    let controller = Controller::new(vec![LAW; 3], Timing::Continuous, None).unwrap();
    let simulation = whole(&robot, &reference, &controller, &schedule);
    let x = parameters(&robot, 1.0);
    let (direction, candidate) = (vec![1.0; x.len()], Candidate { x: &x, scale: &[1.0; 3] });
    for patience in [0, 1, 5] {
        let asked = std::sync::atomic::AtomicUsize::new(0);
        let poll = || asked.fetch_add(1, std::sync::atomic::Ordering::Relaxed) >= patience;
        let (outcome, found) =
            sensitivities(simulation, candidate, &[&direction], 1, &Cancel::when(&poll)).unwrap();
        assert_eq!((outcome, found), (Outcome::Cancelled { time: 0.0 }, Vec::new()));
        // Raised once, the flag is not asked for again.
        assert_eq!(asked.into_inner(), patience + 1);
    }
}
