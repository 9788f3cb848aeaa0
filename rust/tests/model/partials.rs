//! Partial derivatives of the inverse model against differences.

use crate::common::arms::{frictions, robot};
use crate::common::partials::partials;
use didim::model::inverse::inverse_dynamics;
use didim::robot::parameters::Layout;

#[test]
fn values_are_those_of_the_kernel_and_derivatives_differences_of_them() {
    // The second joint is within its dead zone.
    for friction in frictions() {
        let robot = robot(friction);
        let x: Vec<f64> = (0..Layout::of(&robot).count()).map(|k| ((k * k) as f64 * 0.7).sin()).collect();
        let (q, dq, ddq) = ([0.3, -0.7, 0.2, 1.1], [0.4, -0.2, 0.3, -0.6], [1.0, -2.0, 0.5, 3.0]);
        let model = |q: &[f64], dq: &[f64]| {
            let mut tau = [0.0; 4];
            inverse_dynamics(&robot, q, dq, &ddq, &x, &mut tau).unwrap();
            tau
        };
        let found = partials(&robot, &x, &q, &dq, &ddq);
        let exact = model(&q, &dq);
        let h = 1e-6;
        for j in 0..4 {
            let moved = |by: f64, v: [f64; 4]| {
                let mut v = v;
                v[j] += by;
                v
            };
            let along_q = (model(&moved(h, q), &dq), model(&moved(-h, q), &dq));
            let along_dq = (model(&q, &moved(h, dq)), model(&q, &moved(-h, dq)));
            for i in 0..4 {
                assert!((found.tau[i] - exact[i]).abs() < 1e-12);
                let difference = |pair: ([f64; 4], [f64; 4])| (pair.0[i] - pair.1[i]) / (2.0 * h);
                assert!((found.position[i][j] - difference(along_q)).abs() < 1e-8, "q {i} {j}");
                assert!((found.velocity[i][j] - difference(along_dq)).abs() < 1e-8, "dq {i} {j}");
            }
        }
    }
}
