"""Findings of causes, as records with the edit that takes each away. Tested in ``tests/test_evidence_causes.py``."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..regression.linear_system import LinearSystem
from ..result.finding import Finding, Remedy
from .causes import Cause, Tried, cause_of_torques
from .products import Declared


def cause_findings(rows: Declared, cause: Cause | None) -> list[Finding]:
    """Return the finding of a cause with those that explain the log as well; none without a cause."""
    if cause is None:
        return []
    best, *ties = cause.tried
    item = best.hypothesis
    return [
        Finding(
            code=item.code,
            grade="wrong" if cause.certain else "doubtful",
            joints=item.joints,
            value=item.value,
            effect=best.decisive,
            remedy=remedy_of(best),
            facts={
                **item.facts,
                "left": float(np.exp(best.decisive / (2.0 * rows.n))),
                "blocks": best.blocks,
                "friction": _friction(rows, best) if best.friction else None,
                "ties": [_tie(tie) for tie in ties],
            },
        )
    ]


def torque_findings(system: LinearSystem) -> list[Finding]:
    """Return the turned sign or the exchange of torques that a linear system (7) shows by itself; empty for a sound log."""
    found = cause_of_torques(system)
    return [] if found is None else cause_findings(*found)


def remedy_of(tried: Tried) -> Remedy | None:
    """Return the edit of a file that a cause asks for; None where the file does not say enough."""
    item = tried.hypothesis
    joints = item.joints
    if item.code == "torque-sign":
        return Remedy(file="experiment", table="[recording.torque]", key="gain", action="turn", joints=joints)
    if item.code == "drive-gain":
        return Remedy(
            file="experiment",
            table="[recording.torque]",
            key="gain",
            action="divide",
            value=item.value,
            joints=joints,
        )
    if item.code == "swapped-torques":
        return Remedy(
            file="experiment", table="[recording.torque]", key="columns", action="exchange", joints=joints
        )
    if item.code in ("position-sign", "joint-sign"):
        return Remedy(file="robot", table="[[joint]]", key="axis", action="turn", joints=joints)
    if item.code == "gravity":
        vector: Any = item.facts["vector"]
        return Remedy(file="robot", table="", key="gravity_m_s2", action="set", value=list(vector))
    if item.code == "twist-sign":
        return Remedy(file="robot", table="[[joint]]", key="alpha_deg", action="turn", joints=joints)
    if item.code == "link-length":
        key = str(item.facts["symbol"])
        return Remedy(file="robot", table="[[joint]]", key=key, action="set", value=item.value, joints=joints)
    if item.code == "dh-convention":
        value = "mdh" if item.facts.get("standard") else "dh"
        return Remedy(file="robot", table="", key="convention", action="set", value=value)
    return None


def _tie(tried: Tried) -> dict[str, Any]:
    item = tried.hypothesis
    return {
        "code": item.code,
        "joints": list(item.joints),
        "value": item.value,
        "facts": dict(item.facts),
        "effect": tried.decisive,
    }


def _friction(rows: Declared, tried: Tried) -> dict[str, float]:
    """Return the friction of a joint as declared, which would drive it."""
    names = {f"{kind}{joint}" for joint in tried.hypothesis.joints for kind in ("Fv", "Fc")}
    return {
        name: float(value)
        for name, value in zip(rows.names, rows.declared.beta, strict=True)
        if name.rstrip("+-") in names
    }
