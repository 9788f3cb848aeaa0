//! Position servos whose numbers differ between candidates: against the law of a controller, and jumps within steps.

use crate::common::loops::{PD, distance, parameters, rest, robot, run, whole};
use didim::closed_loop::control::{Controller, Law, Timing};
use didim::closed_loop::groups::simulate;
use didim::closed_loop::observers::Positions;
use didim::closed_loop::reference::Reference;
use didim::closed_loop::schedule::{Plan, Schedule};
use didim::closed_loop::servo::Servos;
use didim::closed_loop::simulation::{Candidate, Simulation, SimulationError};
use didim::ground::cancel::Cancel;
use didim::robot::Robot;

fn plan(robot: &Robot, reference: &Reference, step: f64) -> Schedule {
    let n = robot.n_dof();
    let (fine, slow) = (vec![step; n], vec![0.0; n]);
    let plan =
        Plan { rate: 20.0, records: 11, period: None, coarse: step, fine: &fine, slow: &slow, motion: None };
    Schedule::new(robot, reference, plan).unwrap()
}

fn positions(
    simulation: Simulation<'_>,
    candidates: &[Candidate<'_>],
) -> Result<Vec<Vec<f64>>, SimulationError> {
    let groups = simulate(simulation, candidates, 1, &Cancel::never(), |lanes| Positions {
        lanes: vec![Vec::new(); lanes],
    })?;
    Ok(groups.into_iter().flat_map(|(_, found)| found.lanes).collect())
}

#[test]
fn servos_are_the_law_of_their_controller_in_any_lane() {
    let robot = robot(0.1);
    let here = [0.2, -0.1, 0.05];
    let still = Reference::from_knots(3, vec![0.0, 0.5], &[0.0; 6], &[0.0; 6], &[0.0; 6]).unwrap();
    let schedule = plan(&robot, &still, 1e-3);
    let steps = schedule.steps();
    // The second reference is 0.1 off the first, as the shift of the first.
    let targets: Vec<f64> = [vec![0.0; 3 * steps], vec![-0.1; 3 * steps]].concat();
    let servos = Servos::new(3, &schedule, &targets).unwrap();
    let row = |kp: f64, limit: f64, shift: f64, number: f64| -> Vec<f64> {
        let parts = [[kp; 3], [5.0; 3], [limit; 3], [shift; 3], here, [0.0; 3], [0.0; 3], [0.0; 3], [0.0; 3]];
        parts.into_iter().flatten().chain([number]).collect()
    };
    let rows = [
        row(40.0, 1e30, 0.0, 0.0),
        row(60.0, 1.5, 0.1, 0.0),
        row(60.0, 1.5, 0.0, 1.0),
        row(60.0, 9.0, 0.0, 0.0),
    ];
    let x = parameters(&robot, 1.0);
    let candidates: Vec<Candidate<'_>> = rows.iter().map(|scale| Candidate { x: &x, scale }).collect();
    let any = Controller::new(vec![PD; 3], Timing::Continuous, None).unwrap();
    let simulation = Simulation { servos: Some(&servos), ..whole(&robot, &still, &any, &schedule) };
    let found = positions(simulation, &candidates).unwrap();
    let shifted = Reference::from_knots(3, vec![0.0, 0.5], &[-0.1; 6], &[0.0; 6], &[0.0; 6]).unwrap();
    for (l, (kp, limit, reference)) in
        [(40.0, f64::INFINITY, &still), (60.0, 1.5, &shifted), (60.0, 1.5, &shifted), (60.0, 9.0, &still)]
            .into_iter()
            .enumerate()
    {
        let law = Law { position: kp, velocity: 5.0, reference_velocity: 0.0, limit, ..PD };
        let controller = Controller::new(vec![law; 3], Timing::Continuous, None).unwrap();
        let start = Some((&here[..], &[0.0; 3][..]));
        let simulation = Simulation { start, ..whole(&robot, reference, &controller, &schedule) };
        let (_, expected) = run(simulation, std::slice::from_ref(&x), 1);
        assert!(distance(&found[l], &expected[0].q) < 1e-12, "{l}");
        assert!(found[l].iter().any(|q| (q - here[0]).abs() > 0.02));
        assert_eq!(positions(simulation_of(simulation, &servos), &candidates[l..=l]).unwrap()[0], found[l]);
    }
    let none = row(40.0, 1.0, 0.0, 2.0);
    let lost = positions(simulation, &[Candidate { x: &x, scale: &none }]);
    assert_eq!(lost, Err(SimulationError::Reference));
}

fn simulation_of<'a>(simulation: Simulation<'a>, servos: &'a Servos<'a>) -> Simulation<'a> {
    Simulation { servos: Some(servos), start: None, ..simulation }
}

