//! Trees: the models agree with each other and with the textbook recursion, whatever stands on what.

use crate::common::bodies::parameters;
use crate::common::partials::partials;
use didim::model::{
    direct::direct_dynamics, inertia::inertia_matrix, inverse::inverse_dynamics, regressor::regressor,
};
use didim::regression::base::base_parameters;
use didim::robot::parameters::Layout;
use didim::robot::{Friction, Joint, JointKind, Mount, Robot};
use didim::tangent::adjoint::{Gradient, contraction_gradient};

/// Joints on given parents (one-based, 0 for the base), every kind of placement, coefficients of a motor that turns two joints.
fn tree(parents: &[usize], coupled: Option<(usize, usize)>) -> Robot {
    let n = parents.len();
    let joint = |j: usize| Joint {
        kind: if j % 4 == 2 { JointKind::Prismatic } else { JointKind::Revolute },
        alpha: [0.3, std::f64::consts::FRAC_PI_2, 0.0, -1.1][j % 4],
        d: [0.2, 0.0, -0.3][j % 3],
        theta: 0.1 * j as f64,
        r: [0.0, 0.25][j % 2],
    };
    let mount = |j: usize| Mount {
        parent: parents[j].checked_sub(1),
        gamma: [0.0, 0.7, std::f64::consts::FRAC_PI_2, 0.0, -2.0][j % 5],
        b: [0.1, 0.0][j % 2],
        shift: if j % 3 == 1 { [0.1, -0.2, 0.3] } else { [0.0; 3] },
    };
    let mut transmission = vec![vec![0.0; n]; n];
    for (m, row) in transmission.iter_mut().enumerate() {
        row[m] = 1.0;
    }
    if let Some((motor, other)) = coupled {
        transmission[motor][other] = 0.6;
    }
    let friction = Friction { smoothing: vec![0.3; n], ..Friction::sign(n) };
    let joints = (0..n).map(joint).collect();
    Robot::tree(joints, (0..n).map(mount).collect(), [1.0, 2.0, -9.81], &transmission, friction).unwrap()
}

/// Two arms on a torso, legs on the base, a star, one long branch; and motors between branches.
fn trees() -> Vec<Robot> {
    let deep: Vec<usize> = (0..40).collect();
    vec![
        tree(&[0, 1, 2, 3, 2, 5, 6], None),
        tree(&[0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11], None),
        tree(&[0, 1, 1, 1, 1, 0, 0], None),
        tree(&deep, None),
        tree(&[0, 1, 2, 3, 2, 5, 6], Some((6, 3))),
        tree(&[0, 1, 2, 0, 4, 5], Some((5, 1))),
    ]
}

fn motion(n: usize, samples: usize, a: f64) -> Vec<f64> {
    (0..n * samples).map(|k| (a * k as f64 + a).sin() * 1.5).collect()
}

fn close(found: &[f64], wanted: &[f64]) {
    let size = wanted.iter().fold(1e-3_f64, |size, value| size.max(value.abs()));
    for (a, b) in found.iter().zip(wanted) {
        assert!((a - b).abs() < 1e-10 * size, "{a} and {b} of {size}");
    }
}

#[test]
fn the_models_of_trees_agree() {
    for robot in trees() {
        let (n, p, samples) = (robot.n_dof(), Layout::of(&robot).count(), 5);
        let (q, dq, ddq) = (motion(n, samples, 1.1), motion(n, samples, 0.7), motion(n, samples, 1.7));
        let x = parameters(&robot);
        let mut tau = vec![0.0; n * samples];
        inverse_dynamics(&robot, &q, &dq, &ddq, &x, &mut tau).unwrap();
        let mut w = vec![0.0; n * samples * p];
        regressor(&robot, &q, &dq, &ddq, &mut w).unwrap();
        let product: Vec<f64> =
            w.chunks_exact(p).map(|row| row.iter().zip(&x).map(|(a, b)| a * b).sum()).collect();
        close(&tau, &product);
        let textbook: Vec<f64> = (0..samples)
            .flat_map(|k| {
                let at = |values: &[f64]| values[k * n..(k + 1) * n].to_vec();
                partials(&robot, &x, &at(&q), &at(&dq), &at(&ddq)).tau[..n].to_vec()
            })
            .collect();
        close(&tau, &textbook);
        let mut matrices = vec![0.0; n * n * samples];
        inertia_matrix(&robot, &q, &x, &mut matrices).unwrap();
        let mut still = vec![0.0; n * samples];
        inverse_dynamics(&robot, &q, &dq, &vec![0.0; n * samples], &x, &mut still).unwrap();
        let sum: Vec<f64> = (0..n * samples)
            .map(|row| {
                let (k, matrix) = (row / n, &matrices[row * n..(row + 1) * n]);
                still[row] + matrix.iter().zip(&ddq[k * n..]).map(|(m, a)| m * a).sum::<f64>()
            })
            .collect();
        close(&tau, &sum);
        // The bodies of these parameters need not be real ones for the factors to exist.
        let mut back = vec![0.0; n * samples];
        if direct_dynamics(&robot, &q, &dq, &tau, &x, &mut back).unwrap().is_none() {
            close(&back, &ddq);
        }
    }
}

