"""What every method of identification keeps, written once: `check_method` is to methods what scikit-learn's ``check_estimator`` is.

The arm is a pendulum of one joint in closed loop, so that all of it takes seconds. A method of one's own passes it with

    check_method(Contract(make=MyMethod))

``tests/test_contract.py`` runs every packaged method through it, check by check.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

import didim
from didim import Experiment, Identification, Status, identify
from didim.errors import DidimError
from didim.experiment.specs import ReferenceSpec, SimulationSettings
from didim.methods.method import Method
from didim.result.iteration import Reporter
from didim.signal.processing import SignalProcessing
from didim.studies.simulated_log import simulated_log

Array = NDArray[np.float64]

PENDULUM = """\
schema = 1
name = "pendulum"
gravity_m_s2 = [9.81, 0.0, 0.0]
[[joint]]
kind = "revolute"
[friction]
coulomb = "tanh"
smoothing_rad_s = 0.05
[parameters.reference]
ZZ1R = 0.4
MX1 = 0.6
MY1 = 0.1
Fv1 = 0.5
Fc1 = 0.8
Off1 = 0.2
"""
RATE_HZ = 200.0
DURATION_S = 4.0
TORQUE_NOISE_N_M = 0.1
POSITION_NOISE_RAD = 1e-5
SEEDS = 40
LONGEST_SENTENCE = 200
"""Largest number of characters of a refusal."""


@dataclass(frozen=True, kw_only=True)
class Contract:
    """A method, and what of the contract its own documentation restricts.

    Attributes
    ----------
    make : callable
        Makes its settings; takes keywords such as ``fixed`` and ``dropped``.
    recovery : float
        Largest error of a parameter without noise, as the torque it makes over the torque of the log.
    needs_controller, needs_torque : bool
        Whether it refuses logs without them.
    coverage : (float, float) or None
        Bounds of the share of true parameters inside their 95 % intervals over 40 seeds; None for a method that is documented to
        have no standard deviations, or wrong ones.
    """

    make: Callable[..., Method]
    recovery: float = 2e-3
    needs_controller: bool = False
    needs_torque: bool = True
    coverage: tuple[float, float] | None = (0.90, 0.99)


@cache
def pendulum() -> didim.Robot:
    """Robot of one joint whose six base parameters are all known."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "pendulum.toml"
        path.write_text(PENDULUM, encoding="utf-8")
        return didim.load_robot(path)


def truth() -> Array:
    """True base parameters, (6,)."""
    return pendulum().set_base("reference")


@cache
def clean(seed: int = 0) -> Experiment:
    """Log without noise in closed loop, and the loop that made it."""
    robot = pendulum()
    reference = didim.Reference.random_fourier(
        harmonics=6,
        period_s=DURATION_S,
        max_position=[1.5],
        max_velocity=[4.0],
        max_acceleration=[30.0],
        seed=seed + 1,
    )
    settings = SimulationSettings(
        rate_hz=RATE_HZ, smoothing=(0.05,), step_s=2.5e-3, fine_step_s=1.25e-3, start="reference"
    )
    made = simulated_log(
        Experiment(
            name="pendulum",
            robot=robot,
            recordings=(),
            reference=reference,
            controller=didim.Controller.tuned([6.0], [0.7], [0.4]),
            signal=SignalProcessing(cutoff_hz=40.0, trim_start=20, trim_end=20, decimation=(4,)),
            simulation=settings,
        ),
        robot.parameter_set("reference"),
        noise=False,
        refinement=1,
    )
    (item,) = made.recordings
    item = replace(item, name=f"log {seed}", q_ref=reference.at(item.t)[0])
    return replace(made, recordings=(item,), reference=ReferenceSpec("recorded", None, {}))


