//! Runs that begin with a controller that has worked before.

use crate::common::loops::{PD, distance, parameters, reference, robot, run, schedule, whole};
use didim::closed_loop::control::{Controller, Digital, Law, Timing};
use didim::closed_loop::groups::simulate;
use didim::closed_loop::memory::{Initial, Memory};
use didim::closed_loop::observers::Trajectories;
use didim::closed_loop::reference::{Reference, Target};
use didim::closed_loop::schedule::{Plan, Schedule};
use didim::closed_loop::simulation::{Candidate, Simulation};
use didim::ground::cancel::Cancel;
use didim::model::inverse::inverse_dynamics;
use didim::robot::Robot;

/// Two joints under gravity with every kind of law, and a reference that moves all along.
fn wound_up(timing: Timing) -> (Robot, Reference, Controller) {
    let integrating = Law { integral: 900.0, gain: 2.0, position: 150.0, velocity: 15.0, ..PD };
    let cascade = Law {
        integral: 400.0,
        integrated_position: 8.0,
        integrated_velocity: 1.0,
        position: 300.0,
        velocity: 30.0,
        reference_velocity: 0.0,
        ..PD
    };
    let laws = vec![integrating, cascade, Law { acceleration: 0.3, limit: 1e3, ..integrating }];
    (robot(0.5), reference(), Controller::new(laws, timing, None).unwrap())
}

#[test]
fn a_run_resumed_from_its_records_is_the_run() {
    let digital = Digital { period: 2e-3, delay: 2, smoothing: vec![0.6, 0.4], resolution: vec![0.0; 3] };
    for timing in [Timing::Continuous, Timing::Digital(digital)] {
        let (robot, reference, controller) = wound_up(timing.clone());
        let x = parameters(&robot, 1.0);
        let scale = [1.2, 0.8, 1.0];
        let (cut, all, rate) = (120, 301, 500.0);
        let plan = |records| Plan {
            rate,
            records,
            period: controller.period(),
            coarse: 1e-3,
            fine: &[1e-3; 3],
            slow: &[0.0; 3],
            motion: None,
        };
        let run = |simulation: Simulation<'_>, records: usize| {
            let candidates = [Candidate { x: &x, scale: &scale }];
            let cancel = Cancel::never();
            simulate(simulation, &candidates, 1, &cancel, |lanes| Trajectories::new(lanes, records, 3))
                .unwrap()
                .remove(0)
                .1
                .lanes
                .remove(0)
        };
        let schedule = Schedule::new(&robot, &reference, plan(all)).unwrap();
        let whole_run = run(whole(&robot, &reference, &controller, &schedule), all);
        // The same motion, from the cut on.
        let shift = cut as f64 / rate;
        let knots = 2000;
        let end = (all - 1 - cut) as f64 / rate;
        let times: Vec<f64> = (0..=knots).map(|k| end * f64::from(k) / f64::from(knots)).collect();
        let (mut piece, mut target) = (0, Target::zero());
        let mut motion: [Vec<f64>; 3] = std::array::from_fn(|_| Vec::new());
        for t in &times {
            reference.at(t + shift, &mut piece, &mut target);
            for (out, values) in motion.iter_mut().zip([&target.q, &target.dq, &target.ddq]) {
                out.extend_from_slice(&values[..3]);
            }
        }
        let rest = Reference::from_knots(3, times, &motion[0], &motion[1], &motion[2]).unwrap();
        let row = |values: &[f64], k: usize| values[k * 3..(k + 1) * 3].to_vec();
        let (q, dq) = (row(&whole_run.q, cut), row(&whole_run.dq, cut));
        let outputs: Vec<f64> = (0..2).flat_map(|k| row(&whole_run.tau, cut + k)).collect();
        let positions: Vec<f64> = (1..=2).flat_map(|k| row(&whole_run.q, cut - k)).collect();
        let delay = if timing == Timing::Continuous { 0 } else { 2 };
        let first = row(&whole_run.tau, cut + delay);
        let memory = Memory {
            initial: Initial::Torque(&first),
            outputs: (delay > 0).then_some(&outputs),
            positions: (delay > 0).then_some(&positions),
        };
        let schedule = Schedule::new(&robot, &rest, plan(all - cut)).unwrap();
        let again = |memory| {
            let simulation =
                Simulation { start: Some((&q, &dq)), memory, ..whole(&robot, &rest, &controller, &schedule) };
            run(simulation, all - cut)
        };
        let resumed = again(memory);
        let size = distance(&whole_run.tau, &vec![0.0; whole_run.tau.len()]);
        let apart = distance(&resumed.tau, &whole_run.tau[cut * 3..]);
        assert!(apart < 1e-8 * size, "{timing:?}: {apart} of {size}");
        // From zero the integrators have to wind up first.
        let empty = again(Memory::default());
        assert!(distance(&empty.tau, &whole_run.tau[cut * 3..]) > 0.05 * size);
    }
}

