//! The one door to Python: arrays in, arrays out, errors mapped to `ValueError` with their sentence, the interpreter
//! released during long work. Typed in `python/didim/_core.pyi`; private to the Python package.

// What Python hands over is owned here, as the macros of PyO3 want it.
#![allow(clippy::needless_pass_by_value)]

mod arrays;
mod simulation;

use crate::base::{Base, base_parameters as find_base};
use crate::filter::Stage;
use crate::observation::{Log, decimate as decimate_columns, observation as observe};
use crate::parameters::{self, Layout};
use crate::robot::{Coupling, Friction, Joint, JointKind, Robot as CoreRobot};
use crate::table::{Delimiter, parse};
use crate::{direct, inertia, inverse, least_squares as ls, parallel, regressor as idm};
use arrays::{Input, Shape, flat, same_rows};
use faer::Mat;
use numpy::{
    PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

fn wrong(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// A checked robot, immutable.
#[pyclass(frozen, module = "didim._core")]
struct Robot(CoreRobot);

#[pymethods]
impl Robot {
    #[new]
    #[pyo3(signature = (*, kind, alpha, d, theta, r, gravity, transmission, asymmetric, printed_coupling, smoothing, dead_zone))]
    #[allow(clippy::too_many_arguments)] // one keyword each, called from one place in robot.py
    fn new(
        kind: Vec<u8>,
        alpha: Vec<f64>,
        d: Vec<f64>,
        theta: Vec<f64>,
        r: Vec<f64>,
        gravity: [f64; 3],
        transmission: Vec<Vec<f64>>,
        asymmetric: bool,
        printed_coupling: bool,
        smoothing: Vec<f64>,
        dead_zone: Vec<f64>,
    ) -> PyResult<Self> {
        let n = kind.len();
        for (what, list) in [("alpha", &alpha), ("d", &d), ("theta", &theta), ("r", &r)] {
            if list.len() != n {
                return Err(PyValueError::new_err(format!("{what} needs {n} entries, got {}", list.len())));
            }
        }
        let joints = (0..n)
            .map(|j| Joint {
                kind: if kind[j] == 0 { JointKind::Revolute } else { JointKind::Prismatic },
                alpha: alpha[j],
                d: d[j],
                theta: theta[j],
                r: r[j],
            })
            .collect();
        let coupling = if printed_coupling { Coupling::Printed } else { Coupling::Shaft };
        let friction = Friction { asymmetric, coupling, smoothing, dead_zone };
        CoreRobot::new(joints, gravity, &transmission, friction).map(Self).map_err(wrong)
    }

    #[getter]
    fn n_dof(&self) -> usize {
        self.0.n_dof()
    }

    #[getter]
    fn n_parameters(&self) -> usize {
        Layout::of(&self.0).count()
    }

    #[getter]
    fn parameter_names(&self) -> Vec<String> {
        parameters::names(&self.0)
    }

    #[getter]
    fn parameter_units(&self) -> Vec<&'static str> {
        parameters::units(&self.0)
    }
}

type Terms = Vec<Vec<(usize, f64, String)>>;

/// `(kept columns, per kept column its terms (column, coefficient, symbol), columns that no motion shows)`.
#[pyfunction]
fn base_parameters(py: Python<'_>, robot: &Robot) -> PyResult<(Vec<usize>, Terms, Vec<usize>)> {
    let Base { kept, terms, unidentifiable } = py.detach(|| find_base(&robot.0)).map_err(wrong)?;
    let terms = terms
        .into_iter()
        .map(|terms| terms.into_iter().map(|t| (t.column, t.coefficient, t.symbol)).collect())
        .collect();
    Ok((kept, terms, unidentifiable))
}

#[pyfunction]
fn inverse_dynamics<'py>(
    py: Python<'py>,
    robot: &Robot,
    q: Input<'py>,
    dq: Input<'py>,
    ddq: Input<'py>,
    x: PyReadonlyArray1<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let shape = Shape::of("q", &q, robot.0.n_dof())?;
    let (q, dq, ddq) = (shape.take("q", &q)?, shape.take("dq", &dq)?, shape.take("ddq", &ddq)?);
    let x = x.as_array().to_vec();
    let mut tau = vec![0.0; shape.samples * shape.width];
    py.detach(|| inverse::inverse_dynamics(&robot.0, &q, &dq, &ddq, &x, &mut tau)).map_err(wrong)?;
    PyArray1::from_vec(py, tau).reshape([shape.samples, shape.width])
}

