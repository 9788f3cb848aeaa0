//! The inertia matrix, its smallest eigenvalue, and steps of the parameters that keep it positive definite.

use crate::common::bodies::{parameters, polar, robot};
use didim::model::inertia::{inertia_matrix, largest_safe_step, smallest_eigenvalue};
use didim::model::inverse::inverse_dynamics;

/// Positions of all joints, within two rad or m.
fn positions(n: usize, samples: usize) -> Vec<f64> {
    (0..samples * n).map(|k| (1.3 * k as f64 + 0.4).sin() * 2.0).collect()
}

#[test]
fn columns_are_those_of_the_inverse_model() {
    let (o, i) = (false, true);
    for slides in [
        vec![o],
        vec![i],
        vec![o, i, o],
        vec![i, i, i],
        vec![o; 6],
        vec![i, o, o, i, o, o],
        vec![o, o, i, o, o, i, o, o],
    ] {
        let robot = robot(&slides);
        let (n, samples, x) = (slides.len(), 6, parameters(&robot));
        let (q, still) = (positions(n, samples), vec![0.0; samples * n]);
        let torques = |ddq: &[f64]| {
            let mut tau = still.clone();
            inverse_dynamics(&robot, &q, &still, ddq, &x, &mut tau).unwrap();
            tau
        };
        let at_rest = torques(&still);
        let mut matrices = vec![0.0; samples * n * n];
        inertia_matrix(&robot, &q, &x, &mut matrices).unwrap();
        for j in 0..n {
            let unit: Vec<f64> = (0..samples * n).map(|k| if k % n == j { 1.0 } else { 0.0 }).collect();
            for (row, (tau, rest)) in torques(&unit).iter().zip(&at_rest).enumerate() {
                let (got, want) = (matrices[row * n + j], tau - rest);
                assert!((got - want).abs() < 1e-11 * (1.0 + tau.abs()), "{slides:?} {row} {j}: {got} {want}");
            }
        }
    }
}

#[test]
fn the_smallest_eigenvalue_is_that_of_its_sample() {
    let q = [0.3, 0.5, 0.1, 1.0, -0.2, -2.0, 0.0, 3.0, 0.7, 0.2];
    // 4 - 0.4 q^2 is smallest at q = 3; the other is 1.6 everywhere.
    let (robot, x) = polar([4.0, -0.4, 2.0]);
    let (sample, value) = smallest_eigenvalue(&robot, &q, &x).unwrap().unwrap();
    assert!(sample == 3 && (value - 0.4).abs() < 1e-14, "{sample} {value}");
    // Here it is the slider's own, and with a negative rotor below zero.
    let (robot, x) = polar([4.0, 0.5, -0.75]);
    let (_, value) = smallest_eigenvalue(&robot, &q, &x).unwrap().unwrap();
    assert!((value + 0.25).abs() < 1e-14, "{value}");
    assert_eq!(smallest_eigenvalue(&robot, &[], &x).unwrap(), None);
}

#[test]
fn a_safe_step_ends_where_the_closed_form_has_the_margin() {
    let q = [0.3, 0.5, 0.1, -2.0, -0.2, 1.0];
    let (robot, x) = polar([4.0, 2.0, 5.0]);
    let step = |target: [f64; 3]| largest_safe_step(&robot, &q, &x, &polar(target).1, 0.1).unwrap();
    // At q = 2: 4 + 4 (2 - 5 a) = 0.1 (4 + 8).
    assert!((step([4.0, -3.0, 5.0]) - 0.54).abs() < 1e-14);
    // The slider: 7 - 28 a = 0.7.
    assert!((step([4.0, 2.0, -23.0]) - 0.225).abs() < 1e-14);
    assert_eq!(step([5.0, 2.5, 4.0]), 1.0);
    let outside = polar([4.0, -3.0, 5.0]).1;
    assert_eq!(largest_safe_step(&robot, &q, &outside, &x, 0.1).unwrap(), 0.0);
}

#[test]
fn a_safe_step_ends_where_any_robot_has_the_margin() {
    for slides in [vec![false; 3], vec![false, true, false], vec![true, false, false, true]] {
        let robot = robot(&slides);
        let (q, x) = (positions(slides.len(), 9), parameters(&robot));
        let target: Vec<f64> = x.iter().enumerate().map(|(k, x)| x * (k as f64 + 0.5).cos()).collect();
        for margin in [0.0, 0.3] {
            let step = largest_safe_step(&robot, &q, &x, &target, margin).unwrap();
            assert!(step > 0.0 && step < 1.0, "{slides:?}: {step}");
            // M is linear in the parameters: what is left above the margin is M of these.
            let left = |a: f64| {
                let above: Vec<f64> =
                    x.iter().zip(&target).map(|(x, t)| x + a * (t - x) - margin * x).collect();
                smallest_eigenvalue(&robot, &q, &above).unwrap().unwrap().1
            };
            assert!(left(step).abs() < 1e-12, "{slides:?}: {}", left(step));
            assert!(left(0.99 * step) > 1e-6 && left(1.01 * step) < -1e-6, "{slides:?}");
        }
    }
}

#[test]
fn arrays_that_do_not_fit_are_named() {
    let (robot, x) = polar([4.0, 2.0, 5.0]);
    let message = |q: &[f64], x: &[f64], length: usize| {
        inertia_matrix(&robot, q, x, &mut vec![0.0; length]).unwrap_err().to_string()
    };
    assert_eq!(message(&[0.0; 4], &x[1..], 8), "x has 27 numbers where 28 are needed");
    assert_eq!(message(&[0.0; 4], &x, 4), "matrices has 4 numbers where 8 are needed");
    let step = |x: &[f64], target: &[f64]| largest_safe_step(&robot, &[0.0; 4], x, target, 0.1);
    assert_eq!(step(&x, &x[2..]).unwrap_err().to_string(), "x has 26 numbers where 28 are needed");
    assert!(step(&x[1..], &x).is_err());
    assert!(smallest_eigenvalue(&robot, &[0.0; 4], &x[1..]).is_err());
}
