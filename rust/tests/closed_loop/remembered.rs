//! Friction that remembers, in the closed loop: its torque, its steps, its lanes, and derivatives that refuse it.

use crate::common::loops::{distance, parameters, pd, reference, robot, run, whole};
use didim::closed_loop::observers::Trajectory;
use didim::closed_loop::schedule::{Plan, Schedule};
use didim::closed_loop::simulation::{Integrator, Outcome, Simulation};
use didim::model::inverse::inverse_dynamics;
use didim::robot::friction_terms::{Law, Term};
use didim::robot::parameters::{FRICTION, Layout};
use didim::robot::{Friction, Robot};

const WIDTHS: [f64; 2] = [0.02, 0.005];

/// Joints 1 and 3 remember.
fn remembering() -> Robot {
    let plain = robot(0.1);
    let term = |joint: usize, width| Term { joint, law: Law::Dahl { width }, name: "Fz".to_owned() };
    let mut friction = plain.friction().clone();
    friction.terms = vec![term(0, WIDTHS[0]), term(2, WIDTHS[1])];
    let coupling = [vec![1.0, 0.0, 0.0], vec![1.0, 1.0, 0.0], vec![0.0, 0.0, 1.0]];
    Robot::new(plain.joints().to_vec(), plain.gravity(), &coupling, friction).unwrap()
}

/// The sign of joint 2, of whose speed the coupled motor has a share, is kept through rest, in Coulomb, Stribeck and load friction.
fn holding(width: f64) -> Robot {
    let plain = robot(0.1);
    let term = |law, name: &str| Term { joint: 1, law, name: name.to_owned() };
    let mut friction = plain.friction().clone();
    friction.terms = vec![term(Law::Stribeck { velocity: 0.3 }, "Fs"), term(Law::Load, "Fl")];
    friction.held[1] = width;
    let coupling = [vec![1.0, 0.0, 0.0], vec![1.0, 1.0, 0.0], vec![0.0, 0.0, 1.0]];
    Robot::new(plain.joints().to_vec(), plain.gravity(), &coupling, friction).unwrap()
}

fn standard(robot: &Robot, amounts: [f64; 2]) -> Vec<f64> {
    let mut x = parameters(robot, 1.0);
    let count = x.len();
    x[count - 2..].copy_from_slice(&amounts);
    x
}

/// A run of a second, recorded at every step.
fn recorded(robot: &Robot, xs: &[Vec<f64>], rate: f64, integrator: Integrator) -> Vec<Trajectory> {
    let (reference, controller) = (reference(), pd(300.0, 30.0));
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a few thousand
    let records = rate as usize + 1;
    let plan = Plan {
        rate,
        records,
        period: None,
        coarse: 1.0 / rate,
        fine: &[1.0 / rate; 3],
        slow: &[0.0; 3],
        motion: None,
    };
    let schedule = Schedule::new(robot, &reference, plan).unwrap();
    let simulation = Simulation { integrator, ..whole(robot, &reference, &controller, &schedule) };
    let (outcomes, found) = run(simulation, xs, 1);
    assert!(outcomes.iter().all(|outcome| *outcome == Outcome::Completed));
    found
}

#[test]
fn torques_have_the_states_of_the_path() {
    let robot = remembering();
    let (amounts, x) = ([3.0, 2.0], standard(&remembering(), [3.0, 2.0]));
    for (integrator, tolerance) in [(Integrator::RungeKutta, 1e-4), (Integrator::Additive, 1e-4)] {
        let found = &recorded(&robot, std::slice::from_ref(&x), 4000.0, integrator)[0];
        let mut tau = vec![0.0; found.q.len()];
        inverse_dynamics(&robot, &found.q, &found.dq, &found.ddq, &x, &mut tau).unwrap();
        let (mut z, mut reversals) = ([0, 2].map(|j: usize| (found.dq[j] / 0.1).tanh()), 0);
        for k in 0..found.q.len() / 3 {
            for (m, j) in [(0, 0), (1, 2)] {
                let way = if k == 0 { 0.0 } else { found.q[3 * k + j] - found.q[3 * k - 3 + j] };
                let s = 1.0_f64.copysign(way);
                reversals += usize::from(way != 0.0 && s * z[m] < -0.5);
                z[m] = s - (s - z[m]) * (-way.abs() / WIDTHS[m]).exp();
                let error = found.tau[3 * k + j] - tau[3 * k + j] - amounts[m] * z[m];
                assert!(error.abs() < tolerance, "{integrator:?} {k} {j}: {error}");
            }
        }
        assert!(reversals >= 2, "{reversals}");
    }
}

