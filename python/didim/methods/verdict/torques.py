"""Torques that contradict each other, or the simulated robot, as evidence. Tested in ``tests/test_verdict.py``."""

from __future__ import annotations

import re
from collections.abc import Sequence

from ...result.verdict import Reason

TORQUE_CODES = frozenset({"torque-sign", "swapped-torques"})
"""Codes of the reasons of suspicions: they say what is wrong with the torques."""
CONTRADICTIONS = TORQUE_CODES | {"no-robot"}
"""Codes of reasons why no robot explains the torques."""
ASTRAY = 1.0
"""Output error (12) from which on a simulated robot is further from the log than no torque at all."""


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
