"""Parameters of several logs: blocks of columns in addition to the base parameters of the robot.

    beta_l = beta + B (v_l + V_l theta)          base parameters of log l
    Y_l = W_l beta_l + rho_l

``V_l`` has a column for each unknown of log l's payload, and for each of its own offsets and friction coefficients; ``v_l`` is
the known part of its payload; ``B`` is the matrix of the base parameters. The columns of all blocks are thus combinations of
the columns of W, along measured or simulated motion. An extended vector has the parameters of the robot first, base (b) or
standard (p), and then the e further ones. Tested in ``tests/test_logs.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..._tools.arrays import Array
from ..._tools.words import did_you_mean, listing
from ...errors import ExperimentError, FitError
from ...log.recording import Recording
from ...robot.correspondence import Pose
from ...robot.payload import NOTHING, UNITS, Payload, payload_columns
from ...robot.robot import Robot
from ..selection import Role, Selection, select

Kind = Literal["payload", "offset", "friction", "gain"]

ESTIMATED: Role = "estimated"
DEPENDENT_COLUMN = 1e-9
"""Norm of a unit column's component orthogonal to the others below which it depends on them: rounding."""


@dataclass(frozen=True)
class ColumnBlock:
    """A group of further parameters.

    Attributes
    ----------
    kind : {"payload", "offset", "friction", "gain"}
        Kind of the parameters.
    owner : str
        Their payload or recording; empty for gains.
    names, units : tuple of str
        Names and units of the parameters, without their owner: ``MX``, ``Off3``, ``K1``.
    complete : bool
        Whether they are all unknowns of their owner. A planar arm does not identify all ten of a payload; its pseudo-inertia is
        then unknown and unconstrained.
    """

    kind: Kind
    owner: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    complete: bool = True

    @property
    def full_names(self) -> tuple[str, ...]:
        """Names of the columns, prefixed by the owner: ``disc.MX``."""
        return tuple(f"{self.owner}.{name}" if self.owner else name for name in self.names)