/// Into `out` where it is given: memory that is used again stays in the cache.
#[pyfunction]
#[pyo3(signature = (robot, q, dq, ddq, out=None))]
fn regressor<'py>(
    py: Python<'py>,
    robot: &Robot,
    q: Input<'py>,
    dq: Input<'py>,
    ddq: Input<'py>,
    out: Option<Bound<'py, PyArray3<f64>>>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let shape = Shape::of("q", &q, robot.0.n_dof())?;
    let (q, dq, ddq) = (shape.take("q", &q)?, shape.take("dq", &dq)?, shape.take("ddq", &ddq)?);
    let p = Layout::of(&robot.0).count();
    if let Some(out) = out {
        let wanted = [shape.samples, shape.width, p];
        if out.shape() != wanted || !out.is_c_contiguous() {
            return Err(PyValueError::new_err(format!(
                "out must be a contiguous array of shape {wanted:?}, got {:?}",
                out.shape()
            )));
        }
        {
            let mut w = out.try_readwrite().map_err(|reason| {
                PyValueError::new_err(format!(
                    "out must be an array of its own that can be written ({reason})"
                ))
            })?;
            let w = w.as_slice_mut()?;
            idm::regressor(&robot.0, &q, &dq, &ddq, w).map_err(wrong)?;
        }
        return Ok(out);
    }
    let mut w = vec![0.0; q.len() * p];
    py.detach(|| idm::regressor(&robot.0, &q, &dq, &ddq, &mut w)).map_err(wrong)?;
    PyArray1::from_vec(py, w).reshape([shape.samples, shape.width, p])
}

/// `M(q)`, shape `(n_samples, n_dof, n_dof)`.
#[pyfunction]
fn inertia_matrix<'py>(
    py: Python<'py>,
    robot: &Robot,
    q: Input<'py>,
    x: PyReadonlyArray1<'py, f64>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let shape = Shape::of("q", &q, robot.0.n_dof())?;
    let q = shape.take("q", &q)?;
    let x = x.as_array().to_vec();
    let mut matrices = vec![0.0; q.len() * shape.width];
    py.detach(|| inertia::inertia_matrix(&robot.0, &q, &x, &mut matrices)).map_err(wrong)?;
    PyArray1::from_vec(py, matrices).reshape([shape.samples, shape.width, shape.width])
}

/// Accelerations and indefinite sample.
type Accelerations<'py> = (Bound<'py, PyArray2<f64>>, Option<(usize, usize)>);

/// `ddq`, and `(sample, joint)` of the first indefinite `M(q)`, from 0.
#[pyfunction]
fn direct_dynamics<'py>(
    py: Python<'py>,
    robot: &Robot,
    q: Input<'py>,
    dq: Input<'py>,
    tau: Input<'py>,
    x: PyReadonlyArray1<'py, f64>,
) -> PyResult<Accelerations<'py>> {
    let shape = Shape::of("q", &q, robot.0.n_dof())?;
    let (q, dq, tau) = (shape.take("q", &q)?, shape.take("dq", &dq)?, shape.take("tau", &tau)?);
    let x = x.as_array().to_vec();
    let mut ddq = vec![0.0; q.len()];
    let indefinite =
        py.detach(|| direct::direct_dynamics(&robot.0, &q, &dq, &tau, &x, &mut ddq)).map_err(wrong)?;
    let ddq = PyArray1::from_vec(py, ddq).reshape([shape.samples, shape.width])?;
    Ok((ddq, indefinite.map(|at| (at.sample, at.joint))))
}

