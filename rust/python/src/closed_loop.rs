//! References, controllers, schedules and runs of the closed loop, for Python.

use super::arrays::{Input, Shape, flat};
use super::robot::Robot;
use super::wrong;
use didim::closed_loop::control::{Controller as CoreController, Digital, Law, Signal, Timing};
use didim::closed_loop::groups::{self as core};
use didim::closed_loop::memory::{Initial, Memory};
use didim::closed_loop::observers::{Cost, Measured, Observer, Trajectories, Trajectory};
use didim::closed_loop::point_to_point::PointToPoint;
use didim::closed_loop::reference::{Fourier, Reference as CoreReference, Target};
use didim::closed_loop::schedule::{Plan, Schedule as CoreSchedule};
use didim::closed_loop::servo::Servos;
use didim::closed_loop::simulation::SimulationError;
use didim::closed_loop::simulation::{Candidate, Integrator, Outcome, Simulation};
use didim::ground::cancel::Cancel;
use didim::ground::parallel;
use didim::robot::parameters::Layout;
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::sync::Mutex;

/// Reference of a closed loop.
#[pyclass(frozen, module = "didim._core")]
pub(super) struct Reference(CoreReference);

type Motion<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>);

#[pymethods]
impl Reference {
    #[staticmethod]
    fn from_knots(
        times: PyReadonlyArray1<'_, f64>,
        q: Input<'_>,
        dq: Input<'_>,
        ddq: Input<'_>,
    ) -> PyResult<Self> {
        let n = q.as_array().ncols();
        let shape = Shape::of("q", &q, n)?;
        let (q, dq, ddq) = (shape.take("q", &q)?, shape.take("dq", &dq)?, shape.take("ddq", &ddq)?);
        CoreReference::from_knots(n, times.as_array().to_vec(), &q, &dq, &ddq).map(Self).map_err(wrong)
    }

    #[staticmethod]
    fn sampled(rate: f64, q: Input<'_>) -> PyResult<Self> {
        CoreReference::sampled(q.as_array().ncols(), rate, &flat("q", &q)?).map(Self).map_err(wrong)
    }

    #[staticmethod]
    fn fourier(
        period: f64,
        offset: Vec<f64>,
        sine: Input<'_>,
        cosine: Input<'_>,
        duration: f64,
        knots: usize,
    ) -> PyResult<Self> {
        let (sine, cosine) = (flat("sine", &sine)?, flat("cosine", &cosine)?);
        let series = Fourier { period, offset: &offset, sine: &sine, cosine: &cosine };
        CoreReference::fourier(offset.len(), series, duration, knots).map(Self).map_err(wrong)
    }

    #[staticmethod]
    fn point_to_point(
        points: Input<'_>,
        velocity: Vec<f64>,
        acceleration: Vec<f64>,
        dwell: f64,
    ) -> PyResult<Self> {
        let n = points.as_array().ncols();
        let points = flat("points", &points)?;
        let moves = PointToPoint { points: &points, velocity: &velocity, acceleration: &acceleration, dwell };
        CoreReference::point_to_point(n, moves).map(Self).map_err(wrong)
    }

    fn with_breaks(&self, breaks: Vec<f64>) -> Self {
        Self(self.0.clone().with_breaks(breaks))
    }

    #[getter]
    fn n_dof(&self) -> usize {
        self.0.n_dof()
    }

    #[getter]
    fn span(&self) -> (f64, f64) {
        self.0.span()
    }

    #[getter]
    fn breaks(&self) -> Vec<f64> {
        self.0.breaks().to_vec()
    }

    /// Positions, velocities and accelerations at times, `(n_times, n_dof)` each.
    fn at<'py>(&self, py: Python<'py>, times: PyReadonlyArray1<'py, f64>) -> PyResult<Motion<'py>> {
        let n = self.0.n_dof();
        let times = times.as_array();
        let mut out: [Vec<f64>; 3] = std::array::from_fn(|_| Vec::with_capacity(times.len() * n));
        let (mut piece, mut target) = (0, Target::zero());
        for &t in times {
            self.0.at(t, &mut piece, &mut target);
            for (out, values) in out.iter_mut().zip([&target.q, &target.dq, &target.ddq]) {
                out.extend_from_slice(&values[..n]);
            }
        }
        let [q, dq, ddq] = out;
        let shaped = |values: Vec<f64>| PyArray1::from_vec(py, values).reshape([times.len(), n]);
        Ok((shaped(q)?, shaped(dq)?, shaped(ddq)?))
    }
}