def noisy(seed: int) -> Experiment:
    """The log with white noise on torques and positions."""
    log, rng = clean(), np.random.default_rng(seed)
    (item,) = log.recordings
    assert item.tau is not None
    tau = item.tau + TORQUE_NOISE_N_M * rng.standard_normal(item.tau.shape)
    q = item.q + POSITION_NOISE_RAD * rng.standard_normal(item.q.shape)
    return replace(log, recordings=(replace(item, tau=tau, q=q),))


@cache
def fitted(contract: Contract) -> Identification:
    """Result of the method on the first noisy log, which several checks look at."""
    return identify(noisy(0), contract.make())


def off(fit: Identification) -> float:
    """Largest error of a parameter: the torque that it makes along the log, over the torque of the log."""
    (item,) = clean().recordings
    assert item.tau is not None
    dq = np.gradient(item.q, axis=0) * RATE_HZ
    ddq = np.gradient(dq, axis=0) * RATE_HZ
    robot = pendulum()
    columns = didim.regressor(robot, item.q, dq, ddq)[:, 0, list(robot.base_parameters.indices)]
    sizes = np.sqrt(np.mean(columns**2, axis=0) / np.mean(item.tau**2))
    return float(np.max(np.abs(fit.beta - truth()) * sizes))


def recovers_without_noise(contract: Contract) -> None:
    """The parameters of a log without noise are the true ones, and the result says that it ended well."""
    fit = identify(clean(), contract.make())
    assert off(fit) < contract.recovery, fit.beta - truth()
    assert fit.names == pendulum().base_parameters.names
    assert fit.n_rows > 0
    assert np.isfinite(fit.beta).all()


def repeats_bit_by_bit(contract: Contract) -> None:
    """Two runs agree in every bit and leave the experiment as it was."""
    log = noisy(0)
    before = log.recordings[0].q.copy()
    one, other = fitted(contract), identify(log, contract.make())
    assert one.beta.tobytes() == other.beta.tobytes()
    assert one.covariance.tobytes() == other.covariance.tobytes()
    np.testing.assert_array_equal(log.recordings[0].q, before)


def calls_back(contract: Contract) -> None:
    """The callback hears every iteration once and in order; True stops with the best point so far."""
    heard: list[Any] = []
    fit = identify(noisy(0), contract.make(), callback=heard.append)
    assert tuple(heard) == fit.history
    assert heard
    numbers = [item.iteration for item in heard]
    assert numbers == sorted(set(numbers))
    stopped = identify(noisy(0), contract.make(), callback=lambda iteration: True)
    assert len(stopped.history) == 1
    assert np.isfinite(stopped.beta).all()
    assert stopped.status in ((Status.STOPPED,) if len(heard) > 1 else (Status.STOPPED, fit.status))
    assert not (stopped.status is Status.STOPPED and stopped.verdict.sound)


def ends_at_an_interrupt(contract: Contract) -> None:
    """Ctrl-C ends the run: with the best point so far, or as the KeyboardInterrupt that it is."""

    def interrupt(iteration: object) -> None:
        raise KeyboardInterrupt

    try:
        fit = identify(noisy(0), contract.make(), callback=interrupt)
    except KeyboardInterrupt:
        return
    assert fit.status is Status.INTERRUPTED
    assert np.isfinite(fit.beta).all()


def keeps_fixed_and_dropped(contract: Contract) -> None:
    """Fixed parameters keep their values and dropped ones are zero, both without a standard deviation."""
    fit = identify(noisy(0), contract.make(fixed={"Fv1": 0.55}, dropped=("MY1",)))
    roles, values, std = (
        dict(zip(fit.names, column, strict=True)) for column in (fit.roles, fit.beta, fit.std)
    )
    assert (values["Fv1"], std["Fv1"], roles["Fv1"]) == (0.55, 0.0, "fixed")
    assert (values["MY1"], std["MY1"], roles["MY1"]) == (0.0, 0.0, "dropped")
    assert {role for name, role in roles.items() if name not in ("Fv1", "MY1")} == {"estimated"}
    for wrong in ({"Fw9": 1.0}, {"Fv1": float("nan")}):
        refused(clean(), lambda wrong=wrong: contract.make(fixed=wrong))  # type: ignore[misc]


