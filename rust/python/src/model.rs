//! The models of (1), (2) and (4), for Python.

use super::arrays::{Input, Shape};
use super::robot::Robot;
use super::wrong;
use didim::model::{direct, inertia, inverse, regressor as idm};
use didim::robot::parameters::Layout;
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

#[pyfunction]
pub(super) fn inverse_dynamics<'py>(
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
#[pyo3(signature = (robot, q, dq, ddq, out=None, load=None))]
pub(super) fn regressor<'py>(
    py: Python<'py>,
    robot: &Robot,
    q: Input<'py>,
    dq: Input<'py>,
    ddq: Input<'py>,
    out: Option<Bound<'py, PyArray3<f64>>>,
    load: Option<Input<'py>>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let shape = Shape::of("q", &q, robot.0.n_dof())?;
    let (q, dq, ddq) = (shape.take("q", &q)?, shape.take("dq", &dq)?, shape.take("ddq", &ddq)?);
    let load = load.as_ref().map(|load| shape.take("load", load)).transpose()?;
    let load = load.as_deref().unwrap_or_default();
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
            idm::regressor_under_load(&robot.0, &q, &dq, &ddq, load, w).map_err(wrong)?;
        }
        return Ok(out);
    }
    let mut w = vec![0.0; q.len() * p];
    py.detach(|| idm::regressor_under_load(&robot.0, &q, &dq, &ddq, load, &mut w)).map_err(wrong)?;
    PyArray1::from_vec(py, w).reshape([shape.samples, shape.width, p])
}

/// `M(q)`, shape `(n_samples, n_dof, n_dof)`.
#[pyfunction]
pub(super) fn inertia_matrix<'py>(
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
pub(super) fn direct_dynamics<'py>(
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
pub(super) fn smallest_eigenvalue<'py>(
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
pub(super) fn largest_safe_step<'py>(
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
