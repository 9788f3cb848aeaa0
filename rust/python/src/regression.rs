//! Base parameters and least squares, (7) to (11), for Python.

use super::arrays::same_rows;
use super::robot::Robot;
use super::wrong;
use didim::regression::base::{Base, base_parameters as find_base};
use didim::regression::least_squares as ls;
use faer::Mat;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

type Terms = Vec<Vec<(usize, f64, String)>>;

/// `(kept columns, per kept column its terms (column, coefficient, symbol), columns that no motion shows)`.
#[pyfunction]
pub(super) fn base_parameters(py: Python<'_>, robot: &Robot) -> PyResult<(Vec<usize>, Terms, Vec<usize>)> {
    let Base { kept, terms, unidentifiable } = py.detach(|| find_base(&robot.0)).map_err(wrong)?;
    let terms = terms
        .into_iter()
        .map(|terms| terms.into_iter().map(|t| (t.column, t.coefficient, t.symbol)).collect())
        .collect();
    Ok((kept, terms, unidentifiable))
}

/// QR least squares: what Python needs for the solution, its covariance and its checks.
#[pyclass(frozen, module = "didim._core")]
pub(super) struct LeastSquares {
    solution: Vec<f64>,
    inverse_r: Mat<f64>,
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
pub(super) fn least_squares(
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
        singular_values: solution.singular_values,
        residual_norm: solution.residual_norm,
        dependent: solution.dependent.into_iter().map(|d| (d.column, d.coefficients)).collect(),
    })
}
