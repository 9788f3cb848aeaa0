//! An arm with every kind of joint and twist, and a coupled motor.

use didim::robot::{Coupling, Friction, Joint, JointKind, Robot};

/// Four joints, the third one prismatic; the last motor moves with the first two joints.
pub fn robot(friction: Friction) -> Robot {
    let joint = |kind, alpha, d, theta, r| Joint { kind, alpha, d, theta, r };
    let joints = vec![
        joint(JointKind::Revolute, 0.3, 0.1, 0.2, 0.1),
        joint(JointKind::Revolute, -std::f64::consts::FRAC_PI_2, 0.3, 0.0, 0.0),
        joint(JointKind::Prismatic, 0.7, -0.2, 0.4, 0.3),
        joint(JointKind::Revolute, 1.1, 0.1, -0.5, -0.2),
    ];
    let transmission = [
        vec![1.0, 0.0, 0.0, 0.0],
        vec![0.0, 1.0, 0.0, 0.0],
        vec![0.0, 0.0, 1.0, 0.0],
        vec![0.5, -0.3, 0.0, 1.0],
    ];
    Robot::new(joints, [1.0, -2.0, -9.81], &transmission, friction).unwrap()
}

/// Every friction of [`robot`]: smooth and not, asymmetric, as printed, with a dead zone.
pub fn frictions() -> [Friction; 6] {
    let sign = Friction::sign(4);
    let smooth = Friction { smoothing: vec![0.3; 4], ..sign.clone() };
    let dead_zone = vec![0.25; 4];
    [
        smooth.clone(),
        Friction { asymmetric: true, ..smooth.clone() },
        Friction { coupling: Coupling::Printed, ..smooth.clone() },
        Friction { dead_zone: dead_zone.clone(), ..smooth },
        Friction { dead_zone, asymmetric: true, ..sign.clone() },
        sign,
    ]
}
