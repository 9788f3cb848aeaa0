//! Further friction terms in the inverse and the direct model, the regressor and the observation matrix.

use crate::common::bodies::{parameters, robot, with_friction};
use didim::model::direct::direct_dynamics;
use didim::model::inverse::inverse_dynamics;
use didim::model::regressor::{regressor, regressor_under_load};
use didim::regression::base::base_parameters;
use didim::robot::Friction;
use didim::robot::Robot;
use didim::robot::friction_terms::{Cylinder, Law, MAX_TERMS, Table, Term};
use didim::robot::parameters::{Layout, names, units};
use didim::signal::observation::{Log, observation};

fn term(joint: usize, name: &str, law: Law) -> Term {
    Term { joint, law, name: name.into() }
}

/// Every law, on an arm with sliding and turning joints and a coupled motor.
fn with_terms(smoothing: f64) -> Robot {
    let plain = robot(&[false, true, false, false, false, false]);
    let table = Table::new(-4.0, 0.5, (0..17).map(|k| 0.1 * f64::from(k * k)).collect()).unwrap();
    let friction = Friction {
        smoothing: vec![smoothing; 6],
        dead_zone: vec![if smoothing > 0.0 { 0.0 } else { 0.5 }; 6],
        terms: vec![
            term(0, "Rest", Law::Rest),
            term(0, "Fa", Law::Atan { velocity: 0.7 }),
            term(1, "Fs", Law::Stribeck { velocity: 0.9 }),
            term(1, "Fl", Law::Load),
            term(2, "Fr", Law::Root),
            term(3, "Fvp", Law::Forward),
            term(4, "Fu", Law::Table(table)),
            term(5, "Fl", Law::Load),
            term(0, "Ks", Law::Spring),
            term(2, "Gs", Law::Sine),
            term(3, "Gc", Law::Cosine),
            term(4, "Cf", Law::Cylinder(CYLINDER)),
            term(5, "Ck", Law::CylinderRate(CYLINDER)),
        ],
        ..plain.friction().clone()
    };
    with_friction(&plain, friction)
}

const CYLINDER: Cylinder = Cylinder { a: 0.6, b: 0.25, phi: 0.4, rest: 0.5 };

fn without_terms(robot: &Robot) -> Robot {
    with_friction(robot, Friction { terms: Vec::new(), ..robot.friction().clone() })
}

fn motion(samples: usize) -> [Vec<f64>; 3] {
    [1.1, 0.7, 1.7].map(|a| (0..samples * 6).map(|k| (a * k as f64 + a).sin() * 2.0).collect())
}

/// Parameters of a robot that can be simulated, with load friction below 1 in size.
fn values(robot: &Robot) -> Vec<f64> {
    let mut x = parameters(&without_terms(robot));
    x.extend([0.4, 1.3, -0.6, 0.2, 0.8, -0.3, 0.5, -0.15, 0.7, -0.4, 0.9, 1.2, -0.8]);
    assert_eq!(x.len(), Layout::of(robot).count());
    x
}

/// Torques of links and rotors: the inverse model without friction.
fn load(robot: &Robot, [q, dq, ddq]: &[Vec<f64>; 3], x: &[f64]) -> Vec<f64> {
    let mut x = x.to_vec();
    for (value, name) in x.iter_mut().zip(names(robot)) {
        if ["F", "Off", "Rest", "Ks", "G", "C"].iter().any(|first| name.starts_with(first)) {
            *value = 0.0;
        }
    }
    let mut tau = vec![0.0; q.len()];
    inverse_dynamics(robot, q, dq, ddq, &x, &mut tau).unwrap();
    tau
}

#[test]
fn torques_are_the_columns_times_the_parameters_and_the_direct_model_undoes_them() {
    for smoothing in [0.0, 0.3] {
        let robot = with_terms(smoothing);
        let (x, p) = (values(&robot), Layout::of(&robot).count());
        let log = motion(11);
        let [q, dq, ddq] = &log;
        let (mut tau, mut w, mut back) = (vec![0.0; 66], vec![0.0; 66 * p], vec![0.0; 66]);
        inverse_dynamics(&robot, q, dq, ddq, &x, &mut tau).unwrap();
        let load = load(&robot, &log, &x);
        regressor_under_load(&robot, q, dq, ddq, &load, &mut w).unwrap();
        for (tau, row) in tau.iter().zip(w.chunks_exact(p)) {
            let want: f64 = row.iter().zip(&x).map(|(w, x)| w * x).sum();
            assert!((tau - want).abs() < 1e-11 * (1.0 + want.abs()), "{tau} {want}");
        }
        assert_eq!(direct_dynamics(&robot, q, dq, &tau, &x, &mut back).unwrap(), None);
        for (back, want) in back.iter().zip(ddq) {
            assert!((back - want).abs() < 1e-9 * (1.0 + want.abs()), "{back} {want}");
        }
    }
}

#[test]
fn the_observation_matrix_has_the_columns_of_the_regressor() {
    let robot = with_terms(0.0);
    let p = Layout::of(&robot).count();
    let log = motion(9);
    let load = load(&robot, &log, &values(&robot));
    let [q, dq, ddq] = &log;
    let mut w = vec![0.0; 54 * p];
    regressor_under_load(&robot, q, dq, ddq, &load, &mut w).unwrap();
    let columns: Vec<usize> = (p - 13..p).collect();
    let observed = observation(&robot, Log { q, dq, ddq, load: &load }, &columns, &[], 1).unwrap();
    for (c, &column) in columns.iter().enumerate() {
        for j in 0..6 {
            for k in 0..9 {
                assert_eq!(observed[c * 54 + j * 9 + k], w[(k * 6 + j) * p + column]);
            }
        }
    }
    let error = observation(&robot, Log { q, dq, ddq, load: &[] }, &columns, &[], 1).unwrap_err();
    assert!(error.to_string().contains("load friction"), "{error}");
    assert!(regressor(&robot, q, dq, ddq, &mut w).is_err());
}