#[test]
fn a_sign_that_is_kept_stands_for_that_of_the_speed() {
    let width = 1e-3;
    let robot = holding(width);
    let (fs, fl) = (0.5, 0.2);
    let x = standard(&robot, [fs, fl]);
    let fc = x[14 + 12];
    let found = &recorded(&robot, std::slice::from_ref(&x), 4000.0, Integrator::RungeKutta)[0];
    let inverse = |x: &[f64]| {
        let mut tau = vec![0.0; found.q.len()];
        inverse_dynamics(&robot, &found.q, &found.dq, &found.ddq, x, &mut tau).unwrap();
        tau
    };
    // Without friction of any kind the torque of links and rotors is left, which load friction goes by.
    let mut bare = x.clone();
    for j in 0..3 {
        bare[14 * j + 11..14 * j + 14].fill(0.0);
    }
    bare[3 * 14..].fill(0.0);
    let (tau, load) = (inverse(&x), inverse(&bare));
    let (mut z, mut farthest) = ((found.dq[1] / 0.1).tanh(), 0.0_f64);
    for k in 0..found.q.len() / 3 {
        let (at, dq) = (3 * k + 1, found.dq[3 * k + 1]);
        let way = if k == 0 { 0.0 } else { found.q[at] - found.q[at - 3] };
        let s = 1.0_f64.copysign(way);
        z = s - (s - z) * (-way.abs() / width).exp();
        let change = z - (dq / 0.1).tanh();
        farthest = farthest.max(change.abs());
        let all = fc + fs * (-(dq / 0.3).powi(2)).exp() + fl * load[at].abs();
        let error = found.tau[at] - tau[at] - change * all;
        assert!(error.abs() < 1e-3, "{k}: {error}");
    }
    assert!(farthest > 0.5, "{farthest}");
    assert!(found.tau.iter().zip(&tau).enumerate().all(|(k, (a, b))| k % 3 == 1 || (a - b).abs() < 1e-8));
}

#[test]
fn long_steps_are_as_right_as_without() {
    let robot = remembering();
    let x = standard(&robot, [3.0, 2.0]);
    let fine = &recorded(&robot, std::slice::from_ref(&x), 16000.0, Integrator::RungeKutta)[0];
    let coarse = &recorded(&robot, &[x], 500.0, Integrator::RungeKutta)[0];
    let same: Vec<f64> = fine.q.chunks_exact(3).step_by(32).flatten().copied().collect();
    assert!(distance(&coarse.q, &same) < 2e-6, "{}", distance(&coarse.q, &same));
}

#[test]
fn a_candidate_has_the_same_bits_alone_and_in_lanes() {
    for robot in [remembering(), holding(1e-5)] {
        let xs: Vec<Vec<f64>> =
            (0..5).map(|k| standard(&robot, [0.2 * f64::from(k), 0.6 - 0.1 * f64::from(k)])).collect();
        let together = recorded(&robot, &xs, 4000.0, Integrator::RungeKutta);
        for (x, found) in xs.iter().zip(&together) {
            let alone = &recorded(&robot, std::slice::from_ref(x), 4000.0, Integrator::RungeKutta)[0];
            assert_eq!(alone.q, found.q);
        }
    }
}

#[test]
fn a_kept_sign_has_the_friction_of_its_direction() {
    let (width, [forward, backward]) = (1e-3, [0.9, 0.2]);
    let plain = robot(0.1);
    let mut friction = Friction { asymmetric: true, ..plain.friction().clone() };
    friction.held[1] = width;
    let robot = Robot::new(plain.joints().to_vec(), plain.gravity(), plain.transmission(), friction).unwrap();
    let layout = Layout::of(&robot);
    // The parameters of symmetric friction, joint by joint, with those of the other direction behind them.
    let mut x = vec![0.1; layout.count()];
    for (j, own) in parameters(&plain, 1.0).chunks_exact(14).take(3).enumerate() {
        x[layout.joint(j)..layout.joint(j) + 14].copy_from_slice(own);
    }
    (x[layout.joint(1) + FRICTION + 1], x[layout.joint(1) + FRICTION + 3]) = (forward, backward);
    let found = &recorded(&robot, std::slice::from_ref(&x), 4000.0, Integrator::RungeKutta)[0];
    let mut tau = vec![0.0; found.q.len()];
    inverse_dynamics(&robot, &found.q, &found.dq, &found.ddq, &x, &mut tau).unwrap();
    let coulomb = |s: f64| s * if s > 0.0 { forward } else { backward };
    let (mut z, mut farthest) = ((found.dq[1] / 0.1).tanh(), [0.0_f64; 2]);
    for k in 0..found.q.len() / 3 {
        let at = 3 * k + 1;
        let way = if k == 0 { 0.0 } else { found.q[at] - found.q[at - 3] };
        let s = 1.0_f64.copysign(way);
        z = s - (s - z) * (-way.abs() / width).exp();
        let change = coulomb(z) - coulomb((found.dq[at] / 0.1).tanh());
        farthest = [farthest[0].min(change), farthest[1].max(change)];
        let error = found.tau[at] - tau[at] - change;
        assert!(error.abs() < 1e-3, "{k}: {error}");
    }
    assert!(farthest[0] < -0.1 && farthest[1] > 0.1, "{farthest:?}");
}
