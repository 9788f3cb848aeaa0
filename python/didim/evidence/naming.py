"""Findings of causes, as records with the edit that takes each away. Tested in ``tests/test_evidence_causes.py``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from ..result.finding import Finding, Remedy
from ..robot.parameters import friction_names
from ..terms.rows import LinearSystem
from .causes import Cause, Tried, cause_of_torques
from .products import Declared


def cause_findings(rows: Declared, cause: Cause | None) -> list[Finding]:
    """Return the finding of a cause with those that explain the log as well; none without a cause."""
    if cause is None:
        return []
    best, *ties = cause.tried
    hypothesis = best.hypothesis
    return [
        Finding(
            code=hypothesis.code,
            grade="wrong" if cause.certain else "doubtful",
            joints=hypothesis.joints,
            value=hypothesis.value,
            effect=best.decisive,
            remedy=remedy_of(best),
            facts={
                **hypothesis.facts,
                "left": float(np.exp(best.decisive / (2.0 * rows.n))),
                "blocks": best.blocks,
                "friction": _friction(rows, best) if best.friction else None,
                "ties": [_tie(tie) for tie in ties],
            },
        )
    ]


def torque_findings(system: LinearSystem) -> list[Finding]:
    """Return the wrong sign or the exchange of torques that a linear system (7) shows by itself; empty for a correct log."""
    cause = cause_of_torques(system)
    return [] if cause is None else cause_findings(*cause)


REMEDIES: dict[
    str, tuple[Literal["experiment", "robot"], str, str, Literal["set", "turn", "exchange", "divide"]]
] = {
    "torque-sign": ("experiment", "[recording.torque]", "sign", "turn"),
    # Every unit takes `scale`, and `gain` is for currents and voltages alone.
    "drive-gain": ("experiment", "[recording.torque]", "scale", "divide"),
    "torque-unit": ("experiment", "[recording.torque]", "scale", "divide"),
    "swapped-torques": ("experiment", "[recording.torque]", "columns", "exchange"),
    "swapped-positions": ("experiment", "[recording.position]", "columns", "exchange"),
    "unit": ("experiment", "[recording.position]", "unit", "set"),
    "position-sign": ("experiment", "[recording.position]", "sign", "turn"),
    "gravity": ("robot", "", "gravity_m_s2", "set"),
    "twist-sign": ("robot", "[[joint]]", "alpha_deg", "turn"),
    "link-length": ("robot", "[[joint]]", "", "set"),
    "dh-convention": ("robot", "", "convention", "set"),
}
"""File, table, key and kind of the edit that removes a cause, where a file declares enough."""


def remedy_of(tried: Tried) -> Remedy | None:
    """Return the edit of a file that a cause asks for; None where the file does not say enough."""
    hypothesis = tried.hypothesis
    facts: Mapping[str, Any] = hypothesis.facts
    if hypothesis.code not in REMEDIES or facts.get("urdf"):
        return None
    file, table, key, action = REMEDIES[hypothesis.code]
    value: Any = hypothesis.value
    if hypothesis.code == "gravity":
        value = list(facts["vector"])
    elif hypothesis.code == "dh-convention":
        value = "mdh" if facts.get("standard") else "dh"
    elif hypothesis.code == "unit":
        value = facts["unit"]
    key = key or str(facts["symbol"])
    joints = (int(facts["row"]),) if "row" in facts else hypothesis.joints
    return Remedy(file=file, table=table, key=key, action=action, value=value, joints=joints)


def _tie(tried: Tried) -> dict[str, Any]:
    hypothesis = tried.hypothesis
    return {
        "code": hypothesis.code,
        "joints": list(hypothesis.joints),
        "value": hypothesis.value,
        "facts": dict(hypothesis.facts),
        "effect": tried.decisive,
    }


def _friction(rows: Declared, tried: Tried) -> dict[str, float]:
    """Return the friction of a joint as declared, which would drive it."""
    names = frozenset().union(*(friction_names(joint - 1) for joint in tried.hypothesis.joints))
    return {
        name: float(value)
        for name, value in zip(rows.names, rows.declared.beta, strict=True)
        if name in names
    }