#[test]
fn the_law_begins_in_balance_or_with_the_integrators_given() {
    let (robot, reference, controller) = wound_up(Timing::Continuous);
    let schedule = schedule(&robot, &reference, 1e-3);
    let xs: Vec<Vec<f64>> = (0..5).map(|k| parameters(&robot, 1.0 + 0.2 * f64::from(k))).collect();
    let simulation = |initial| Simulation {
        memory: Memory { initial, ..Memory::default() },
        ..whole(&robot, &reference, &controller, &schedule)
    };
    // Each candidate is in balance with its own weight.
    let (_, runs) = run(simulation(Initial::Balance), &xs, 2);
    let mut target = Target::zero();
    reference.at(0.0, &mut 0, &mut target);
    for (x, run) in xs.iter().zip(&runs) {
        let mut tau = [0.0; 3];
        inverse_dynamics(&robot, &target.q[..3], &target.dq[..3], &[0.0; 3], x, &mut tau).unwrap();
        // What is fed forward of the acceleration is for the inertia.
        tau[2] += 2.0 * 0.3 * target.ddq[2];
        assert!(
            distance(&run.tau[..3], &tau) < 1e-6 * distance(&tau, &[0.0; 3]),
            "{:?} {tau:?}",
            &run.tau[..3]
        );
    }
    // At the reference's own state, only the integrators and the feed-forward of acceleration act.
    let (_, runs) = run(simulation(Initial::Integrators(&[0.1, -0.2, 0.3])), &xs[..1], 1);
    let want =
        [2.0 * 900.0 * 0.1, -400.0 * 0.2 - 30.0 * target.dq[1], 2.0 * (900.0 * 0.3 + 0.3 * target.ddq[2])];
    assert!(distance(&runs[0].tau[..3], &want) < 1e-5, "{:?} {want:?}", &runs[0].tau[..3]);
    // A torque beyond the saturation begins at the limit.
    let (_, runs) = run(simulation(Initial::Torque(&[0.0, 0.0, 1e9])), &xs[..1], 1);
    assert!((runs[0].tau[2] - 2e3).abs() < 1e-6);
    let candidate = Candidate { x: &xs[0], scale: &[1.0; 3] };
    let refused = simulate(simulation(Initial::Torque(&[1.0])), &[candidate], 1, &Cancel::never(), |lanes| {
        Trajectories::new(lanes, 1, 3)
    })
    .err()
    .map(|error| error.to_string())
    .unwrap_or_default();
    assert!(refused.contains("initial state of the controller has 1 entries where 3"), "{refused}");
}

#[test]
fn a_step_is_not_a_part_of_the_balance() {
    // Far from its reference the integrator holds the weight and no error: the law pulls at once.
    let (robot, reference, controller) = wound_up(Timing::Continuous);
    let schedule = schedule(&robot, &reference, 1e-3);
    let x = parameters(&robot, 1.0);
    let mut target = Target::zero();
    reference.at(0.0, &mut 0, &mut target);
    let (q, dq) = ([target.q[0] + 0.1, target.q[1], target.q[2]], [0.0; 3]);
    let memory = Memory { initial: Initial::Balance, ..Memory::default() };
    let simulation =
        Simulation { start: Some((&q, &dq)), memory, ..whole(&robot, &reference, &controller, &schedule) };
    let (_, runs) = run(simulation, std::slice::from_ref(&x), 1);
    let mut tau = [0.0; 3];
    inverse_dynamics(&robot, &q, &dq, &dq, &x, &mut tau).unwrap();
    let pull = 2.0 * (-150.0 * 0.1 + 15.0 * target.dq[0]);
    assert!((runs[0].tau[0] - tau[0] - pull).abs() < 1e-9, "{} {} {pull}", runs[0].tau[0], tau[0]);
}
