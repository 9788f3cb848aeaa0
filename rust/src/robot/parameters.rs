//! Order, names and units of the standard parameters (3). The only place that knows an index.
//!
//! Per joint: `XX XY XZ YY YZ ZZ MX MY MZ M Ia Fv Fc Off`; with asymmetric friction `Fv+ Fc+ Fv- Fc-`
//! stand where `Fv Fc Off` stood. After the last joint, `Fvm Fcm` of each coupled motor: the 86 of the TX40. Further terms of
//! friction come last, in the order in which the robot has them.

use super::followers::Followers;
use super::friction_terms::Law;
use crate::robot::{JointKind, Robot};

/// Number of inertial parameters of a link, `XX` to `M`.
pub const INERTIAL: usize = 10;
/// Index of `XX`, first of the link's inertia matrix about the origin of its frame (`XX XY XZ YY YZ ZZ`).
pub const XX: usize = 0;
/// Index of `MX`, first of the first moments.
pub const MX: usize = 6;
/// Index of the mass.
pub const M: usize = 9;
/// Index of the rotor (and gear) inertia, joint side.
pub const IA: usize = 10;
/// Index of the first friction parameter.
pub const FRICTION: usize = 11;

const INERTIAL_NAMES: [&str; 11] = ["XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M", "Ia"];

/// Index of each parameter of a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout<'a> {
    n_joints: usize,
    /// Number of each joint of the kernels where some follow others; empty otherwise.
    numbers: &'a [usize],
    per_joint: usize,
    n_coupled: usize,
    n_terms: usize,
}

/// Owner of a column.
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

impl<'a> Layout<'a> {
    /// The layout of a robot.
    #[inline(always)]
    pub fn of(robot: &'a Robot) -> Self {
        let per_joint = if robot.friction().asymmetric { FRICTION + 4 } else { FRICTION + 3 };
        let n_terms = robot.friction().terms.len();
        let numbers = robot.followers().map_or(&[][..], Followers::numbers);
        Self { n_joints: robot.n_joints(), numbers, per_joint, n_coupled: robot.coupled().len(), n_terms }
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
    #[inline(always)]
    pub fn joint(self, joint: usize) -> usize {
        self.number(joint) * self.per_joint
    }

    /// Number of a joint of the kernels, from 0: its own, unless some joints follow others.
    #[inline(always)]
    pub fn number(self, joint: usize) -> usize {
        if self.numbers.is_empty() { joint } else { self.numbers[joint] }
    }

    /// Index of `Fvm` of a coupled motor; `Fcm` follows.
    pub fn coupled(self, index: usize) -> usize {
        self.n_joints * self.per_joint + 2 * index
    }

    /// Owner of a column.
    pub fn owner(self, column: usize) -> Owner {
        let joints = self.n_joints * self.per_joint;
        if column < joints {
            let number = column / self.per_joint;
            let joint = self.numbers.iter().position(|&other| other == number).unwrap_or(number);
            Owner::Joint { joint, local: column % self.per_joint }
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
    let layout = Layout::of(robot);
    for j in 1..=robot.n_joints() {
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
    names.extend(
        robot.friction().terms.iter().map(|term| format!("{}{}", term.name, layout.number(term.joint) + 1)),
    );
    names
}

/// Units in order, joint side.
pub fn units(robot: &Robot) -> Vec<&'static str> {
    let mut units = Vec::with_capacity(Layout::of(robot).count());
    let layout = Layout::of(robot);
    let mut joints: Vec<usize> = (0..robot.n_joints()).collect();
    joints.sort_by_key(|&joint| layout.number(joint));
    for joint in joints.into_iter().map(|joint| &robot.joints()[joint]) {
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
            (Law::Spring, JointKind::Revolute) => "N.m/rad",
            (Law::Spring, JointKind::Prismatic) | (Law::CylinderRate(_), _) => "N/m",
            (Law::Cylinder(_), _) => "N",
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
