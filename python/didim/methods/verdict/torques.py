"""Torques that contradict each other, or the simulated robot, as evidence. Tested in ``tests/test_verdict.py``."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from ..._tools.arrays import Array
from ..._tools.words import joints_text
from ...experiment.experiment import Experiment
from ...log.recording import Recording
from ...result.verdict import Reason

TORQUE_CODES = frozenset({"torque-sign", "swapped-torques", "constant-torque"})
"""Codes of the reasons that say what is wrong with the torques: no other cause is looked for beside them."""
CONTRADICTIONS = TORQUE_CODES | {"no-robot"}
"""Codes of reasons why no robot explains the torques."""
ASTRAY = 1.0
"""Output error (12) from which on a simulated robot is further from the log than no torque at all."""

SAME = 1e-12
"""Largest range of a constant torque, as a share of its size: rounding of units and reductions."""


def is_constant(values: Array) -> bool:
    """Whether a torque has one value in all samples, (n_samples,)."""
    return bool(np.ptp(values) <= SAME * np.abs(values).max())


def constant_torque_reasons(experiment: Experiment) -> list[Reason]:
    """Return a reason for each recording with torques that never change: a dead sensor, or an empty column."""
    found = []
    for recording in experiment.recordings:
        if recording.tau is None:
            continue
        tau, side = _as_logged(recording, recording.tau)
        dead = [number + 1 for number, values in enumerate(tau.T) if is_constant(values)]
        if dead:
            joints = joints_text(joint - 1 for joint in dead).replace("joint", side)
            torques = "torque of {} is" if len(dead) == 1 else "torques of {} are"
            found.append(
                Reason(
                    code="constant-torque",
                    severity="wrong",
                    sentence=f"recording '{recording.name}': the {torques.format(joints)} constant in all {len(tau)} samples",
                    advice="Look at the sensor and at columns under [recording.torque]",
                    joints=tuple(dead) if side == "joint" else (),
                )
            )
    return found


def _as_logged(recording: Recording, tau: Array) -> tuple[Array, str]:
    """Return the torques on the side on which they were logged, and the name of that side."""
    reduction = recording.origin.get("reduction")
    if reduction is None or recording.origin.get("torque", {}).get("side") != "motor":
        return tau, "joint"
    return tau @ np.linalg.inv(np.array(reduction)), "motor"


def torque_reasons(sentences: Sequence[str]) -> list[Reason]:
    """Return a reason for each suspicion (`didim.regression.suspicions`)."""
    return [
        Reason(
            code="swapped-torques" if "exchanged" in sentence else "torque-sign",
            severity="wrong",
            sentence=sentence,
            advice="Exchange their columns under [recording.torque]"
            if "exchanged" in sentence
            else "Turn the sign of the gain or of the column under [recording.torque]",
            joints=_joints(sentence),
        )
        for sentence in sentences
    ]


def _joints(sentence: str) -> tuple[int, ...]:
    """Return the joints that a sentence names before it goes on with "look"."""
    return tuple(int(number) for number in re.findall(r"\d+", sentence.partition(" look")[0]))


def following_reasons(output_error: float, *, updating: bool = True) -> list[Reason]:
    """Return a reason where the simulated robot does not follow, judged by the output error (12).

    `updating` is whether the gains of the first simulation are scaled: if not, that may help.
    """
    if not output_error >= ASTRAY:
        return []
    return [
        Reason(
            code="controller",
            severity="wrong",
            sentence=f"with these parameters the robot does not follow: its torques are off by {100.0 * output_error:.3g} %",
            advice="Check the controller, start elsewhere"
            + ("" if updating else ", or let gain_updating be 'first'"),
            value=output_error,
        )
    ]


def contradiction_reasons(sentences: Sequence[str]) -> list[Reason]:
    """Return a reason for each contradiction between torques and physics (`didim.regression.consistent.diagnosis`)."""
    return [
        Reason(
            code="torque-sign" if "looks reversed" in sentence else "no-robot",
            severity="wrong" if "reversed" in sentence or "no robot" in sentence else "doubtful",
            sentence=sentence,
        )
        for sentence in sentences
    ]
