"""Flags on what physics forbids, and M(q) from the inverse dynamic model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import simulated
from didim.methods.identify import identify
from didim.methods.idim_ls import IDIMLS
from didim.model.dynamics import inertia_matrix
from didim.model.physics import physical_flags
from didim.robot.friction import FrictionTerm
from didim.robot.robot import Robot
from didim.robot.robot_file import load_robot

Array = NDArray[np.float64]

SETS = {"planar2": "reference", "tx40": "didim"}


def base_values(robot: Robot, **changes: float) -> Array:
    beta = np.array(robot.base_parameters.project(np.asarray(robot.sets[SETS[robot.name]])))
    for name, value in changes.items():
        beta[robot.base_parameters.names.index(name)] = value
    return beta


def flags(robot: Robot, beta: Array, std: float = 1e-3) -> tuple[str, ...]:
    found = physical_flags(robot, beta, std**2 * np.eye(beta.size), simulated.motion(robot.n_dof, 200))
    return tuple(flag.sentence for flag in found)


@pytest.mark.parametrize("name", SETS)
def test_m_is_symmetric_and_the_true_one_positive_definite(name: str) -> None:
    robot = load_robot(name)
    q = simulated.motion(robot.n_dof, 50)
    m = inertia_matrix(robot, q, np.asarray(robot.base_parameters.lift(base_values(robot))))
    assert m.shape == (50, robot.n_dof, robot.n_dof)
    np.testing.assert_allclose(m, m.transpose(0, 2, 1), atol=1e-12)
    assert np.linalg.eigvalsh(m).min() > 0.0


def test_true_parameters_raise_no_flag() -> None:
    robot = load_robot("planar2")
    assert flags(robot, base_values(robot)) == ()


@pytest.mark.parametrize("name", ["Fv1", "Fc2"])
def test_negative_friction(name: str) -> None:
    robot = load_robot("planar2")
    (flag,) = flags(robot, base_values(robot, **{name: -0.2}))
    assert flag.startswith(f"{name} = -0.2 N.m")
    assert flag.endswith("is negative, by 200.0 sigma")


def test_noise_as_an_explanation() -> None:
    robot = load_robot("planar2")
    (flag,) = flags(robot, base_values(robot, Fv1=-0.2), std=0.15)
    assert flag.endswith("is negative, by 1.3 sigma (noise can explain it)")


def test_parameters_of_either_sign_are_left_alone() -> None:
    robot = load_robot("planar2")
    beta = base_values(robot, Off1=-5.0, MY2=-0.01)
    assert flags(robot, beta) == ()


def test_negative_rotor_inertia() -> None:
    robot = load_robot("tx40")
    told = flags(robot, base_values(robot, Ia3=-0.02))
    assert any(flag.startswith("Ia3 = -0.02 kg.m^2 is negative") for flag in told)


def test_indefinite_inertia_matrix() -> None:
    robot = load_robot("planar2")
    told = flags(robot, base_values(robot, ZZ1R=0.01))
    assert len(told) == 1
    assert told[0].startswith("M(q) is not positive definite in ")
    assert "of 200 poses of the log" in told[0]
    assert told[0].endswith("cannot be simulated")


def test_torques_of_the_wrong_sign_are_suspected() -> None:
    robot = load_robot("planar2")
    log = simulated.log(robot, np.asarray(robot.sets["reference"]), noise=0.1)
    assert log.tau is not None
    fit = identify(simulated.experiment(robot, replace(log, tau=-log.tau)))
    (told,) = [flag for flag in fit.warnings if flag.startswith("M(q)")]
    assert "in 100 % of 1000 poses" in told
    # An indefinite M(q) says nothing about signs: a light link has one by noise. Friction that drives says it.
    assert told.endswith("sigma below zero): this estimate cannot be simulated")
    assert fit.verdict.reasons[0].code == "torque-sign"


def test_a_fixed_value_is_told_as_such() -> None:
    robot = load_robot("planar2")
    assert flags(robot, base_values(robot, Fv1=-0.2), std=0.0) == (
        "Fv1 = -0.2 N.m.s/rad is negative, as fixed",
    )


def test_the_printed_table_of_the_tx40_is_flagged() -> None:
    robot = load_robot("tx40")
    printed = np.asarray(robot.base_parameters.project(np.asarray(robot.sets["didim_printed"])))
    assert any(flag.startswith("M(q) is not positive definite in ") for flag in flags(robot, printed))
    corrected = flags(robot, base_values(robot))
    assert not any("M(q)" in flag for flag in corrected)


def test_flags_are_part_of_the_result() -> None:
    robot = load_robot("planar2")
    x = np.array(robot.sets["reference"])
    log = simulated.log(robot, x)
    assert identify(simulated.experiment(robot, log)).warnings == ()
    x[robot.parameter_names.index("Fv2")] = -0.5
    fit = identify(simulated.experiment(robot, simulated.log(robot, x)), IDIMLS(weights="none"))
    assert len(fit.warnings) == 1
    assert "Doubtful:\n  Fv2 = -0.5 N.m.s/rad is negative" in str(fit)
    last = str(fit).splitlines()[-1]
    assert last.startswith("Verdict: doubtful, for 1 reason: Fv2 = -0.5 N.m.s/rad is negative")


def test_an_indefinite_inertia_matrix_with_load_friction_is_flagged() -> None:
    """Load friction has no sign at rest: the flag is that of the robot without it."""
    robot = load_robot("planar2")
    heavy = robot.with_terms([FrictionTerm(law="load", joint=joint) for joint in range(2)])
    x = np.append(np.asarray(robot.sets["reference"]), [0.1, 0.2])
    x[robot.parameter_names.index("ZZ1")] = -5.0
    told = flags(heavy, np.asarray(heavy.base_parameters.project(x)))
    assert told == flags(robot, np.asarray(robot.base_parameters.project(x[:-2])))
    assert told[-1].startswith("M(q) is not positive definite in ")


def test_load_friction_on_a_log_without_a_positive_definite_estimate() -> None:
    """Turned torques end in a result with a flag, with load friction as without."""
    robot = load_robot("planar2").with_terms([FrictionTerm(law="load", joint=0)])
    x = np.append(np.asarray(load_robot("planar2").sets["reference"]), 0.1)
    log = simulated.log(robot, x, noise=0.1)
    assert log.tau is not None
    fit = identify(simulated.experiment(robot, replace(log, tau=-log.tau)))
    assert "Fl1" in fit.names
    assert any(flag.startswith("M(q) is not positive definite in ") for flag in fit.warnings)


def test_a_sign_without_a_standard_deviation_is_of_unknown_significance() -> None:
    """Zero variance means fixed only where the parameter was fixed; a run that has not converged has no significant signs."""
    robot = load_robot("planar2")
    beta = base_values(robot, Fv1=-0.2)
    none = np.zeros((beta.size, beta.size))
    (flag,) = physical_flags(robot, beta, none, np.zeros((0, 2)), unknown=("Fv1",))
    assert flag.sentence == "Fv1 = -0.2 N.m.s/rad is negative, of unknown significance"
    (flag,) = physical_flags(robot, beta, none, np.zeros((0, 2)))
    assert flag.sentence.endswith("is negative, as fixed")
