//! Order, names and units of the standard parameters (3). The only place that knows an index.
//!
//! Per joint: `XX XY XZ YY YZ ZZ MX MY MZ M Ia Fv Fc Off`; with asymmetric friction `Fv+ Fc+ Fv- Fc-`
//! stand where `Fv Fc Off` stood. After the last joint, `Fvm Fcm` of each coupled motor: the 86 of the TX40. Further terms of
//! friction come last, in the order in which the robot has them.

use super::friction_terms::Law;
use crate::robot::{JointKind, Robot};

/// Inertial parameters of a link: `XX` to `M`.
pub const INERTIAL: usize = 10;
/// `XX`, first of the link's inertia matrix about the origin of its frame (`XX XY XZ YY YZ ZZ`).
pub const XX: usize = 0;
/// `MX`, first of the first moments.
pub const MX: usize = 6;
/// The mass.
pub const M: usize = 9;
/// Rotor (and gear) inertia, joint side.
pub const IA: usize = 10;
/// First friction parameter.
pub const FRICTION: usize = 11;

const INERTIAL_NAMES: [&str; 11] = ["XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M", "Ia"];

/// Where each parameter of a robot stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    n_dof: usize,
    per_joint: usize,
    n_coupled: usize,
    n_terms: usize,
}

/// What a column belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Owner {
    /// Parameter `local` of a joint's own block.
    Joint {
        /// Joint, from 0.
        joint: usize,
        /// Place in its block.
        local: usize,
    },
    /// Friction of a coupled motor: `Fvm` (0) or `Fcm` (1).
    Coupled {
        /// Place in [`Robot::coupled`].
        index: usize,
        /// 0 viscous, 1 Coulomb.
        local: usize,
    },
    /// A further term of friction.
    Term {
        /// Place in [`crate::robot::Friction::terms`].
        index: usize,
    },
}

impl Layout {
    /// The layout of a robot.
    pub fn of(robot: &Robot) -> Self {
        let per_joint = if robot.friction().asymmetric { FRICTION + 4 } else { FRICTION + 3 };
        let n_terms = robot.friction().terms.len();
        Self { n_dof: robot.n_dof(), per_joint, n_coupled: robot.coupled().len(), n_terms }
    }

    /// Number of standard parameters.
    pub fn count(self) -> usize {
        self.term(self.n_terms)
    }

    /// Index of a further term of friction.
    pub fn term(self, index: usize) -> usize {
        self.coupled(self.n_coupled) + index
    }

    /// Parameters of one joint.
    pub fn per_joint(self) -> usize {
        self.per_joint
    }

    /// First index of a joint's block.
    pub fn joint(self, joint: usize) -> usize {
        joint * self.per_joint
    }

    /// Index of `Fvm` of a coupled motor; `Fcm` follows.
    pub fn coupled(self, index: usize) -> usize {
        self.n_dof * self.per_joint + 2 * index
    }

    /// What a column belongs to.
    pub fn owner(self, column: usize) -> Owner {
        let joints = self.n_dof * self.per_joint;
        if column < joints {
            Owner::Joint { joint: column / self.per_joint, local: column % self.per_joint }
        } else if column < self.term(0) {
            Owner::Coupled { index: (column - joints) / 2, local: (column - joints) % 2 }
        } else {
            Owner::Term { index: column - self.term(0) }
        }
    }
}

/// Names in order, such as `ZZ1`, `Fv1`, `Fvm6`.
pub fn names(robot: &Robot) -> Vec<String> {
    let mut names = Vec::with_capacity(Layout::of(robot).count());
    for j in 1..=robot.n_dof() {
        names.extend(INERTIAL_NAMES.iter().map(|name| format!("{name}{j}")));
        if robot.friction().asymmetric {
            names.extend([format!("Fv{j}+"), format!("Fc{j}+"), format!("Fv{j}-"), format!("Fc{j}-")]);
        } else {
            names.extend([format!("Fv{j}"), format!("Fc{j}"), format!("Off{j}")]);
        }
    }
    for coupled in robot.coupled() {
        let j = coupled.motor + 1;
        names.extend([format!("Fvm{j}"), format!("Fcm{j}")]);
    }
    names.extend(robot.friction().terms.iter().map(|term| format!("{}{}", term.name, term.joint + 1)));
    names
}

/// Units in order, joint side.
pub fn units(robot: &Robot) -> Vec<&'static str> {
    let mut units = Vec::with_capacity(Layout::of(robot).count());
    for joint in robot.joints() {
        units.extend(["kg.m^2"; MX]);
        units.extend(["kg.m"; 3]);
        units.push("kg");
        let (rotor, viscous, force) = side_units(joint.kind);
        units.push(rotor);
        if robot.friction().asymmetric {
            units.extend([viscous, force, viscous, force]);
        } else {
            units.extend([viscous, force, force]);
        }
    }
    for coupled in robot.coupled() {
        let (_, viscous, force) = side_units(robot.joints()[coupled.motor].kind);
        units.extend([viscous, force]);
    }
    units.extend(robot.friction().terms.iter().map(|term| {
        let kind = robot.joints()[term.joint].kind;
        let (_, viscous, force) = side_units(kind);
        match (&term.law, kind) {
            (Law::Load, _) => "1",
            (Law::Forward, _) => viscous,
            (Law::Root, JointKind::Revolute) => "N.m.(s/rad)^0.5",
            (Law::Root, JointKind::Prismatic) => "N.(s/m)^0.5",
            _ => force,
        }
    }));
    units
}

fn side_units(kind: JointKind) -> (&'static str, &'static str, &'static str) {
    match kind {
        JointKind::Revolute => ("kg.m^2", "N.m.s/rad", "N.m"),
        JointKind::Prismatic => ("kg", "N.s/m", "N"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{Friction, Joint};

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
}
