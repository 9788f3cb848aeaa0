"""Further judgements of the evidence and of the checks turn where their documentation says.

The numbers stand here as they are documented, so that one which is doubled or halved is noticed.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
import didim.diagnosis.excitation as excitation
import didim.evidence.causes as causes
import didim.evidence.uses as uses
from didim.diagnosis.channels import Channel, _stuck
from didim.diagnosis.check import loop_table
from didim.evidence.causes import Search
from didim.evidence.gain_check import gain_information
from didim.evidence.hypotheses.geometry import gravities, with_geometry
from didim.evidence.hypotheses.hypothesis import Hypothesis
from didim.evidence.loop.law import Recovered, _gains
from didim.evidence.loop.law_rows import LawRows
from didim.evidence.products import Products
from didim.evidence.screen import Screen
from didim.evidence.torques import constant_torque_findings, is_constant
from didim.model.dynamics import friction_places
from didim.robot.rigid_body import INERTIAL
from didim.signal.processing import SignalProcessing
from plain import stub
from test_friction_terms import motion

Array = NDArray[np.float64]


def wave(correlation: float) -> Array:
    """Pairs of 1 and x in turn with their negatives: of white noise but for this correlation at a lag of one, (1600,)."""
    x = (1.0 - np.sqrt(1.0 - 4.0 * correlation**2)) / (2.0 * correlation)
    one = np.array([1.0, x, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    return np.tile(np.concatenate([one, -one]), 100)


@pytest.mark.parametrize(
    ("moves", "correlation", "told"), [(0.048, 0.05, 0), (0.052, 0.05, 1), (1.0, 0.095, 1), (1.0, 0.105, 0)]
)
def test_a_torque_that_is_noise_alone(moves: float, correlation: float, told: int) -> None:
    """White to four standard deviations, of ``1 / sqrt(1600)``, along a motion of five hundredths."""
    tau = 1.0 + wave(correlation)[:, None]
    positions = np.linspace(0.0, moves, 1600)[:, None]
    recording = stub(
        name="log", tau=tau, origin={}, has_positions=True, windows=[(0, 1600)],
        measured_positions=lambda: positions,
    )  # fmt: skip
    assert len(constant_torque_findings(stub(recordings=[recording]))) == told


@pytest.mark.parametrize(("change", "constant"), [(0.8e-12, True), (1.2e-12, False)])
def test_rounding_of_a_constant_torque(change: float, constant: bool) -> None:
    assert is_constant(np.array([1.0, 1.0 - change])) is constant


@pytest.mark.parametrize(("change", "told"), [(0.8e-12, 1), (1.2e-12, 0)])
def test_rounding_of_a_stuck_channel(change: float, told: int) -> None:
    values = np.sin(np.arange(2000) * 2.0 * np.pi / 500.0)
    values[1000:1020] = 0.5 + change * np.arange(20)
    values[0] = 1.0
    channel = Channel("position", 1, "joint", stub(name="log", rate_hz=100.0), None, None, values)
    assert len(_stuck(channel)) == told


@pytest.mark.parametrize(("trim", "cut"), [(0, 12), (20, 20)])
def test_rows_of_a_law_leave_out_twelve_samples(trim: int, cut: int) -> None:
    signal = SignalProcessing(cutoff_hz=None, trim_start=trim, trim_end=trim, edge_rows=0)
    rows = LawRows.reduced(stub(signal=signal), [np.arange(100.0)[:, None]])
    assert rows[[0, -1], 0].tolist() == [cut, 99 - cut]


@pytest.mark.parametrize(("rate_hz", "lag_s"), [(250.0, 0.008), (1000.0, 0.0095), (100.0, 0.008)])
def test_records_between_two_outputs_are_late_by_half_of_their_hold(rate_hz: float, lag_s: float) -> None:
    rows = object.__new__(LawRows)
    rows.controller = stub(digital=didim.loop.Digital(sample_time_s=0.004, delay_samples=2))
    rows.rate_hz = rate_hz
    assert rows.declared_lag_s == pytest.approx(lag_s)


def rows_of_a_log(joints: int = 1) -> Any:
    part = stub(q=np.ones((9, joints)), dq=np.ones((9, joints)), ddq=np.ones((9, joints)))
    products = stub(seen=lambda: np.ones(joints), g=np.ones((joints, 1, 1, 1)), scale=np.ones(1))
    robot = stub(joint_kinds=("revolute",) * joints, base_parameters=stub(indices=(0,)))
    return stub(
        robot=robot, parts=[part], n=joints, y=np.ones((joints, 9)), products=products, names=("ZZ1",), beta=np.zeros(1)
    )  # fmt: skip


@pytest.mark.parametrize(("share", "told"), [(0.095, 0), (0.105, 1)])
def test_a_parameter_that_a_log_does_not_identify(
    share: float, told: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(excitation, "_shares", lambda *given: np.array([share]))
    assert len(excitation.check_excitation(rows_of_a_log(), 9.0)) == told


def test_a_rich_motion_has_500_states(monkeypatch: pytest.MonkeyPatch) -> None:
    counts: list[int] = []

    def regressor(robot: object, q: Array, dq: Array, ddq: Array) -> Array:
        counts.extend(map(len, (q, dq, ddq)))
        return np.ones((len(q), 1, 1))

    monkeypatch.setattr(excitation, "regressor", regressor)
    excitation.check_excitation(rows_of_a_log(), 9.0)
    assert counts == [500] * 3


def payload(monkeypatch: pytest.MonkeyPatch, error: Array, *column: float) -> float:
    """Return the standard deviation of a mass with this torque at each joint, whose largest torques are one."""
    monkeypatch.setattr(uses, "inverse_dynamics", lambda robot, q, dq, ddq, x: q)
    n, n_rows = error.shape
    names = tuple(f"{kind}{n}" for kind in INERTIAL)
    robot = stub(parameter_names=names, n_dof=n, geometry=stub(parents=(None, *range(n - 1))))
    part = stub(q=np.tile(column, (n_rows, 1)), dq=None, ddq=None)
    signal = SignalProcessing(cutoff_hz=None, edge_rows=0)
    return uses.payload_std(robot, [part], cast(Any, stub(error=error, size=np.ones(n))), signal)


def test_masses_of_ten_stretches_give_the_deviation_of_a_payload(monkeypatch: pytest.MonkeyPatch) -> None:
    error = np.random.default_rng(0).standard_normal((2, 200))
    masses = error[1].reshape(10, 20).mean(axis=1)
    assert payload(monkeypatch, error, 0.0, 1.0) == pytest.approx(masses.std(ddof=1) / np.sqrt(10.0))


def test_errors_of_a_billionth_are_rounding(monkeypatch: pytest.MonkeyPatch) -> None:
    """A joint without errors counts as one with errors of a billionth of the largest torque."""
    error = np.zeros((2, 200))
    error[1] = 3e-9 * np.repeat(np.arange(10.0) - 4.5, 20) / np.std(np.arange(10.0))
    # So the other one, with three times as large errors, has a tenth of the information.
    wanted = 0.1 * 3e-9 / np.sqrt(9.0)
    assert payload(monkeypatch, error, 1.0, 1.0) == pytest.approx(wanted, rel=1e-6, abs=0.0)


def test_gains_are_checked_over_twenty_intervals() -> None:
    """One parameter of two joints: the residual beside the gain's own column, summed over intervals of time."""
    rng = np.random.default_rng(0)
    w = rng.standard_normal((2, 400, 1))
    y = w[:, :, 0] + 0.1 * rng.standard_normal((2, 400))
    sigma, _ = gain_information(stub(w=w, y=y, products=Products.of(w, y)))
    root = np.sqrt(400.0 / Products.of(w, y).seen())[:, None]
    a, b = w[:, :, 0] * root, y * root
    model = a * (np.sum(a * b) / np.sum(a * a))
    own = np.stack([model[0], np.zeros(400)])
    beside = own - a * (np.sum(a * own) / np.sum(a * a))
    scores = np.sum(beside * (b - model), axis=0).reshape(20, 20).sum(axis=1)
    assert sigma[0] == pytest.approx(np.sqrt(20 / 19 * scores @ scores) / np.sum(beside**2))


