"""The model of a robot in its recordings: payloads, own offsets and friction, and drive gains. Tested in ``tests/test_logs.py``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from .._tools.words import did_you_mean, listing
from ..errors import ExperimentError, FitError
from ..log.recording import Recording
from ..robot.correspondence import Pose
from ..robot.payload import NOTHING, Payload, payload_columns
from ..robot.robot import Robot
from .model import Model
from .share import ColumnBlock, Share, independent, payload_share

OWN: dict[Literal["offset", "friction"], tuple[str, tuple[str, ...]]] = {
    "offset": ("offsets", ("Off",)),
    "friction": ("friction", ("Fv", "Fc")),
}
"""Name in the file and kinds of parameters of what a recording may have of its own, by kind."""


def model_of(
    robot: Robot,
    recordings: Sequence[Recording] = (),
    payloads: Mapping[str, Payload] | None = None,
    flange: Pose | None = None,
    *,
    checked: bool = True,
) -> Model:
    """Return the model of a robot in its recordings, with all unknowns estimated.

    Parameters
    ----------
    robot : Robot
        The robot.
    recordings : sequence of Recording
        Recordings of the experiment: each names its payload and its own parameters.
    payloads : mapping of str to Payload, optional
        Known properties of the payloads.
    flange : 3 x 4 tuple of float, optional
        Pose of the flange (`didim.robot.payload.flange_in_last_frame`).
    checked : bool
        Refuse unknowns that cannot be separated from those of the robot; False if the robot is known.

    Raises
    ------
    ExperimentError
        For a payload that is not declared.
    FitError
        When the recordings to fit cannot separate an unknown from those of the robot.
    """
    fitted = {number: each for number, each in enumerate(recordings) if each.role == "fit"}
    shares = _payloads(robot, recordings, payloads or {}, flange)
    reference: dict[str, str] = {}
    for kind in OWN:
        shares += _own(robot, fitted, kind, reference if checked else None)
    if checked:
        _check(robot, fitted, shares)
    if any(recording.drives is not None for recording in fitted.values()):
        shares.append(_gains(robot, list(fitted.values())))
    return Model(robot, tuple(shares), reference=reference)


def _payloads(
    robot: Robot, recordings: Sequence[Recording], payloads: Mapping[str, Payload], flange: Pose | None
) -> list[Share]:
    used: dict[str, list[int]] = {}
    for number, recording in enumerate(recordings):
        if recording.payload == NOTHING:
            continue
        if recording.payload not in payloads:
            raise ExperimentError(
                f"{recording.name}: payload {recording.payload!r} is not described; add a table "
                f"[payload.{recording.payload}]{did_you_mean(recording.payload, payloads)}"
            )
        used.setdefault(recording.payload, []).append(number)
    shares = [
        payload_share(robot, payloads[name], numbers, payload_columns(robot, payloads[name], flange))
        for name, numbers in used.items()
    ]
    return [share for share in shares if share is not None]


def _own(
    robot: Robot,
    fitted: Mapping[int, Recording],
    kind: Literal["offset", "friction"],
    reference: dict[str, str] | None,
) -> list[Share]:
    """Return own offsets or friction of recordings.

    If all recordings have their own, those of the first are the robot's, unless the robot is known (no `reference`).
    """
    key, kinds = OWN[kind]
    owners = [(number, recording) for number, recording in fitted.items() if key in recording.own]
    if not owners:
        return []
    chosen = [k for k, each in enumerate(robot.standard_parameters) if each.kind in kinds]
    if not chosen:
        raise ExperimentError(
            f"{owners[0][1].name}: own {key} need friction with such parameters, which robot {robot.name!r} has not"
        )
    if reference is not None and len(owners) == len(fitted):
        reference[kind] = owners[0][1].name
        owners = owners[1:]
    names, units = robot.parameter_names, robot.parameter_units
    own_names, own_units = tuple(names[k] for k in chosen), tuple(units[k] for k in chosen)
    directions = np.eye(len(names))[:, chosen]
    return [
        Share(ColumnBlock(kind, recording.name, own_names, own_units), (number,), directions)
        for number, recording in owners
    ]


def _check(robot: Robot, fitted: Mapping[int, Recording], shares: Sequence[Share]) -> None:
    """Refuse unknowns that cannot be separated from those of the robot, naming the payload or the recording."""
    if not shares:
        return
    matrix = robot.base_parameters.matrix
    zero = np.zeros(len(matrix))
    shared = [np.concatenate([column] * len(fitted)) for column in np.eye(len(matrix))]
    own = [
        np.concatenate([matrix @ direction if number in share.recordings else zero for number in fitted])
        for share in shares
        for direction in share.directions.T
    ]
    separable = set(independent([*shared, *own]))
    names = [(share.block, name) for share in shares for name in share.block.names]
    lost = [names[k] for k in range(len(own)) if k + len(shared) not in separable]
    if not lost:
        return
    owner = lost[0][0].owner
    which = listing([name for block, name in lost if block.owner == owner], 30)
    if lost[0][0].kind != "payload":
        raise FitError(
            f"{which} of recording '{owner}' cannot be separated from those of the other recordings"
        )
    if not any(recording.payload == owner for recording in fitted.values()):
        raise FitError(
            f"no recording to fit has payload '{owner}', of which {which} are unknown: describe it under [payload], or fit "
            "a recording with it"
        )
    raise FitError(
        f"{which} of payload '{owner}' cannot be separated from the last link: every recording carries it; add one "
        "without it, or use `didim payload`"
    )


def _gains(robot: Robot, fitted: Sequence[Recording]) -> Share:
    """Return a drive gain for each motor; refuse recordings of which some have torques, or other motors."""
    for recording in fitted:
        if recording.drives != fitted[0].drives:
            raise FitError(
                f"recording '{recording.name}' and recording '{fitted[0].name}' do not both have currents of the "
                "same motors: drive gains are estimated from recordings of one kind"
            )
    units = tuple("N.m/A" if kind == "revolute" else "N/A" for kind in robot.joint_kinds)
    names = tuple(f"K{joint + 1}" for joint in range(robot.n_dof))
    return Share(
        ColumnBlock("gain", "", names, units), (), np.zeros((len(robot.parameter_names), robot.n_dof))
    )
