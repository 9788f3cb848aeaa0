//! The information matrix of a motion and its gradient, for the design of motions.

use super::arrays::{Input, Shape, flat};
use super::robot::Robot;
use super::wrong;
use didim::tangent::adjoint::Gradient;
use didim::tangent::information::{self as core, Motion, Torques, Weighting};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1};
use pyo3::prelude::*;

/// `sum W' diag(weights) W` of the columns of the regressor along a motion, `(n_columns, n_columns)`.
#[pyfunction]
pub(super) fn information<'py>(
    py: Python<'py>,
    robot: &Robot,
    q: Input<'py>,
    dq: Input<'py>,
    ddq: Input<'py>,
    columns: Vec<usize>,
    weights: PyReadonlyArray1<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let shape = Shape::of("q", &q, robot.0.n_dof())?;
    let (q, dq, ddq) = (shape.take("q", &q)?, shape.take("dq", &dq)?, shape.take("ddq", &ddq)?);
    let weights = weights.as_array().to_vec();
    let b = columns.len();
    let mut matrix = vec![0.0; b * b];
    py.detach(|| {
        let motion = Motion { q: &q, dq: &dq, ddq: &ddq };
        core::information(&robot.0, motion, Weighting { columns: &columns, joints: &weights }, &mut matrix)
    })
    .map_err(wrong)?;
    PyArray1::from_vec(py, matrix).reshape([b, b])
}

/// Derivatives with respect to positions, velocities and accelerations.
type Gradients<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>);

/// Gradient of a criterion with derivative `derivative` by the information matrix, and `torque_weights` by the torques of `x`.
#[pyfunction]
#[pyo3(signature = (robot, q, dq, ddq, columns, weights, derivative, torque_weights=None, x=None))]
#[allow(clippy::too_many_arguments)] // the arrays of a motion are separate in Python
pub(super) fn information_gradient<'py>(
    py: Python<'py>,
    robot: &Robot,
    q: Input<'py>,
    dq: Input<'py>,
    ddq: Input<'py>,
    columns: Vec<usize>,
    weights: PyReadonlyArray1<'py, f64>,
    derivative: Input<'py>,
    torque_weights: Option<Input<'py>>,
    x: Option<PyReadonlyArray1<'py, f64>>,
) -> PyResult<Gradients<'py>> {
    let shape = Shape::of("q", &q, robot.0.n_dof())?;
    let (q, dq, ddq) = (shape.take("q", &q)?, shape.take("dq", &dq)?, shape.take("ddq", &ddq)?);
    let weights = weights.as_array().to_vec();
    let derivative = flat("derivative", &derivative)?;
    let torque_weights =
        torque_weights.as_ref().map(|given| shape.take("torque_weights", given)).transpose()?;
    let x = x.map(|x| x.as_array().to_vec());
    let torques = match (&torque_weights, &x) {
        (Some(weights), Some(x)) => Some(Torques { weights, x }),
        _ => None,
    };
    let [mut gq, mut gdq, mut gddq] = [(); 3].map(|()| vec![0.0; q.len()]);
    py.detach(|| {
        let motion = Motion { q: &q, dq: &dq, ddq: &ddq };
        let weighting = Weighting { columns: &columns, joints: &weights };
        let mut out = Gradient { q: &mut gq, dq: &mut gdq, ddq: &mut gddq };
        core::information_gradient(&robot.0, motion, weighting, &derivative, torques, &mut out)
    })
    .map_err(wrong)?;
    let array = |values| PyArray1::from_vec(py, values).reshape([shape.samples, shape.width]);
    Ok((array(gq)?, array(gdq)?, array(gddq)?))
}
