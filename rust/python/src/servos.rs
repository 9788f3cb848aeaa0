//! Runs of position servos, for Python.

use super::arrays::{Input, flat};
use super::closed_loop::{Ending, Setting, ending, run};
use super::wrong;
use didim::closed_loop::observers::Positions;
use didim::closed_loop::servo::Servos;
use didim::closed_loop::set_point::areas;
use numpy::{PyArray1, PyArray3, PyArrayMethods, PyReadonlyArray1};
use pyo3::prelude::*;

/// Positions `(m, n_records, n_dof)` of candidates `x`, `(m, n_parameters)`, that servos drive: `rows` has a row for each, and
/// `targets`, `(references * steps, n_dof)`, the means of what they follow over the steps of the schedule.
#[pyfunction]
#[pyo3(signature = (setting, x, rows, targets, threads=None))]
pub(super) fn simulate_servos<'py>(
    py: Python<'py>,
    setting: Setting<'py>,
    x: Input<'py>,
    rows: Input<'py>,
    targets: Input<'py>,
    threads: Option<usize>,
) -> PyResult<(Bound<'py, PyArray3<f64>>, Vec<Ending>)> {
    let n = setting.robot.get().0.n_dof();
    let schedule = setting.schedule.clone_ref(py);
    let records = schedule.get().0.records();
    let targets = flat("targets", &targets)?;
    let servos = Servos::new(n, &schedule.get().0, &targets).map_err(wrong)?;
    let observer = |lanes| Positions { lanes: vec![Vec::with_capacity(records * n); lanes] };
    let groups = run(py, setting, &x, &rows, Some(&servos), threads, observer)?;
    let m = x.as_array().nrows();
    let (mut q, mut endings) = (Vec::with_capacity(m * records * n), Vec::with_capacity(m));
    for (outcomes, positions) in groups {
        for (outcome, mut lane) in outcomes.into_iter().zip(positions.lanes) {
            endings.push(ending(outcome));
            // Records that a run did not reach are not numbers.
            lane.resize(records * n, f64::NAN);
            q.append(&mut lane);
        }
    }
    Ok((PyArray1::from_vec(py, q).reshape([m, records, n])?, endings))
}

/// Integrals `(n_times,)` from time 0 to `times` of a set-point between `goals`, `(n_samples,)`, with a largest acceleration.
#[pyfunction]
pub(super) fn set_point_areas<'py>(
    py: Python<'py>,
    goals: PyReadonlyArray1<'py, f64>,
    rate: f64,
    acceleration: f64,
    times: PyReadonlyArray1<'py, f64>,
) -> Bound<'py, PyArray1<f64>> {
    let (goals, times) = (goals.as_array().to_vec(), times.as_array().to_vec());
    PyArray1::from_vec(py, areas(&goals, rate, acceleration, &times))
}
