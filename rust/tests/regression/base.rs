//! Base parameters: textbook groupings, and torques that regrouping leaves as they are.

use crate::common::bodies::robot as bodies;
use didim::model::inverse::inverse_dynamics;
use didim::model::regressor::regressor;
use didim::regression::base::base_parameters;
use didim::regression::least_squares::solve;
use didim::robot::Friction;
use didim::robot::Robot;
use didim::robot::friction_terms::{Law, Term};
use didim::robot::parameters::Layout;
use didim::robot::parameters::names;
use didim::robot::{Joint, JointKind};
use faer::Mat;
use proptest::prelude::*;
use std::f64::consts::FRAC_PI_2;

fn planar(lengths: &[f64]) -> Robot {
    let n = lengths.len();
    let joints = lengths
        .iter()
        .map(|&d| Joint { kind: JointKind::Revolute, alpha: 0.0, d, theta: 0.0, r: 0.0 })
        .collect();
    let identity: Vec<Vec<f64>> =
        (0..n).map(|i| (0..n).map(|j| f64::from(u8::from(i == j))).collect()).collect();
    Robot::new(joints, [0.0, -9.81, 0.0], &identity, Friction::sign(n)).unwrap()
}

#[test]
fn planar_arm_regroups_as_the_textbook_says() {
    let robot = planar(&[0.0, 0.5]);
    let base = base_parameters(&robot).unwrap();
    let names = names(&robot);
    let kept: Vec<&str> = base.kept.iter().map(|&c| names[c].as_str()).collect();
    let inertial: Vec<&str> =
        kept.iter().copied().filter(|n| !n.starts_with('F') && !n.starts_with('O')).collect();
    assert_eq!(inertial, ["ZZ1", "MX1", "MY1", "ZZ2", "MX2", "MY2", "Ia2"]);
    let zz1 = kept.iter().position(|n| *n == "ZZ1").unwrap();
    let text: Vec<String> =
        base.terms[zz1].iter().map(|t| format!("{} {}", t.symbol, names[t.column])).collect();
    assert_eq!(text, [" Ia1", "d2^2 M2"]);
    assert_eq!(base.terms[zz1][1].coefficient, 0.25);
    assert!(base.unidentifiable.iter().any(|&c| names[c] == "MZ2"));
}

/// The value of a symbol, read as it is written: `2 r4 sin(alpha4)`, `(d3^2 + r3^2)`, or a number.
fn read(robot: &Robot, text: &str) -> f64 {
    if let Some(sum) = text.strip_prefix('(').and_then(|rest| rest.strip_suffix(')')) {
        return match sum.split_once(" + ") {
            Some((a, b)) => read(robot, a) + read(robot, b),
            None => sum.split_once(" - ").map(|(a, b)| read(robot, a) - read(robot, b)).unwrap(),
        };
    }
    let (sign, product) = text.strip_prefix('-').map_or((1.0, text), |rest| (-1.0, rest));
    let joint = |number: &str| robot.joints()[number.parse::<usize>().unwrap() - 1];
    let angle = |name: &str| match name.strip_prefix("alpha") {
        Some(number) => joint(number).alpha,
        None => joint(name.strip_prefix("theta").unwrap()).theta,
    };
    let factor = |text: &str| {
        let inside = |function: &str| text.strip_prefix(function)?.strip_suffix(')');
        match (text.strip_prefix('d'), text.strip_prefix('r'), inside("cos("), inside("sin(")) {
            (Some(number), ..) => joint(number).d,
            (_, Some(number), ..) => joint(number).r,
            (.., Some(name), _) => angle(name).cos(),
            (.., Some(name)) => angle(name).sin(),
            _ => text.parse().unwrap(),
        }
    };
    product.split_whitespace().fold(sign, |value, text| match text.strip_suffix("^2") {
        Some(root) => value * factor(root) * factor(root),
        None => value * factor(text),
    })
}