/// The laws of all joints.
#[pyclass(frozen, module = "didim._core")]
pub(super) struct Controller(CoreController);

/// Sample time, delay, weights of the smoothed position, encoder steps.
type DigitalInput = (f64, usize, Vec<f64>, Vec<f64>);
/// Rate, and samples `(n_samples, n_dof)`.
type SignalInput<'py> = (f64, Input<'py>);

fn signal(what: &str, given: Option<SignalInput<'_>>) -> PyResult<Option<Signal>> {
    given
        .map(|(rate, values)| {
            let n = values.as_array().ncols();
            Ok(Signal { rate, n, values: flat(what, &values)?.into_owned() })
        })
        .transpose()
}

#[pymethods]
impl Controller {
    /// `laws` has a row per joint: `P D I A w a b limit g`.
    #[new]
    #[pyo3(signature = (laws, digital=None, feedforward=None))]
    fn new(
        laws: Vec<[f64; 9]>,
        digital: Option<DigitalInput>,
        feedforward: Option<SignalInput<'_>>,
    ) -> PyResult<Self> {
        let laws = laws
            .into_iter()
            .map(|[position, velocity, integral, acceleration, w, a, b, limit, gain]| Law {
                position,
                velocity,
                integral,
                acceleration,
                reference_velocity: w,
                integrated_position: a,
                integrated_velocity: b,
                limit,
                gain,
            })
            .collect();
        let timing = digital.map_or(Timing::Continuous, |(period, delay, smoothing, resolution)| {
            Timing::Digital(Digital { period, delay, smoothing, resolution })
        });
        let feedforward = signal("feedforward", feedforward)?;
        CoreController::new(laws, timing, feedforward).map(Self).map_err(wrong)
    }

    #[getter]
    fn period(&self) -> Option<f64> {
        self.0.period()
    }
}

/// When a simulation steps, records and controls.
#[pyclass(frozen, module = "didim._core")]
pub(super) struct Schedule(pub(super) CoreSchedule);

#[pymethods]
impl Schedule {
    #[new]
    #[pyo3(signature = (robot, reference, *, rate, records, period, coarse, fine, slow, motion=None))]
    #[allow(clippy::too_many_arguments)] // one keyword each, called from one place in simulation.py
    fn new(
        robot: &Robot,
        reference: &Reference,
        rate: f64,
        records: usize,
        period: Option<f64>,
        coarse: f64,
        fine: Vec<f64>,
        slow: Vec<f64>,
        motion: Option<&Reference>,
    ) -> PyResult<Self> {
        let motion = motion.map(|motion| &motion.0);
        let plan = Plan { rate, records, period, coarse, fine: &fine, slow: &slow, motion };
        CoreSchedule::new(&robot.0, &reference.0, plan).map(Self).map_err(wrong)
    }

    #[getter]
    fn steps(&self) -> usize {
        self.0.steps()
    }

    #[getter]
    fn records(&self) -> usize {
        self.0.records()
    }

    #[getter]
    fn edges<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_vec(py, self.0.edges())
    }

    fn divided(&self, parts: usize) -> PyResult<Self> {
        if parts == 0 {
            return Err(PyValueError::new_err("a step cannot be divided into 0 parts"));
        }
        Ok(Self(self.0.divided(parts)))
    }
}

/// Everything but the candidates.
#[derive(FromPyObject)]
pub(super) struct Setting<'py> {
    pub(super) robot: Py<Robot>,
    reference: Py<Reference>,
    controller: Py<Controller>,
    pub(super) schedule: Py<Schedule>,
    start: Option<(Vec<f64>, Vec<f64>)>,
    memory: MemoryInput,
    external: Option<SignalInput<'py>>,
    divergence: f64,
    implicit_friction: bool,
}

