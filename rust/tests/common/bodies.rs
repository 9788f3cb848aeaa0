//! Robots of every kind of joint and step, with bodies that exist.

use didim::robot::parameters::Layout;
use didim::robot::{Friction, Joint, JointKind, Robot};
use std::f64::consts::FRAC_PI_2;

/// Every kind of step; `slides` says which joints are prismatic.
pub fn robot(slides: &[bool]) -> Robot {
    let n = slides.len();
    let alphas = [0.2, FRAC_PI_2, 0.0, -FRAC_PI_2, 0.7, 2.0 * FRAC_PI_2];
    let joint = |j: usize| Joint {
        kind: if slides[j] { JointKind::Prismatic } else { JointKind::Revolute },
        alpha: alphas[(j + usize::from(slides[0])) % 6],
        d: [0.0, 0.3, -0.2][j % 3],
        theta: 0.1 * j as f64,
        r: [0.4, 0.0][j % 2],
    };
    let coupling: Vec<Vec<f64>> = (0..n)
        .map(|m| {
            (0..n)
                .map(|j| {
                    if m == j {
                        1.0
                    } else if m == n - 1 && j + 2 >= n {
                        0.5
                    } else {
                        0.0
                    }
                })
                .collect()
        })
        .collect();
    let friction = Friction { smoothing: vec![0.3; n], ..Friction::sign(n) };
    Robot::new((0..n).map(joint).collect(), [1.0, 2.0, -9.81], &coupling, friction).unwrap()
}

/// The same robot with other joints.
pub fn with_joints(robot: &Robot, joints: Vec<Joint>) -> Robot {
    Robot::new(joints, robot.gravity(), robot.transmission(), robot.friction().clone()).unwrap()
}

/// The same robot with other friction.
pub fn with_friction(robot: &Robot, friction: Friction) -> Robot {
    Robot::new(robot.joints().to_vec(), robot.gravity(), robot.transmission(), friction).unwrap()
}

/// Each link a body that exists, seen from a distance.
pub fn parameters(robot: &Robot) -> Vec<f64> {
    let link = [0.5, 0.05, -0.03, 0.6, 0.04, 0.4, 0.3, -0.2, 0.1, 2.0, 0.2, 0.4, 0.3, 0.1];
    let (joints, count) = (14 * robot.n_dof(), Layout::of(robot).count());
    (0..count).map(|k| if k < joints { link[k % 14] } else { 0.1 }).collect()
}

/// A slider along an axis that turns, and parameters with which `M(q)` is `diag(inertia + mass q2^2, mass + rotor)`.
pub fn polar([inertia, mass, rotor]: [f64; 3]) -> (Robot, Vec<f64>) {
    let joint = |kind, alpha| Joint { kind, alpha, d: 0.0, theta: 0.0, r: 0.0 };
    let joints = vec![joint(JointKind::Revolute, 0.0), joint(JointKind::Prismatic, FRAC_PI_2)];
    let identity = [vec![1.0, 0.0], vec![0.0, 1.0]];
    let robot = Robot::new(joints, [0.0; 3], &identity, Friction::sign(2)).unwrap();
    let mut x = vec![0.0; 28];
    (x[5], x[14 + 9], x[14 + 10]) = (inertia, mass, rotor);
    (robot, x)
}
