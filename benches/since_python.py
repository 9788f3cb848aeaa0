"""Rows of `since_0_2_0.py` that Python shows, with names that both versions have."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module

import numpy as np
from since_observe import RATE_HZ, TREE, arrays, module, motion, smooth

import didim
from didim.robot.friction import FrictionTerm
from didim.robot.payload import Payload


def load_friction() -> str:
    """Torques of the wrong sign, load friction on a joint."""
    robot = didim.load_robot("planar2").with_terms([FrictionTerm(law="load", joint=0)])
    experiment = arrays(robot)
    (item,) = experiment.recordings
    assert item.tau is not None
    try:
        fit = didim.identify(replace(experiment, recordings=(replace(item, tau=-item.tau),)))
    except didim.DidimError as reason:
        return f"refused: {str(reason).partition(': ')[2]}"
    return f"a result, {'with' if any('M(q)' in text for text in fit.warnings) else 'without'} a flag on M(q)"


def friction_picture() -> str:
    """Two logs, one with a load of 0.8 kg: root mean square of the dots beside the line."""
    from didim.robot.payload import last_link
    from didim.studies.friction_curve import friction_curves

    robot = smooth()
    experiment = arrays()
    (item,) = experiment.recordings
    ten = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.012, 0.2, 0.05, 0.0, 0.8])
    x = robot.parameter_set("reference")
    dq = np.gradient(item.q, axis=0) * RATE_HZ
    ddq = np.gradient(dq, axis=0) * RATE_HZ
    extra = didim.inverse_dynamics(robot, item.q, dq, ddq, x + last_link(robot, np.eye(4)) @ ten)
    extra -= didim.inverse_dynamics(robot, item.q, dq, ddq, x)
    assert item.tau is not None
    heavy = replace(item, name="loaded", payload="disc", tau=item.tau + extra)
    both = replace(experiment, recordings=(item, heavy), payloads={"disc": Payload(name="disc")})
    fit = didim.identify(both)
    errors = [
        curve.measured - np.interp(curve.measured_speed, curve.speed, curve.torque)
        for curve in friction_curves(fit, both)
    ]
    return f"dots {np.sqrt(np.mean(np.square(errors))):.2f} N.m from the line, rms"


def dead_torques() -> str:
    """All torques zero; the torque of joint 2 constant."""
    _, _, tau = motion()
    answers = []
    for values in (0.0 * tau, np.where(np.arange(2) == 1, 2.0, tau)):
        try:
            kinds = {finding.kind for finding in didim.check(arrays(tau=values))}
            answers.append("named" if "constant-torque" in kinds else "not named")
        except Exception as error:
            answers.append(type(error).__name__)
    return f"zero: {answers[0]}, constant: {answers[1]}"


def changed_payload() -> str:
    """A load that the experiment does not declare, weighed by two commands."""
    residual = module("studies.loads.residual").residual_torques
    weighed = module("studies.loads.payload").identify_payload
    sys.path.insert(0, str(TREE / "tests"))
    logs = import_module("test_payload")
    robot = didim.load_robot("tx40")
    fit = didim.identify(logs.tx40_log(robot.parameter_set("didim"), 1))
    heavy = logs.loaded(8)
    change = residual(fit, heavy).windows[0].payload_change
    ratio = weighed(fit, heavy).std[9] / change.std[9]
    return f"its deviation is {'that' if abs(ratio - 1.0) < 1e-6 else f'1/{ratio:.1f}'} of `payload`"


def limits_of_the_tx40() -> str:
    """Position limits in the packaged file."""
    known = sum(limit.position is not None for limit in didim.load_robot("tx40").limits)
    return f"{known} of 6 joints"


def packaged_comparison() -> str:
    """CLOE by Levenberg and Marquardt on the packaged experiment, seed 0."""
    compared = didim.compare("tx40", methods=[didim.CLOE()], seed=0)
    ((name, _),) = compared.fits.items()
    off = compared.deviations(name)
    return f"largest error {np.nanmax(np.abs(off)):.1f} sigma"


def other_friction() -> str:
    """`validate` with other friction, `to_c` with a result, a start by standard names."""
    experiment = arrays()
    fit = didim.identify(experiment)
    answers = []
    asymmetric = replace(experiment, robot=smooth().with_friction(model="asymmetric"))
    start = module("methods.start").standard_start
    robot = smooth()
    named = dict(zip(robot.parameter_names, robot.parameter_set("reference").tolist(), strict=True))
    calls: tuple[tuple[Callable[[], object], str], ...] = (
        (lambda: didim.validate(fit, asymmetric), "Fc1+"),
        (lambda: didim.to_c(robot, fit), "fit.parameters"),  # type: ignore[attr-defined]
        (lambda: start(robot, named), ""),
    )
    for call, wanted in calls:
        try:
            call()
            answers.append(True)
        except didim.DidimError as reason:
            answers.append(bool(wanted) and wanted in str(reason))
    return f"{sum(answers)} of {len(answers)} answered"


def gravity() -> str:
    """Torques of gravity by their name."""
    call = getattr(didim, "gravity", None)
    if call is None:
        return "no such name"
    robot = smooth()
    torque = call(robot, np.zeros((1, 2)), robot.parameter_set("reference"))
    return f"didim.gravity, shape {torque.shape}"
