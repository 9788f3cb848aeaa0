//! The information of a motion and its gradient.

use didim::model::inverse::inverse_dynamics;
use didim::model::regressor::regressor;
use didim::robot::Robot;
use didim::robot::parameters::Layout;
use didim::robot::{Friction, Joint, JointKind};
use didim::tangent::adjoint::Gradient;
use didim::tangent::information::{BLOCK, Motion, Torques, Weighting, information, information_gradient};

/// Joints that slide where it says so; the last motor turns with the joint before.
fn robot(slides: &[bool]) -> Robot {
    let n = slides.len();
    let joint = |(j, &slides): (usize, &bool)| Joint {
        kind: if slides { JointKind::Prismatic } else { JointKind::Revolute },
        alpha: 0.4 * j as f64,
        d: 0.1 * j as f64,
        theta: 0.3,
        r: 0.2,
    };
    let mut transmission = vec![vec![0.0; n]; n];
    for j in 0..n {
        transmission[j][j] = 1.0;
    }
    if n > 1 {
        transmission[n - 1][n - 2] = 0.5;
    }
    let friction = Friction { smoothing: vec![0.4; n], ..Friction::sign(n) };
    let joints = slides.iter().enumerate().map(joint).collect();
    Robot::new(joints, [0.5, 1.0, -9.81], &transmission, friction).unwrap()
}

fn wave(a: f64, count: usize) -> Vec<f64> {
    (0..count).map(|k| 2.0 * (a * k as f64 + a).sin()).collect()
}

/// Samples that do not fill the last block.
const SAMPLES: usize = 2 * BLOCK + 7;

fn columns(robot: &Robot) -> Vec<usize> {
    (0..Layout::of(robot).count()).filter(|k| k % 3 != 1).collect()
}

#[test]
fn the_matrix_is_that_of_the_regressor() {
    let robot = robot(&[false, true, false]);
    let (n, p, columns) = (3, Layout::of(&robot).count(), columns(&robot));
    let (q, dq, ddq) = (wave(1.1, n * SAMPLES), wave(0.7, n * SAMPLES), wave(1.7, n * SAMPLES));
    let weights = [2.0, 0.5, 3.0];
    let mut w = vec![0.0; n * SAMPLES * p];
    regressor(&robot, &q, &dq, &ddq, &mut w).unwrap();
    let b = columns.len();
    let mut matrix = vec![0.0; b * b];
    let motion = Motion { q: &q, dq: &dq, ddq: &ddq };
    information(&robot, motion, Weighting { columns: &columns, joints: &weights }, &mut matrix).unwrap();
    for (i, &ci) in columns.iter().enumerate() {
        for (j, &cj) in columns.iter().enumerate() {
            let want: f64 =
                w.chunks_exact(p).enumerate().map(|(r, row)| weights[r % n] * row[ci] * row[cj]).sum();
            let scale: f64 = w.chunks_exact(p).map(|row| row[ci].abs().max(row[cj].abs()).powi(2)).sum();
            assert!((matrix[i * b + j] - want).abs() < 1e-12 * (1.0 + scale), "{i} {j}");
        }
    }
}

#[test]
fn the_gradient_is_the_difference_of_the_criterion() {
    let robot = robot(&[false, true, false]);
    let (n, p, columns) = (3, Layout::of(&robot).count(), columns(&robot));
    let b = columns.len();
    let weights = [2.0, 0.5, 3.0];
    let weighting = Weighting { columns: &columns, joints: &weights };
    // A criterion that is linear in the matrix, and in the torques.
    let mut derivative = vec![0.0; b * b];
    for i in 0..b {
        for j in 0..b {
            derivative[i * b + j] = ((i * j) as f64 * 0.3).cos() + ((i + j) as f64).sin();
        }
    }
    let (x, torque_weights) = (wave(0.31, p), wave(0.53, n * SAMPLES));
    let value = |arrays: &[Vec<f64>; 3]| -> f64 {
        let [q, dq, ddq] = arrays;
        let (mut matrix, mut tau) = (vec![0.0; b * b], vec![0.0; q.len()]);
        information(&robot, Motion { q, dq, ddq }, weighting, &mut matrix).unwrap();
        inverse_dynamics(&robot, q, dq, ddq, &x, &mut tau).unwrap();
        let of_matrix: f64 = matrix.iter().zip(&derivative).map(|(m, d)| m * d).sum();
        of_matrix + tau.iter().zip(&torque_weights).map(|(t, w)| t * w).sum::<f64>()
    };
    let arrays = [wave(1.1, n * SAMPLES), wave(0.7, n * SAMPLES), wave(1.7, n * SAMPLES)];
    let mut found = [(); 3].map(|()| vec![0.0; n * SAMPLES]);
    {
        let [q, dq, ddq] = &mut found;
        let motion = Motion { q: &arrays[0], dq: &arrays[1], ddq: &arrays[2] };
        let torques = Torques { weights: &torque_weights, x: &x };
        let mut out = Gradient { q, dq, ddq };
        information_gradient(&robot, motion, weighting, &derivative, Some(torques), &mut out).unwrap();
    }
    for kind in 0..3 {
        for at in [0, n * BLOCK + 1, n * SAMPLES - 1] {
            let h = 1e-5;
            let moved = |by: f64| {
                let mut arrays = arrays.clone();
                arrays[kind][at] += by;
                value(&arrays)
            };
            let want = (moved(h) - moved(-h)) / (2.0 * h);
            let got = found[kind][at];
            assert!((got - want).abs() < 1e-4 * (1.0 + want.abs()), "{kind} {at}: {got} {want}");
        }
    }
}

#[test]
fn columns_and_arrays_that_do_not_fit_are_named() {
    let robot = robot(&[false]);
    let motion = Motion { q: &[0.0], dq: &[0.0], ddq: &[0.0] };
    let message = |columns: &[usize], joints: &[f64], length: usize| {
        let weighting = Weighting { columns, joints };
        information(&robot, motion, weighting, &mut vec![0.0; length]).unwrap_err().to_string()
    };
    assert_eq!(message(&[0], &[1.0, 2.0], 1), "weights has 2 numbers where 1 are needed");
    assert_eq!(message(&[0], &[1.0], 2), "the information matrix has 2 numbers where 1 are needed");
    assert!(message(&[99], &[1.0], 1).contains("99"));
}
