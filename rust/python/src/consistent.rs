//! The constrained problem of [`didim::regression::consistent`] in Python.

use super::arrays::{Input, flat};
use super::wrong;
use didim::regression::consistent::{Cone, Ending, Equality, LEAST_WEIGHT, Problem, Solution};
use numpy::{
    PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;

/// A cone: unknowns, `B` of shape `(k, m, m)`, `K`, weight, `Q`.
type ConeInput<'py> =
    (Vec<usize>, PyReadonlyArray3<'py, f64>, PyReadonlyArray2<'py, f64>, f64, PyReadonlyArray2<'py, f64>);

/// A checked problem, immutable.
#[pyclass(frozen, module = "didim._core")]
pub struct ConsistentProblem(Problem);

#[pymethods]
impl ConsistentProblem {
    /// From its number of unknowns, cones and equalities `coefficients @ x = values`.
    #[new]
    #[pyo3(signature = (count, cones, coefficients=None, values=None, least_weight=LEAST_WEIGHT))]
    fn new(
        count: usize,
        cones: Vec<ConeInput<'_>>,
        coefficients: Option<PyReadonlyArray2<'_, f64>>,
        values: Option<PyReadonlyArray1<'_, f64>>,
        least_weight: f64,
    ) -> PyResult<Self> {
        let cones: Vec<Cone> = cones
            .into_iter()
            .map(|(indices, basis, constant, weight, slope)| Cone {
                order: constant.shape()[0],
                indices,
                basis: basis.as_array().iter().copied().collect(),
                constant: constant.as_array().iter().copied().collect(),
                weight,
                slope: slope.as_array().iter().copied().collect(),
            })
            .collect();
        let equalities: Vec<Equality> = match (coefficients, values) {
            (Some(coefficients), Some(values)) => {
                let rows = coefficients.as_array();
                let pairs =
                    rows.rows().into_iter().zip(values.as_array().iter().copied().collect::<Vec<_>>());
                pairs.map(|(row, value)| Equality { coefficients: row.to_vec(), value }).collect()
            }
            _ => Vec::new(),
        };
        Problem::new(count, &cones, &equalities, least_weight).map(Self).map_err(wrong)
    }

    /// Minimise for rows `a` and right sides `z`, one a row, from a start.
    #[pyo3(signature = (a, z, start, threads=1))]
    fn solve(
        &self,
        py: Python<'_>,
        a: Input<'_>,
        z: Input<'_>,
        start: PyReadonlyArray1<'_, f64>,
        threads: usize,
    ) -> PyResult<ConsistentSolutions> {
        let rows = flat("a", &a)?;
        let sides: Vec<Vec<f64>> = z.as_array().rows().into_iter().map(|row| row.to_vec()).collect();
        let start = start.as_array().to_vec();
        let solved = py.detach(|| self.0.solve(&rows, &sides, &start, threads.max(1))).map_err(wrong)?;
        Ok(ConsistentSolutions { count: start.len(), solved })
    }
}

/// Solutions of one call, a row each.
#[pyclass(frozen, module = "didim._core")]
pub struct ConsistentSolutions {
    count: usize,
    solved: Vec<Solution>,
}

#[pymethods]
impl ConsistentSolutions {
    /// Unknowns, `(n_solutions, count)`.
    #[getter]
    fn x<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let numbers = self.solved.iter().flat_map(|solution| solution.x.iter().copied()).collect();
        PyArray1::from_vec(py, numbers).reshape([self.solved.len(), self.count])
    }

    /// "solved", "contradictory", "stalled" or "limit", with the cone of a contradiction.
    #[getter]
    fn endings(&self) -> Vec<(&'static str, Option<usize>)> {
        let ending = |solution: &Solution| match solution.ending {
            Ending::Solved => ("solved", None),
            Ending::Contradictory(cone) => ("contradictory", Some(cone)),
            Ending::Stalled => ("stalled", None),
            Ending::Limit => ("limit", None),
        };
        self.solved.iter().map(ending).collect()
    }

    /// Newton systems factored.
    #[getter]
    fn iterations(&self) -> Vec<usize> {
        self.solved.iter().map(|solution| solution.iterations).collect()
    }

    /// Multipliers of the cones of one solution, row-major.
    fn multipliers(&self, solution: usize) -> Vec<Vec<f64>> {
        self.solved.get(solution).map_or_else(Vec::new, |solution| solution.multipliers.clone())
    }
}