@pytest.mark.parametrize(("factor", "shown"), [(99.0, True), (101.0, False)])
def test_gains_and_errors_of_a_hundred_are_shown(factor: float, shown: bool) -> None:
    found = stub(relative=np.array([factor]), keys=lambda: (("kp",), np.array([[factor]]), None))
    _, (_, gain, left) = loop_table(found)
    assert (gain != "-") is shown
    assert (left != "-") is shown


@pytest.mark.parametrize(
    ("factor", "sigma", "told"), [(1.028, 0.0, 0), (1.032, 0.0, 1), (1.48, 0.1, 0), (1.52, 0.1, 1)]
)
def test_a_gain_that_differs(factor: float, sigma: float, told: int) -> None:
    """The limits are three per cent and five standard deviations."""
    rows = stub(
        columns=lambda: np.ones((1, 5, 1)),
        reduced=lambda signals: np.zeros((5, 1)),
        forward=[],
        error=lambda torque: torque,
        controller=stub(kind="pd"),
    )
    found = Recovered(("kp",), np.array([[factor]]), np.array([[sigma]]), np.ones(1), cast(Any, rows))
    assert len(_gains(found, [0]).facts["gains"]) == told


def test_gravity_that_a_robot_file_lacks_is_that_of_the_earth() -> None:
    robot = with_geometry(didim.load_robot("planar2"), gravity=(0.0, 0.0, 0.0))
    found = [item.facts["vector"] for item in gravities(stub(robot=robot))]
    assert [-9.81, 0.0, 0.0] in found
    assert np.linalg.norm(np.array(found), axis=1).tolist() == [9.81] * 6