/// The smallest eigenvalue of `M(q)` over the rows of `q`, and its sample; None without rows.
#[pyfunction]
fn smallest_eigenvalue<'py>(
    py: Python<'py>,
    robot: &Robot,
    q: Input<'py>,
    x: PyReadonlyArray1<'py, f64>,
) -> PyResult<Option<(usize, f64)>> {
    let shape = Shape::of("q", &q, robot.0.n_dof())?;
    let q = shape.take("q", &q)?;
    let x = x.as_array().to_vec();
    py.detach(|| inertia::smallest_eigenvalue(&robot.0, &q, &x)).map_err(wrong)
}

/// The largest step from `x` towards `target` that keeps `margin` of `M(q)` at every row of `q`.
#[pyfunction]
fn largest_safe_step<'py>(
    py: Python<'py>,
    robot: &Robot,
    q: Input<'py>,
    x: PyReadonlyArray1<'py, f64>,
    target: PyReadonlyArray1<'py, f64>,
    margin: f64,
) -> PyResult<f64> {
    let shape = Shape::of("q", &q, robot.0.n_dof())?;
    let q = shape.take("q", &q)?;
    let (x, target) = (x.as_array().to_vec(), target.as_array().to_vec());
    py.detach(|| inertia::largest_safe_step(&robot.0, &q, &x, &target, margin)).map_err(wrong)
}

/// One filter as Python gives it: sections, their steady states, padding, factor, first kept sample.
type StageInput<'py> = (PyReadonlyArray2<'py, f64>, PyReadonlyArray2<'py, f64>, usize, usize, usize);

fn stages(given: &[StageInput<'_>]) -> PyResult<Vec<Stage>> {
    given
        .iter()
        .map(|(sos, zi, padding, factor, first)| {
            let (sos, zi) = (sos.as_array(), zi.as_array());
            if sos.ncols() != 6 || zi.ncols() != 2 {
                return Err(PyValueError::new_err(format!(
                    "a filter stage needs sections of 6 and states of 2 numbers, got {} and {}",
                    sos.ncols(),
                    zi.ncols()
                )));
            }
            Ok(Stage {
                sos: sos.rows().into_iter().map(|row| std::array::from_fn(|k| row[k])).collect(),
                zi: zi.rows().into_iter().map(|row| [row[0], row[1]]).collect(),
                padding: *padding,
                factor: *factor,
                first: *first,
            })
        })
        .collect()
}

/// `W`, shape `(n_dof * n_kept, n_columns)`, rows joint by joint.
#[pyfunction]
#[pyo3(signature = (robot, q, dq, ddq, columns, stages, threads=None))]
#[allow(clippy::too_many_arguments)] // the arrays of a log are separate in Python
fn observation<'py>(
    py: Python<'py>,
    robot: &Robot,
    q: Input<'py>,
    dq: Input<'py>,
    ddq: Input<'py>,
    columns: Vec<usize>,
    stages: Vec<StageInput<'py>>,
    threads: Option<usize>,
) -> PyResult<Bound<'py, PyAny>> {
    let shape = Shape::of("q", &q, robot.0.n_dof())?;
    let (q, dq, ddq) = (shape.take("q", &q)?, shape.take("dq", &dq)?, shape.take("ddq", &ddq)?);
    let stages = self::stages(&stages)?;
    let threads = threads.unwrap_or_else(parallel::available_threads);
    let log = Log { q: &q, dq: &dq, ddq: &ddq };
    let w = py.detach(|| observe(&robot.0, log, &columns, &stages, threads)).map_err(wrong)?;
    let rows = w.len().checked_div(columns.len()).unwrap_or(0);
    PyArray1::from_vec(py, w).reshape([columns.len(), rows])?.getattr("T")
}

/// Zero-phase filter and decimation of each column of `(n_samples, m)`.
#[pyfunction]
#[pyo3(signature = (signals, stages, threads=None))]
fn decimate<'py>(
    py: Python<'py>,
    signals: Input<'py>,
    stages: Vec<StageInput<'py>>,
    threads: Option<usize>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let width = signals.as_array().ncols();
    let data = flat("signals", &signals)?;
    let stages = self::stages(&stages)?;
    let threads = threads.unwrap_or_else(parallel::available_threads);
    let out = py.detach(|| decimate_columns(&data, width, &stages, threads)).map_err(wrong)?;
    let rows = out.len().checked_div(width).unwrap_or(0);
    PyArray1::from_vec(py, out).reshape([rows, width])
}

