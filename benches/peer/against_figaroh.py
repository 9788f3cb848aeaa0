"""figaroh on the measured TX40: set-up and ordinary least squares, by the steps of its published example.

Structural base parameters from random states, filter and differences, regressor with the coupled wrist, decimation by 100,
double QR, estimate and standard deviations. The robot is the twin that Pinocchio gets, so that no URDF is read; the columns of
the wrist are filled at once and not sample by sample, as the example does.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import importlib.util
import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import decimate

import didim

from . import against_pinocchio
from .task import Task
from .timing import Contestant, DisagreementError, MissingError, seconds
from .whole_runs import EXPERIMENT, NO_DATA

Array = NDArray[np.float64]

RANDOM_SAMPLES = 1000
"""States for the structural base parameters."""
CLOSE = 0.05
"""By how much the relative errors of both on the log may differ: ours has weights."""
RATE_HZ = 5000.0
CUTOFF_HZ = 50.0
ASKED_HZ = 4.0 * CUTOFF_HZ
"""Version 1.0 cuts off at a quarter of what it is asked for: its normalised frequency is f / (2 rate), SciPy's 2 f / rate."""
ORDER = 4
REDUCTION = np.diag([32.0, 32.0, 45.0, -48.0, 45.0, 32.0])
REDUCTION[5, 4] = 32.0
OPTIONS = {
    "has_friction": True,
    "has_actuator_inertia": True,
    "has_joint_offset": True,
    "is_joint_torques": True,
    "is_external_wrench": False,
    "force_torque": None,
    "act_idxv": list(range(6)),
    "ts": 1.0 / RATE_HZ,
    "cut_off_frequency_butterworth": ASKED_HZ,
}


def versions() -> dict[str, str]:
    """figaroh's version."""
    return {"figaroh": importlib.metadata.version("figaroh")}


def contestants(task: Task, data: Path | None, rounds: int) -> list[Contestant]:
    """One run, from the CSV files to estimates and standard deviations, after a look at what it finds."""
    if data is None:
        raise MissingError(NO_DATA)
    if importlib.util.find_spec("figaroh") is None:
        raise MissingError("figaroh is not installed (pip install figaroh).")
    robot = _robot(task)
    run = seconds(lambda: identify(robot, data))
    error = identify(robot, data)
    fit = didim.identify(didim.load_experiment(EXPERIMENT, data=data), didim.IDIMLS())
    ours = fit.overall_relative_error
    if not abs(error - ours) < CLOSE * ours:
        raise DisagreementError(
            f"figaroh leaves a relative error of {error:.3g} on the log, didim {ours:.3g}"
        )
    return [Contestant(name="figaroh, TX40 log", measure=run, unit="s", rounds=rounds)]


def identify(robot: Any, data: Path) -> float:
    """Identify base parameters with standard deviations from CSV files; return the relative error of the torques."""
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        # It warns on import, and its functions of QR on names are deprecated without another form.
        warnings.simplefilter("ignore")
        import pandas
        from figaroh.identification.identification_tools import (
            calculate_first_second_order_differentiation,
            low_pass_filter_data,
            relative_stdev,
        )
        from figaroh.tools.qrdecomposition import double_QR, get_baseParams
        from figaroh.tools.regressor import (
            build_regressor_basic,
            build_regressor_reduced,
            eliminate_non_dynaffect,
            get_index_eliminate,
        )

        standard = _standard(robot)
        rng = np.random.default_rng(0)
        q, dq, ddq = (size * rng.uniform(-1.0, 1.0, (RANDOM_SAMPLES, 6)) for size in (6.0, 10.0, 30.0))
        W = _with_wrist(build_regressor_basic(robot, q, dq, ddq, OPTIONS), dq, ddq)
        gone, kept = get_index_eliminate(W, standard, 1e-6)
        get_baseParams(build_regressor_reduced(W, gone), kept, standard)

        position = pandas.read_csv(data / "motor_position.csv").to_numpy()
        torque = pandas.read_csv(data / "motor_torque.csv").to_numpy()
        q = np.linalg.solve(REDUCTION, position.T).T
        filtered = np.column_stack([low_pass_filter_data(q[:, j], OPTIONS, ORDER) for j in range(6)])
        q, dq, ddq = calculate_first_second_order_differentiation(robot.model, filtered, OPTIONS)
        border = 5 * ORDER
        tau = (REDUCTION.T @ torque.T)[:, border : border + len(q)]
        W = _with_wrist(build_regressor_basic(robot, q, dq, ddq, OPTIONS), dq, ddq)
        rows = W.reshape(6, len(q), -1)
        W = np.concatenate([_decimated(joint) for joint in rows])
        y = np.concatenate([_decimated(joint) for joint in tau])
        reduced, kept = eliminate_non_dynaffect(W, standard, 0.001)
        base, _, _, beta = double_QR(y, reduced, kept)
        relative_stdev(base, beta, y)
        beta = np.linalg.lstsq(base, y, rcond=None)[0]
    return float(np.linalg.norm(y - base @ beta) / np.linalg.norm(y))


def _robot(task: Task) -> Any:
    from pinocchio import RobotWrapper

    return RobotWrapper(against_pinocchio.twin(task, rotors=False))


def _standard(robot: Any) -> dict[str, float]:
    """Names of the columns, in figaroh's order."""
    from figaroh.identification.parameter import get_standard_parameters

    names = dict(get_standard_parameters(robot.model))
    for block in ("fv", "fs", "Ia", "off"):
        names |= {f"{block}_joint{j + 1}": 0.0 for j in range(6)}
    return names | {"Iam6": 0.0, "fvm6": 0.0, "fsm6": 0.0}


def _with_wrist(W: Array, dq: Array, ddq: Array) -> Array:
    """Add the columns of motor 6, which turns with joint 5 as well."""
    n = len(dq)
    wrist = np.zeros((len(W), 3))
    shaft = np.sign(dq[:, 4] + dq[:, 5])
    wrist[4 * n : 5 * n] = np.column_stack([ddq[:, 5], dq[:, 5], shaft])
    wrist[5 * n : 6 * n] = np.column_stack([ddq[:, 4], dq[:, 4], shaft])
    return np.hstack([W, wrist])


def _decimated(values: Array) -> Array:
    for _ in range(2):
        values = decimate(values, 10, axis=0, zero_phase=True)
    return values
