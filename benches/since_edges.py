"""Measurements of `since_0_1_0.py`: rows 1 to 14, fits and endings; with names that both versions have."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import didim
from didim import CLOE, DIDIM, IDIMLS, Controller, Experiment, Identification, Recording, SignalProcessing

Array = NDArray[np.float64]
Value = float | str

NO_KEY = "no key for it"
REFUSED = "refused"
PLANAR_ROWS = (1500 - 40 - 90) * 2


def moved(old: str, new: str) -> Any:
    """Return a module of the package, which has moved since."""
    try:
        return import_module(f"didim.{new}")
    except ModuleNotFoundError:
        return import_module(f"didim.{old}")


def load(folder: Path, name: str) -> Experiment:
    return didim.load_experiment(folder / f"{name}.toml")


def truth_of(experiment: Experiment, name: str = "reference") -> Array:
    return np.asarray(experiment.robot.set_base(name))


def worst_sigmas(fit: Identification, truth: Array) -> float:
    return float(np.max(np.abs(fit.beta - truth) / fit.std))


def plain(**settings: Any) -> DIDIM:
    """Return DIDIM of the paper; without physical conditions, which 0.1.0 did not have and which are the default now."""
    present = "physical" in {item.name for item in fields(DIDIM)}
    return DIDIM(**({**settings, "physical": False} if present else settings))


@contextmanager
def watched(owner: Any, name: str) -> Iterator[list[tuple[Any, ...]]]:
    """Note the arguments of each call of a method."""
    method, calls = getattr(owner, name), []

    def noting(*arguments: Any, **options: Any) -> Any:
        calls.append(arguments)
        return method(*arguments, **options)

    setattr(owner, name, noting)
    try:
        yield calls
    finally:
        setattr(owner, name, method)


def refusal(call: Callable[[], object]) -> str | None:
    """Return how a call ends that should be refused: None where it is not."""
    try:
        call()
    except didim.DidimError:
        return REFUSED
    except Exception as error:
        return f"traceback, {type(error).__name__}"
    return None


# Rows 1 to 4.


def resting_joint(folder: Path) -> Value:
    log = load(folder, "rest")
    return worst_sigmas(didim.identify(log, CLOE(start="idim-ls")), truth_of(log))


def resting_joint_absolute(folder: Path) -> Value:
    log = load(folder, "rest")
    return float(np.max(np.abs(didim.identify(log, CLOE(start="idim-ls")).beta - truth_of(log))))


def exact(log: Experiment) -> Identification:
    """Return a result whose parameters are the true ones."""
    fit = didim.identify(log, IDIMLS())
    return replace(fit, parameters=log.robot.parameter_set("reference"), beta=truth_of(log))


def measured_start(folder: Path) -> Value:
    log = load(folder, "cut")
    (found,) = didim.validate(exact(log), log).recordings
    return 100.0 * float(np.max(found.simulated["torque"]))


def given_state(folder: Path) -> Value:
    memory = getattr(didim, "ControllerMemory", None)
    if memory is None:
        return NO_KEY
    robot = didim.load_robot("planar2").with_smoothing([0.05, 0.05])
    x = robot.parameter_set("reference")
    reference = didim.Reference.random_fourier(
        harmonics=5,
        period_s=5.0,
        max_position=[1.5, 1.5],
        max_velocity=[4.0, 5.0],
        max_acceleration=[30.0, 40.0],
        seed=3,
    )
    controller = Controller.pid([300.0, 60.0], [40.0, 5.0], [600.0, 150.0])
    steps: dict[str, Any] = {"step": 2e-4, "fine_step": 2e-4, "rate_hz": 1000.0}
    run = didim.simulate(robot, x, reference, controller, **steps)
    t = np.arange(3 * 4000 + 1) / 4000.0
    rest = didim.Reference.through(*reference.at(t + 2.0), rate_hz=4000.0)
    state = memory(start="torque", values=tuple(run.tau[2000].tolist()))
    again = didim.simulate(
        robot, x, rest, controller, start=(run.q[2000], run.dq[2000]), memory=state, **steps
    )
    return float(np.linalg.norm(run.tau[2000:] - again.tau) / np.linalg.norm(run.tau[2000:]))


def eight_windows(folder: Path) -> Value:
    robot = didim.load_robot("planar2").with_smoothing((0.2, 0.2))
    data = np.load(folder / "windows.npz")
    recording = Recording.from_arrays(data["q"], data["tau"], rate_hz=1000.0)
    parts = tuple((1000 * k, 1000 * (k + 1)) for k in range(8))
    log = Experiment(
        name="ends",
        robot=robot,
        recordings=(replace(recording, windows=parts),),
        signal=SignalProcessing(cutoff_hz=None),
    )
    truth = truth_of(log)
    off = np.abs(didim.identify(log, IDIMLS()).beta - truth)
    return 100.0 * float(np.max(off / np.where(truth != 0.0, np.abs(truth), 1.0)))


def short(folder: Path, **trim: Any) -> Experiment:
    """Return 1500 samples of the planar arm."""
    log = load(folder, "arm")
    (recording,) = log.recordings
    recording = replace(recording, windows=((0, 1500),))
    return replace(log, recordings=(recording,), signal=replace(log.signal, **trim))


def rows_of_cloe(folder: Path) -> Value:
    log = short(folder, trim_start=40, trim_end=90)
    fit = didim.identify(log, CLOE(start="idim-ls", max_iterations=3))
    right = fit.error_norm / np.sqrt(PLANAR_ROWS - len(fit.beta))
    return 100.0 * abs(float(fit.error_std / right) - 1.0)


def nothing_left(folder: Path) -> Value:
    log = short(folder, trim_start=800, trim_end=800)
    method = CLOE(start="reference", max_iterations=2)
    return (
        refusal(lambda: didim.identify(log, method))
        or f"a result of {didim.identify(log, method).n_rows} rows"
    )


def errors_with_delay(folder: Path) -> Value:
    log = short(folder, trim_start=40, trim_end=90)
    (recording,) = log.recordings
    assert recording.tau is not None
    late = replace(recording, tau=np.roll(recording.tau, 3, axis=0))
    log = replace(log, recordings=(late,), delay=replace(log.delay, compensate_samples=3.0))
    fit = didim.identify(log, CLOE(start="idim-ls", max_iterations=3))
    prediction = moved("prediction", "studies.prediction")
    errors = np.asarray(prediction.relative_errors(prediction.predict(fit, log)))
    return 100.0 * float(np.max(np.abs(fit.relative_error / errors - 1.0)))


# Rows 9 to 11: endings of DIDIM.


def slow_contraction(folder: Path) -> Value:
    log = load(folder, "slack")
    fit = didim.identify(log, plain(sigma_fraction=0.0, tolerance=0.025, max_iterations=40))
    end = didim.identify(log, plain(start=fit.beta, sigma_fraction=1e-4, tolerance=0.0, max_iterations=80))
    distance = float(np.max(np.abs(fit.beta - end.beta) / end.std))
    return distance - float(fit.history[-1].more.get("remaining_sigma", 0.0))


def failed(folder: Path) -> tuple[Identification, list[float]]:
    """Return DIDIM on torques of the wrong sign, and the torque errors of its iterates."""
    log = load(folder, "arm")
    (recording,) = log.recordings
    assert recording.tau is not None
    fit = didim.identify(
        replace(log, recordings=(replace(recording, tau=-recording.tau),)), plain(start="unit")
    )
    errors = [
        float(item.more[key]) for item in fit.history for key in item.more if key.startswith("output_error")
    ]
    return fit, [error for error in errors if np.isfinite(error)]


def best_iterate(folder: Path) -> Value:
    fit, errors = failed(folder)
    assert not fit.converged
    assert fit.output_error is not None
    return float(fit.output_error[1]) / min(errors)


def sigmas_of_a_failure(folder: Path) -> Value:
    fit, _ = failed(folder)
    return float(np.count_nonzero(fit.std))


def sticking_start(folder: Path) -> Value:
    log = load(folder, "creeping")
    start = log.robot.parameters_by_name({"Ia1": 2.0, "Fc1": 1.0, "Fv1": 400.0})
    method = plain(start=start, gain_updating="never")
    refused = refusal(lambda: didim.identify(log, method))
    return refused or worst_sigmas(didim.identify(log, method), truth_of(log))


# Rows 12 to 14: delays, hold, filter.


def sound(folder: Path, joints: slice = slice(0), samples: int = 0) -> Identification:
    log = load(folder, "sound")
    log = replace(log, robot=log.robot.with_smoothing([0.01] * 6))
    (recording,) = log.recordings
    assert recording.tau is not None
    tau = recording.tau.copy()
    tau[samples:, joints] = recording.tau[: len(tau) - samples, joints]
    late = replace(log, recordings=(replace(recording, tau=tau),))
    return didim.identify(late, IDIMLS(compensate_samples="estimate"))


def no_delay(folder: Path) -> Value:
    return abs(float(sound(folder).delay["estimated_samples"]))


def one_sample(folder: Path) -> Value:
    return abs(float(sound(folder, slice(None), 1).delay["estimated_samples"]) - 1.0)


def late_wrist(folder: Path) -> Value:
    found = np.asarray(sound(folder, slice(4, 6), 2).delay["compensated_samples"])
    return float(np.max(np.abs(np.broadcast_to(found, 6) - [0.0, 0.0, 0.0, 0.0, 2.0, 2.0])))


def hold(folder: Path) -> Value:
    log = load(folder, "hold")
    log = replace(log, robot=log.robot.with_smoothing([0.01] * 2))
    (recording,) = log.recordings
    assert recording.tau is not None
    found = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        tau = recording.tau + rng.standard_normal(recording.tau.shape) * [0.1, 0.05]
        q = np.round(recording.q / 1e-5) * 1e-5
        found.append(
            didim.identify(replace(log, recordings=(replace(recording, q=q, tau=tau),)), IDIMLS()).beta
        )
    place = log.robot.base_parameters.names.index("Fv1")
    values = np.array(found)[:, place]
    return abs(float((values.mean() - truth_of(log)[place]) / values.std(ddof=1)))


def packaged_filter(folder: Path) -> Value:
    del folder
    off: list[Array] = []
    for seed in range(3):
        fit = didim.compare("tx40", methods=[IDIMLS()], seed=seed).fits["idim-ls"]
        truth = didim.load_robot("tx40").set_base("didim")
        off.append((fit.beta - truth) / fit.std)
    return float(np.sqrt(np.mean(np.square(off))))