@dataclass(frozen=True, eq=False)
class LogParameters:
    """Parameters of the robot and of its logs.

    Attributes
    ----------
    robot : Robot
        The robot.
    blocks : tuple of ColumnBlock
        Further parameters, in the order of their columns.
    columns : mapping of int to (p, e) array
        Contribution of the further parameters to the standard parameters, by recording; only for recordings with any.
    known : mapping of int to (p,) array
        Known part of the payloads, by recording.
    reference : mapping of str to str
        Recording whose offsets (friction) are those of the robot, by kind; the blocks of others are differences from it.
    """

    robot: Robot
    blocks: tuple[ColumnBlock, ...]
    columns: Mapping[int, Array]
    known: Mapping[int, Array]
    reference: Mapping[str, str]

    @classmethod
    def of(
        cls,
        robot: Robot,
        recordings: Sequence[Recording] = (),
        payloads: Mapping[str, Payload] | None = None,
        flange: Pose | None = None,
        *,
        checked: bool = True,
    ) -> LogParameters:
        """Find the blocks of an experiment.

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
            Refuse further parameters that cannot be separated from those of the robot; False if all are known.

        Raises
        ------
        ExperimentError
            For a payload that is not declared.
        FitError
            When the recordings to fit cannot separate a further parameter from those of the robot.
        """
        payloads = payloads or {}
        if not any(
            recording.payload != NOTHING or recording.own or recording.drives is not None
            for recording in recordings
        ):
            return cls(robot, (), {}, {}, {})
        builder = _Builder(robot, recordings)
        builder.payloads(payloads, flange)
        for kind in ("offset", "friction"):
            builder.own(kind, referred=checked)
        if checked:
            builder.check()
        if any(recording.drives is not None for recording in recordings if recording.role == "fit"):
            builder.gains()
        return builder.built()

    @property
    def n_base(self) -> int:
        """Number of base parameters."""
        return len(self.robot.base_parameters.names)

    @property
    def n_further(self) -> int:
        """Number of further parameters."""
        return sum(len(block.names) for block in self.blocks)

    @property
    def simple(self) -> bool:
        """Whether the logs only have the parameters of the robot."""
        return not self.blocks and not self.known

    @property
    def n_gains(self) -> int:
        """Number of drive gains among the further parameters; they are the last."""
        return sum(len(block.names) for block in self.blocks if block.kind == "gain")

    @property
    def further_names(self) -> tuple[str, ...]:
        """Names of the further parameters."""
        return tuple(name for block in self.blocks for name in block.full_names)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the base parameters and the further ones."""
        return (*self.robot.base_parameters.names, *self.further_names)

    def slices(self) -> list[tuple[ColumnBlock, slice]]:
        """Return each block with its slice of the further parameters."""
        slices, start = [], 0
        for block in self.blocks:
            slices.append((block, slice(start, start + len(block.names))))
            start += len(block.names)
        return slices

    def select(self, fixed: Mapping[str, float], dropped: Sequence[str]) -> Selection:
        """Return the roles of all parameters; further ones are estimated, known ones are declared in ``[payload]``."""
        chosen = select(self.robot, fixed, dropped)
        return Selection(
            roles=chosen.roles + (ESTIMATED,) * self.n_further,
            values=np.concatenate([chosen.values, np.zeros(self.n_further)]),
        )

    def lift(self, beta: Array) -> Array:
        """Return extended standard parameters, (p + e,), of extended base parameters, (b + e,)."""
        standard = self.robot.base_parameters.lift(beta[: self.n_base])
        return np.concatenate([standard, beta[self.n_base :]])

    def project(self, x: Array) -> Array:
        """Return extended base parameters, (b + e,), of extended standard ones, (p + e,)."""
        p = len(self.robot.parameter_names)
        return np.concatenate([self.robot.base_parameters.project(x[:p]), x[p:]])

    def standard(self, x: Array, recording: int) -> Array:
        """Return the standard parameters (..., p) of the robot in a recording, of extended ones, (..., p + e)."""
        p = len(self.robot.parameter_names)
        own = x[..., :p]
        if recording in self.columns:
            own = own + x[..., p:] @ self.columns[recording].T
        if recording in self.known:
            own = own + self.known[recording]
        return np.ascontiguousarray(own)

    def base(self, beta: Array, recording: int) -> Array:
        """Return the base parameters (b,) of the robot in a recording, of extended ones, (b + e,)."""
        return np.asarray(self.robot.base_parameters.matrix @ self.standard(self.lift(beta), recording))

    def base_columns(self, recording: int) -> Array:
        """Return the contribution of the further parameters to the base parameters in a recording, (b, e)."""
        if recording not in self.columns:
            return np.zeros((self.n_base, self.n_further))
        return np.asarray(self.robot.base_parameters.matrix @ self.columns[recording])

    def base_known(self, recording: int) -> Array:
        """Return the contribution of the payload's known part to the base parameters, (b,)."""
        matrix = self.robot.base_parameters.matrix
        return np.asarray(matrix @ self.known.get(recording, np.zeros(matrix.shape[1])))

    def extended(self, x: Array, further: Mapping[str, float] | None = None) -> Array:
        """Return standard parameters, (p,) or already extended, with further ones by name; those without a value are zero."""
        p = len(self.robot.parameter_names)
        if len(x) == p + self.n_further:
            return x
        values = further or {}
        return np.concatenate([x[:p], [values.get(name, 0.0) for name in self.further_names]])


