//! The direct model (4).

use crate::common::bodies::{parameters, polar, robot, with_joints};
use didim::model::direct::{Indefinite, direct_dynamics};
use didim::model::inverse::inverse_dynamics;
use didim::robot::Joint;
use didim::robot::arm::{At, DISPLACED, MOMENTS};

#[test]
fn axes_that_meet_in_a_point_need_no_forces() {
    // A shoulder of three axes, then an arm: the wrenches within the shoulder are moments only.
    let arm = robot(&[false; 5]);
    let bend = |(j, joint): (usize, &Joint)| {
        if j < 3 { Joint { d: 0.0, r: 0.0, ..*joint } } else { Joint { d: 0.3, ..*joint } }
    };
    let robot = with_joints(&arm, arm.joints().iter().enumerate().map(bend).collect());
    let carries = [1, 2, 3, 4].map(|j| robot.geometry().step(At(j)).form.carries);
    assert_eq!(carries, [MOMENTS, MOMENTS, DISPLACED, DISPLACED]);
    let motion = |a: f64| (0..35).map(|k| (a * f64::from(k) + a).sin() * 2.0).collect::<Vec<_>>();
    let (q, dq, ddq, x) = (motion(1.1), motion(0.7), motion(1.7), parameters(&robot));
    let (mut tau, mut back) = (vec![0.0; 35], vec![0.0; 35]);
    inverse_dynamics(&robot, &q, &dq, &ddq, &x, &mut tau).unwrap();
    assert_eq!(direct_dynamics(&robot, &q, &dq, &tau, &x, &mut back).unwrap(), None);
    for (back, want) in back.iter().zip(&ddq) {
        assert!((back - want).abs() < 1e-9, "{back} {want}");
    }
}

#[test]
fn an_indefinite_inertia_matrix_is_named_by_sample_and_joint() {
    let q = [0.3, 0.5, 0.1, 1.0, -0.2, -1.5, 0.0, 0.2, 0.0, -1.9, 0.7, 2.1, 0.1, 3.0];
    let run = |inertia: f64, mass: f64, rotor: f64| {
        let (robot, x) = polar([inertia, mass, rotor]);
        direct_dynamics(&robot, &q, &[0.0; 14], &[0.0; 14], &x, &mut [0.0; 14]).unwrap()
    };
    // 4 - q^2 below zero, in the second block of lanes first.
    assert_eq!(run(4.0, -1.0, 2.0), Some(Indefinite { sample: 5, joint: 0 }));
    assert_eq!(run(10.0, -1.0, 2.0), None);
    assert_eq!(run(4.0, 1.0, -1.5), Some(Indefinite { sample: 0, joint: 1 }));
    assert_eq!(run(f64::NAN, 1.0, 1.0), Some(Indefinite { sample: 0, joint: 0 }));
}

#[test]
fn arrays_that_do_not_fit_are_named() {
    let (robot, x) = polar([4.0, 1.0, 2.0]);
    let error = direct_dynamics(&robot, &[0.0; 4], &[0.0; 4], &[0.0; 2], &x, &mut [0.0; 4]).unwrap_err();
    assert_eq!(error.to_string(), "tau has 2 numbers where 4 are needed");
    let error = direct_dynamics(&robot, &[], &[], &[], &x[3..], &mut []).unwrap_err();
    assert_eq!(error.to_string(), "x has 25 numbers where 28 are needed");
    assert_eq!(direct_dynamics(&robot, &[], &[], &[], &x, &mut []).unwrap(), None);
}
