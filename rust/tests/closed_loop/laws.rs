//! Control laws on a slider against closed forms.

use crate::common::loops::{PD, parameters, pd, reference, rest, robot, run, schedule, slider, whole};
use didim::closed_loop::control::{Controller, Digital, Law, Signal, Timing};
use didim::closed_loop::groups::simulate;
use didim::closed_loop::memory::Memory;
use didim::closed_loop::observers::{Trajectories, Trajectory};
use didim::closed_loop::point_to_point::PointToPoint;
use didim::closed_loop::reference::{Reference, Target};
use didim::closed_loop::schedule::{Plan, Schedule};
use didim::closed_loop::simulation::{Candidate, Integrator, Simulation};
use didim::ground::cancel::Cancel;

fn slide(controller: &Controller, reference: &Reference, records: usize, start: f64) -> Trajectory {
    let (robot, x) = slider();
    let plan = Plan {
        rate: 100.0,
        records,
        period: controller.period(),
        coarse: 1e-3,
        fine: &[1e-3],
        slow: &[0.0],
        motion: None,
    };
    let schedule = Schedule::new(&robot, reference, plan).unwrap();
    let simulation = Simulation {
        robot: &robot,
        reference,
        controller,
        schedule: &schedule,
        external: None,
        start: Some((&[start], &[0.0])),
        memory: Memory::default(),
        divergence: 1e3,
        integrator: Integrator::RungeKutta,
        servos: None,
    };
    run(simulation, &[x], 1).1.remove(0)
}

#[test]
fn a_continuous_pid_is_its_transfer_function() {
    // M q'' = -kp q - kv q' - ki int q: characteristic polynomial (s + 1)(s + 2)(s + 3) = s^3 + 6 s^2 + 11 s + 6.
    let law = Law { position: 22.0, velocity: 12.0, integral: 12.0, ..PD };
    let controller = Controller::new(vec![law], Timing::Continuous, None).unwrap();
    let run = slide(&controller, &rest(2.0), 201, 1.0);
    // q(0) = 1, q'(0) = 0, q''(0) = -11 fix the three exponentials.
    for (k, q) in run.q.iter().enumerate() {
        let t = k as f64 / 100.0;
        let want = -2.5 * (-t).exp() + 8.0 * (-2.0 * t).exp() - 4.5 * (-3.0 * t).exp();
        assert!((q - want).abs() < 1e-9, "{t}: {q} {want}");
    }
}

#[test]
fn saturation_holds_and_windup_is_avoided() {
    let law = Law { position: 22.0, velocity: 12.0, integral: 30.0, limit: 0.5, gain: 2.0, ..PD };
    let controller = Controller::new(vec![law], Timing::Continuous, None).unwrap();
    let run = slide(&controller, &rest(20.0), 2001, 1.0);
    assert!(run.tau.iter().all(|tau| tau.abs() <= 1.0));
    // A full second at the limit: half of a t^2 with a = 1 / 2.
    assert!((run.q[100] - 0.75).abs() < 1e-9);
    // With windup the integrator would carry it far past zero.
    let lowest = run.q.iter().copied().fold(0.0, f64::min);
    assert!(lowest > -0.3, "{lowest}");
    assert!(run.q[2000].abs() < 1e-3);
}

#[test]
fn a_digital_law_holds_and_is_late() {
    // Position 1, no velocity: u = kp e, sampled every 50 ms and one sample late.
    let law = Law { position: 8.0, velocity: 0.5, ..PD };
    let digital = |delay, resolution| {
        let digital =
            Digital { period: 0.05, delay, smoothing: vec![0.5, 0.5], resolution: vec![resolution] };
        Controller::new(vec![law], Timing::Digital(digital), None).unwrap()
    };
    for (delay, resolution) in [(0, 0.0), (2, 0.0), (1, 0.1)] {
        let run = slide(&digital(delay, resolution), &rest(1.0), 101, 1.0);
        // The same by hand: between samples the acceleration is constant.
        let (mut q, mut dq, mut past, mut outputs) = (1.0_f64, 0.0, vec![1.0_f64; 3], vec![0.0; delay + 1]);
        for k in 0..20 {
            let seen = if resolution > 0.0 { (q / resolution).round() * resolution } else { q };
            past.insert(0, seen);
            let velocity = (0.5 * past[0] - 0.5 * past[2]) / 0.05;
            outputs.insert(0, -8.0 * seen - 0.5 * velocity);
            assert!((run.tau[5 * k] - outputs[delay]).abs() < 1e-9);
            assert!((run.tau[5 * k + 4] - outputs[delay]).abs() < 1e-9);
            assert!((run.q[5 * k] - q).abs() < 1e-9, "{k} {delay}");
            let a = outputs[delay] / 2.0;
            q += 0.05 * dq + 0.5 * a * 0.05 * 0.05;
            dq += a * 0.05;
        }
    }
}

