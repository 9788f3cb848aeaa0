"""Identified parameters as files that robots, simulations and other programs read.

    [parameters.arm]
    ZZ1R = 1.2430871 # kg.m^2, standard deviation 0.0141 (1.14 %)

TOML is a parameter set as a robot file has it; npz has the covariance too. Tested in ``tests/test_parameter_files.py``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._tools.arrays import Array, relative_percent
from .._tools.files import write_atomically
from .._tools.inputs import open_npz, read_file
from .._tools.saved import read_saved, save_npz
from .._tools.toml import Table, read_toml, toml_key
from .._tools.words import counted, listing, one_line
from ..errors import FitError
from .robot import Robot

SUFFIXES = (".toml", ".npz")
"""Suffixes of the formats that can be written."""


def check_path(path: Path) -> None:
    """Refuse a file name without the suffix of a parameter file.

    Raises
    ------
    FitError
        The message names the valid suffixes.
    """
    if path.suffix not in SUFFIXES:
        raise FitError(f"a file of parameters ends in {' or '.join(SUFFIXES)}, and '{path.name}' does not")


def write_parameters(
    path: str | Path, arrays: Mapping[str, NDArray[Any]], comments: Sequence[str], sources: Iterable[str]
) -> None:
    """Write the parameters of a result, whole or not at all; its input files are never overwritten.

    Parameters
    ----------
    path : str or Path
        ``.toml``: a set named after the file with the base parameters (all standard parameters of a physically consistent
        result) and their standard deviations in comments; it can be pasted into the robot file. ``.npz``: the arrays.
    arrays : mapping of str to array
        ``names``, ``units``, ``roles``, ``beta`` (b,), ``std`` (b,), ``covariance`` (b, b), and the standard parameters as
        ``parameter_names`` and ``parameters`` (p,). SI units, joint side.
    comments : sequence of str
        Sentences at the head of the TOML.
    sources : iterable of str
        SHA-256 of the input files.

    Raises
    ------
    FitError
        When the name has another suffix.
    OSError
        When the file cannot be written.
    """
    path = Path(path)
    check_path(path)
    if path.suffix == ".toml":
        beta, stds, parameters = (arrays[key] for key in ("beta", "std", "parameters"))
        known = bool(stds.any())
        lines = [f"# {one_line(text)}" for text in comments]
        lines += ["# SI units, joint side.", f"[parameters.{toml_key(path.stem)}]"]
        texts = (arrays[key] for key in ("names", "units", "roles"))
        values = zip(*texts, beta, stds, relative_percent(stds, beta), strict=True)
        # A consistent result writes all standard parameters; the base parameters are then comments.
        whole = bool(np.count_nonzero(parameters) > np.count_nonzero(beta))
        mark = "# " if whole else ""
        for parameter, unit, role, value, std, percent in values:
            sigma = (
                f"standard deviation {std:.3g} ({percent:.3g} %)" if known else "standard deviation unknown"
            )
            lines.append(
                f"{mark}{toml_key(parameter)} = {float(value)!r} # {unit}, {sigma if role == 'estimated' else role}"
            )
        if whole:
            standard = zip(arrays["parameter_names"], parameters, strict=True)
            lines += [f"{toml_key(parameter)} = {float(value)!r}" for parameter, value in standard]
        write_atomically(path, "\n".join(lines) + "\n", sources)
        return
    save_npz(path, arrays, sources)


def load_parameters(robot: Robot, path: str | Path) -> Array:
    """Read standard parameters of a robot from a file.

    Tested in ``tests/test_parameter_files.py``.

    Parameters
    ----------
    robot : Robot
        Robot of the parameters.
    path : str or Path
        ``.toml`` with one set ``[parameters.NAME]``, parameters not named there are zero; ``.npz`` of `save_parameters`;
        ``.json`` of
        `Identification.save`.

    Returns
    -------
    (n_parameters,) array
        In the order of ``robot.parameter_names``, SI units, joint side.

    Raises
    ------
    FitError
        When the file is none of these, or of another robot.
    RobotError
        When the set names a parameter that the robot does not have.
    OSError
        When the file cannot be read.
    """
    path = Path(path)
    if path.suffix == ".toml":
        return robot.parameters_by_name(*_set(path))
    if path.suffix == ".npz":
        names, parameters = _arrays(path)
    else:
        names, parameters = _result(path)
    if tuple(names) != robot.parameter_names:
        other = next((name for name in names if name not in robot.parameter_names), None)
        what = f"parameter {other!r}" if other else counted(len(names), "parameter")
        raise FitError(f"{path}: it has {what}, which robot {robot.name!r} of the experiment has not")
    return parameters


def is_file(source: str) -> bool:
    """Whether a text is the path of a parameter file rather than the name of a set."""
    return source.endswith((*SUFFIXES, ".json"))


def _set(path: Path) -> tuple[dict[str, float], str]:
    """Values of a file's only set, and the prefix of messages on it."""
    table = Table(read_toml(path, FitError), path.name, FitError)
    sets = table.table("parameters")
    table.done()
    names = list(sets.content)
    if len(names) != 1:
        raise FitError(f"{path.name}: one set [parameters.NAME] is needed, got {listing(names) or 'none'}")
    values = sets.table(names[0])
    return {name: values.number(name) for name in values.content}, f"{path.name}: [parameters.{names[0]}]"


def _arrays(path: Path) -> tuple[Sequence[str], Array]:
    content = read_file(path, FitError)
    try:
        with open_npz(content, str(path), FitError) as arrays:
            names = [str(name) for name in arrays["parameter_names"]]
            parameters = np.array(arrays["parameters"], dtype=np.float64)
    except FitError:
        raise
    except KeyError as error:
        raise FitError(f"{path}: not a file of parameters, {error.args[0]}") from None
    except Exception as error:  # damaged archives raise errors of many types: sizes, compressions, encryption
        raise FitError(f"{path}: not an npz file of parameters ({error or type(error).__name__})") from None
    if parameters.shape != (len(names),) or not np.isfinite(parameters).all():
        raise FitError(f"{path}: parameters must be {len(names)} finite numbers, one per name")
    return names, parameters


def _result(path: Path) -> tuple[Sequence[str], Array]:
    """Names and values of the standard parameters in the JSON of a result."""
    data = read_saved(path)
    try:
        standard = dict(data["standard_parameters"])
        return list(standard), np.array([float(value) for value in standard.values()])
    except KeyError as error:
        raise FitError(f"{path}: key {error} is missing or unknown") from None
    except (TypeError, ValueError, OverflowError) as error:
        raise FitError(f"{path}: not the result of an identification: {error}") from None
