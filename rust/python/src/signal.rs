//! Text, filters and the observation matrix (6), for Python.

use super::arrays::{Input, Shape, flat};
use super::robot::Robot;
use super::wrong;
use didim::ground::parallel;
use didim::signal::filter::Stage;
use didim::signal::observation::{Log, decimate as decimate_columns, observation as observe};
use didim::signal::text::{Delimiter, parse};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;

/// One filter as Python gives it: sections, their steady states, padding, factor, first kept sample.
type StageInput<'py> = (PyReadonlyArray2<'py, f64>, PyReadonlyArray2<'py, f64>, usize, usize, usize);

fn stages(given: &[StageInput<'_>]) -> Vec<Stage> {
    given
        .iter()
        .map(|(sos, zi, padding, factor, first)| {
            let rows = |given: &PyReadonlyArray2<'_, f64>| -> Vec<Vec<f64>> {
                given.as_array().rows().into_iter().map(|row| row.to_vec()).collect()
            };
            Stage { sos: rows(sos), zi: rows(zi), padding: *padding, factor: *factor, first: *first }
        })
        .collect()
}

/// `W`, shape `(n_dof * n_kept, n_columns)`, rows joint by joint.
#[pyfunction]
#[pyo3(signature = (robot, q, dq, ddq, columns, stages, threads=None, load=None))]
#[allow(clippy::too_many_arguments)] // the arrays of a log are separate in Python
pub(super) fn observation<'py>(
    py: Python<'py>,
    robot: &Robot,
    q: Input<'py>,
    dq: Input<'py>,
    ddq: Input<'py>,
    columns: Vec<usize>,
    stages: Vec<StageInput<'py>>,
    threads: Option<usize>,
    load: Option<Input<'py>>,
) -> PyResult<Bound<'py, PyAny>> {
    let shape = Shape::of("q", &q, robot.0.n_dof())?;
    let (q, dq, ddq) = (shape.take("q", &q)?, shape.take("dq", &dq)?, shape.take("ddq", &ddq)?);
    let load = load.as_ref().map(|load| shape.take("load", load)).transpose()?;
    let stages = self::stages(&stages);
    let threads = threads.unwrap_or_else(parallel::available_threads);
    let log = Log { q: &q, dq: &dq, ddq: &ddq, load: load.as_deref().unwrap_or_default() };
    let w = py.detach(|| observe(&robot.0, log, &columns, &stages, threads)).map_err(wrong)?;
    let rows = w.len().checked_div(columns.len()).unwrap_or(0);
    PyArray1::from_vec(py, w).reshape([columns.len(), rows])?.getattr("T")
}

/// Zero-phase filter and decimation of each column of `(n_samples, m)`.
#[pyfunction]
#[pyo3(signature = (signals, stages, threads=None))]
pub(super) fn decimate<'py>(
    py: Python<'py>,
    signals: Input<'py>,
    stages: Vec<StageInput<'py>>,
    threads: Option<usize>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let width = signals.as_array().ncols();
    let data = flat("signals", &signals)?;
    let stages = self::stages(&stages);
    let threads = threads.unwrap_or_else(parallel::available_threads);
    let out = py.detach(|| decimate_columns(&data, width, &stages, threads)).map_err(wrong)?;
    let rows = out.len().checked_div(width).unwrap_or(0);
    PyArray1::from_vec(py, out).reshape([rows, width])
}

/// Zero-phase filter of each column of `(n_samples, m)`.
#[pyfunction]
#[pyo3(signature = (signals, sos, zi, padding, threads=None))]
pub(super) fn filtfilt<'py>(
    py: Python<'py>,
    signals: Input<'py>,
    sos: PyReadonlyArray2<'py, f64>,
    zi: PyReadonlyArray2<'py, f64>,
    padding: usize,
    threads: Option<usize>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    decimate(py, signals, vec![(sos, zi, padding, 1, 0)], threads)
}

/// Columns of plain delimited text, `(n_rows, n_wanted)`; None where the text is not plain. A blank stands for any white space.
#[pyfunction]
#[pyo3(signature = (text, delimiter, columns, wanted, threads=None))]
pub(super) fn parse_table<'py>(
    py: Python<'py>,
    text: &[u8],
    delimiter: u8,
    columns: usize,
    wanted: Vec<usize>,
    threads: Option<usize>,
) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
    let separator = if delimiter == b' ' { Delimiter::Blanks } else { Delimiter::Byte(delimiter) };
    let threads = threads.unwrap_or_else(parallel::available_threads);
    let parsed = py.detach(|| parse(text, separator, columns, &wanted, threads));
    parsed
        .map(|numbers| {
            let rows = numbers.len() / wanted.len().max(1);
            PyArray1::from_vec(py, numbers).reshape([rows, wanted.len()])
        })
        .transpose()
}
