"""The dead-zone recipe of the TX40 log once more, from Pinocchio, NumPy and SciPy alone: what `didim` must find.

Links, filters, decimation, weights and covariance come from other people's code here; friction and the coupled
wrist are written out as docs/conventions.md has them. Of `didim` there is the table of geometry only.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy import signal

import didim
from twins import PINOCCHIO_ORDER, pinocchio_model

Array = NDArray[np.float64]

RATE_HZ = 5000.0
CUTOFF_HZ = 50.0
DEAD_ZONE = 0.01  # rad/s
TRIMMED = 100
REWEIGHTINGS = 3
LINK = ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M")
# Motor 6 turns with joints 5 and 6.
REDUCTION = np.diag([32.0, 32.0, 45.0, -48.0, 45.0, 32.0])
REDUCTION[5, 4] = 32.0


@dataclass(frozen=True)
class Expected:
    """Estimate, white standard deviations (10), condition number of W and relative errors per joint."""

    beta: Array
    std: Array
    condition_number: float
    relative_error: Array


def columns(q: Array, dq: Array, ddq: Array, names: tuple[str, ...]) -> Array:
    """Columns of the regressor by the names of standard parameters, (n_samples, 6, n_names)."""
    robot = didim.load_robot("tx40")
    # The regressor does not depend on the links' inertia, but Pinocchio wants one.
    unit = [float(name[:-1] in ("XX", "YY", "ZZ", "M")) for name in robot.parameter_names]
    model = pinocchio_model(robot, np.array(unit))
    data = model.createData()
    n = len(q)
    made = {name: np.zeros((n, 6)) for name in names}
    place = {
        f"{LINK[kind]}{joint + 1}": 10 * joint + column
        for joint in range(6)
        for column, kind in enumerate(PINOCCHIO_ORDER)
    }
    inertial = [name for name in names if name in place]
    kept = [place[name] for name in inertial]
    links = np.stack(
        [pin.computeJointTorqueRegressor(model, data, q[k], dq[k], ddq[k])[:, kept] for k in range(n)]
    )
    for index, name in enumerate(inertial):
        made[name] = links[:, :, index]
    shaft = dq[:, 4] + dq[:, 5]

    def sign(speed: Array) -> Array:
        return np.sign(speed) * (np.abs(speed) > DEAD_ZONE)

    for name in set(names) - set(inertial):
        kind, joint = name[:-1], int(name[-1]) - 1
        if kind == "Ia":
            made[name][:, joint] = ddq[:, joint]
        elif kind == "Fv":
            made[name][:, joint] = dq[:, joint]
        elif kind == "Fc":
            made[name][:, joint] = sign(dq[:, joint])
        elif kind == "Off":
            made[name][:, joint] = 1.0
    # The rotor and the friction of motor 6 act on both joints; Ia5 and Fv5 contain their part on joint 5 (24).
    made["Ia6"][:, 4] = ddq[:, 5]
    made["Ia6"][:, 5] = ddq[:, 4] + ddq[:, 5]
    made["Fvm6"][:, 4], made["Fvm6"][:, 5] = dq[:, 5], dq[:, 4]
    made["Fcm6"][:, 4] = sign(shaft)
    made["Fcm6"][:, 5] = sign(shaft) - sign(dq[:, 5])
    return np.stack([made[name] for name in names], axis=2)


def expected(folder: Path, base_names: tuple[str, ...]) -> Expected:
    """Fit the log of a folder.

    A base parameter is estimated by the column of the standard parameter whose name it has: the regrouped ones
    lie in the span of those columns.
    """
    motor_q, motor_tau = (
        np.loadtxt(folder / f"motor_{what}.csv", delimiter=",", skiprows=1, usecols=range(6))
        for what in ("position", "torque")
    )
    q: Array = np.asarray(np.linalg.solve(REDUCTION, motor_q.T).T, dtype=np.float64)
    tau = motor_tau @ REDUCTION
    sos = signal.butter(4, CUTOFF_HZ, fs=RATE_HZ, output="sos")
    q = np.asarray(signal.sosfiltfilt(sos, q, axis=0), dtype=np.float64)
    dq: Array = np.asarray(np.gradient(q, 1.0 / RATE_HZ, axis=0), dtype=np.float64)
    ddq: Array = np.asarray(np.gradient(dq, 1.0 / RATE_HZ, axis=0), dtype=np.float64)
    inside = slice(TRIMMED, len(q) - TRIMMED)
    names = tuple(name.removesuffix("R") for name in base_names)
    w = columns(q[inside], dq[inside], ddq[inside], names)
    y = tau[inside]
    for _ in range(2):
        w, y = (signal.decimate(x, 10, axis=0) for x in (w, y))
    w, y = w.transpose(1, 0, 2), y.T  # joint by joint
    flat, torques = w.reshape(-1, len(names)), y.reshape(-1)
    sigma = np.ones(6)
    for _ in range(1 + REWEIGHTINGS):
        scale = np.repeat(1.0 / sigma, y.shape[1])
        beta = np.linalg.lstsq(flat * scale[:, None], torques * scale, rcond=None)[0]
        residual = y - w @ beta
        sigma = np.sqrt(np.mean(residual**2, axis=1))
    weighted = residual.reshape(-1) * scale
    variance = weighted @ weighted / (flat.shape[0] - flat.shape[1])
    covariance = variance * np.linalg.pinv((flat * scale[:, None]).T @ (flat * scale[:, None]))
    return Expected(
        beta=np.asarray(beta, dtype=np.float64),
        std=np.sqrt(np.diag(covariance)),
        condition_number=float(np.linalg.cond(flat)),
        relative_error=np.linalg.norm(residual, axis=1) / np.linalg.norm(y, axis=1),
    )