class _Builder:
    """Builder of the blocks of an experiment."""

    def __init__(self, robot: Robot, recordings: Sequence[Recording]) -> None:
        self.robot, self.recordings = robot, recordings
        self.fitted = {number: each for number, each in enumerate(recordings) if each.role == "fit"}
        self.blocks: list[ColumnBlock] = []
        self.directions: list[tuple[Array, tuple[int, ...]]] = []
        self.known: dict[int, Array] = {}
        self.reference: dict[str, str] = {}

    def payloads(self, payloads: Mapping[str, Payload], flange: Pose | None) -> None:
        """Add the payloads of recordings."""
        used: dict[str, list[int]] = {}
        for number, recording in enumerate(self.recordings):
            if recording.payload == NOTHING:
                continue
            if recording.payload not in payloads:
                raise ExperimentError(
                    f"{recording.name}: payload {recording.payload!r} is not described; add a table "
                    f"[payload.{recording.payload}]{did_you_mean(recording.payload, payloads)}"
                )
            used.setdefault(recording.payload, []).append(number)
        for name, numbers in used.items():
            known, columns, names = payloads[name].split
            transform = payload_columns(self.robot, payloads[name], flange)
            if known.any():
                self.known |= dict.fromkeys(numbers, transform @ known)
            by_body = [transform @ column for column in columns.T]
            effects = [self.robot.base_parameters.matrix @ column for column in by_body]
            # A planar arm does not identify or separate some of the ten.
            chosen = independent(effects)
            if chosen:
                block = tuple(names[index] for index in chosen)
                units = tuple(UNITS[name] for name in block)
                self.blocks.append(ColumnBlock("payload", name, block, units, len(chosen) == len(names)))
                self.directions += [(by_body[index], tuple(numbers)) for index in chosen]

    def own(self, kind: Literal["offset", "friction"], *, referred: bool) -> None:
        """Add the own offsets or friction of recordings.

        If all recordings have their own, those of the first are the robot's, unless the robot is known (`referred` is False).
        """
        key = {"offset": "offsets", "friction": "friction"}[kind]
        owners = [(number, recording) for number, recording in self.fitted.items() if key in recording.own]
        if not owners:
            return
        kinds = ("Off",) if kind == "offset" else ("Fv", "Fc")
        chosen = [k for k, each in enumerate(self.robot.standard_parameters) if each.kind in kinds]
        if not chosen:
            raise ExperimentError(
                f"{owners[0][1].name}: own {key} need friction with such parameters, which robot {self.robot.name!r} has not"
            )
        if referred and len(owners) == len(self.fitted):
            self.reference[kind] = owners[0][1].name
            owners = owners[1:]
        names, units = self.robot.parameter_names, self.robot.parameter_units
        own_names, own_units = tuple(names[k] for k in chosen), tuple(units[k] for k in chosen)
        for number, recording in owners:
            self.blocks.append(ColumnBlock(kind, recording.name, own_names, own_units))
            self.directions += [(direction, (number,)) for direction in np.eye(len(names))[chosen]]

    def check(self) -> None:
        """Refuse further parameters that cannot be separated from those of the robot.

        Raises
        ------
        FitError
            Naming the payload or the recording.
        """
        if not self.directions:
            return
        matrix = self.robot.base_parameters.matrix
        zero = np.zeros(len(matrix))
        shared = [np.concatenate([column] * len(self.fitted)) for column in np.eye(len(matrix))]
        own = [
            np.concatenate([matrix @ direction if number in numbers else zero for number in self.fitted])
            for direction, numbers in self.directions
        ]
        independent_columns = set(independent([*shared, *own]))
        names = [(block, name) for block in self.blocks for name in block.names]
        lost = [names[k] for k in range(len(own)) if k + len(shared) not in independent_columns]
        if not lost:
            return
        owner = lost[0][0].owner
        which = listing([name for block, name in lost if block.owner == owner], 30)
        if lost[0][0].kind == "payload":
            if not any(recording.payload == owner for recording in self.fitted.values()):
                raise FitError(
                    f"no recording to fit has payload '{owner}', of which {which} are unknown: describe it under [payload], or fit "
                    "a recording with it"
                )
            raise FitError(
                f"{which} of payload '{owner}' cannot be separated from the last link: every recording carries it; add one "
                "without it, or use `didim payload`"
            )
        raise FitError(
            f"{which} of recording '{owner}' cannot be separated from those of the other recordings"
        )

    def gains(self) -> None:
        """Add a drive gain for each motor.

        Raises
        ------
        FitError
            When some recordings to fit have torques, or other motors.
        """
        fitted = list(self.fitted.values())
        for recording in fitted:
            if recording.drives != fitted[0].drives:
                raise FitError(
                    f"recording '{recording.name}' and recording '{fitted[0].name}' do not both have currents of the "
                    "same motors: drive gains are estimated from recordings of one kind"
                )
        n = self.robot.n_dof
        units = ["N.m/A" if kind == "revolute" else "N/A" for kind in self.robot.joint_kinds]
        self.blocks.append(ColumnBlock("gain", "", tuple(f"K{j + 1}" for j in range(n)), tuple(units)))
        self.directions += [(np.zeros(len(self.robot.parameter_names)), ())] * n

    def built(self) -> LogParameters:
        """Return the assembled blocks."""
        columns: dict[int, Array] = {}
        for number in range(len(self.recordings)):
            used = [number in numbers for _, numbers in self.directions]
            if any(used):
                columns[number] = np.stack([direction for direction, _ in self.directions], axis=1) * used
        return LogParameters(self.robot, tuple(self.blocks), columns, self.known, self.reference)


def independent(vectors: Sequence[Array]) -> list[int]:
    """Return the vectors that are independent of the preceding ones."""
    basis: list[Array] = []
    chosen = []
    for index, vector in enumerate(vectors):
        size = np.linalg.norm(vector)
        if not size > 0.0:
            continue
        rest = vector / size
        for _ in range(2):  # repeated because of rounding
            for other in basis:
                rest = rest - other * (other @ rest)
        left = np.linalg.norm(rest)
        if left > DEPENDENT_COLUMN:
            basis.append(rest / left)
            chosen.append(index)
    return chosen
