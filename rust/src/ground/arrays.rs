//! Arrays as the core takes them: how many joints state per sample has room for, and lengths checked with a sentence.

use thiserror::Error;

/// Largest number of joints; per-sample state is in arrays of this size.
pub const MAX_DOF: usize = 128;

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
    /// Load friction without the torques that it depends on.
    #[error("the robot has load friction: its columns need the torque of links and rotors")]
    Load,
    /// A column that is asked for more than once.
    #[error("column {column} is asked for twice")]
    Twice {
        /// Column asked for, counted from 0.
        column: usize,
    },
}

/// `array` has `want` numbers, or the error that says so.
pub(crate) fn check_length(what: &'static str, array: &[f64], want: usize) -> Result<(), ShapeError> {
    if array.len() == want { Ok(()) } else { Err(ShapeError::Length { what, want, got: array.len() }) }
}
