//! What can be wrong with what the core is given. Each message names the joint, sample or key.

use thiserror::Error;

/// A robot description that is not a robot.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum RobotError {
    /// No joints, or more than [`crate::robot::MAX_DOF`].
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
    /// A gravity vector with a NaN or an infinity.
    #[error("gravity must be three finite numbers")]
    Gravity,
    /// Rotor speeds that do not determine the joint speeds.
    #[error(
        "the transmission matrix is singular: the motors of the coupled joints cannot tell their speeds apart"
    )]
    SingularTransmission,
    /// A motor that does not turn with the joint it is named after.
    #[error(
        "motor {motor} of the transmission matrix does not move with joint {motor}; number the motors so that its diagonal has no zero"
    )]
    DetachedMotor {
        /// Motor, counted from 1.
        motor: usize,
    },
}

/// Arrays that do not fit a robot.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ShapeError {
    /// A flat array of the wrong length.
    #[error("{what} has {got} numbers where {want} are needed")]
    Length {
        /// Name of the array.
        what: &'static str,
        /// Numbers needed.
        want: usize,
        /// Numbers given.
        got: usize,
    },
    /// A column number that the robot does not have.
    #[error("column {column} does not exist: the robot has {count} standard parameters")]
    Column {
        /// Column asked for, counted from 0.
        column: usize,
        /// Columns there are.
        count: usize,
    },
}
