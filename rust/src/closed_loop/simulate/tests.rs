use super::*;
use crate::closed_loop::control::{Controller, Signal};
use crate::closed_loop::control::{Digital, Law};
use crate::closed_loop::observers::{Cost, Measured, Trajectories, Trajectory};
use crate::closed_loop::point_to_point::PointToPoint;
use crate::closed_loop::reference::Fourier;
use crate::closed_loop::reference::Reference;
use crate::closed_loop::schedule::Plan;
use crate::closed_loop::schedule::Schedule;
use crate::model::links::tests::polar;
use crate::robot::Robot;
use crate::robot::parameters::Layout;
use crate::robot::{Coupling, Friction, Joint, JointKind};
use std::f64::consts::FRAC_PI_2;

mod laws;

pub(crate) use laws::slider;

pub(crate) const PD: Law = Law {
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

fn rest(seconds: f64) -> Reference {
    Reference::from_knots(1, vec![0.0, seconds], &[0.0; 2], &[0.0; 2], &[0.0; 2]).unwrap()
}

/// Two bent revolute joints, whose motors are coupled, and a sliding one.
pub(crate) fn robot(smoothing: f64) -> Robot {
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
pub(crate) fn parameters(robot: &Robot, factor: f64) -> Vec<f64> {
    let one = [0.5, 0.05, -0.03, 0.6, 0.04, 0.4, 0.3, -0.2, 0.1, 2.0, 0.2, 0.4, 0.3, 0.1];
    let mut x: Vec<f64> = (0..3).flat_map(|_| one.map(|value| value * factor)).collect();
    x.resize(Layout::of(robot).count(), 0.1);
    x
}

pub(crate) fn reference() -> Reference {
    let series = Fourier {
        period: 2.0,
        offset: &[0.3, -0.2, 0.1],
        sine: &[0.4, 0.3, 0.1, -0.1, 0.1, 0.05],
        cosine: &[0.1, -0.2, 0.1, 0.1, 0.05, -0.05],
    };
    Reference::fourier(3, series, 1.0, 1000).unwrap()
}

fn pd(kp: f64, kv: f64) -> Controller {
    Controller::new(vec![Law { position: kp, velocity: kv, ..PD }; 3], Timing::Continuous, None).unwrap()
}

fn schedule(robot: &Robot, reference: &Reference, step: f64) -> Schedule {
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

fn run(simulation: Simulation<'_>, xs: &[Vec<f64>], threads: usize) -> (Vec<Outcome>, Vec<Trajectory>) {
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

pub(crate) fn whole<'a>(
    robot: &'a Robot,
    reference: &'a Reference,
    controller: &'a Controller,
    schedule: &'a Schedule,
) -> Simulation<'a> {
    Simulation { robot, reference, controller, schedule, external: None, start: None, divergence: 100.0 }
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn the_error_falls_sixteen_times_per_halved_step() {
    let (robot, reference, controller) = (robot(0.5), reference(), pd(300.0, 30.0));
    let x = [parameters(&robot, 1.0)];
    let at = |step: f64| {
        let schedule = schedule(&robot, &reference, step);
        run(whole(&robot, &reference, &controller, &schedule), &x, 1).1.remove(0)
    };
    let exact = at(5e-2 / 128.0);
    let errors: Vec<f64> =
        [4.0, 8.0, 16.0].iter().map(|parts| distance(&at(5e-2 / parts).q, &exact.q)).collect();
    for pair in errors.windows(2) {
        let ratio = pair[0] / pair[1];
        assert!((13.0..20.0).contains(&ratio), "{errors:?}");
    }
}

#[test]
fn lanes_and_threads_have_the_same_bits() {
    let (robot, reference, controller) = (robot(0.01), reference(), pd(300.0, 30.0));
    let schedule = schedule(&robot, &reference, 1e-3);
    let simulation = whole(&robot, &reference, &controller, &schedule);
    let xs: Vec<Vec<f64>> = (0..7).map(|k| parameters(&robot, 1.0 + 0.1 * f64::from(k))).collect();
    let (outcomes, together) = run(simulation, &xs, 1);
    assert!(outcomes.iter().all(|o| *o == Outcome::Completed));
    assert_eq!(run(simulation, &xs, 3), (outcomes, together.clone()));
    for (x, trajectory) in xs.iter().zip(&together) {
        let alone = run(simulation, std::slice::from_ref(x), 1).1;
        assert_eq!(alone[0], *trajectory);
    }
}

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

/// Runs one candidate and four, as an arm of known shape and as any robot: the same bits.
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
    let x: Vec<Vec<f64>> = (1..=4)
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
    let geometry = Geometry::of(robot);
    assert!(geometry.known::<Elbow>().is_some());
    for lanes in [1, 4] {
        let (mut known, mut any) = (Trajectories::new(lanes, 11, 6), Trajectories::new(lanes, 11, 6));
        let candidates = &candidates[..lanes];
        let of_any = Run { simulation, geometry, candidates, cancel: &cancel, observer: &mut any };
        let outcomes = run_group(simulation, candidates, &cancel, &mut known);
        let of_any = run_kernel(lanes, of_any);
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
    assert!(Geometry::of(&robot.with_joints(joints).unwrap()).known::<Elbow>().is_none());
}

#[test]
fn a_bad_candidate_does_not_disturb_its_neighbours() {
    let (robot, reference, controller) = (robot(0.01), reference(), pd(300.0, 30.0));
    let schedule = schedule(&robot, &reference, 1e-3);
    let simulation = whole(&robot, &reference, &controller, &schedule);
    let good = parameters(&robot, 1.0);
    let mut bad = good.clone();
    // A rotor of the sliding joint that more than takes its mass away.
    bad[2 * 14 + 10] = -9.0;
    let (outcomes, trajectories) = run(simulation, &[good.clone(), bad, good], 1);
    assert_eq!(outcomes[0], Outcome::Completed);
    assert!(matches!(outcomes[1], Outcome::Indefinite { time, joint: 2 } if time < 1e-9), "{outcomes:?}");
    assert_eq!(outcomes[2], Outcome::Completed);
    assert_eq!(trajectories[0], trajectories[2]);
    assert_eq!(trajectories[0].q.len(), 63);
}

#[test]
fn a_cost_is_the_sum_over_the_trajectory() {
    let (robot, reference, controller) = (robot(0.01), reference(), pd(300.0, 30.0));
    let schedule = schedule(&robot, &reference, 1e-3);
    let simulation = whole(&robot, &reference, &controller, &schedule);
    let xs: Vec<Vec<f64>> = (0..5).map(|k| parameters(&robot, 1.0 + 0.1 * f64::from(k))).collect();
    let trajectories = run(simulation, &xs, 1).1;
    let (q, tau) = (&trajectories[0].q, &trajectories[0].tau);
    let measured = Measured { q, tau, weight_q: &[1.0, 2.0, 3.0], weight_tau: &[0.0, 0.5, 0.0] };
    let scale = [1.0; 3];
    let candidates: Vec<Candidate<'_>> = xs.iter().map(|x| Candidate { x, scale: &scale }).collect();
    let groups = simulate(simulation, &candidates, 2, &Cancel::never(), |_| Cost::new(measured, 3)).unwrap();
    let sums: Vec<f64> = groups.iter().flat_map(|(o, cost)| cost.sums[..o.len()].to_vec()).collect();
    assert_eq!(sums[0], 0.0);
    for (sum, trajectory) in sums.iter().zip(&trajectories) {
        let mut want = 0.0;
        for k in 0..21 {
            for j in 0..3 {
                let at = 3 * k + j;
                want += measured.weight_q[j] * (trajectory.q[at] - q[at]).powi(2);
                want += measured.weight_tau[j] * (trajectory.tau[at] - tau[at]).powi(2);
            }
        }
        assert!((sum - want).abs() <= 1e-12 * want, "{sum} {want}");
    }
}

#[test]
fn gains_that_are_far_too_high_diverge_and_say_so() {
    let (robot, reference) = (robot(0.01), reference());
    let controller = pd(-3e4, -10.0);
    let schedule = schedule(&robot, &reference, 1e-3);
    let (outcomes, _) = run(whole(&robot, &reference, &controller, &schedule), &[parameters(&robot, 1.0)], 1);
    assert!(
        matches!(outcomes[0], Outcome::Diverged { time, .. } if time > 0.0 && time < 1.0),
        "{outcomes:?}"
    );
}

#[test]
fn a_request_to_stop_is_heard() {
    let (robot, reference, controller) = (robot(0.01), reference(), pd(300.0, 30.0));
    let schedule = schedule(&robot, &reference, 1e-3);
    let cancel = Cancel::never();
    cancel.raise();
    let x = parameters(&robot, 1.0);
    let candidate = Candidate { x: &x, scale: &[1.0; 3] };
    let simulation = whole(&robot, &reference, &controller, &schedule);
    let outcomes = run_group(simulation, &[candidate], &cancel, &mut Trajectories::new(1, 21, 3));
    assert_eq!(outcomes, [Outcome::Cancelled { time: 0.0 }]);
}

#[test]
fn a_request_to_stop_is_heard_within_a_long_segment() {
    let (robot, x) = slider();
    let (reference, controller) = (rest(1.0), Controller::new(vec![PD], Timing::Continuous, None).unwrap());
    // 10 000 steps between two records.
    let plan =
        Plan { rate: 1.0, records: 2, period: None, coarse: 1.0, fine: &[1e-4], slow: &[0.1], motion: None };
    let schedule = Schedule::new(&robot, &reference, plan).unwrap();
    let simulation = whole(&robot, &reference, &controller, &schedule);
    let candidate = Candidate { x: &x, scale: &[1.0] };
    let run = |patience: usize| {
        let asked = std::sync::atomic::AtomicUsize::new(0);
        let poll = || asked.fetch_add(1, std::sync::atomic::Ordering::Relaxed) >= patience;
        let mut records = Trajectories::new(1, 2, 1);
        let outcomes = run_group(simulation, &[candidate], &Cancel::when(&poll), &mut records);
        (outcomes[0], records.lanes[0].q.len())
    };
    let cancelled = Outcome::Cancelled { time: 0.0 };
    assert_eq!(
        [run(0), run(1), run(2), run(3)],
        [(cancelled, 0), (cancelled, 1), (cancelled, 1), (Outcome::Completed, 2)]
    );
}

#[test]
fn no_candidates_have_no_outcomes() {
    let (robot, reference, controller) = (robot(0.01), reference(), pd(300.0, 30.0));
    let schedule = schedule(&robot, &reference, 1e-3);
    let simulation = whole(&robot, &reference, &controller, &schedule);
    assert_eq!(run(simulation, &[], 2), (vec![], vec![]));
    assert_eq!(run_group(simulation, &[], &Cancel::never(), &mut Trajectories::default()), []);
}

#[test]
fn a_processor_without_fused_operations_runs_the_same_candidates() {
    let (robot, reference, controller) = (robot(0.1), reference(), pd(300.0, 30.0));
    let schedule = schedule(&robot, &reference, 1e-3);
    let simulation = whole(&robot, &reference, &controller, &schedule);
    let mut xs: Vec<Vec<f64>> = (0..3).map(|k| parameters(&robot, 1.0 + 0.2 * f64::from(k))).collect();
    xs[1][2 * 14 + 10] = -9.0; // indefinite, as above
    let (outcomes, together) = run(simulation, &xs, 1);
    let scale = [1.0; 3];
    let candidates: Vec<Candidate<'_>> = xs.iter().map(|x| Candidate { x, scale: &scale }).collect();
    let mut plain = Trajectories::new(3, 21, 3);
    assert_eq!(portable(simulation, &candidates, &Cancel::never(), &mut plain), outcomes);
    let (q, tau) = (&together[0].q, &together[0].tau);
    let measured = Measured { q, tau, weight_q: &[1.0, 2.0, 3.0], weight_tau: &[0.0, 0.5, 0.0] };
    let (mut cost, mut plain_cost) = (Cost::new(measured, 3), Cost::new(measured, 3));
    run_group(simulation, &candidates, &Cancel::never(), &mut cost);
    portable(simulation, &candidates, &Cancel::never(), &mut plain_cost);
    for lane in [0, 2] {
        let (got, want) = (&plain.lanes[lane], &together[lane]);
        assert_eq!(got.q.len(), 63);
        assert!(distance(&got.q, &want.q) < 1e-10 && distance(&got.tau, &want.tau) < 1e-8);
        assert!((plain_cost.sums[lane] - cost.sums[lane]).abs() < 1e-8 * (1.0 + cost.sums[lane]));
    }
    assert!(cost.sums[2] > 1e-3); // the third is not the first
}

#[test]
fn a_run_that_is_lost_within_a_step_has_diverged_and_one_that_is_not_is_indefinite() {
    // 4 - q^2 of a polar arm falls below zero on the way out.
    let (robot, x) = polar([4.0, -1.0, 2.0]);
    let controller = Controller::new(vec![PD; 2], Timing::Continuous, None).unwrap();
    let zeros = [0.0; 4];
    let reference = Reference::from_knots(2, vec![0.0, 1.0], &zeros, &zeros, &zeros).unwrap();
    let plan = Plan {
        rate: 10.0,
        records: 11,
        period: None,
        coarse: 1e-2,
        fine: &[1e-2; 2],
        slow: &[0.0; 2],
        motion: None,
    };
    let schedule = Schedule::new(&robot, &reference, plan).unwrap();
    let outcome = |speed: f64| {
        let start: Option<(&[f64], &[f64])> = Some((&[0.0; 2], &[0.0, speed]));
        let simulation = Simulation { start, ..whole(&robot, &reference, &controller, &schedule) };
        run(simulation, std::slice::from_ref(&x), 1).0[0]
    };
    let lost = outcome(1e9);
    assert!(matches!(lost, Outcome::Diverged { time, joint: 1 } if (time - 0.005).abs() < 1e-9), "{lost:?}");
    // 2 m are passed between 0.09 s and the middle of the next step.
    let seen = outcome(21.5);
    assert!(
        matches!(seen, Outcome::Indefinite { time, joint: 0 } if (time - 0.095).abs() < 1e-9),
        "{seen:?}"
    );
    assert_eq!(outcome(1.0), Outcome::Completed);
}
