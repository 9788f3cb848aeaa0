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
    /// A column that is asked for more than once.
    #[error("column {column} is asked for twice")]
    Twice {
        /// Column asked for, counted from 0.
        column: usize,
    },
}

/// A reference motion that cannot be followed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ReferenceError {
    /// No joints, or too many.
    #[error("a reference has 1 to {max} joints, got {got}")]
    Joints {
        /// Joints given.
        got: usize,
        /// Joints possible.
        max: usize,
    },
    /// Nothing to move between.
    #[error("a reference needs at least two different points, got {got}")]
    TooShort {
        /// Points given.
        got: usize,
    },
    /// Too few samples for differences of five neighbours.
    #[error("a sampled reference needs at least 5 samples, got {got}")]
    TooFewSamples {
        /// Samples given.
        got: usize,
    },
    /// Times that do not increase.
    #[error("the times of a reference must increase: knot {knot} does not come after the one before")]
    Time {
        /// Knot, counted from 1.
        knot: usize,
    },
    /// A list of the wrong length.
    #[error("{what} of the reference needs {want} numbers, got {got}")]
    Length {
        /// Name of the list.
        what: &'static str,
        /// Numbers needed.
        want: usize,
        /// Numbers given.
        got: usize,
    },
    /// A NaN or an infinity.
    #[error("{what} of joint {joint} at knot {knot} of the reference is not a finite number")]
    NotFinite {
        /// Name of the quantity.
        what: &'static str,
        /// Joint, counted from 1.
        joint: usize,
        /// Knot, counted from 1.
        knot: usize,
    },
    /// A limit of zero or less.
    #[error("{what} of joint {joint} must be positive, got {value}")]
    NotPositive {
        /// Name of the quantity.
        what: &'static str,
        /// Joint, counted from 1.
        joint: usize,
        /// Its value.
        value: f64,
    },
}

/// A controller that cannot be.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ControlError {
    /// A NaN or an infinity.
    #[error("{what} of joint {joint} is not a finite number")]
    NotFinite {
        /// Name of the quantity.
        what: &'static str,
        /// Joint, counted from 1.
        joint: usize,
    },
    /// A saturation that lets nothing through.
    #[error("the saturation of joint {joint} must be positive, got {value}")]
    Limit {
        /// Joint, counted from 1.
        joint: usize,
        /// Its value.
        value: f64,
    },
    /// A drive without effect.
    #[error("the drive gain of joint {joint} is zero: its controller has no effect")]
    NoGain {
        /// Joint, counted from 1.
        joint: usize,
    },
    /// A sample time of zero or less.
    #[error("the sample time of the controller must be positive, got {value}")]
    Period {
        /// Its value.
        value: f64,
    },
    /// No smoothing weights, or a NaN among them.
    #[error("the smoothing of the velocity needs one or more finite weights")]
    Smoothing,
    /// Encoder steps that do not fit the joints.
    #[error("the encoder resolution needs {want} entries, one per joint, got {got}")]
    Resolution {
        /// Entries needed.
        want: usize,
        /// Entries given.
        got: usize,
    },
    /// A signal with another number of joints, or none.
    #[error("{what} needs samples of {want} joints, got {got}")]
    Signal {
        /// Name of the signal.
        what: &'static str,
        /// Joints needed.
        want: usize,
        /// Joints given.
        got: usize,
    },
    /// A signal with a NaN.
    #[error("{what} needs a positive rate and finite samples")]
    SignalNotFinite {
        /// Name of the signal.
        what: &'static str,
    },
}

/// Steps that cannot be taken.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ScheduleError {
    /// A rate or a step of zero or less.
    #[error("{what} must be positive, got {value}")]
    NotPositive {
        /// Name of the quantity.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// Nothing to simulate.
    #[error("a simulation needs at least 2 records, got {got}")]
    TooShort {
        /// Records asked for.
        got: usize,
    },
    /// Another number of joints.
    #[error("the reference and the limits of slow motion need {want} joints, got {got}")]
    Joints {
        /// Joints of the robot.
        want: usize,
        /// Joints given.
        got: usize,
    },
    /// Steps far too small.
    #[error("{got:.1e} steps are too many: the step is too small for the length of the run")]
    TooManySteps {
        /// Steps that it would take.
        got: f64,
    },
    /// A reference that does not last.
    #[error("the reference starts at {first} s and ends at {last} s, before the run, at {end} s")]
    Reference {
        /// First time of the reference.
        first: f64,
        /// Last time of the reference.
        last: f64,
        /// End of the run.
        end: f64,
    },
}

/// A simulation whose parts do not fit together.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SimulationError {
    /// A list of the wrong length.
    #[error("{what} has {got} entries where {want} are needed")]
    Length {
        /// Name of the list.
        what: &'static str,
        /// Entries needed.
        want: usize,
        /// Entries given.
        got: usize,
    },
    /// A schedule made for another controller.
    #[error("the schedule was made for another controller: only one of them is digital")]
    Schedule,
    /// A signal that is none.
    #[error(transparent)]
    Signal(#[from] ControlError),
}
