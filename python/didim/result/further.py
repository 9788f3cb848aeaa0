"""Further parameters of a result: payloads, own offsets and friction of recordings, drive gains.

Tested in ``tests/test_logs.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .._tools.arrays import Array
from .._tools.pickling import Pickled, make_read_only
from .._tools.saved import plain, restored, rows
from ..robot.correspondence import Pose
from ..robot.payload import Payload
from ..terms.share import ColumnBlock
from .table import Estimates, parameter_lines, parameter_rows

TITLES = {
    "payload": "payload '{owner}', on {link}",
    "offset": "offsets of recording '{owner}'",
    "friction": "friction of recording '{owner}'",
    "gain": "drive gains",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Further(Pickled):
    """Estimates of the further parameters of several logs.

    Attributes
    ----------
    blocks : tuple of ColumnBlock
        Groups of the parameters, in the order of `values`.
    values : (e,) array
        Estimates: inertial parameters of payloads about the flange, differences of offsets and friction from those of the robot,
        and drive gains.
    covariance : (b + e, b + e) array
        Joint covariance of the robot's base parameters and these; zero if no standard deviations are known.
    std_white : (e,) array
        Standard deviations as if the errors of all rows were independent.
    payloads : mapping of str to Payload
        Known properties of each payload.
    reference : mapping of str to str
        Recording whose offsets (friction) are those of the robot, by kind.
    flange : 3 x 4 tuple of float, or None
        Pose of the flange in the robot's last own frame, where the experiment gives one.
    """

    blocks: tuple[ColumnBlock, ...]
    values: Array
    covariance: Array
    std_white: Array
    payloads: Mapping[str, Payload] = field(default_factory=dict)
    reference: Mapping[str, str] = field(default_factory=dict)
    flange: Pose | None = None

    def __post_init__(self) -> None:
        make_read_only(self, ("values", "covariance", "std_white"), ("payloads", "reference"))

    @property
    def names(self) -> tuple[str, ...]:
        """Names with their owners: ``disc.MX``."""
        return tuple(name for block in self.blocks for name in block.full_names)

    @property
    def units(self) -> tuple[str, ...]:
        """Units, SI, joint side; drive gains are on the side of the log."""
        return tuple(unit for block in self.blocks for unit in block.units)

    @property
    def std(self) -> Array:
        """Standard deviations, (e,)."""
        variances = np.diag(self.covariance)
        return np.asarray(np.sqrt(variances[len(variances) - len(self.values) :]))

    @property
    def by_name(self) -> dict[str, float]:
        """Estimates by name."""
        return dict(zip(self.names, self.values.tolist(), strict=True))

    def part(self, kind: str, owner: str = "") -> slice:
        """Return the slice of a block among the values; empty for a missing block."""
        start = 0
        for block in self.blocks:
            stop = start + len(block.names)
            if (block.kind, block.owner) == (kind, owner):
                return slice(start, stop)
            start = stop
        return slice(0, 0)

    @property
    def gains(self) -> Array | None:
        """Drive gains (n_dof,), or None."""
        part = self.part("gain")
        return self.values[part] if part.stop else None

    def covariance_of(self, part: slice) -> Array:
        """Return the covariance of some of the values."""
        b = len(self.covariance) - len(self.values)
        rows = slice(b + part.start, b + part.stop)
        return self.covariance[rows, rows]

    def ten(self, name: str) -> tuple[Array, Array]:
        """Return the ten inertial parameters of a payload about the flange, (10,), and their covariance, (10, 10).

        Unidentifiable parameters are zero.

        Raises
        ------
        KeyError
            For a payload that the result does not have.
        """
        known, columns, names = self.payloads[name].split
        part = self.part("payload", name)
        blocks = [block for block in self.blocks if (block.kind, block.owner) == ("payload", name)]
        chosen = columns[:, [names.index(label) for label in blocks[0].names]] if blocks else columns[:, :0]
        return known + chosen @ self.values[part], chosen @ self.covariance_of(part) @ chosen.T

    def tables(self, factor: float) -> list[tuple[list[str], list[tuple[str, ...]]]]:
        """Return the lines above each block and the cells of its table, intervals half as wide as `factor` standard deviations.

        The cells are those of `didim.result.table.parameter_rows`, heading included.
        """
        tables = []
        for block in self.blocks:
            part, roles = self.part(block.kind, block.owner), ("estimated",) * len(block.names)
            columns = self.values[part], self.std[part], self.std_white[part]
            rows = parameter_rows(Estimates(block.names, block.units, roles, *columns, factor), {})
            tables.append((self._titles(block), rows))
        return tables

    def value_rows(self, factor: float) -> list[dict[str, Any]]:
        """Return a row of each parameter for a data frame, intervals half as wide as `factor` standard deviations.

        The keys are those of the parameters of a result in JSON, and ``group``: "payload", "offset", "friction" or "gain".
        """
        columns = ("estimated",) * len(self.values), self.values, self.std, self.std_white
        rows = Estimates(self.names, self.units, *columns, factor).value_rows()
        groups = (block.kind for block in self.blocks for _ in block.names)
        return [{**row, "group": group} for row, group in zip(rows, groups, strict=True)]

    def lines(self, factor: float) -> list[str]:
        """Return the lines of a printed result, intervals half as wide as `factor` standard deviations."""
        return [
            line for titles, rows in self.tables(factor) for line in ("", *titles, *parameter_lines(rows))
        ]

    def _titles(self, block: ColumnBlock) -> list[str]:
        payload = self.payloads.get(block.owner)
        link = "the flange" if payload is None or payload.link is None else f"link {payload.link}"
        title = TITLES[block.kind].format(owner=block.owner, link=link)
        if block.kind in ("offset", "friction"):
            reference = self.reference.get(block.kind)
            title += f", less those of {'the other recordings' if reference is None else repr(reference)}"
        lines = [title]
        if block.kind == "payload" and payload is not None:
            if payload.mass_kg is not None:
                lines = [f"{title}, of known mass {payload.mass_kg:g} kg"]
            ten, covariance = self.ten(block.owner)
            if ten[9] > 0.0 and "MX" in block.names:
                centre = ten[6:9] / ten[9]
                # c = l / m, with the error of the mass unless it is known
                derivative = np.hstack([np.eye(3), -centre[:, None]]) / ten[9]
                std = np.sqrt(np.maximum(np.diag(derivative @ covariance[6:, 6:] @ derivative.T), 0.0))
                where = ", ".join(
                    f"{1e3 * value:.1f} +- {1e3 * sigma:.1f}"
                    for value, sigma in zip(centre, std, strict=True)
                )
                lines.append(f"centre of mass: {where} mm")
        return lines

    def to_dict(self) -> dict[str, Any]:
        """Return the values as JSON data."""
        columns = rows(
            name=self.names, unit=self.units, value=self.values, std=self.std, std_white=self.std_white
        )
        data: dict[str, Any] = plain(self)
        del data["values"], data["std_white"]
        return {**data, "parameters": columns}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Further:
        """Restore the values from `to_dict`."""
        columns = data["parameters"]
        values = {
            "values": [row["value"] for row in columns],
            "std_white": [row["std_white"] for row in columns],
        }
        fields = {key: value for key, value in data.items() if key != "parameters"}
        made: Further = restored(cls, {**fields, **values})
        return made
