//! Inverse model, regressor and direct model are one model: (1), (2) and (4).

use crate::common::bodies::{parameters, robot};
use didim::model::direct::direct_dynamics;
use didim::model::inverse::inverse_dynamics;
use didim::model::regressor::regressor;
use didim::robot::parameters::Layout;

#[test]
fn regrouping_changes_no_torque_and_the_direct_model_is_the_inverse() {
    let (o, i) = (false, true);
    for slides in [
        vec![o],
        vec![i],
        vec![i, o],
        vec![o, i, o],
        vec![i, i, i],
        vec![o; 6],
        vec![i, o, o, i, o, o],
        vec![o; 7],
        vec![o, o, i, o, o, i, o, o],
    ] {
        let robot = robot(&slides);
        let (n, p, samples) = (slides.len(), Layout::of(&robot).count(), 6);
        let motion = |a: f64| (0..samples * n).map(|k| (a * k as f64 + a).sin() * 2.0).collect::<Vec<_>>();
        let (q, dq, ddq) = (motion(1.1), motion(0.7), motion(1.7));
        let x = parameters(&robot);
        let (mut tau, mut w) = (vec![0.0; samples * n], vec![0.0; samples * n * p]);
        inverse_dynamics(&robot, &q, &dq, &ddq, &x, &mut tau).unwrap();
        regressor(&robot, &q, &dq, &ddq, &mut w).unwrap();
        for (tau, row) in tau.iter().zip(w.chunks_exact(p)) {
            let want: f64 = row.iter().zip(&x).map(|(w, x)| w * x).sum();
            assert!((tau - want).abs() < 1e-11 * (1.0 + want.abs()), "{slides:?}: {tau} {want}");
        }
        let mut back = vec![0.0; samples * n];
        assert_eq!(direct_dynamics(&robot, &q, &dq, &tau, &x, &mut back).unwrap(), None);
        for (back, want) in back.iter().zip(&ddq) {
            assert!((back - want).abs() < 1e-9, "{slides:?}: {back} {want}");
        }
    }
}
