"""Causes are named by the code of a finding, by every method, and good logs raise none: simulated ones and real ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
import simulated
from arm import arm_log
from didim import DIDIM, IDIMLS, Experiment, identify
from didim.errors import FitError
from didim.evidence import causes
from didim.evidence.causes import Search
from didim.evidence.hypotheses.geometry import with_geometry
from didim.evidence.hypotheses.hypothesis import Hypothesis
from didim.evidence.hypotheses.positions import units
from didim.evidence.hypotheses.table import OF_TORQUES
from didim.evidence.lasting import delay_findings
from didim.evidence.naming import cause_findings, torque_findings
from didim.evidence.products import BLOCKS
from didim.evidence.rows import LogRows
from didim.result.finding import Finding
from didim.robot.payload import Payload
from didim.signal.filters import differentiate
from didim.studies.simulated_log import measured
from didim.terms.rows import LinearSystem
from plain import plain_didim, stub
from planted import tx40_exact, with_torques
from several import DISC, arm_logs
from simulated import experiment as of_recordings
from simulated import log as recorded

Array = NDArray[np.float64]

JOINTS = range(6)
PAIRS = tuple(combinations(JOINTS, 2))
Named = tuple[str, tuple[int, ...]]
"""Code and joints of a finding."""


@pytest.fixture(scope="module")
def exact() -> Experiment:
    return tx40_exact()


@pytest.fixture(scope="module")
def log(exact: Experiment) -> Experiment:
    return measured(exact)


def turned(tau: Array, *joints: int) -> Array:
    tau = tau.copy()
    tau[:, joints] *= -1.0
    return tau


def exchanged(tau: Array, i: int, j: int) -> Array:
    tau = tau.copy()
    tau[:, [i, j]] = tau[:, [j, i]]
    return tau


def torques(log: Experiment) -> Array:
    (recording,) = log.recordings
    assert recording.tau is not None
    return recording.tau


def system_of(log: Experiment) -> LinearSystem:
    job = IDIMLS().job(log)
    return job.model.rows(job.parts("fit"), job.signal)


def told(findings: list[Finding] | tuple[Finding, ...]) -> list[Named]:
    """Codes and joints of what is wrong with torques."""
    return [(item.code, item.joints) for item in findings if item.code in ("torque-sign", "swapped-torques")]


def with_ties(finding: Finding) -> set[Named]:
    """A cause, and those that explain the log as well."""
    ties = {(tie["code"], tuple(tie["joints"])) for tie in finding.facts["ties"]}
    return {(finding.code, finding.joints)} | ties


def seen(system: LinearSystem, tau: Array) -> list[Finding]:
    """Findings with decimated torques, (n_rows, n_dof), in the place of those of the log."""
    return torque_findings(replace(system, y=np.ascontiguousarray(tau.T).reshape(-1)))


def check_all(log: Experiment) -> None:
    """Turn each joint and exchange each pair: that must be named, and by itself or with what explains the log as well."""
    system = system_of(log)
    tau = system.y.reshape(len(JOINTS), -1).T
    assert seen(system, tau) == []
    for joint in JOINTS:
        (finding,) = seen(system, turned(tau, joint))
        assert ("torque-sign", (joint + 1,)) in with_ties(finding)
        assert finding.grade == "wrong"
    for i, j in PAIRS:
        (finding,) = seen(system, exchanged(tau, i, j))
        assert ("swapped-torques", (i + 1, j + 1)) in with_ties(finding)


def test_every_joint_and_pair_of_the_simulated_tx40(log: Experiment) -> None:
    check_all(log)


def test_a_system_with_fewer_rows_than_blocks_shows_nothing(log: Experiment) -> None:
    system = system_of(log)
    rows = np.arange(len(JOINTS) * len(system.y) // len(JOINTS)).reshape(len(JOINTS), -1)[:, :9].ravel()
    assert torque_findings(replace(system, w=system.w[rows], y=-system.y[rows])) == []


def test_every_joint_and_pair_without_noise(exact: Experiment) -> None:
    check_all(exact)


@pytest.mark.slow
def test_idim_ls_says_so(log: Experiment) -> None:
    tau = torques(log)
    assert told(identify(log).evidence) == []
    fit = identify(with_torques(log, turned(tau, 2)))
    assert told(fit.evidence) == [("torque-sign", (3,))]
    fit = identify(with_torques(log, exchanged(tau, 4, 5)))
    assert told(fit.evidence) == [("swapped-torques", (5, 6))]
    assert fit.verdict.reasons[0].sentence in str(fit)
    assert fit.verdict.state == "wrong"


def named(log: Experiment, method: DIDIM, wanted: Named) -> None:
    """Whatever DIDIM estimates from the log, the cause is reported."""
    found: list[Finding] | tuple[Finding, ...]
    try:
        found = identify(log, method).evidence
    except FitError as error:
        # Where DIDIM cannot start, the sentence says why.
        found = [
            item for item in torque_findings(system_of(log)) if item.sentence.partition(":")[0] in str(error)
        ]
    (finding,) = [item for item in found if item.code in ("torque-sign", "swapped-torques")]
    assert wanted in with_ties(finding)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "gain_updating", "wanted"),
    [
        (lambda tau: exchanged(tau, 4, 5), "first", ("swapped-torques", (5, 6))),
        (lambda tau: turned(tau, 1), "never", ("torque-sign", (2,))),
    ],
    ids=["exchanged", "turned"],
)
def test_didim_names_turned_and_exchanged_joints(
    log: Experiment, change: Callable[[Array], Array], gain_updating: Any, wanted: Named
) -> None:
    """One of each, with and without gain updating: the search is that of all joints and pairs above."""
    named(
        with_torques(log, change(torques(log))),
        plain_didim(max_iterations=1, gain_updating=gain_updating),
        wanted,
    )


@pytest.mark.slow
def test_two_joints() -> None:
    """Turning one joint of two leaves as much as turning the other: friction tells which it was."""
    log = arm_log(1)
    tau = torques(log)
    for joint in range(2):
        assert told(identify(with_torques(log, turned(tau, joint))).evidence) == [
            ("torque-sign", (joint + 1,))
        ]
    for start in ("unit", "idim-ls"):
        assert told(identify(log, plain_didim(start=start)).evidence) == []
        for joint in range(2):
            named(
                with_torques(log, turned(tau, joint)), plain_didim(start=start), ("torque-sign", (joint + 1,))
            )
        named(with_torques(log, -tau), plain_didim(start=start), ("torque-sign", (1, 2)))
        named(with_torques(log, exchanged(tau, 0, 1)), plain_didim(start=start), ("swapped-torques", (1, 2)))


@pytest.mark.parametrize("file", ["", "emps.toml", "emps_asymmetric.toml"])
def test_one_joint(project: Path, file: str, request: pytest.FixtureRequest) -> None:
    """Only the sign of its friction says that its force is turned: of a simulated slide, and of the measured one."""
    if file:
        data = request.getfixturevalue("shared") / "data" / "emps"
        log = didim.load_experiment(project / "examples" / file, data=data)
    else:
        robot = didim.load_robot("emps")
        log = of_recordings(robot, recorded(robot, robot.parameter_set("published"), noise=4.0))
    assert told(identify(log).evidence) == []
    fit = identify(with_torques(log, -torques(log)))
    assert told(fit.evidence) == [("torque-sign", (1,))]
    (finding,) = [item for item in fit.evidence if item.code == "torque-sign"]
    assert all(value < 0.0 for value in finding.facts["friction"].values())


def rows_of(log: Experiment) -> LogRows:
    job = IDIMLS(fixed={}, dropped=()).job(log)
    return LogRows(job.robot, job.signal, job.parts("fit", job.declared_delay))


def search_of(log: Experiment) -> list[Finding]:
    """What the whole search finds, plain and consistent fits."""
    rows = rows_of(log)
    return cause_findings(rows, Search(rows).cause())


REAL = {
    "tx40_log.toml": "tx40",
    "tx40_log_best.toml": "tx40",
    "emps.toml": "emps",
    "emps_asymmetric.toml": "emps",
}


@pytest.mark.parametrize("file", REAL)
def test_real_logs_have_no_false_cause(project: Path, shared: Path, file: str) -> None:
    log = didim.load_experiment(project / "examples" / file, data=shared / "data" / REAL[file])
    verdict = identify(log).verdict
    assert verdict.state == "doubtful"
    assert not any("ties" in reason.facts for reason in verdict.reasons)


@pytest.fixture(scope="module")
def measured_tx40(project: Path, shared: Path) -> Experiment:
    return didim.load_experiment(project / "examples" / "tx40_log_best.toml", data=shared / "data" / "tx40")


@pytest.mark.parametrize("joint", [3, 5])
def test_a_turned_torque_of_the_measured_tx40(measured_tx40: Experiment, joint: int) -> None:
    """Its model errors hide the signs of the wrist from the plain fit; the consistent fit and friction do not."""
    log = with_torques(measured_tx40, turned(torques(measured_tx40), joint))
    found = search_of(log)
    assert all(("torque-sign", (joint + 1,)) in with_ties(item) for item in found)
    if joint < 4:  # joints 5 and 6 share a motor's torque
        assert found


@pytest.mark.slow
@pytest.mark.parametrize("gravity", [(9.81, 0.0, 0.0), (0.0, 0.0, 9.81)], ids=("x", "up"))
def test_gravity_of_the_measured_tx40(measured_tx40: Experiment, gravity: tuple[float, ...]) -> None:
    log = replace(measured_tx40, robot=with_geometry(measured_tx40.robot, gravity=gravity))
    (finding,) = search_of(log)
    assert ("gravity", ()) in with_ties(finding)
    if finding.code == "gravity":
        np.testing.assert_allclose(finding.facts["vector"], measured_tx40.robot.geometry.gravity)
        assert finding.remedy is not None
        assert finding.remedy.key == "gravity_m_s2"


@pytest.mark.slow
@pytest.mark.parametrize("joint", [0, 2])
def test_a_gain_and_its_remedy(measured_tx40: Experiment, joint: int) -> None:
    """What the finding says is what was planted, and with the remedy it is gone."""
    factors = np.ones(6)
    factors[joint] = 2.0
    log = with_torques(measured_tx40, torques(measured_tx40) * factors)
    (finding,) = search_of(log)
    assert ("drive-gain", (joint + 1,)) in with_ties(finding)
    if finding.code == "drive-gain" and finding.joints == (joint + 1,):
        assert finding.value == pytest.approx(2.0, rel=0.35)
        factors[joint] /= finding.value
        assert search_of(with_torques(measured_tx40, torques(measured_tx40) * factors)) == []


def test_an_optimum_at_the_end_of_its_range_is_no_estimate(measured_tx40: Experiment) -> None:
    factors = np.ones(6)
    factors[1] = 30.0
    found = search_of(with_torques(measured_tx40, torques(measured_tx40) * factors))
    assert all(item.code != "drive-gain" or 0.2 < (item.value or 0.0) < 5.0 for item in found)


def test_a_few_seconds_of_a_good_log_are_not_wrong(measured_tx40: Experiment) -> None:
    """Three seconds do not identify 60 parameters: what their blocks left out like best is no cause."""
    (recording,) = measured_tx40.recordings
    n = len(recording.q)
    third = replace(recording, windows=((2 * n // 3, n),))
    verdict = identify(replace(measured_tx40, recordings=(third,))).verdict
    assert verdict.state == "doubtful"
    assert not any("ties" in item.facts for item in verdict.reasons)


@pytest.mark.parametrize("known", [False, True], ids=["unknown", "known"])
def test_causes_of_logs_with_a_payload(known: bool) -> None:
    """A turned torque and a gain are named where one of the recordings has a payload; without them nothing is."""
    payload = Payload(name="disc", mass_kg=float(DISC[9])) if known else Payload(name="disc")
    logs = arm_logs([False, True], payloads={"disc": payload}, noise=(0.2, 0.1))
    assert not any("ties" in item.facts for item in identify(logs).verdict.reasons)
    for factor, code in ((-1.0, "torque-sign"), (2.0, "drive-gain")):
        scale = np.array([1.0, factor])
        wrong = replace(
            logs,
            recordings=tuple(
                replace(item, tau=item.tau * scale) for item in logs.recordings if item.tau is not None
            ),
        )
        (cause,) = [item for item in identify(wrong).verdict.reasons if "ties" in item.facts]
        assert (code, (2,)) in with_ties(cause)
        assert code in [item.code for item in didim.check(wrong)]


def test_a_family_with_a_row_in_the_table_is_searched(
    log: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The hypothesis of CONTRIBUTING: two neighbours that share a drive."""

    def halved(rows: LogRows) -> Iterator[Hypothesis]:
        for joint in range(rows.n - 1):
            factors = np.ones(rows.n)
            factors[joint : joint + 2] = 0.5
            yield Hypothesis(code="shared-drive", joints=(joint + 1, joint + 2), factors=factors)

    job = IDIMLS().job(with_torques(log, torques(log) * [1.0, 0.5, 0.5, 1.0, 1.0, 1.0]))
    rows = LogRows(job.robot, job.signal, job.parts("fit", job.declared_delay))

    def named() -> list[Named]:
        cause = Search(rows, readings=False).cause()
        return (
            [] if cause is None else [(item.hypothesis.code, item.hypothesis.joints) for item in cause.tried]
        )

    assert ("shared-drive", (2, 3)) not in named()
    monkeypatch.setattr(causes, "OF_TORQUES", (*OF_TORQUES, halved))
    assert ("shared-drive", (2, 3)) in named()


