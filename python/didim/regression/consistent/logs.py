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
from ...terms.model import Model
from ...terms.share import Share
from ..logs.body import RADIUS_M
from .prior import drawn

MASS_KG = 1.0
"""Mass (kg) of the prior solid of a payload, at the last frame."""


def log_conditions(model: Model, gamma: float, drives: Sequence[Cone]) -> list[Cone]:
    """Return the conditions on payloads and on recordings with friction of their own.

    Parameters
    ----------
    model : Model
        The unknowns of its shares stand behind the standard parameters.
    gamma : float
        Weight of the prior of a payload (nats).
    drives : sequence of Cone
        Conditions of the robot on rotors and friction, with the weights that each recording with friction of its own repeats.
    """
    conditions = []
    for share, places in model.slices():
        block = share.block
        if block.kind == "payload" and block.complete and block.names:
            conditions.append(_payload(model, share, places, gamma))
        elif block.kind == "friction":
            own = _among_all(model, share, places)
            changed = set(np.flatnonzero(own.any(axis=1)).tolist())
            conditions += [
                replace(_moved(cone, own), label=f"{cone.label} of recording '{block.owner}'")
                for cone in drives
                if changed & set(cone.indices)
            ]
    return conditions


def log_start(model: Model) -> Array:
    """Return further parameters to start from, (e,): solids as payloads, and nothing of a recording's own."""
    start = np.zeros(model.n_further)
    for share, places in model.slices():
        if share.block.kind == "payload":
            indices = list(link_cones(model.own)[-1].indices)
            known = np.zeros(len(share.directions)) if share.fixed is None else share.fixed
            wanted = ten_parameters(_solid()) - known[indices]
            start[places] = np.linalg.lstsq(share.directions[indices], wanted, rcond=None)[0]
    return start


def _payload(model: Model, share: Share, places: slice, gamma: float) -> Cone:
    link = link_cones(model.own)[-1]
    moved = _moved(link, _among_all(model, share, places), share.fixed)
    own = [k for k, index in enumerate(moved.indices) if index not in link.indices]
    indices = tuple(moved.indices[k] for k in own)
    body = Cone(f"payload '{share.block.owner}'", indices, moved.basis[own], moved.constant)
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


def _among_all(model: Model, share: Share, places: slice) -> Array:
    """Return the directions of a share among those of all shares, (p, e): zero for the others."""
    directions = np.zeros((len(share.directions), model.n_further))
    directions[:, places] = share.directions
    return directions


def _solid() -> Array:
    return MASS_KG * np.diag([RADIUS_M**2] * 3 + [1.0])
