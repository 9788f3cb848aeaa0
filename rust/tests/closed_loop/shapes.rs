//! Arms of a known shape have the bits of any robot.

use crate::common::bodies::with_joints;
use crate::common::loops::{PD, whole};
use didim::closed_loop::control::{Controller, Digital, Law, Signal, Timing};
use didim::closed_loop::observers::Trajectories;
use didim::closed_loop::reference::{Fourier, Reference};
use didim::closed_loop::schedule::{Plan, Schedule};
use didim::closed_loop::simulate::{run_as_any, run_group};
use didim::closed_loop::simulation::{Candidate, Outcome, Simulation};
use didim::ground::cancel::Cancel;
use didim::robot::arm::Elbow;
use didim::robot::parameters::Layout;
use didim::robot::{Coupling, Friction, Joint, JointKind, Robot};
use std::f64::consts::FRAC_PI_2;

/// The arm whose shape is known to the compiler, of other lengths than the TX40.
fn elbow(friction: Friction) -> Robot {
    let rows = [
        (0.0, 0.0, 0.2, 0.0),
        (-FRAC_PI_2, 0.0, -1.2, 0.0),
        (0.0, 0.4, 1.5, -0.1),
        (FRAC_PI_2, 0.0, 0.1, 0.3),
        (-FRAC_PI_2, 0.0, 0.0, 0.0),
        (FRAC_PI_2, 0.0, 3.0, 0.0),
    ];
    let joint = |&(alpha, d, theta, r)| Joint { kind: JointKind::Revolute, alpha, d, theta, r };
    let mut coupling: Vec<Vec<f64>> =
        (0..6).map(|m| (0..6).map(|j| f64::from(u8::from(m == j))).collect()).collect();
    coupling[5][4] = 0.7;
    Robot::new(rows.iter().map(joint).collect(), [0.5, 0.0, -9.81], &coupling, friction).unwrap()
}

/// Runs one candidate, four and eight, as an arm of known shape and as any robot: the same bits.
fn known_as_any(robot: &Robot, controller: &Controller, external: Option<&Signal>) {
    let series = Fourier {
        period: 1.0,
        offset: &[0.3, -0.2, 0.1, 0.0, 0.5, -0.4],
        sine: &[0.4, 0.3, 0.1, -0.3, 0.2, 0.5],
        cosine: &[0.1, -0.2, 0.3, 0.4, -0.5, 0.1],
    };
    let reference = Reference::fourier(6, series, 1.0, 1000).unwrap();
    let plan = Plan {
        rate: 20.0,
        records: 11,
        period: controller.period(),
        coarse: 1e-3,
        fine: &[5e-4; 6],
        slow: &[0.1; 6],
        motion: None,
    };
    let schedule = Schedule::new(robot, &reference, plan).unwrap();
    let simulation = Simulation { external, ..whole(robot, &reference, controller, &schedule) };
    let link = [0.5, 0.05, -0.03, 0.6, 0.04, 0.4, 0.1, -0.2, 0.1, 2.0, 0.5, 0.4, 0.3, 0.1, 0.2];
    let layout = Layout::of(robot);
    let x: Vec<Vec<f64>> = (1..=8)
        .map(|k| {
            let one = link[..layout.per_joint()].iter().map(|value| value * f64::from(k));
            let mut x: Vec<f64> = (0..6).flat_map(|_| one.clone()).collect();
            x.resize(layout.count(), 0.1);
            x
        })
        .collect();
    let scale = [1.0; 6];
    let candidates: Vec<Candidate<'_>> = x.iter().map(|x| Candidate { x, scale: &scale }).collect();
    let cancel = Cancel::never();
    assert!(robot.geometry().known::<Elbow>().is_some());
    for lanes in [1, 4, 8] {
        let (mut known, mut any) = (Trajectories::new(lanes, 11, 6), Trajectories::new(lanes, 11, 6));
        let candidates = &candidates[..lanes];
        let outcomes = run_group(simulation, candidates, &cancel, &mut known);
        let of_any = run_as_any(simulation, candidates, &cancel, &mut any);
        assert_eq!(outcomes, vec![Outcome::Completed; lanes]);
        assert_eq!(of_any, outcomes);
        assert!(known.lanes[0].q.iter().any(|q| q.abs() > 0.5));
        assert_eq!(known.lanes, any.lanes);
    }
}

#[test]
fn a_shape_that_is_known_changes_no_bit() {
    let smooth = Friction { smoothing: vec![0.02; 6], ..Friction::sign(6) };
    let laws = |law: Law| vec![Law { position: 900.0, velocity: 60.0, ..law }; 6];
    let plain = Controller::new(laws(PD), Timing::Continuous, None).unwrap();
    for friction in [
        smooth.clone(),
        Friction { asymmetric: true, ..smooth.clone() },
        Friction { coupling: Coupling::Printed, ..smooth.clone() },
        Friction::sign(6),
        Friction { dead_zone: vec![0.3; 6], ..smooth.clone() },
    ] {
        known_as_any(&elbow(friction), &plain, None);
    }
    let robot = elbow(smooth);
    let push = Signal { rate: 10.0, n: 6, values: (0..66).map(|k| f64::from(k).sin()).collect() };
    known_as_any(&robot, &plain, Some(&push));
    let fed = Controller::new(laws(PD), Timing::Continuous, Some(push)).unwrap();
    known_as_any(&robot, &fed, None);
    let pid = Law { integral: 500.0, limit: 60.0, ..PD };
    known_as_any(&robot, &Controller::new(laws(pid), Timing::Continuous, None).unwrap(), None);
    let digital = Digital { period: 1e-3, delay: 1, smoothing: vec![0.6, 0.4], resolution: vec![1e-4; 6] };
    known_as_any(&robot, &Controller::new(laws(PD), Timing::Digital(digital), None).unwrap(), None);
    // An arm with an offset more is not of that shape.
    let mut joints = robot.joints().to_vec();
    joints[1].d = 0.1;
    assert!(with_joints(&robot, joints).geometry().known::<Elbow>().is_none());
}