#[test]
fn gradients_of_trees_are_derivatives_of_the_inverse_model() {
    for robot in trees() {
        let (n, p) = (robot.n_dof(), Layout::of(&robot).count());
        let (q, dq, ddq, weights) =
            (motion(n, 1, 1.1), motion(n, 1, 0.7), motion(n, 1, 1.7), motion(n, 1, 2.3));
        let x = parameters(&robot);
        // Rows of parameters, each with a weight: the sum is that of the weighted torques.
        let g: Vec<f64> =
            weights.iter().flat_map(|weight| x.iter().map(move |value| weight * value)).collect();
        let mut found = [vec![0.0; n], vec![0.0; n], vec![0.0; n]];
        let [of_q, of_dq, of_ddq] = &mut found;
        contraction_gradient(&robot, &q, &dq, &ddq, &g, Gradient { q: of_q, dq: of_dq, ddq: of_ddq })
            .unwrap();
        let slopes = partials(&robot, &x, &q, &dq, &ddq);
        let mut matrix = vec![0.0; n * n];
        inertia_matrix(&robot, &q, &x, &mut matrix).unwrap();
        let sum = |entry: &dyn Fn(usize, usize) -> f64| -> Vec<f64> {
            (0..n).map(|j| (0..n).map(|i| weights[i] * entry(i, j)).sum()).collect()
        };
        assert_eq!(g.len(), n * p);
        close(&found[0], &sum(&|i, j| slopes.position[i][j]));
        close(&found[1], &sum(&|i, j| slopes.velocity[i][j]));
        close(&found[2], &sum(&|i, j| matrix[i * n + j]));
    }
}

#[test]
fn branches_that_share_nothing_have_zeros_between_them() {
    let robot = &trees()[1];
    let (n, q) = (12, motion(12, 1, 1.1));
    let mut matrix = vec![0.0; n * n];
    inertia_matrix(robot, &q, &parameters(robot), &mut matrix).unwrap();
    for i in 0..n {
        for j in 0..n {
            if i / 3 != j / 3 {
                assert_eq!(matrix[i * n + j], 0.0, "entry {i} {j}");
            }
        }
        assert!(matrix[i * n + i] > 0.0, "entry {i} {i}");
    }
}

#[test]
fn legs_have_the_base_parameters_of_each_leg() {
    let count = |robot: &Robot| base_parameters(robot).unwrap().kept.len();
    let legs = &trees()[1];
    let one = |first: usize| {
        let part = |j: usize| (legs.joints()[j], legs.mounts()[j]);
        let (joints, mut mounts): (Vec<Joint>, Vec<Mount>) = (first..first + 3).map(part).unzip();
        for (j, mount) in mounts.iter_mut().enumerate() {
            mount.parent = j.checked_sub(1);
        }
        let identity: Vec<Vec<f64>> =
            (0..3).map(|m| (0..3).map(|j| f64::from(u8::from(m == j))).collect()).collect();
        count(&Robot::tree(joints, mounts, legs.gravity(), &identity, Friction::sign(3)).unwrap())
    };
    assert_eq!(count(legs), (0..12).step_by(3).map(one).sum::<usize>());
}

#[test]
fn joints_are_numbered_branch_by_branch() {
    let joint = Joint { kind: JointKind::Revolute, alpha: 0.0, d: 0.1, theta: 0.0, r: 0.0 };
    let make = |parents: &[Option<usize>]| {
        let n = parents.len();
        let identity: Vec<Vec<f64>> =
            (0..n).map(|m| (0..n).map(|j| f64::from(u8::from(m == j))).collect()).collect();
        let mounts = parents.iter().map(|&parent| Mount::on(parent)).collect();
        Robot::tree(vec![joint; n], mounts, [0.0; 3], &identity, Friction::sign(n)).map_err(|e| e.to_string())
    };
    assert!(make(&[None, Some(0), Some(0), Some(2)]).is_ok());
    assert!(
        make(&[None, Some(0), Some(0), Some(1)]).unwrap_err().contains("number the joints branch by branch")
    );
    assert!(make(&[None, Some(1)]).unwrap_err().contains("numbered higher than the one it stands on"));
}
