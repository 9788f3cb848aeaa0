//! Simulations: their order, their bits on lanes and threads, their endings.

use crate::common::bodies::polar;
use crate::common::loops::{
    PD, distance, parameters, pd, reference, rest, robot, run, schedule, slider, whole,
};
use didim::closed_loop::control::{Controller, Timing};
use didim::closed_loop::groups::simulate;
use didim::closed_loop::observers::{Cost, Measured, Trajectories};
use didim::closed_loop::reference::Reference;
use didim::closed_loop::schedule::{Plan, Schedule};
use didim::closed_loop::simulate::{portable, run_group};
use didim::closed_loop::simulation::{Candidate, Outcome, Simulation};
use didim::ground::cancel::Cancel;
use didim::ground::isa::{Isa, choose};

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
    // Two groups of eight and one of three where there are eight lanes.
    let xs: Vec<Vec<f64>> = (0..19).map(|k| parameters(&robot, 1.0 + 0.1 * f64::from(k))).collect();
    let (outcomes, together) = run(simulation, &xs, 1);
    assert!(outcomes.iter().all(|o| *o == Outcome::Completed));
    assert_eq!(run(simulation, &xs, 3), (outcomes.clone(), together.clone()));
    // Other tests may run on the narrower set in the meantime: that it makes no difference is what is tested here.
    for isa in Isa::available().filter(|&isa| isa > Isa::Portable) {
        assert_eq!(choose(isa.name()), Ok(isa));
        assert_eq!(run(simulation, &xs, 1), (outcomes.clone(), together.clone()), "{isa:?}");
    }
    assert_eq!(choose("auto"), Ok(Isa::widest()));
    for (x, trajectory) in xs.iter().zip(&together) {
        let alone = run(simulation, std::slice::from_ref(x), 1).1;
        assert_eq!(alone[0], *trajectory);
    }
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