#[test]
fn base_parameters_make_the_same_torques_and_symbols_say_their_value() {
    let (o, i) = (false, true);
    let both = |robot: &Robot| {
        let coupling = [vec![1.0, 0.5], vec![0.25, 1.0]];
        Robot::new(robot.joints().to_vec(), robot.gravity(), &coupling, robot.friction().clone()).unwrap()
    };
    let mut symbols = Vec::new();
    for robot in [
        bodies(&[i, o, o]),
        bodies(&[o, i, o, i]),
        bodies(&[o, o, o, o]),
        bodies(&[i, i, i, o]),
        both(&bodies(&[o, o])),
    ] {
        let base = base_parameters(&robot).unwrap();
        let (n, p) = (robot.n_dof(), Layout::of(&robot).count());
        let x: Vec<f64> = (0..p).map(|k| (0.7 * (k * k) as f64).sin()).collect();
        let mut grouped = vec![0.0; p];
        for (&kept, terms) in base.kept.iter().zip(&base.terms) {
            grouped[kept] = x[kept] + terms.iter().map(|term| term.coefficient * x[term.column]).sum::<f64>();
            for term in terms {
                let value = read(&robot, &term.symbol);
                assert!((value - term.coefficient).abs() < 1e-9, "{value} {term:?}");
                symbols.push(term.symbol.clone());
            }
        }
        // Other states than those the columns were judged on.
        let motion = |a: f64| (0..20 * n).map(|k| (a * k as f64 + a).sin() * 2.0).collect::<Vec<_>>();
        let torques = |x: &[f64]| {
            let mut tau = vec![0.0; 20 * n];
            inverse_dynamics(&robot, &motion(1.1), &motion(0.7), &motion(1.7), x, &mut tau).unwrap();
            tau
        };
        for (got, want) in torques(&grouped).iter().zip(torques(&x)) {
            assert!((got - want).abs() < 1e-8 * (1.0 + want.abs()), "{got} {want}");
        }
        // Every parameter is kept, in a group, or without effect.
        let regrouped: Vec<usize> = base.terms.iter().flatten().map(|term| term.column).collect();
        let found = |column| {
            [base.kept.contains(&column), regrouped.contains(&column), base.unidentifiable.contains(&column)]
        };
        assert!((0..p).all(|column| found(column).iter().filter(|&&yes| yes).count() == 1));
    }
    for symbol in [
        "2 r3",
        "sin(theta2)^2",
        "-2 cos(theta4) sin(theta4)",
        "(d3^2 + r3^2)",
        "(r3^2 + d3^2 cos(theta2)^2)",
        "(2 sin(theta4)^2 - 1)",
    ] {
        assert!(symbols.iter().any(|found| found == symbol), "{symbol}");
    }
}

#[test]
fn equal_lengths_are_told_apart() {
    let robot = planar(&[0.0, 0.5, 0.5]);
    let base = base_parameters(&robot).unwrap();
    let names = names(&robot);
    let m3: Vec<(&str, &str)> = base
        .kept
        .iter()
        .zip(&base.terms)
        .flat_map(|(&k, terms)| terms.iter().map(move |t| (k, t)))
        .filter(|(_, t)| names[t.column] == "M3")
        .map(|(k, t)| (names[k].as_str(), t.symbol.as_str()))
        .collect();
    assert_eq!(m3, [("ZZ1", "d2^2"), ("MX1", "d2"), ("ZZ2", "d3^2"), ("MX2", "d3")]);
}

#[test]
fn a_bent_arm_has_symbols_of_its_angle() {
    let mut joints = planar(&[0.0, 0.3]).joints().to_vec();
    joints[1].alpha = 0.4;
    joints.push(Joint { alpha: FRAC_PI_2, ..joints[0] });
    let identity: Vec<Vec<f64>> =
        (0..3).map(|i| (0..3).map(|j| f64::from(u8::from(i == j))).collect()).collect();
    let robot = Robot::new(joints, [1.0, 2.0, -9.81], &identity, Friction::sign(3)).unwrap();
    let base = base_parameters(&robot).unwrap();
    for term in base.terms.iter().flatten() {
        assert!(!term.symbol.contains('.'), "{term:?}");
        assert!((read(&robot, &term.symbol) - term.coefficient).abs() < 1e-12, "{term:?}");
    }
}

/// A joint of a random robot: does it slide, quarter turns from the axis before, is its origin elsewhere, does it have a torque at
/// rest, is its sign kept through rest?
type Drawn = (bool, u8, bool, bool, bool);