/// How the integrators begin ("zero", "balance", "torque" or "integrators") with its numbers, outputs on their way, positions before.
type MemoryInput = (String, Vec<f64>, Option<Vec<f64>>, Option<Vec<f64>>);

fn memory((kind, values, outputs, positions): &MemoryInput) -> PyResult<Memory<'_>> {
    let initial = match kind.as_str() {
        "zero" => Initial::Zero,
        "balance" => Initial::Balance,
        "torque" => Initial::Torque(values),
        "integrators" => Initial::Integrators(values),
        _ => return Err(PyValueError::new_err(format!("'{kind}' is not a start of a controller"))),
    };
    Ok(Memory { initial, outputs: outputs.as_deref(), positions: positions.as_deref() })
}

/// `(0, end, 0)` completed, `(1, time, joint)` diverged, `(2, time, joint)` indefinite.
pub(super) type Ending = (u8, f64, usize);

pub(super) fn ending(outcome: Outcome) -> Ending {
    match outcome {
        Outcome::Completed => (0, f64::NAN, 0),
        Outcome::Diverged { time, joint } => (1, time, joint),
        Outcome::Indefinite { time, joint } => (2, time, joint),
        Outcome::Cancelled { time } => (3, time, 0),
    }
}

/// Some of positions, velocities, accelerations and torques, `(m, n_records, n_dof)` each, and how each run ended.
type Runs<'py> = (Vec<Bound<'py, PyArray3<f64>>>, Vec<Ending>);

/// Runs candidates `x`, `(m, n_parameters)`, with gains scaled by `scale`, `(m, n_dof)`; `wanted` says which signals are recorded.
#[pyfunction]
#[pyo3(signature = (setting, x, scale, threads=None, wanted=[true; 4]))]
pub(super) fn simulate<'py>(
    py: Python<'py>,
    setting: Setting<'py>,
    x: Input<'py>,
    scale: Input<'py>,
    threads: Option<usize>,
    wanted: [bool; 4],
) -> PyResult<Runs<'py>> {
    let n = setting.robot.get().0.n_dof();
    let records = setting.schedule.get().0.records();
    let observer = |lanes| Trajectories::of(wanted, lanes, records, n);
    let groups = run(py, setting, &x, &scale, None, threads, observer)?;
    let m = x.as_array().nrows();
    let mut out = wanted.map(|wanted| wanted.then(|| Vec::with_capacity(m * records * n)));
    let mut endings = Vec::with_capacity(m);
    for (outcomes, trajectories) in groups {
        for (outcome, mut lane) in outcomes.into_iter().zip(trajectories.lanes) {
            endings.push(ending(outcome));
            let Trajectory { q, dq, ddq, tau } = &mut lane;
            for (out, values) in out.iter_mut().zip([q, dq, ddq, tau]) {
                if let Some(out) = out {
                    // Records that a run did not reach are not numbers.
                    values.resize(records * n, f64::NAN);
                    out.append(values);
                }
            }
        }
    }
    let arrays =
        out.into_iter().flatten().map(|values| PyArray1::from_vec(py, values).reshape([m, records, n]));
    Ok((arrays.collect::<PyResult<_>>()?, endings))
}

/// Sums of squared errors of the same runs against `q` and `tau`, `(n_records, n_dof)`, weighted per joint; memory does not grow
/// with the candidates.
#[pyfunction]
#[pyo3(signature = (setting, x, scale, q, tau, weight_q, weight_tau, threads=None))]
#[allow(clippy::too_many_arguments)] // one each, called from one place in simulation.py
pub(super) fn simulate_cost<'py>(
    py: Python<'py>,
    setting: Setting<'py>,
    x: Input<'py>,
    scale: Input<'py>,
    q: Input<'py>,
    tau: Input<'py>,
    weight_q: Vec<f64>,
    weight_tau: Vec<f64>,
    threads: Option<usize>,
) -> PyResult<(Bound<'py, PyArray1<f64>>, Vec<Ending>)> {
    let n = setting.robot.get().0.n_dof();
    let shape = Shape { samples: setting.schedule.get().0.records(), width: n };
    let (q, tau) = (shape.take("q", &q)?, shape.take("tau", &tau)?);
    if weight_q.len() != n || weight_tau.len() != n {
        return Err(PyValueError::new_err(format!("the weights need {n} entries, one per joint")));
    }
    let measured = Measured { q: &q, tau: &tau, weight_q: &weight_q, weight_tau: &weight_tau };
    let groups = run(py, setting, &x, &scale, None, threads, |_| Cost::new(measured, n))?;
    let (mut costs, mut endings) = (Vec::new(), Vec::new());
    for (outcomes, cost) in groups {
        for (outcome, sum) in outcomes.into_iter().zip(cost.sums) {
            costs.push(if outcome == Outcome::Completed { sum } else { f64::INFINITY });
            endings.push(ending(outcome));
        }
    }
    Ok((PyArray1::from_vec(py, costs), endings))
}