#[test]
fn a_cascade_and_feed_forwards_follow_without_error() {
    // The acceleration gain is the mass, so that nothing is left to the feedback.
    let law = Law { position: 30.0, velocity: 5.0, acceleration: 2.0, ..PD };
    let moves = PointToPoint { points: &[0.0, 1.0], velocity: &[2.0], acceleration: &[4.0], dwell: 0.105 };
    let reference = Reference::point_to_point(1, moves).unwrap();
    let controller = Controller::new(vec![law], Timing::Continuous, None).unwrap();
    let run = slide(&controller, &reference, 121, 0.0);
    assert!((run.q[120] - 1.0).abs() < 1e-12, "{}", run.q[120]);
    // The same by a torque fed forward, sampled finely.
    let mut target = Target::zero();
    let torque = |t: f64, target: &mut Target| {
        reference.at(t, &mut 0, target);
        2.0 * target.ddq[0]
    };
    let values = (0..12_100).map(|k| torque(f64::from(k) * 1e-4, &mut target)).collect();
    let signal = Signal { rate: 1e4, n: 1, values };
    let law = Law { acceleration: 0.0, gain: 3.0, position: 10.0, velocity: 5.0 / 3.0, ..law };
    let controller = Controller::new(vec![law], Timing::Continuous, Some(signal)).unwrap();
    let run = slide(&controller, &reference, 121, 0.0);
    // Straight lines smear each jump over a sample.
    assert!((run.q[120] - 1.0).abs() < 1e-3, "{}", run.q[120]);
}

#[test]
fn an_external_force_pushes() {
    let (robot, x) = slider();
    let reference = rest(1.0);
    let controller = Controller::new(vec![PD], Timing::Continuous, None).unwrap();
    let plan = Plan {
        rate: 10.0,
        records: 11,
        period: None,
        coarse: 1e-2,
        fine: &[1e-2],
        slow: &[0.0],
        motion: None,
    };
    let schedule = Schedule::new(&robot, &reference, plan).unwrap();
    let external = Signal { rate: 1.0, n: 1, values: vec![0.0, 12.0] };
    let simulation =
        Simulation { external: Some(&external), ..whole(&robot, &reference, &controller, &schedule) };
    // Force 12 t on 2 kg: q = t^3.
    let run = run(simulation, &[x], 1).1.remove(0);
    assert!((run.q[5] - 0.125).abs() < 1e-12 && (run.dq[10] - 3.0).abs() < 1e-12);
    assert_eq!(run.tau[10], 0.0);
}

#[test]
fn parts_that_do_not_fit_are_refused() {
    let (robot, reference, controller) = (robot(0.01), reference(), pd(300.0, 30.0));
    let schedule = schedule(&robot, &reference, 1e-3);
    let simulation = whole(&robot, &reference, &controller, &schedule);
    let refused = |simulation: Simulation<'_>, x: &[f64]| {
        let candidate = Candidate { x, scale: &[1.0; 3] };
        let result = simulate(simulation, &[candidate], 1, &Cancel::never(), |_| Trajectories::default());
        result.map(drop).expect_err("wrong").to_string()
    };
    assert!(refused(simulation, &[0.0; 3]).contains("x has 3 entries where 44 are needed"));
    let x = parameters(&robot, 1.0);
    let start: Option<(&[f64], &[f64])> = Some((&[0.0; 2], &[0.0; 3]));
    assert!(refused(Simulation { start, ..simulation }, &x).contains("initial positions has 2"));
    let signal = Signal { rate: 1.0, n: 2, values: vec![0.0; 4] };
    assert!(refused(Simulation { external: Some(&signal), ..simulation }, &x).contains("external torque"));
    let digital = Digital { period: 0.01, delay: 0, smoothing: vec![1.0], resolution: vec![0.0; 3] };
    let sampled = Controller::new(vec![PD; 3], Timing::Digital(digital), None).unwrap();
    assert!(
        refused(Simulation { controller: &sampled, ..simulation }, &x)
            .contains("made for another controller")
    );
}
