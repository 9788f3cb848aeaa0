//! The method that takes steep friction implicitly: its order, its reversals, its bits, and what it refuses.

use crate::common::loops::{distance, parameters, pd, reference, robot, run, schedule, whole};
use didim::closed_loop::groups::simulate;
use didim::closed_loop::observers::Trajectories;
use didim::closed_loop::simulation::{Candidate, Integrator, Outcome, Simulation};
use didim::ground::cancel::Cancel;
use didim::ground::isa::{Isa, choose};
use didim::robot::friction_terms::{Law, Term};
use didim::robot::parameters::{FRICTION, IA, Layout};
use didim::robot::{Coupling, Friction, Robot};

/// The robot of [`robot`] with another friction.
fn with_friction(friction: Friction) -> Robot {
    let plain = robot(0.01);
    let coupling = [vec![1.0, 0.0, 0.0], vec![1.0, 1.0, 0.0], vec![0.0, 0.0, 1.0]];
    Robot::new(plain.joints().to_vec(), plain.gravity(), &coupling, friction).unwrap()
}

/// Positions of a run with steps of at most `step`.
fn positions(robot: &Robot, x: &[f64], step: f64, integrator: Integrator) -> Vec<f64> {
    let (reference, controller) = (reference(), pd(300.0, 30.0));
    let schedule = schedule(robot, &reference, step);
    let simulation = Simulation { integrator, ..whole(robot, &reference, &controller, &schedule) };
    let (outcomes, mut found) = run(simulation, &[x.to_vec()], 1);
    assert_eq!(outcomes, [Outcome::Completed]);
    found.remove(0).q
}

/// Five times the friction of [`parameters`], and light rotors: stiff at reversals.
fn steep(robot: &Robot) -> Vec<f64> {
    let layout = Layout::of(robot);
    let mut x = parameters(robot, 1.0);
    for j in 0..3 {
        x[layout.joint(j) + FRICTION + 1] = 3.0;
        if robot.friction().asymmetric {
            x[layout.joint(j) + FRICTION + 3] = 2.0;
        }
    }
    x
}

#[test]
fn the_error_falls_eight_times_per_halved_step() {
    let robot = robot(2.0);
    let x = parameters(&robot, 1.0);
    let exact = positions(&robot, &x, 5e-2 / 1024.0, Integrator::RungeKutta);
    let errors: Vec<f64> = [8.0, 16.0, 32.0, 64.0]
        .iter()
        .map(|parts| distance(&positions(&robot, &x, 5e-2 / parts, Integrator::Additive), &exact))
        .collect();
    for pair in errors.windows(2) {
        let ratio = pair[0] / pair[1];
        assert!((6.5..9.5).contains(&ratio), "{errors:?}");
    }
}

#[test]
fn at_reversals_it_comes_nearer_than_the_classical_method() {
    let robot = robot(1e-3);
    let x = steep(&robot);
    let exact = positions(&robot, &x, 5e-6, Integrator::RungeKutta);
    let error = |step, integrator| distance(&positions(&robot, &x, step, integrator), &exact);
    let (implicit, classical) = (error(5e-4, Integrator::Additive), error(5e-4, Integrator::RungeKutta));
    assert!(implicit < 0.5 * classical, "{implicit} {classical}");
}

#[test]
fn every_friction_that_it_takes_gives_the_motion_of_the_classical_method() {
    let smooth = Friction { smoothing: vec![0.02; 3], ..Friction::sign(3) };
    let stribeck = Term { joint: 1, law: Law::Stribeck { velocity: 0.1 }, name: "Fs".to_owned() };
    for friction in [
        smooth.clone(),
        Friction { asymmetric: true, ..smooth.clone() },
        Friction { terms: vec![stribeck], ..smooth },
    ] {
        let robot = with_friction(friction);
        let mut x = steep(&robot);
        for (name, sign) in [("as it is", 1.0), ("with a negative coefficient", -0.05)] {
            x[Layout::of(&robot).joint(2) + FRICTION + 1] *= sign;
            let exact = positions(&robot, &x, 2e-5, Integrator::RungeKutta);
            let found = positions(&robot, &x, 1e-4, Integrator::Additive);
            assert!(distance(&found, &exact) < 1e-8, "{name}: {}", distance(&found, &exact));
        }
    }
}

#[test]
fn lanes_threads_and_sets_have_the_same_bits() {
    let (robot, reference, controller) = (robot(1e-3), reference(), pd(300.0, 30.0));
    let schedule = schedule(&robot, &reference, 1e-3);
    let simulation =
        Simulation { integrator: Integrator::Additive, ..whole(&robot, &reference, &controller, &schedule) };
    let mut xs: Vec<Vec<f64>> = (0..19).map(|k| parameters(&robot, 1.0 + 0.1 * f64::from(k))).collect();
    // One that no robot has, among them: its neighbours do not notice.
    xs[5][Layout::of(&robot).joint(2) + IA] = -10.0;
    let (outcomes, together) = run(simulation, &xs, 1);
    for (k, outcome) in outcomes.iter().enumerate() {
        match outcome {
            Outcome::Indefinite { joint: 2, .. } if k == 5 => {}
            Outcome::Completed if k != 5 => {}
            other => panic!("{k}: {other:?}"),
        }
    }
    let sound = |k: &usize| *k != 5;
    let same = |other: &(Vec<Outcome>, Vec<_>)| {
        other.0 == outcomes && (0..19).filter(sound).all(|k| other.1[k] == together[k])
    };
    assert!(same(&run(simulation, &xs, 3)));
    for isa in Isa::available().filter(|&isa| isa > Isa::Portable) {
        assert_eq!(choose(isa.name()), Ok(isa));
        assert!(same(&run(simulation, &xs, 1)), "{isa:?}");
    }
    assert_eq!(choose("auto"), Ok(Isa::widest()));
    for k in (0..19).filter(sound) {
        assert_eq!(run(simulation, &xs[k..=k], 1).1[0], together[k]);
    }
}

#[test]
fn what_it_does_not_take_is_refused() {
    let smooth = Friction { smoothing: vec![0.02; 3], ..Friction::sign(3) };
    let load = Term { joint: 1, law: Law::Load, name: "Fl".to_owned() };
    for (friction, why) in [
        (Friction::sign(3), "friction as tanh"),
        (Friction { dead_zone: vec![0.01; 3], ..smooth.clone() }, "no dead zone"),
        (Friction { held: vec![0.0, 1e-5, 0.0], ..smooth.clone() }, "kept through rest"),
        (Friction { terms: vec![load], ..smooth.clone() }, "depends on the load"),
        (Friction { coupling: Coupling::Printed, ..smooth }, "their shafts alone"),
    ] {
        let robot = with_friction(friction);
        let (reference, controller) = (reference(), pd(300.0, 30.0));
        let schedule = schedule(&robot, &reference, 1e-2);
        let simulation = Simulation {
            integrator: Integrator::Additive,
            ..whole(&robot, &reference, &controller, &schedule)
        };
        let x = steep(&robot);
        let candidate = [Candidate { x: &x, scale: &[1.0; 3] }];
        let refused = simulate(simulation, &candidate, 1, &Cancel::never(), |_| Trajectories::new(1, 1, 3));
        assert!(refused.unwrap_err().to_string().contains(why), "{why}");
    }
}
