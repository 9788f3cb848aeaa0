//! The regressor (2).

use crate::common::bodies::{parameters, robot, with_friction};
use didim::model::inverse::inverse_dynamics;
use didim::model::regressor::regressor;
use didim::robot::parameters::Layout;
use didim::robot::{Coupling, Friction};

fn motion(n: usize, samples: usize) -> [Vec<f64>; 3] {
    [1.1, 0.7, 1.7].map(|a| (0..samples * n).map(|k| (a * k as f64 + a).sin() * 2.0).collect())
}

#[test]
fn torques_are_the_columns_times_the_parameters_for_all_shapes_of_friction() {
    let plain = robot(&[false, true, false]);
    let sign = Friction::sign(3);
    let dead_zone = vec![0.5, 1.0, 1.5];
    for friction in [
        sign.clone(),
        Friction { asymmetric: true, ..sign.clone() },
        Friction { coupling: Coupling::Printed, ..sign.clone() },
        Friction { dead_zone: dead_zone.clone(), ..sign.clone() },
        Friction { dead_zone, smoothing: vec![0.3; 3], coupling: Coupling::Printed, ..sign },
    ] {
        let robot = with_friction(&plain, friction);
        let p = Layout::of(&robot).count();
        let x: Vec<f64> = (0..p).map(|k| (0.7 * (k * k) as f64).sin()).collect();
        let [q, dq, ddq] = motion(3, 11);
        let (mut tau, mut w) = (vec![0.0; 33], vec![0.0; 33 * p]);
        inverse_dynamics(&robot, &q, &dq, &ddq, &x, &mut tau).unwrap();
        regressor(&robot, &q, &dq, &ddq, &mut w).unwrap();
        for (tau, row) in tau.iter().zip(w.chunks_exact(p)) {
            let want: f64 = row.iter().zip(&x).map(|(w, x)| w * x).sum();
            assert!((tau - want).abs() < 1e-11 * (1.0 + want.abs()), "{:?}: {tau} {want}", robot.friction());
        }
    }
}

#[test]
fn arrays_that_do_not_fit_are_named() {
    let robot = robot(&[false]);
    let count = parameters(&robot).len();
    let message = |dq: &[f64], ddq: &[f64], length: usize| {
        regressor(&robot, &[0.0; 2], dq, ddq, &mut vec![0.0; length]).unwrap_err().to_string()
    };
    assert_eq!(message(&[0.0; 3], &[0.0; 2], 2 * count), "dq has 3 numbers where 2 are needed");
    assert_eq!(message(&[0.0; 2], &[0.0; 1], 2 * count), "ddq has 1 numbers where 2 are needed");
    assert_eq!(
        message(&[0.0; 2], &[0.0; 2], count),
        format!("w has 14 numbers where {} are needed", 2 * count)
    );
}
