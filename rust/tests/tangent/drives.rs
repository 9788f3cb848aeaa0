//! Gradients through further friction terms against differences.

use crate::common::arms::robot;
use didim::model::regressor::regressor;
use didim::robot::Friction;
use didim::robot::friction_terms::{Cylinder, Law, Table, Term};
use didim::robot::parameters::Layout;
use didim::tangent::adjoint::{Gradient, contraction_gradient};

#[test]
fn further_terms_have_the_differences_of_their_columns() {
    let term = |joint, name: &str, law| Term { joint, law, name: name.into() };
    let cylinder = Cylinder::new(0.6, 0.25, 0.4, 0.5).unwrap();
    let table = Table::new(-3.0, 0.5, (0..13).map(|k| 0.1 * f64::from(k * k)).collect()).unwrap();
    let terms = vec![
        term(0, "Fa", Law::Atan { velocity: 0.7 }),
        term(0, "Fs", Law::Stribeck { velocity: 0.9 }),
        term(1, "Fr", Law::Root),
        term(2, "Fvp", Law::Forward),
        term(3, "Fu", Law::Table(table)),
        term(2, "Ks", Law::Spring),
        term(0, "Gs", Law::Sine),
        term(1, "Gc", Law::Cosine),
        term(3, "Cf", Law::Cylinder(cylinder)),
        term(3, "Ck", Law::CylinderRate(cylinder)),
    ];
    let robot = robot(Friction { smoothing: vec![0.3; 4], terms, ..Friction::sign(4) });
    let (n, p) = (4, Layout::of(&robot).count());
    let wave = |a: f64, count: usize| -> Vec<f64> { (0..count).map(|k| (a * k as f64 + a).sin()).collect() };
    let (q, dq, ddq, g) = (wave(0.7, 5 * n), wave(1.1, 5 * n), wave(1.7, 5 * n), wave(0.37, 5 * n * p));
    let value = |q: &[f64], dq: &[f64]| -> f64 {
        let mut w = vec![0.0; g.len()];
        regressor(&robot, q, dq, &ddq, &mut w).unwrap();
        w.iter().zip(&g).map(|(w, g)| w * g).sum()
    };
    let [mut gq, mut gdq, mut gddq] = [(); 3].map(|()| vec![0.0; 5 * n]);
    let out = Gradient { q: &mut gq, dq: &mut gdq, ddq: &mut gddq };
    contraction_gradient(&robot, &q, &dq, &ddq, &g, out).unwrap();
    let moved = |values: &[f64], k: usize, by: f64| {
        let mut values = values.to_vec();
        values[k] += by;
        values
    };
    for k in 0..5 * n {
        let of_speed = value(&q, &moved(&dq, k, 1e-6)) - value(&q, &moved(&dq, k, -1e-6));
        let of_position = value(&moved(&q, k, 1e-6), &dq) - value(&moved(&q, k, -1e-6), &dq);
        for (got, difference) in [(gdq[k], of_speed), (gq[k], of_position)] {
            let want = difference / 2e-6;
            assert!((got - want).abs() < 1e-7 * (1.0 + want.abs()), "{k}: {got} {want}");
        }
    }
}