/// A sliding mass of 1 with `kp = 400`, `kv = 40`, whose reference jumps at 0.1003 s: the mean over the step that has the jump, of
/// 1 ms, is as good as a step that ends on it.
#[test]
fn a_jump_within_a_step_keeps_its_impulse() {
    let jump = 0.1003;
    let (robot, x) = crate::common::loops::slider();
    let run_with = |breaks: Vec<f64>, step: f64| {
        let reference = rest(0.5).with_breaks(breaks);
        let schedule = plan(&robot, &reference, step);
        let mean = |ends: &[f64]| ((ends[1] - jump) / (ends[1] - ends[0])).clamp(0.0, 1.0);
        let targets: Vec<f64> = schedule.edges().windows(2).map(mean).collect();
        let servos = Servos::new(1, &schedule, &targets).unwrap();
        let controller = Controller::new(vec![PD], Timing::Continuous, None).unwrap();
        let simulation =
            Simulation { servos: Some(&servos), ..whole(&robot, &reference, &controller, &schedule) };
        let row = [400.0, 40.0, 1e30, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        positions(simulation, &[Candidate { x: &x, scale: &row }]).unwrap().remove(0)
    };
    let exact = run_with(vec![jump], 1e-4);
    assert!(distance(&run_with(vec![jump], 1e-3), &exact) < 1e-7);
    let within = distance(&run_with(vec![], 1e-3), &exact);
    assert!(within > 1e-7 && within < 400.0 * 1e-6 / 8.0, "{within}");
    assert!(exact.iter().any(|q| *q > 0.9));
}

/// Where friction is never reached, a slope k and a rate b are an inertia k and a viscosity k b; where it always is, a constant torque. The
/// second motor is coupled, so its inertia is not that of its joint alone.
#[test]
fn soft_friction_sticks_and_slides() {
    let robot = robot(0.1);
    let still = Reference::from_knots(3, vec![0.0, 0.5], &[0.0; 6], &[0.0; 6], &[0.0; 6]).unwrap();
    let schedule = plan(&robot, &still, 1e-3);
    let targets = vec![0.0; 3 * schedule.steps()];
    let servos = Servos::new(3, &schedule, &targets).unwrap();
    let any = Controller::new(vec![PD; 3], Timing::Continuous, None).unwrap();
    let simulation = Simulation { servos: Some(&servos), ..whole(&robot, &still, &any, &schedule) };
    let row = |slope: [f64; 3], rate: f64, shift: [f64; 3]| -> Vec<f64> {
        let parts = [
            [40.0; 3],
            [5.0; 3],
            [1e30; 3],
            shift,
            [0.2, -0.1, 0.05],
            [0.9, 0.8, 0.7],
            slope,
            [rate; 3],
            [0.0; 3],
        ];
        parts.into_iter().flatten().chain([0.0]).collect()
    };
    let with = |ia: [f64; 3], fv: [f64; 3], fc: f64| {
        let mut x = parameters(&robot, 1.0);
        for j in 0..3 {
            (x[14 * j + 10], x[14 * j + 11]) = (x[14 * j + 10] + ia[j], x[14 * j + 11] + fv[j]);
            x[14 * j + 12] = fc;
        }
        x
    };
    let run_all = |cases: &[(Vec<f64>, Vec<f64>)]| {
        let candidates: Vec<_> = cases.iter().map(|(x, scale)| Candidate { x, scale }).collect();
        positions(simulation, &candidates).unwrap()
    };
    let (slope, rate, none) = ([2.0, 0.0, 1.5], 3.0, [0.0; 3]);
    let found = run_all(&[
        (with(none, none, 1e3), row(slope, rate, none)),
        (with(slope, slope.map(|k| k * rate), 0.0), row(none, 0.0, none)),
        // Beyond 0.1 rad/s all slide on: the rate is high, and the slope is steep.
        (with(none, none, 0.3), row([1e4; 3], 1e4, none)),
        (with(none, none, 0.0), row(none, 0.0, [0.3 / 40.0; 3])),
    ]);
    assert!(distance(&found[0], &found[1]) < 1e-12);
    // The first record after the start, 50 ms on, comes before a joint turns round.
    assert!(distance(&found[2][..6], &found[3][..6]) < 1e-12);
    assert!(distance(&found[2], &found[3]) > 1e-3 && distance(&found[0], &found[3]) > 1e-3);
    // The lanes beside a candidate change none of its bits.
    let (x, scale) = (with(none, none, 0.3), row([5.0; 3], 100.0, none));
    let alone = run_all(&[(x.clone(), scale.clone())]);
    assert_eq!(run_all(&[(with(none, none, 1e3), row(slope, rate, none)), (x, scale)])[1], alone[0]);
    let stuck = alone[0].chunks(3).last().unwrap();
    assert!(stuck.iter().any(|q| q.abs() > 1e-4), "friction holds what the servos would bring to zero");
}

/// A lead adds to the inertia while the servo saturates, and nothing before: all saturate, or none does.
#[test]
fn a_lead_adds_inertia_where_a_servo_saturates() {
    let robot = robot(0.1);
    let still = Reference::from_knots(3, vec![0.0, 0.5], &[0.0; 6], &[0.0; 6], &[0.0; 6]).unwrap();
    let schedule = plan(&robot, &still, 1e-3);
    let targets = vec![3.0; 3 * schedule.steps()];
    let servos = Servos::new(3, &schedule, &targets).unwrap();
    let any = Controller::new(vec![PD; 3], Timing::Continuous, None).unwrap();
    let simulation = Simulation { servos: Some(&servos), ..whole(&robot, &still, &any, &schedule) };
    let row = |limit: f64, lead: [f64; 3]| -> Vec<f64> {
        let parts =
            [[40.0; 3], [5.0; 3], [limit; 3], [0.0; 3], [0.2, -0.1, 0.05], [0.0; 3], [0.0; 3], [0.0; 3]];
        parts.into_iter().flatten().chain(lead).chain([0.0]).collect()
    };
    // The second motor is coupled, so its inertia is not that of its joint alone.
    let (lead, light) = ([0.2, 0.0, 0.1], parameters(&robot, 1.0));
    let mut heavy = light.clone();
    for (j, lead) in lead.iter().enumerate() {
        heavy[14 * j + 10] += 5.0 * lead;
    }
    let run_one =
        |x: &[f64], scale: &[f64]| positions(simulation, &[Candidate { x, scale }]).unwrap().remove(0);
    let saturated = run_one(&light, &row(1.0, lead));
    assert!(distance(&saturated, &run_one(&heavy, &row(1.0, [0.0; 3]))) < 1e-12);
    assert!(distance(&saturated, &run_one(&light, &row(1.0, [0.0; 3]))) > 1e-3);
    assert!(distance(&run_one(&light, &row(1e30, lead)), &run_one(&light, &row(1e30, [0.0; 3]))) < 1e-12);
}
