//! A robot: Khalil-Kleinfinger (modified Denavit-Hartenberg) joints in a line or a tree, gravity, transmission
//! and the shape of its friction. Everything is checked once, here; the rest of the core trusts it.
//!
//! In a chain frame `j` follows frame `j-1` by `Rot(x, alpha) Trans(x, d) Rot(z, theta) Trans(z, r)`; in a tree its antecedent's, after
//! a [`Mount`]. A revolute joint (`sigma = 0`) turns by `theta + q`, a prismatic one (`sigma = 1`) slides by `r + q`.

use super::followers::Followers;
use super::friction_terms::{Law, MAX_TERMS, Term};
use crate::ground::arrays::MAX_DOF;
use crate::robot::geometry::Geometry;
use crate::robot::placement::{Mount, Placement, ends};
use crate::robot::transmission::{CoupledMotor, Coupling, coupled_motors, normalised};
use std::sync::Arc;
use thiserror::Error;

/// A robot description that is not a robot.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum RobotError {
    /// No joints, or more than [`MAX_DOF`].
    #[error("a robot has 1 to {max} joints, got {got}")]
    JointCount {
        /// Joints given.
        got: usize,
        /// Joints possible.
        max: usize,
    },
    /// A list whose length is not the number of joints.
    #[error("{what} needs {want} entries, one per joint, got {got}")]
    Length {
        /// Name of the list.
        what: &'static str,
        /// Entries needed.
        want: usize,
        /// Entries given.
        got: usize,
    },
    /// A number that is NaN or infinite.
    #[error("{what} of joint {joint} is not a finite number")]
    NotFinite {
        /// Name of the quantity.
        what: &'static str,
        /// Joint, counted from 1.
        joint: usize,
    },
    /// A velocity below zero.
    #[error("{what} of joint {joint} must not be negative, got {value}")]
    Negative {
        /// Name of the quantity.
        what: &'static str,
        /// Joint, counted from 1.
        joint: usize,
        /// Its value.
        value: f64,
    },
    /// A joint that stands on a joint behind it.
    #[error(
        "joint {joint} stands on joint {parent}, and a joint must be numbered higher than the one it stands on"
    )]
    ParentAfter {
        /// The joint, counted from 1.
        joint: usize,
        /// Its antecedent, counted from 1.
        parent: usize,
    },
    /// Joints of a branch with those of another one between.
    #[error(
        "joint {joint} stands on joint {parent}, whose branch has ended before: number the joints branch by branch"
    )]
    Scattered {
        /// The joint, counted from 1.
        joint: usize,
        /// Its antecedent, counted from 1.
        parent: usize,
    },
    /// A joint that cannot follow others as it should.
    #[error("joint {joint} follows others: {reason}")]
    Follower {
        /// Joint, counted from 1.
        joint: usize,
        /// Reason.
        reason: &'static str,
    },
    /// A gravity vector with a NaN or an infinity.
    #[error("gravity must be three finite numbers")]
    Gravity,
    /// Rotor speeds that do not determine the joint speeds.
    #[error(
        "the transmission matrix is singular: the motors of the coupled joints cannot tell their speeds apart"
    )]
    SingularTransmission,
    /// More terms of friction than the kernels have room for.
    #[error("friction has at most {max} further terms, got {got}")]
    TermCount {
        /// Terms given.
        got: usize,
        /// Terms possible.
        max: usize,
    },
    /// A term of friction that cannot be.
    #[error("friction term {name} of joint {joint}: {reason}")]
    Term {
        /// Name of its parameter.
        name: String,
        /// Joint, counted from 1.
        joint: usize,
        /// Reason.
        reason: &'static str,
    },
    /// A motor that does not turn with the joint it is named after.
    #[error(
        "motor {motor} of the transmission matrix does not move with joint {motor}; number the motors so that its diagonal has no zero"
    )]
    DetachedMotor {
        /// Motor, counted from 1.
        motor: usize,
    },
}

/// Kind of a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointKind {
    /// Turns about its z axis; `q` in rad.
    Revolute,
    /// Slides along its z axis; `q` in m.
    Prismatic,
}

/// One row of a modified Denavit-Hartenberg table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Joint {
    /// Revolute or prismatic.
    pub kind: JointKind,
    /// Angle between `z_{j-1}` and `z_j` about `x_{j-1}` (rad).
    pub alpha: f64,
    /// Distance between `z_{j-1}` and `z_j` along `x_{j-1}` (m).
    pub d: f64,
    /// Angle between `x_{j-1}` and `x_j` about `z_j` (rad); added to `q` of a revolute joint.
    pub theta: f64,
    /// Distance between `x_{j-1}` and `x_j` along `z_j` (m); added to `q` of a prismatic joint.
    pub r: f64,
}

