"""Torques of the wrong sign and exchanged torques are named, by IDIM-LS and by DIDIM, and sound logs raise no suspicion."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import didim
from arm import arm_log
from didim import DIDIM, IDIMLS, Experiment, FitError, identify
from didim.regression.least_squares import solve
from didim.regression.linear_system import LinearSystem, linear_system
from didim.regression.suspicions import suspicions
from didim.studies.simulated_log import measured, packaged_experiment, simulated_log
from plain import plain_didim

Array = NDArray[np.float64]

JOINTS = range(6)
PAIRS = tuple(combinations(JOINTS, 2))
TURNED = "the torque of joint {} looks as if its sign were wrong"
EXCHANGED = "the torques of joints {} and {} look as if they were exchanged"


@pytest.fixture(scope="module")
def exact() -> Experiment:
    experiment = packaged_experiment("tx40")
    return simulated_log(experiment, experiment.robot.parameter_set("didim"), noise=False)


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


def with_torques(log: Experiment, tau: Array) -> Experiment:
    (recording,) = log.recordings
    return replace(log, recordings=(replace(recording, tau=tau),))


def system_of(log: Experiment) -> LinearSystem:
    job = IDIMLS().job(log)
    return linear_system(job.robot, job.parts("fit", 0.0), job.signal, job.selection)


def suspected(log: Experiment, system: LinearSystem, tau: Array) -> list[str]:
    """Suspicions with decimated torques, (n_rows, n_dof), in the place of those of the log."""
    changed = replace(system, y=np.ascontiguousarray(tau.T).reshape(-1))
    return suspicions(changed, solve(changed, log.least_squares))


def check_all(log: Experiment) -> None:
    """Turn each joint and exchange each pair: that, and nothing else, must be named."""
    system = system_of(log)
    tau = system.y.reshape(len(JOINTS), -1).T
    assert suspected(log, system, tau) == []
    for joint in JOINTS:
        (sentence,) = suspected(log, system, turned(tau, joint))
        assert sentence.startswith(f"{TURNED.format(joint + 1)}: ")
    for i, j in PAIRS:
        (sentence,) = suspected(log, system, exchanged(tau, i, j))
        assert sentence.startswith(f"{EXCHANGED.format(i + 1, j + 1)}: without that the residual falls from ")


def test_every_joint_and_pair_of_the_simulated_tx40(log: Experiment) -> None:
    check_all(log)


def test_every_joint_and_pair_without_noise(exact: Experiment) -> None:
    check_all(exact)


@pytest.mark.parametrize("file", ["tx40_log.toml", "tx40_log_best.toml", "tx40_didim.toml"])
def test_every_joint_and_pair_of_the_measured_tx40(project: Path, shared: Path, file: str) -> None:
    """Its errors hide a wrong sign from the residual; friction gives it away."""
    check_all(didim.load_experiment(project / "examples" / file, data=shared / "data" / "tx40"))


def test_idim_ls_says_so(log: Experiment) -> None:
    tau = torques(log)
    assert identify(log).remarks == ()
    (sentence,) = identify(with_torques(log, turned(tau, 2))).remarks
    assert sentence.startswith(f"{TURNED.format(3)}: without that the residual falls from ")
    fit = identify(with_torques(log, exchanged(tau, 4, 5)))
    (sentence,) = fit.remarks
    assert sentence.startswith(EXCHANGED.format(5, 6))
    assert sentence in str(fit)


def named(log: Experiment, method: DIDIM, sentence: str) -> None:
    """Whatever DIDIM makes of the log, the reader is told."""
    try:
        fit = identify(log, method)
    except FitError as error:
        told = str(error)
    else:
        told = "\n".join(fit.remarks)
        assert f"  {sentence}" in str(fit)
    assert sentence in told
    assert len(re.findall(r"looks? as if", told)) == 1


@pytest.mark.parametrize("joint", JOINTS)
def test_didim_names_a_turned_joint(log: Experiment, joint: int) -> None:
    named(
        with_torques(log, turned(torques(log), joint)),
        plain_didim(max_iterations=1),
        TURNED.format(joint + 1),
    )


@pytest.mark.parametrize(("i", "j"), [(0, 1), (1, 5), (2, 5), (4, 5)])
def test_didim_names_exchanged_joints(log: Experiment, i: int, j: int) -> None:
    tau = exchanged(torques(log), i, j)
    named(with_torques(log, tau), plain_didim(max_iterations=1), EXCHANGED.format(i + 1, j + 1))


def test_didim_on_exchanged_joints_names_them_before_all_else(log: Experiment) -> None:
    tau = exchanged(torques(log), 2, 5)
    fit = identify(with_torques(log, tau), plain_didim())
    assert fit.remarks[0].startswith(EXCHANGED.format(3, 6))


def test_didim_without_gain_updating_names_them_too(log: Experiment) -> None:
    tau = turned(torques(log), 1)
    named(with_torques(log, tau), plain_didim(max_iterations=1, gain_updating="never"), TURNED.format(2))


@pytest.mark.parametrize("start", ["unit", "idim-ls"])
def test_two_joints(start: str) -> None:
    """Turning one joint of two leaves as much as turning the other: friction tells which it was."""
    log = arm_log(1)
    tau = torques(log)
    assert identify(log, plain_didim(start=start)).remarks == ()
    for joint in range(2):
        assert identify(with_torques(log, turned(tau, joint))).remarks[0].startswith(TURNED.format(joint + 1))
        named(with_torques(log, turned(tau, joint)), plain_didim(start=start), TURNED.format(joint + 1))
    both = "the torques of joints 1 and 2 look as if their signs were wrong: friction would drive the robot (Fv1 = -1.2"
    named(with_torques(log, -tau), plain_didim(start=start), both)
    named(with_torques(log, exchanged(tau, 0, 1)), plain_didim(start=start), EXCHANGED.format(1, 2))


def test_friction_that_is_known_or_absent_tells_nothing() -> None:
    log = arm_log(1)
    turned_log = with_torques(log, -torques(log))
    dropped = ("Fv1", "Fc1", "Fv2", "Fc2")
    assert identify(turned_log, IDIMLS(dropped=dropped)).remarks == ()
    (sentence,) = identify(turned_log, IDIMLS(dropped=("Fv1", "Fc1"))).remarks
    assert sentence.startswith(f"{TURNED.format(2)}: friction would drive the robot (Fv2 = -")


@pytest.mark.parametrize("file", ["emps.toml", "emps_asymmetric.toml"])
def test_one_joint(project: Path, shared: Path, file: str) -> None:
    log = didim.load_experiment(project / "examples" / file, data=shared / "data" / "emps")
    assert identify(log).remarks == ()
    (sentence,) = identify(with_torques(log, -torques(log))).remarks
    assert sentence.startswith(f"{TURNED.format(1)}: friction would drive the robot (Fv1")