/// Zero-phase filter of each column of `(n_samples, m)`.
#[pyfunction]
#[pyo3(signature = (signals, sos, zi, padding, threads=None))]
fn filtfilt<'py>(
    py: Python<'py>,
    signals: Input<'py>,
    sos: PyReadonlyArray2<'py, f64>,
    zi: PyReadonlyArray2<'py, f64>,
    padding: usize,
    threads: Option<usize>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    decimate(py, signals, vec![(sos, zi, padding, 1, 0)], threads)
}

/// QR least squares: what Python needs for the solution, its covariance and its checks.
#[pyclass(frozen, module = "didim._core")]
struct LeastSquares {
    solution: Vec<f64>,
    inverse_r: Mat<f64>,
    diagonal_r: Vec<f64>,
    singular_values: Vec<f64>,
    residual_norm: f64,
    dependent: Vec<(usize, Vec<(usize, f64)>)>,
}

#[pymethods]
impl LeastSquares {
    #[getter]
    fn solution<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.solution)
    }

    #[getter]
    fn inverse_r<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let (rows, columns) = (self.inverse_r.nrows(), self.inverse_r.ncols());
        let data = (0..rows).flat_map(|i| (0..columns).map(move |j| (i, j)));
        PyArray1::from_iter(py, data.map(|(i, j)| self.inverse_r[(i, j)])).reshape([rows, columns])
    }

    #[getter]
    fn diagonal_r<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.diagonal_r)
    }

    #[getter]
    fn singular_values<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.singular_values)
    }

    #[getter]
    fn residual_norm(&self) -> f64 {
        self.residual_norm
    }

    #[getter]
    fn dependent(&self) -> Vec<(usize, Vec<(usize, f64)>)> {
        self.dependent.clone()
    }
}

#[pyfunction]
#[pyo3(signature = (w, y, tolerance=1e-10))]
fn least_squares(
    py: Python<'_>,
    w: PyReadonlyArray2<'_, f64>,
    y: PyReadonlyArray1<'_, f64>,
    tolerance: f64,
) -> PyResult<LeastSquares> {
    let w = w.as_array();
    let matrix = Mat::from_fn(w.nrows(), w.ncols(), |i, j| w[(i, j)]);
    let y = y.as_array().to_vec();
    same_rows("y", y.len(), "w", matrix.nrows())?;
    let solution = py.detach(|| ls::solve(matrix.as_ref(), &y, tolerance)).map_err(wrong)?;
    Ok(LeastSquares {
        solution: solution.solution,
        inverse_r: solution.inverse_r,
        diagonal_r: solution.diagonal_r,
        singular_values: solution.singular_values,
        residual_norm: solution.residual_norm,
        dependent: solution.dependent.into_iter().map(|d| (d.column, d.coefficients)).collect(),
    })
}

/// Columns of plain delimited text, `(n_rows, n_wanted)`; None where the text is not plain. A blank stands for any white space.
#[pyfunction]
fn parse_table<'py>(
    py: Python<'py>,
    text: &[u8],
    delimiter: u8,
    columns: usize,
    wanted: Vec<usize>,
) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
    let separator = if delimiter == b' ' { Delimiter::Blanks } else { Delimiter::Byte(delimiter) };
    let parsed = py.detach(|| parse(text, separator, columns, &wanted));
    parsed
        .map(|numbers| {
            let rows = numbers.len() / wanted.len().max(1);
            PyArray1::from_vec(py, numbers).reshape([rows, wanted.len()])
        })
        .transpose()
}

/// The module `didim._core`.
#[pymodule]
mod _core {
    #[pymodule_export]
    use super::simulation::{
        Controller, Reference, Schedule, simulate, simulate_cost, simulate_sensitivities,
    };
    #[pymodule_export]
    use super::{
        LeastSquares, Robot, base_parameters, decimate, direct_dynamics, filtfilt, inertia_matrix,
        inverse_dynamics, largest_safe_step, least_squares, observation, parse_table, regressor,
        smallest_eigenvalue,
    };
}
