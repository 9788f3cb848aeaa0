//! Number, names, units and owners of the standard parameters.

use didim::robot::parameters::{Layout, Owner, names, units};
use didim::robot::{Friction, Joint, JointKind, Robot};

fn robot(n: usize, asymmetric: bool) -> Robot {
    let joint = Joint { kind: JointKind::Revolute, alpha: 0.0, d: 0.0, theta: 0.0, r: 0.0 };
    let mut transmission = vec![vec![0.0; n]; n];
    for j in 0..n {
        transmission[j][j] = 1.0;
    }
    if n > 1 {
        transmission[n - 1][n - 2] = 1.0;
    }
    let friction = Friction { asymmetric, ..Friction::sign(n) };
    Robot::new(vec![joint; n], [0.0; 3], &transmission, friction).unwrap()
}

#[test]
fn a_coupled_six_axis_arm_has_86() {
    let robot = robot(6, false);
    let names = names(&robot);
    assert_eq!(names.len(), 86);
    assert_eq!(names[0], "XX1");
    assert_eq!(names[27], "Off2");
    assert_eq!(names[84..], ["Fvm6", "Fcm6"]);
    assert_eq!(units(&robot).len(), 86);
}

#[test]
fn units_are_those_of_the_kind_and_the_friction() {
    let joint = |kind| Joint { kind, alpha: 0.0, d: 0.0, theta: 0.0, r: 0.0 };
    let joints = vec![joint(JointKind::Revolute), joint(JointKind::Prismatic)];
    let coupling = [vec![1.0, 0.0], vec![1.0, 1.0]];
    let friction = Friction { asymmetric: true, ..Friction::sign(2) };
    let robot = Robot::new(joints, [0.0; 3], &coupling, friction).unwrap();
    let named: Vec<String> =
        names(&robot).iter().zip(units(&robot)).map(|(name, unit)| format!("{name} {unit}")).collect();
    assert_eq!(
        named[9..15],
        ["M1 kg", "Ia1 kg.m^2", "Fv1+ N.m.s/rad", "Fc1+ N.m", "Fv1- N.m.s/rad", "Fc1- N.m"]
    );
    assert_eq!(
        named[24..],
        ["M2 kg", "Ia2 kg", "Fv2+ N.s/m", "Fc2+ N", "Fv2- N.s/m", "Fc2- N", "Fvm2 N.s/m", "Fcm2 N"]
    );
}

#[test]
fn every_column_has_its_owner() {
    for robot in [robot(1, true), robot(3, false), robot(2, true)] {
        let layout = Layout::of(&robot);
        assert_eq!(layout.count(), names(&robot).len());
        for column in 0..layout.count() {
            let back = match layout.owner(column) {
                Owner::Joint { joint, local } => layout.joint(joint) + local,
                Owner::Coupled { index, local } => layout.coupled(index) + local,
                Owner::Term { index } => layout.term(index),
            };
            assert_eq!(back, column);
        }
    }
}
