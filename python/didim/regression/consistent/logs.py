"""Conditions on what logs have beside the robot: payloads that are bodies, friction of their own that only dissipates.

    P(V_l theta + v_l) > 0              the payload of log l, about the frame of the link that carries it
    F(x + V_l theta) >= 0               friction, rotors and rates (B) where log l has friction of its own

Pseudo-inertias in different frames are congruent, so that of the joint stands for that of the flange. A robot and a payload
that are bodies are one together. Offsets have no condition. Tested in ``tests/test_consistent_logs.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..._tools.arrays import Array
from ...model.consistency import Cone, link_cones
from ...robot.rigid_body import ten_parameters
from ..logs.body import RADIUS_M
from ..logs.parameters import ColumnBlock, LogParameters
from .prior import drawn

MASS_KG = 1.0
"""Mass (kg) of the prior solid of a payload, at the last frame."""


def log_conditions(logs: LogParameters, gamma: float, drives: Sequence[Cone]) -> list[Cone]:
    """Return the conditions on payloads and on recordings with friction of their own.

    Parameters
    ----------
    logs : LogParameters
        Further parameters: they stand behind the standard ones.
    gamma : float
        Weight of the prior of a payload (nats).
    drives : sequence of Cone
        Conditions of the robot on rotors and friction, with the weights that each recording with friction of its own repeats.
    """
    conditions = []
    for block, places in logs.slices():
        if block.kind == "payload" and block.complete:
            conditions.append(_payload(logs, block, places, gamma))
        elif block.kind == "friction":
            (recording,) = _recordings(logs, places)
            own = np.zeros_like(logs.columns[recording])
            own[:, places] = logs.columns[recording][:, places]
            changed = set(np.flatnonzero(own.any(axis=1)).tolist())
            conditions += [
                replace(_moved(cone, own), label=f"{cone.label} of recording '{block.owner}'")
                for cone in drives
                if changed & set(cone.indices)
            ]
    return conditions


def log_start(logs: LogParameters) -> Array:
    """Return further parameters to start from, (e,): solids as payloads, and nothing of a recording's own."""
    start = np.zeros(logs.n_further)
    for block, places in logs.slices():
        if block.kind == "payload":
            indices = list(link_cones(logs.robot)[-1].indices)
            recording = _recordings(logs, places)[0]
            known = logs.known.get(recording, np.zeros(len(logs.robot.parameter_names)))
            columns = logs.columns[recording][indices, places]
            start[places] = np.linalg.lstsq(columns, ten_parameters(_solid()) - known[indices], rcond=None)[0]
    return start


def _payload(logs: LogParameters, block: ColumnBlock, places: slice, gamma: float) -> Cone:
    recording = _recordings(logs, places)[0]
    link = link_cones(logs.robot)[-1]
    moved = _moved(link, logs.columns[recording], logs.known.get(recording))
    own = [k for k, index in enumerate(moved.indices) if index not in link.indices]
    indices = tuple(moved.indices[k] for k in own)
    body = Cone(f"payload '{block.owner}'", indices, moved.basis[own], moved.constant)
    return drawn(body, _solid(), gamma)


def _moved(cone: Cone, columns: Array, known: Array | None = None) -> Cone:
    """Return ``F(x + V theta + v)`` in ``x`` and ``theta``."""
    shares = columns[list(cone.indices)]
    further = np.flatnonzero(shares.any(axis=0))
    constant = cone.constant
    if known is not None:
        constant = constant + np.tensordot(known[list(cone.indices)], cone.basis, 1)
    return replace(
        cone,
        indices=(*cone.indices, *(len(columns) + int(k) for k in further)),
        basis=np.concatenate([cone.basis, np.tensordot(shares[:, further].T, cone.basis, 1)]),
        constant=constant,
    )


def _recordings(logs: LogParameters, places: slice) -> list[int]:
    """Return the recordings that have further parameters."""
    return [number for number, columns in logs.columns.items() if columns[:, places].any()]


def _solid() -> Array:
    return MASS_KG * np.diag([RADIUS_M**2] * 3 + [1.0])