/// Many slides of these are along gravity.
fn drawn(joints: &[Drawn], zone: f64, smoothing: f64, asymmetric: bool) -> Robot {
    let n = joints.len();
    let joint = |&(slides, turns, far, ..): &Drawn| Joint {
        kind: if slides { JointKind::Prismatic } else { JointKind::Revolute },
        alpha: f64::from(turns) * FRAC_PI_2,
        d: if far { 0.3 } else { 0.0 },
        theta: 0.2,
        r: 0.1,
    };
    let identity: Vec<Vec<f64>> =
        (0..n).map(|i| (0..n).map(|j| f64::from(u8::from(i == j))).collect()).collect();
    let at_rest = |(joint, &(.., rests, _)): (usize, &Drawn)| {
        (rests && zone > 0.0).then(|| Term { joint, law: Law::Rest, name: "Rest".into() })
    };
    let friction = Friction {
        asymmetric,
        dead_zone: vec![zone; n],
        smoothing: joints.iter().map(|&(.., held)| if held { 0.0 } else { smoothing }).collect(),
        held: joints.iter().map(|&(.., held)| if held { 1e-6 } else { 0.0 }).collect(),
        terms: joints.iter().enumerate().filter_map(at_rest).collect(),
        ..Friction::sign(n)
    };
    Robot::new(joints.iter().map(joint).collect(), [0.0, 0.0, -9.81], &identity, friction).unwrap()
}

/// A dead zone tells the weight of a slide along gravity from friction that differs by direction; a sign that is kept has none.
#[test]
fn a_sign_that_is_kept_through_rest_has_no_dead_zone() {
    let count = |zone, held| {
        let robot = drawn(&[(true, 0, false, false, held)], zone, 0.0, true);
        base_parameters(&robot).unwrap().kept.len()
    };
    assert_eq!(count(0.1, true), count(0.0, false));
    assert_eq!(count(0.1, false), count(0.0, false) + 1);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// A slide along gravity has a constant force, and friction that differs by direction has one too, but not in its dead zone.
    #[test]
    fn regrouped_friction_makes_the_same_torques_at_every_speed(
        joints in prop::collection::vec(any::<Drawn>(), 1..5),
        zone in prop::sample::select(vec![0.0, 1e-3, 1e-2, 0.1]),
        smoothing in prop::sample::select(vec![0.0, 0.0, 1e-3, 5e-2]),
        asymmetric in any::<bool>(),
    ) {
        let joint = |(_, turns, far, rests, held): Drawn| (turns % 2 == 0, turns / 2 % 4, far, rests, held);
        let joints: Vec<Drawn> = joints.into_iter().map(joint).collect();
        let robot = drawn(&joints, zone, smoothing, asymmetric);
        let base = base_parameters(&robot).unwrap();
        let (n, p) = (robot.n_dof(), Layout::of(&robot).count());
        let samples = 4 * p + 20;
        let wave = |a: f64| (0..samples * n).map(|k| (a * (k * k) as f64 + a).sin() * 2.0).collect::<Vec<_>>();
        let (q, mut dq, ddq) = (wave(1.1), wave(0.7), wave(1.7));
        for (k, dq) in dq.iter_mut().enumerate() {
            if joints[k % n].4 {
                // Where a sign is kept, that of the speed is it beyond the zone alone.
                *dq += (2.0 * zone).copysign(*dq);
            } else {
                // A third is around the edge of the zone, and one where a smooth sign turns.
                let pace = [zone, smoothing, 1.0][(k / n + k % n) % 3];
                *dq *= if pace > 0.0 { pace } else { 1.0 };
            }
        }
        let x: Vec<f64> = (0..p).map(|k| (0.7 * (k * k) as f64).sin()).collect();
        let mut grouped = vec![0.0; p];
        for (&kept, terms) in base.kept.iter().zip(&base.terms) {
            grouped[kept] = x[kept] + terms.iter().map(|term| term.coefficient * x[term.column]).sum::<f64>();
        }
        let torques = |x: &[f64]| {
            let mut tau = vec![0.0; samples * n];
            inverse_dynamics(&robot, &q, &dq, &ddq, x, &mut tau).unwrap();
            tau
        };
        for (got, want) in torques(&grouped).iter().zip(torques(&x)) {
            prop_assert!((got - want).abs() < 1e-8 * (1.0 + want.abs()), "{got} {want}");
        }
        if joints.iter().all(|joint| !joint.4) {
            let mut w = vec![0.0; samples * n * p];
            regressor(&robot, &q, &dq, &ddq, &mut w).unwrap();
            let kept = Mat::from_fn(samples * n, base.kept.len(), |row, k| w[row * p + base.kept[k]]);
            let solved = solve(kept.as_ref(), &vec![0.0; samples * n], 1e-9).unwrap();
            prop_assert!(solved.dependent.is_empty(), "{:?}", solved.dependent);
        }
    }
}