def test_units_of_slides_and_turning_joints() -> None:
    """What is declared in metres and radians may be in millimetres, degrees and mrad."""
    rows = stub(origin={}, robot=stub(joint_kinds=("revolute", "prismatic")))
    found = {
        (item.facts["declared"], item.facts["unit"]): np.diagonal(np.asarray(item.position)).tolist()
        for item in units(rows)
    }
    assert found == {
        ("rad", "deg"): pytest.approx([np.pi / 180.0, 1.0]),
        ("deg", "rad"): pytest.approx([180.0 / np.pi, 1.0]),
        ("rad", "mrad"): pytest.approx([1e-3, 1.0]),
        ("deg", "mrad"): pytest.approx([0.18 / np.pi, 1.0]),
        ("m", "mm"): [1.0, 1e-3],
        ("mm", "m"): [1.0, 1e3],
    }


def planar(seed: int, *, exchange: bool = False) -> LogRows:
    robot = didim.load_robot("planar2")
    x = robot.parameter_set("reference")
    log = of_recordings(robot, recorded(robot, x, seed=seed, noise=0.3, n_samples=6000))
    return rows_of(with_torques(log, exchanged(torques(log), 0, 1)) if exchange else log)


def test_another_log_that_agrees_confirms_a_cause_and_one_that_does_not_refuses_it() -> None:
    rows = planar(0, exchange=True)
    cause = Search(rows, planar(1, exchange=True)).cause()
    assert cause is not None
    assert [(item.hypothesis.code, item.hypothesis.joints) for item in cause.tried] == [
        ("swapped-torques", (1, 2))
    ]
    assert Search(rows, planar(1)).cause() is None