/// The shape of the friction, and how its sign is taken near standstill.
#[derive(Debug, Clone, PartialEq)]
pub struct Friction {
    /// Viscous and Coulomb friction per direction (`Fv+ Fc+ Fv- Fc-`) instead of `Fv Fc Off`.
    pub asymmetric: bool,
    /// Coulomb friction of coupled motors.
    pub coupling: Coupling,
    /// Velocity `v` of `tanh(dq / v)` per joint (rad/s or m/s); 0 means `sign(dq)`.
    pub smoothing: Vec<f64>,
    /// Speed per joint (rad/s or m/s) up to which the sign is taken as 0.
    pub dead_zone: Vec<f64>,
    /// Displacement per joint (rad or m) over which a sign held at rest turns in a closed loop; 0 for the sign of the speed.
    pub held: Vec<f64>,
    /// Further terms, in the order of their parameters.
    pub terms: Vec<Term>,
}

impl Friction {
    /// `sign(dq)` on `n` joints, one value for both directions, shaft coupling.
    pub fn sign(n: usize) -> Self {
        Self {
            asymmetric: false,
            coupling: Coupling::Shaft,
            smoothing: vec![0.0; n],
            dead_zone: vec![0.0; n],
            held: vec![0.0; n],
            terms: Vec::new(),
        }
    }

    /// Does a torque depend on the load?
    pub fn has_load(&self) -> bool {
        self.terms.iter().any(|term| term.law == Law::Load)
    }

    /// Does a torque depend on the path?
    pub fn remembers(&self) -> bool {
        self.held.iter().any(|&h| h > 0.0) || self.terms.iter().any(|t| matches!(t.law, Law::Dahl { .. }))
    }
}

/// A checked robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    joints: Vec<Joint>,
    mounts: Vec<Mount>,
    placements: Vec<Placement>,
    ends: Vec<usize>,
    gravity: [f64; 3],
    coupled: Vec<CoupledMotor>,
    transmission: Vec<Vec<f64>>,
    friction: Friction,
    followers: Option<Followers>,
    geometry: Arc<Geometry>,
}

impl Robot {
    /// Checks and stores a chain: each joint stands on the one before.
    ///
    /// See [`Self::tree`].
    pub fn new(
        joints: Vec<Joint>,
        gravity: [f64; 3],
        transmission: &[Vec<f64>],
        friction: Friction,
    ) -> Result<Self, RobotError> {
        let mounts = Mount::chain(joints.len());
        Self::tree(joints, mounts, gravity, transmission, friction)
    }

    /// Checks and stores a description: joints numbered branch by branch, each behind the one it stands on.
    ///
    /// `gravity` is the acceleration of gravity in frame 0 (m/s^2). `transmission` is `C`: rotor speeds
    /// in joint-side units are `C dq` (rows are motors). Its rows are scaled to a unit diagonal, which
    /// is what `Ia_j` and the friction parameters refer to: (22) to (24).
    pub fn tree(
        joints: Vec<Joint>,
        mounts: Vec<Mount>,
        gravity: [f64; 3],
        transmission: &[Vec<f64>],
        friction: Friction,
    ) -> Result<Self, RobotError> {
        let n = joints.len();
        if n == 0 || n > MAX_DOF {
            return Err(RobotError::JointCount { got: n, max: MAX_DOF });
        }
        for (j, joint) in joints.iter().enumerate() {
            for (what, value) in
                [("alpha", joint.alpha), ("d", joint.d), ("theta", joint.theta), ("r", joint.r)]
            {
                if !value.is_finite() {
                    return Err(RobotError::NotFinite { what, joint: j + 1 });
                }
            }
        }
        if mounts.len() != n {
            return Err(RobotError::Length { what: "the placements", want: n, got: mounts.len() });
        }
        let ends = ends(&mounts)?;
        if gravity.iter().any(|g| !g.is_finite()) {
            return Err(RobotError::Gravity);
        }
        check_friction(&joints, &friction)?;
        let transmission = normalised(n, transmission)?;
        let placements =
            joints.iter().zip(&mounts).map(|(joint, mount)| Placement::of(joint, mount)).collect();
        let coupled = coupled_motors(&transmission);
        let (followers, geometry) = (None, Arc::default());
        let mut robot = Self {
            joints,
            mounts,
            placements,
            ends,
            gravity,
            coupled,
            transmission,
            friction,
            followers,
            geometry,
        };
        robot.geometry = Arc::new(Geometry::of(&robot));
        Ok(robot)
    }

    /// Number of driven joints: columns of motions and torques.
    pub fn n_dof(&self) -> usize {
        self.followers.as_ref().map_or(self.joints.len(), Followers::n_driven)
    }

    /// Number of joints, those that follow others among them.
    pub fn n_joints(&self) -> usize {
        self.joints.len()
    }

    /// Joints that follow others, where there are any.
    pub fn followers(&self) -> Option<&Followers> {
        self.followers.as_ref()
    }

    /// The same robot, of which some joints follow others.
    pub(super) fn following(self, followers: Followers) -> Self {
        Self { followers: Some(followers), ..self }
    }

    /// The rows of the geometry.
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// Parent of each joint, and the part of its row that chains do without.
    pub fn mounts(&self) -> &[Mount] {
        &self.mounts
    }

