"""Source of an export: robot and parameters of a result, of a file, or of a set. Tested in ``tests/test_export.py``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from .._tools.arrays import Array
from .._tools.words import did_you_mean, series
from ..errors import FitError
from ..result.identification import Identification
from ..robot.friction import Friction
from ..robot.parameter_file import is_file, load_parameters
from ..robot.payload import carrying_joint, payload_columns
from ..robot.robot import Robot
from ..robot.robot_file import PACKAGED, load_robot
from ..robot.urdf.reading import file_set
from .bodies import PLACED, export_model
from .consistent import consistent_parameters, inertial_of, links_between, parameters_from_prior


@dataclass(frozen=True, eq=False)
class Source:
    """Robot and parameters to be exported.

    Attributes
    ----------
    robot : Robot
        The robot.
    x : (n_parameters,) array
        Standard parameters.
    notes : tuple of str
        Sentences on the origin of the parameters, and on a result that is not sound.
    from_prior : mapping of int to tuple of str
        For each link (from 0), its standard parameters that come from a prior.
    """

    robot: Robot
    x: Array
    notes: tuple[str, ...] = ()
    from_prior: Mapping[int, tuple[str, ...]] = field(default_factory=dict)


def exported_parameters(
    *,
    fit: Path | None,
    parameters: str | None,
    robot: str | None,
    urdf: Path | None,
    prior: str | None = None,
    further_terms: bool = False,
    payload: str | None = None,
) -> Source:
    """Find robot and parameters for ``didim export``.

    Parameters
    ----------
    fit : Path or None
        Result of an identification.
    parameters : str or None
        Alternative: a file of parameters, or a set of the robot.
    robot : str or None
        Robot; by default the file used for the result, or the URDF itself.
    urdf : Path or None
        The URDF or MJCF that is edited.
    prior : str, optional
        Prior of the physically consistent parameters, see `consistent_parameters`. Without one, a result's parameters are
        exported unchanged if they belong to bodies.
    further_terms : bool
        Export the friction of a result with its smoothing and dead zones, for formats that have a place for them.
    payload : str, optional
        Payload of the result that becomes a part of the link which carries it, or "none". By default none, and a note says so.

    Raises
    ------
    FitError
        When the robot is not found or is not that of the result, no consistent parameters are near the result, or it has no such
        payload.
    RobotError
        When the robot cannot be read, or has no such set.
    OSError
        When a file cannot be read.
    """
    if fit is None:
        assert parameters is not None
        if robot is None and urdf is None:
            raise FitError("which robot has these parameters? Say --robot ROBOT")
        model = load_robot(urdf if robot is None else robot)  # type: ignore[arg-type]
        x = load_parameters(model, parameters) if is_file(parameters) else model.parameter_set(parameters)
        return Source(model, x, model.notes)
    result = Identification.load(fit)
    model = fitted_robot(result, fit, robot, urdf, as_fitted=further_terms)
    x, notes = _by_name(result, result.parameters, model, fit)
    if not result.verdict.sound:
        notes.insert(0, f"{fit.name}: {result.verdict.sentence}")
    load, about = carried(result, model, payload)
    empty = links_between(model) if urdf is not None else ()
    full = x[inertial_of(model, empty)].any()
    if prior is None and not full and _are_bodies(model, x) and not _open_to(result, model):
        told: Mapping[int, tuple[str, ...]] = parameters_from_prior(result, model)
    else:
        chosen = consistent_parameters(result, model, prior, empty)
        x, _ = _by_name(result, chosen.x, model, fit)
        told = chosen.from_prior
        notes.append(
            f"physically consistent parameters near the prior {chosen.prior!r}: {chosen.sigmas:.2g} standard deviations rms from "
            "the estimate"
        )
    return Source(model, x + load, (*model.notes, *notes, *about), told)


def carried(fit: Identification, robot: Robot, payload: str | None) -> tuple[Array, list[str]]:
    """Return what a payload adds to the standard parameters of a robot, (p,), and sentences on the payloads of a result.

    Raises
    ------
    FitError
        For a payload that the result does not have (``tests/test_export_payload.py``).
    """
    known = {} if fit.further is None else dict(fit.further.payloads)
    if payload not in (None, "none") and payload not in known:
        has = f"it has {series(known, 30)}" if known else "it has none"
        raise FitError(f"the result has no payload {payload!r}: {has}{did_you_mean(str(payload), known)}")
    load, sentences = np.zeros(len(robot.parameter_names)), list[str]()
    for name, each in known.items():
        assert fit.further is not None
        ten, _ = fit.further.ten(name)
        mass = f"payload '{name}' ({ten[9]:.3g} kg)"
        if name == payload:
            load = payload_columns(robot, each, fit.further.flange) @ ten
            sentences.append(f"{mass} is a part of {robot.joint_label(carrying_joint(robot, each))}'s link")
        else:
            more = "" if payload else f"; --payload {name} makes it a part of its link"
            sentences.append(f"{mass} is left out{more}")
    return load, sentences


def fitted_robot(
    fit: Identification, path: Path, given: str | None, urdf: Path | None = None, *, as_fitted: bool = False
) -> Robot:
    """Return the robot of a result, or the one given, with the friction that its base parameters need.

    `path` is the file of the result, and `urdf` the URDF or MJCF that is edited; `as_fitted` takes the friction's sign and dead
    zones too.
    """
    robot = _candidate(fit, path, urdf) if given is None else load_robot(given)
    saved = fit.robot_record.get("friction", {})
    options = {key: saved[key] for key in ("model", "coulomb", "coupling") if key in saved}
    if options.get("coulomb") == "tanh":  # the friction near standstill does not affect the set of parameters
        options["coulomb"] = "sign"
    robot = robot.with_friction(**options)
    if saved.get("terms"):
        robot = robot.with_terms(Friction.terms_of(saved["terms"]))
    if as_fitted and {"coulomb", "smoothing", "dead_zone"}.issubset(saved):
        smoothing, dead_zone = (tuple(map(float, saved[key])) for key in ("smoothing", "dead_zone"))
        shape = replace(robot.friction, coulomb=saved["coulomb"], smoothing=smoothing, dead_zone=dead_zone)
        robot = replace(robot, friction=shape)
    return robot


def _candidate(fit: Identification, path: Path, urdf: Path | None) -> Robot:
    """Find the robot file by name and digest: beside the result, the URDF, here, or among the included robots."""
    names = [key.removeprefix("robot ") for key in fit.digests if key.startswith("robot ")]
    folders = [path.parent, *([] if urdf is None else [urdf.parent]), Path(), PACKAGED]
    other = None
    for name in names:
        for folder in folders:
            file = folder / name
            if not file.is_file():
                continue
            candidate = load_robot(file)
            if candidate.digest == fit.digests[f"robot {name}"]:
                return candidate
            other = file
    if other is not None:
        raise FitError(
            f"{other} has changed since {path.name} was made with it; identify again, or say --robot ROBOT to take it all the same"
        )
    wanted = f"its robot file {names[0]!r} is" if names else "its robot is"
    raise FitError(f"{path.name}: {wanted} not beside it; say where it is: --robot ROBOT")


def _by_name(fit: Identification, x: Array, robot: Robot, path: Path) -> tuple[Array, list[str]]:
    """Return standard parameters in the order of the robot, and a sentence on further friction terms of the result."""
    values = dict(zip(fit.parameter_names, x.tolist(), strict=True))
    missing = next((name for name in robot.parameter_names if name not in values), None)
    if missing is not None:
        raise FitError(
            f"{path.name}: it has no parameter {missing!r} of robot {robot.name!r}; is it of another robot?"
        )
    further = [name for name in fit.parameter_names if name not in robot.parameter_names]
    other = next((name for name in further if PLACED.fullmatch(name)), None)
    if other is not None:
        raise FitError(
            f"{path.name}: it has parameter {other!r}, which robot {robot.name!r} has not; is it of another robot?"
        )
    left = [name for name in further if values[name]]
    notes = [f"further friction terms are left out: {series(left)}"] if left else []
    return np.array([values[name] for name in robot.parameter_names]), notes


def _open_to(result: Identification, robot: Robot) -> bool:
    """Whether bodies of a result have a generic prior where the robot's own file says more."""
    own = result.settings.get("consistent", {}).get("prior")
    own_names = result.names == robot.base_parameters.names
    return own_names and file_set(robot) is not None and own in (None, "generic") and bool(result.std.any())


def _are_bodies(robot: Robot, x: Array) -> bool:
    """Whether parameters belong to bodies without any change."""
    try:
        model = export_model(robot, x)
        for key in ("rotor", "viscous", "coulomb"):
            model.own_share(key)
    except FitError:
        return False
    return True