def test_the_growth_of_a_trial_is_that_of_errors() -> None:
    """Of blocks that were left out in turn over the same blocks fitted: by the root, as errors are."""
    rows = planar(0)
    found = causes.tried(
        rows, Hypothesis(code="torque-sign", joints=(1,), factors=np.ones(2)), rows.products, rows.names
    )
    weight = 1.0 / rows.declared_seen
    cuts = np.array_split(np.arange(rows.y.shape[1]), BLOCKS)

    def squares(inside: NDArray[np.intp], outside: NDArray[np.intp]) -> float:
        scale = np.sqrt(weight)[:, None]
        w = (rows.w * scale[:, :, None])[:, inside].reshape(-1, rows.w.shape[2])
        beta = np.linalg.lstsq(w, (rows.y * scale)[:, inside].ravel(), rcond=None)[0]
        return float(np.sum((rows.y[:, outside] - rows.w[:, outside] @ beta) ** 2))

    every = np.arange(rows.y.shape[1])
    unseen = sum(squares(np.setdiff1d(every, cut), cut) for cut in cuts)
    assert unseen > 1.02 * squares(every, every)
    assert found.growth == pytest.approx(np.sqrt(unseen / squares(every, every)), rel=2e-3)


@pytest.mark.parametrize(("ahead", "held"), [(0.5, True), (-0.5, False)])
def test_a_digital_hold_leaves_torques_half_a_sample_ahead(ahead: float, held: bool) -> None:
    """Behind the motion by as much no hold explains them."""
    robot = didim.load_robot("planar2")
    q, wanted = (simulated.motion(2, 6000, late_samples=late) for late in (0.0, -ahead))
    tau = didim.inverse_dynamics(
        robot, *differentiate(wanted, simulated.RATE_HZ, simulated.SIGNAL), robot.parameter_set("reference")
    )
    log = of_recordings(robot, didim.Recording.from_arrays(q, tau, rate_hz=simulated.RATE_HZ))
    (finding,) = delay_findings(rows_of(log), np.zeros(0), obeyed=False)
    assert finding.value == pytest.approx(-ahead, abs=0.05)
    assert finding.facts["held"] is held
    assert ("a digital hold" in finding.sentence) is held