    /// Pose of each frame in its parent's, ready for the kernels.
    pub fn placements(&self) -> &[Placement] {
        &self.placements
    }

    /// The geometry as the kernels walk it.
    #[inline(always)]
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// Does joint `i` carry link `j`?
    pub fn carries(&self, i: usize, j: usize) -> bool {
        i <= j && j < self.ends[i]
    }

    /// One past the last joint that joint `j` carries.
    pub fn end(&self, j: usize) -> usize {
        self.ends[j]
    }

    /// Whether a coupled motor turns with joints of which neither carries the other: `M` then is not zero between branches.
    pub fn couples_branches(&self) -> bool {
        self.coupled.iter().any(|coupled| {
            let all = || coupled.others.iter().map(|&(i, _)| i).chain([coupled.motor]);
            all().any(|i| all().any(|j| !self.carries(i, j) && !self.carries(j, i)))
        })
    }

    /// Acceleration of gravity in frame 0 (m/s^2).
    pub fn gravity(&self) -> [f64; 3] {
        self.gravity
    }

    /// Motors that turn with more than one joint, in order.
    pub fn coupled(&self) -> &[CoupledMotor] {
        &self.coupled
    }

    /// `C`, rows scaled to a unit diagonal.
    pub fn transmission(&self) -> &[Vec<f64>] {
        &self.transmission
    }

    /// Shape of the friction.
    pub fn friction(&self) -> &Friction {
        &self.friction
    }

    /// The same robot with some of the further terms of its friction.
    pub(crate) fn with_terms(&self, wanted: impl Fn(&Term) -> bool) -> Self {
        let terms = self.friction.terms.iter().filter(|term| wanted(term)).cloned().collect();
        Self { friction: Friction { terms, ..self.friction.clone() }, ..self.clone() }
    }

    /// The same robot with the plain sign of the speed at joints whose sign is kept through rest: what that of a path is in motion.
    pub(crate) fn with_signs_kept(&self) -> Self {
        let mut friction = self.friction.clone();
        for (j, &width) in self.friction.held.iter().enumerate() {
            if width > 0.0 {
                (friction.smoothing[j], friction.dead_zone[j]) = (0.0, 0.0);
            }
        }
        Self { friction, ..self.clone() }
    }

    /// The same robot with other lengths and angles; used to tell symbols of equal value apart.
    pub(crate) fn with_rows(&self, joints: Vec<Joint>, mounts: Vec<Mount>) -> Result<Self, RobotError> {
        let friction = self.friction.clone();
        let robot = Self::tree(joints, mounts, self.gravity, &self.transmission, friction)?;
        Ok(Self { followers: self.followers.clone(), ..robot })
    }
}

fn check_friction(joints: &[Joint], friction: &Friction) -> Result<(), RobotError> {
    let Friction { smoothing, dead_zone, held, .. } = friction;
    for (what, values) in [("smoothing", smoothing), ("dead zone", dead_zone), ("held sign", held)] {
        if values.len() != joints.len() {
            return Err(RobotError::Length { what, want: joints.len(), got: values.len() });
        }
        for (j, &value) in values.iter().enumerate() {
            if !value.is_finite() {
                return Err(RobotError::NotFinite { what, joint: j + 1 });
            }
            if value < 0.0 {
                return Err(RobotError::Negative { what, joint: j + 1, value });
            }
        }
    }
    check_terms(joints, friction)
}

fn check_terms(joints: &[Joint], friction: &Friction) -> Result<(), RobotError> {
    if friction.terms.len() > MAX_TERMS {
        return Err(RobotError::TermCount { got: friction.terms.len(), max: MAX_TERMS });
    }
    for (k, term) in friction.terms.iter().enumerate() {
        let wrong = |reason: &'static str| {
            Err(RobotError::Term { name: term.name.clone(), joint: term.joint + 1, reason })
        };
        if term.joint >= joints.len() {
            return wrong("the robot does not have this joint");
        }
        if friction.terms[..k].iter().any(|other| other.joint == term.joint && other.name == term.name) {
            return wrong("it is there twice");
        }
        match term.law {
            Law::Atan { velocity } | Law::Stribeck { velocity }
                if !(velocity.is_finite() && velocity > 0.0) =>
            {
                return wrong("its velocity must be a finite number above 0");
            }
            Law::Dahl { width } if !(width.is_finite() && width > 0.0) => {
                return wrong("its width must be a finite number above 0");
            }
            Law::Rest if friction.dead_zone[term.joint] + friction.smoothing[term.joint] <= 0.0 => {
                return wrong("torque at standstill needs a dead zone above 0");
            }
            Law::Sine | Law::Cosine | Law::Cylinder(_) | Law::CylinderRate(_)
                if joints[term.joint].kind != JointKind::Revolute =>
            {
                return wrong("only a joint that turns has such a spring");
            }
            Law::Forward if friction.asymmetric => {
                return wrong("asymmetric friction has a viscous term for each direction already");
            }
            _ => {}
        }
    }
    Ok(())
}
