//! The one door to Python: arrays in, arrays out, errors mapped to `ValueError` with their sentence, the interpreter
//! released during long work. Typed in `python/didim/_core.pyi`; private to the Python package.

// The macros of PyO3 pass arguments by value.
#![allow(clippy::needless_pass_by_value)]

mod arrays;
mod closed_loop;
mod consistent;
mod model;
mod regression;
mod robot;
mod signal;
mod tangent;

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

fn wrong(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// The module `didim._core`.
#[pymodule]
mod _core {
    #[pymodule_export]
    use super::closed_loop::{
        Controller, Reference, Schedule, simulate, simulate_cost, simulate_sensitivities,
    };
    #[pymodule_export]
    use super::consistent::{ConsistentProblem, ConsistentSolutions};
    #[pymodule_export]
    use super::model::{
        direct_dynamics, inertia_matrix, inverse_dynamics, largest_safe_step, regressor, smallest_eigenvalue,
    };
    #[pymodule_export]
    use super::regression::{LeastSquares, base_parameters, least_squares};
    #[pymodule_export]
    use super::robot::Robot;
    #[pymodule_export]
    use super::signal::{decimate, filtfilt, observation, parse_table};
    #[pymodule_export]
    use super::tangent::{information, information_gradient};
}