def predicts_held_out_recordings(contract: Contract) -> None:
    """A recording that is held out is predicted, and changes nothing else."""
    log, other = noisy(0), clean(1).recordings[0]
    alone = fitted(contract)
    both = replace(log, recordings=(*log.recordings, replace(other, role="held-out")))
    fit = identify(both, contract.make())
    np.testing.assert_array_equal(fit.beta, alone.beta)
    (held,) = fit.held_out
    assert held.name == other.name
    assert 0.0 < held.overall_relative_error < 0.1


def fits_several_logs(contract: Contract) -> None:
    """Two logs are one estimate, which is that of the truth without noise."""
    both = replace(clean(), recordings=(*clean().recordings, *clean(1).recordings))
    fit = identify(both, contract.make())
    assert off(fit) < contract.recovery, fit.beta - truth()
    assert fit.n_rows > 1.5 * identify(clean(), contract.make()).n_rows


def is_pickled(contract: Contract) -> None:
    """Settings and results go through `pickle`, and the settings give the same result behind it."""
    method = contract.make()
    again = pickle.loads(pickle.dumps(method))
    assert again == method
    fit = fitted(contract)
    assert identify(noisy(0), again).beta.tobytes() == fit.beta.tobytes()
    assert pickle.loads(pickle.dumps(fit)).to_dict() == fit.to_dict()


def is_saved_and_loaded(contract: Contract) -> None:
    """A result is read back from its file as it was written."""
    fit = fitted(contract)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "fit.json"
        fit.save(path)
        loaded = Identification.load(path)
    assert loaded.to_dict() == fit.to_dict()
    assert loaded.beta.tobytes() == fit.beta.tobytes()
    assert str(loaded) == str(fit)


def refused(experiment: Experiment, make: Callable[[], Method]) -> str:
    """Return the one sentence in which a run is refused."""
    try:
        fit = identify(experiment, make())
    except DidimError as reason:
        text = str(reason)
        assert text
        assert "\n" not in text
        assert len(text) <= LONGEST_SENTENCE, text
        return text
    raise AssertionError(f"{fit!r} where a refusal was due")


def refuses_in_one_sentence(contract: Contract) -> None:
    """What is missing is named: torques, the controller, recordings to fit."""
    log = clean()
    (item,) = log.recordings
    if contract.needs_torque:
        assert "torque" in refused(replace(log, recordings=(replace(item, tau=None),)), contract.make)
    if contract.needs_controller:
        assert "controller" in refused(replace(log, controller=None), contract.make)
    held = replace(log, recordings=(replace(item, role="held-out"),))
    assert "no recording with role 'fit'" in refused(held, contract.make)


def covers_the_truth(contract: Contract) -> None:
    """Over 40 seeds of the noise the 95 % intervals hold the truth as often as they say."""
    if contract.coverage is None:
        return
    hits = []
    for seed in range(SEEDS):
        fit = contract.make().run(noisy(100 + seed), Reporter())  # intervals need no verdict
        low, high = fit.confidence_interval()
        hits += ((low <= truth()) & (truth() <= high)).tolist()
    low_share, high_share = contract.coverage
    assert low_share <= np.mean(hits) <= high_share, f"{100.0 * np.mean(hits):.1f} % of {len(hits)} intervals"


CHECKS: tuple[Callable[[Contract], None], ...] = (
    recovers_without_noise,
    repeats_bit_by_bit,
    calls_back,
    ends_at_an_interrupt,
    keeps_fixed_and_dropped,
    predicts_held_out_recordings,
    fits_several_logs,
    is_pickled,
    is_saved_and_loaded,
    refuses_in_one_sentence,
    covers_the_truth,
)
"""The contract, check by check."""


def check_method(contract: Contract) -> None:
    """Run a method through the whole contract.

    Raises
    ------
    AssertionError
        By the first check that it does not pass.
    """
    for check in CHECKS:
        check(contract)