// A closure is needed: `Python::check_signals` is tied to the lifetime of one token and cannot be passed as a function.
#[allow(clippy::redundant_closure_for_method_calls)]
pub(super) fn run<O: Observer>(
    py: Python<'_>,
    setting: Setting<'_>,
    x: &Input<'_>,
    scale: &Input<'_>,
    servos: Option<&Servos<'_>>,
    threads: Option<usize>,
    observer: impl Fn(usize) -> O + Sync + Send,
) -> PyResult<Vec<(Vec<Outcome>, O)>> {
    let robot = &setting.robot.get().0;
    let (n, p) = (robot.n_dof(), Layout::of(robot).count());
    let m = x.as_array().nrows();
    if scale.as_array().nrows() != m {
        return Err(PyValueError::new_err(format!("{m} candidates need {m} rows of scale")));
    }
    if x.as_array().ncols() != p {
        return Err(PyValueError::new_err(format!("x must have shape (m, {p})")));
    }
    let (x, scale) = (flat("x", x)?, flat("scale", scale)?);
    let width = servos.map_or(n, Servos::width);
    if scale.len() != m * width {
        return Err(PyValueError::new_err(format!("scale must have shape ({m}, {width})")));
    }
    let candidates: Vec<Candidate<'_>> =
        x.chunks_exact(p).zip(scale.chunks_exact(width)).map(|(x, scale)| Candidate { x, scale }).collect();
    let threads = threads.unwrap_or_else(parallel::available_threads);
    with_simulation(py, setting, |simulation, cancel| {
        core::simulate(Simulation { servos, ..simulation }, &candidates, threads, cancel, observer)
    })
}

/// Does work that needs a simulation and hears Ctrl-C, without holding Python's lock.
#[allow(clippy::redundant_closure_for_method_calls)] // see `run`
fn with_simulation<T: Send>(
    py: Python<'_>,
    setting: Setting<'_>,
    work: impl FnOnce(Simulation<'_>, &Cancel<'_>) -> Result<T, SimulationError> + Send,
) -> PyResult<T> {
    let external = signal("external", setting.external)?;
    let simulation = Simulation {
        robot: &setting.robot.get().0,
        reference: &setting.reference.get().0,
        controller: &setting.controller.get().0,
        schedule: &setting.schedule.get().0,
        external: external.as_ref(),
        start: setting.start.as_ref().map(|(q, dq)| (q.as_slice(), dq.as_slice())),
        memory: memory(&setting.memory)?,
        divergence: setting.divergence,
        integrator: if setting.implicit_friction { Integrator::Additive } else { Integrator::RungeKutta },
        servos: None,
    };
    // Only the thread that came from Python hears Ctrl-C; what it raises is kept for the way back.
    let caller = std::thread::current().id();
    let raised: Mutex<Option<PyErr>> = Mutex::new(None);
    let interrupted = || {
        std::thread::current().id() == caller
            && Python::attach(|py| py.check_signals()).is_err_and(|error| {
                if let Ok(mut raised) = raised.lock() {
                    *raised = Some(error);
                }
                true
            })
    };
    let found = py.detach(|| work(simulation, &Cancel::when(&interrupted)));
    if let Ok(Some(error)) = raised.into_inner() {
        return Err(error);
    }
    found.map_err(wrong)
}