#[test]
fn each_term_is_a_base_parameter_with_a_name_and_a_unit() {
    let robot = with_terms(0.0);
    let plain = base_parameters(&without_terms(&robot)).unwrap();
    let base = base_parameters(&robot).unwrap();
    assert_eq!(base.kept[..plain.kept.len()], plain.kept);
    assert_eq!(base.kept.len(), plain.kept.len() + 13);
    for (terms, expected) in base.terms.iter().zip(&plain.terms) {
        assert_eq!(terms.len(), expected.len());
        for (term, other) in terms.iter().zip(expected) {
            assert_eq!((term.column, &term.symbol), (other.column, &other.symbol));
            // The rank is found with the columns of the terms beside the others, so the last digits differ.
            assert!((term.coefficient - other.coefficient).abs() < 1e-12);
        }
    }
    let named: Vec<String> =
        names(&robot).iter().zip(units(&robot)).map(|(name, unit)| format!("{name} {unit}")).collect();
    assert_eq!(
        named[Layout::of(&robot).term(0)..],
        [
            "Rest1 N.m",
            "Fa1 N.m",
            "Fs2 N",
            "Fl2 1",
            "Fr3 N.m.(s/rad)^0.5",
            "Fvp4 N.m.s/rad",
            "Fu5 N.m",
            "Fl6 1",
            "Ks1 N.m/rad",
            "Gs3 N.m",
            "Gc4 N.m",
            "Cf5 N",
            "Ck6 N/m"
        ]
    );
}

#[test]
fn a_cylinder_pushes_along_the_change_of_its_length() {
    let plain = robot(&[false]);
    let terms = vec![term(0, "Cf", Law::Cylinder(CYLINDER)), term(0, "Ck", Law::CylinderRate(CYLINDER))];
    let robot = with_friction(&plain, Friction { terms, ..plain.friction().clone() });
    let p = Layout::of(&robot).count();
    let length = |q: f64| {
        let Cylinder { a, b, phi, .. } = CYLINDER;
        (a * a + b * b - 2.0 * a * b * (q + phi).cos()).sqrt()
    };
    let q: Vec<f64> = (-30..=30).map(|k| 0.1 * f64::from(k)).collect();
    let (still, mut w) = (vec![0.0; q.len()], vec![0.0; q.len() * p]);
    regressor(&robot, &q, &still, &still, &mut w).unwrap();
    for (row, q) in w.chunks_exact(p).zip(q) {
        let h = 1e-5;
        let slope = (length(q + h) - length(q - h)) / (2.0 * h);
        assert!((row[p - 2] - slope).abs() < 1e-9, "{q}");
        assert!((row[p - 1] - (length(q) - CYLINDER.rest) * slope).abs() < 1e-9, "{q}");
    }
}

#[test]
fn a_spring_that_gravity_has_the_columns_of_regroups() {
    let plain = robot(&[false]);
    for (gravity, grown) in [(plain.gravity(), 0), ([0.0; 3], 2)] {
        let made = |friction| Robot::new(plain.joints().to_vec(), gravity, &[vec![1.0]], friction).unwrap();
        let terms = vec![term(0, "Gs", Law::Sine), term(0, "Gc", Law::Cosine)];
        let friction = Friction { terms, ..Friction::sign(1) };
        let before = base_parameters(&made(Friction { terms: Vec::new(), ..friction.clone() })).unwrap();
        let robot = made(friction);
        let base = base_parameters(&robot).unwrap();
        assert_eq!(base.kept.len(), before.kept.len() + grown);
        let regrouped = base.terms.iter().flatten().filter(|term| term.column >= Layout::of(&robot).term(0));
        assert_eq!(regrouped.count() > 0, grown == 0);
    }
}

#[test]
fn terms_that_cannot_be_are_named() {
    let plain = robot(&[false, false]);
    let message = |terms: Vec<Term>, asymmetric: bool| {
        let friction = Friction { asymmetric, terms, ..Friction::sign(2) };
        let made = Robot::new(plain.joints().to_vec(), plain.gravity(), plain.transmission(), friction);
        made.unwrap_err().to_string()
    };
    assert_eq!(
        message(vec![term(2, "Fa", Law::Atan { velocity: 1.0 })], false),
        "friction term Fa of joint 3: the robot does not have this joint"
    );
    assert!(message(vec![term(0, "Fa", Law::Atan { velocity: 0.0 })], false).contains("above 0"));
    let sliding = robot(&[true]);
    let friction = Friction { terms: vec![term(0, "Gs", Law::Sine)], ..Friction::sign(1) };
    let made = Robot::new(sliding.joints().to_vec(), sliding.gravity(), sliding.transmission(), friction);
    assert!(made.unwrap_err().to_string().contains("only a joint that turns"));
    assert!(message(vec![term(0, "Rest", Law::Rest)], false).contains("needs a dead zone"));
    assert!(message(vec![term(0, "Fvp", Law::Forward)], true).contains("each direction already"));
    assert!(message(vec![term(1, "Fl", Law::Load), term(1, "Fl", Law::Load)], false).contains("twice"));
    assert_eq!(
        message(vec![term(0, "Fa", Law::Root); MAX_TERMS + 1], false),
        "friction has at most 120 further terms, got 121"
    );
}
