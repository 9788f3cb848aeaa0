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
mod servos;
mod signal;
mod tangent;

use didim::ground::isa::{Isa, choose};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

fn wrong(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// Environment variable with the set of instructions that the kernels run on.
const VARIABLE: &str = "DIDIM_ISA";

/// The set of instructions that the kernels run on.
#[pyfunction]
fn instruction_set() -> &'static str {
    Isa::chosen().name()
}

/// Those that this processor has, from the narrowest.
#[pyfunction]
fn instruction_sets() -> Vec<&'static str> {
    Isa::available().map(Isa::name).collect()
}

/// Takes the set that the environment asks for; the package's own error where there is none.
fn choose_from_environment(py: Python<'_>) -> PyResult<()> {
    let Some(asked) = std::env::var_os(VARIABLE) else { return Ok(()) };
    match choose(&asked.to_string_lossy()) {
        Ok(_) => Ok(()),
        Err(error) => {
            let class = py.import("didim.errors")?.getattr("InstructionSetError")?;
            Err(PyErr::from_value(class.call1((format!("{VARIABLE} {error}"),))?))
        }
    }
}

/// The module `didim._core`.
#[pymodule]
mod _core {
    use super::choose_from_environment;
    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        choose_from_environment(module.py())
    }

    #[pymodule_export]
    use super::closed_loop::{Controller, Reference, Schedule, simulate, simulate_cost};
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
    use super::servos::{set_point_areas, simulate_servos};
    #[pymodule_export]
    use super::signal::{decimate, filtfilt, observation, parse_table};
    #[pymodule_export]
    use super::tangent::{information, information_gradient};
    #[pymodule_export]
    use super::{instruction_set, instruction_sets};
}