def test_six_causes_are_decided(monkeypatch: pytest.MonkeyPatch) -> None:
    """The best by the plain fit, of which the consistent fit takes long."""
    monkeypatch.setattr(causes, "OF_TORQUES", ())
    search = Search(stub(hopeless=False, known=None))
    decided: list[float] = []
    every = [stub(hypothesis=Hypothesis(code="gain"), d=-1.0 - k, friction=False) for k in range(9)]
    monkeypatch.setattr(causes, "signs", lambda rows: every)
    monkeypatch.setattr(search, "_tried", lambda item: item)
    monkeypatch.setattr(search, "_torn", [], raising=False)
    monkeypatch.setattr(search, "_promising", lambda: [])
    monkeypatch.setattr(search, "_decided", lambda item: decided.append(item.d))
    monkeypatch.setattr(search, "_named", lambda found: None)
    search.cause()
    assert decided == [-9.0, -8.0, -7.0, -6.0, -5.0, -4.0]


def test_products_have_ten_blocks() -> None:
    products = Products.of(np.ones((1, 60, 1)), np.ones((1, 60)))
    assert products.y.tolist() == [[6.0] * 10]


@pytest.mark.parametrize(
    ("factor", "corrected"), [(3.4, True), (3.6, False), (1.0 / 3.4, True), (1.0 / 3.6, False)]
)
def test_columns_of_a_similar_motion_have_the_same_error(factor: float, corrected: bool) -> None:
    """The error is that of the decimated motion, here 1; Coulomb friction keeps its size, viscous friction does not."""
    robot = didim.load_robot("planar2")
    q, dq, ddq = (values[:50].T for values in motion())
    smooth = Screen(robot, (q, dq, ddq), np.zeros((2, 50, len(robot.parameter_names)))).smooth
    screen = Screen(robot, (q, dq, ddq), smooth + 1.0)
    position = np.diag([factor, 1.0])
    plain = Screen(robot, (position @ q, position @ dq, position @ ddq), smooth).smooth
    keeps = np.setdiff1d(friction_places(robot), robot.parameter_names.index("Fv1"))
    links = ~np.isin(screen.base, keeps)
    error = screen.of_motion(position)[:, :, links] - plain[:, :, screen.base][:, :, links]
    np.testing.assert_allclose(error, 1.0 if corrected else 0.0, atol=1e-9)
