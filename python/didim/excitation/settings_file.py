"""The file of a design, ``excite.toml``. Unknown keys are errors with a suggestion.

    schema = 1
    [excitation]
    duration_s = 10
    harmonics = 20
    torque_noise_n_m = 0.5
    prior = ["fit.json"]
    [limits]
    max_acceleration_rad_s2 = [25, 25, 35, 60, 60, 90]
    [workspace]
    floor_m = 0.0
    [[collision]]
    link = 3
    from_m = [0, 0, 0]
    to_m = [0.39, 0, 0]
    radius_m = 0.06

Tested in ``tests/test_excitation_files.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .._tools.keys import declared
from .._tools.toml import Table, read_toml
from ..errors import ExcitationError
from ..log.units import POSITION, kind_of, optional_joint_values
from ..robot.collision import read_capsules
from ..robot.parameter_file import is_file
from ..robot.robot import Robot
from .clearance import Workspace
from .settings import ExcitationSettings


def read_excitation(path: str | Path, robot: Robot) -> ExcitationSettings:
    """Read the file of a design.

    Parameters
    ----------
    path : str or Path
        The file; paths in it are relative to its folder.
    robot : Robot
        Robot with the number of joints and their kinds.

    Raises
    ------
    ExcitationError
        For a file that cannot be read, an unknown key, and a wrong value; one sentence.
    """
    path = Path(path)
    table = Table(read_toml(path, ExcitationError), path.name, ExcitationError, keys=declared("excitation"))
    if table.integer("schema") != 1:
        raise ExcitationError(f"{path.name}: schema must be 1")
    main = table.part("excitation")
    settings: dict[str, Any] = {"wanted": (), **main.given()}
    for key, name in (("for", "wanted"), ("smoothing_rad_s", "smoothing")):
        if key in settings:
            settings[name] = settings.pop(key)
    for key in ("start", "home"):
        settings[key] = optional_joint_values(main, key, robot)
    settings["torque_noise"] = _forces(main, "torque_noise", robot)
    if is_file(settings.get("parameters", "")):
        settings["parameters"] = str(path.parent / settings["parameters"])
    if "noise_of" in settings:
        settings["noise_of"] = path.parent / settings["noise_of"]
    settings["prior"] = tuple(path.parent / name for name in settings.get("prior", ()))
    main.done()
    limits = table.part("limits")
    low: list[float | None] = [None] * robot.n_dof
    high: list[float | None] = [None] * robot.n_dof
    for unit, factor in POSITION.items():
        rows = limits.matrix(f"position_{unit}", robot.n_dof, 2, None)
        for joint, row in enumerate(rows or ()):
            if robot.joint_kinds[joint] == kind_of(unit):
                low[joint], high[joint] = row[0] * factor, row[1] * factor
    lowest, highest = _complete(limits, "position", low), _complete(limits, "position", high)
    settings["position"] = None
    if lowest is not None and highest is not None:
        settings["position"] = list(zip(lowest, highest, strict=True))
    for key, per in (("velocity", "_s"), ("acceleration", "_s2"), ("jerk", "_s3")):
        settings[key] = optional_joint_values(limits, f"max_{key}", robot, per)
    settings["torque"] = _forces(limits, "max_torque", robot)
    limits.done()
    workspace = table.part("workspace")
    settings["workspace"] = Workspace(
        lowest=_corner(workspace, "lowest_m"),
        highest=_corner(workspace, "highest_m"),
        floor=workspace.number("floor_m", None),
        clearance=workspace.number("clearance_m"),
    )
    workspace.done()
    settings["capsules"] = read_capsules(table.tables("collision"), robot.n_dof)
    settings["friction"] = table.part("friction").content
    table.done()
    return table.checked(lambda: ExcitationSettings(**settings))


def _corner(table: Table, key: str) -> tuple[float, float, float] | None:
    values = table.numbers(key, length=3, default=None)
    return None if values is None else (values[0], values[1], values[2])


def _forces(table: Table, key: str, robot: Robot) -> list[float] | None:
    """Read one number per joint of the keys ``..._n_m`` (torques) and ``..._n`` (forces)."""
    forces: list[float | None] = [None] * robot.n_dof
    for unit, kind in (("n_m", "revolute"), ("n", "prismatic")):
        numbers = table.spread(f"{key}_{unit}", robot.n_dof, None)
        for joint, number in enumerate(numbers or ()):
            if robot.joint_kinds[joint] == kind:
                forces[joint] = number
    return _complete(table, key, forces)


def _complete(table: Table, key: str, read: Sequence[float | None]) -> list[float] | None:
    values = [value for value in read if value is not None]
    if values and len(values) < len(read):
        table.fail(f"{key} is missing for joint {list(read).index(None) + 1}")
    return values or None
