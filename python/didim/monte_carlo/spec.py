"""Specification of a study: an experiment, scenarios, methods and seeds. Tested in ``tests/test_study_spec.py``."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from typing import Any

from .._tools.keys import declared
from .._tools.plugins import places, search, source_digest
from .._tools.settings import whole
from .._tools.toml import Table, read_toml
from .._tools.words import brief, listing
from ..errors import ExperimentError, RobotError, StudyError
from ..experiment.experiment_file import robot_place
from ..robot.robot_file import PACKAGED as ROBOTS
from ..studies.simulated_log import LOG_REFINEMENT
from ..studies.simulated_log import PACKAGED as EXPERIMENTS
from .keys import Keys

SHARED = (
    "experiment", "robot", "files", "parameters", "refinement", "noise_in_loop_hz", "other_motion", "root",
)  # fmt: skip
"""Fields of a study that all its tasks have in common."""
MOST_SCENARIOS = 100_000
"""Upper bound of the scenarios of a study: more are a mistake in a grid."""


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """Changes of the simulated log, and of the model of the methods.

    Attributes
    ----------
    name : str
        In tables and rows.
    keys : mapping
        Dotted keys with values that replace those of the files (`didim.monte_carlo.keys`).
    """

    name: str
    keys: Keys


@dataclass(frozen=True, kw_only=True)
class MethodSpec:
    """A method of a study.

    Attributes
    ----------
    label : str
        In tables and rows.
    name : str
        Name of the method, such as "didim".
    settings : mapping
        Its settings.
    keys : mapping
        Dotted keys of the experiment for this method only.
    seeds : int or None
        Number of seeds for this method, if fewer than for the study, because it is slow.
    """

    label: str
    name: str
    settings: Mapping[str, Any]
    keys: Keys
    seeds: int | None = None


@dataclass(frozen=True, kw_only=True)
class StudySpec:
    """A study.

    Attributes
    ----------
    name : str
        Name in reports.
    experiment, robot : mapping
        Content of the experiment file and of the robot file.
    files : (str, str)
        Names of both, for messages.
    parameters : str
        Parameter set of the robot file: the truth.
    refinement : int
        Ratio of the methods' time steps to those of the log.
    noise_in_loop_hz : float or None
        Samples per second of a controller that reads the noisy positions; None if noise is only added to the log.
    other_motion : mapping
        Keys of the other motion, for the torque errors; empty for none.
    scenarios, methods : tuple
        Every method is run on every scenario.
    seeds, root : int
        Number of logs per scenario, and the root of their random numbers.
    folders : tuple of str
        Folders with modules of user-defined methods and friction laws, searched after the installed ones.
    sources : mapping
        SHA-256 of the source of each such "module:name".
    """

    name: str
    experiment: Mapping[str, Any]
    robot: Mapping[str, Any]
    files: tuple[str, str]
    parameters: str
    refinement: int
    noise_in_loop_hz: float | None
    other_motion: Keys
    scenarios: tuple[Scenario, ...]
    methods: tuple[MethodSpec, ...]
    seeds: int
    root: int
    folders: tuple[str, ...] = ()
    sources: Mapping[str, str] = field(default_factory=dict)

    def shared(self) -> dict[str, Any]:
        """Return the common part of the study's tasks, as plain data."""
        shared = {key: getattr(self, key) for key in SHARED}
        # Only if there are any, which preserves the ids of other studies' rows.
        return shared | ({"sources": self.sources} if self.sources else {})


def canonical(value: object, what: str = "the study") -> str:
    """Return plain data as JSON, the same text for the same data.

    Raises
    ------
    StudyError
        For values without JSON form, such as a date or infinity.
    """
    try:
        return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    except (TypeError, ValueError) as reason:
        raise StudyError(
            f"{what} holds a value that is not a text, a number or a table of them ({reason})"
        ) from None


def digest(text: str) -> str:
    """Return the first 32 hexadecimal digits of a text's SHA-256."""
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def load_study(path: str | Path) -> StudySpec:
    """Read a study file.

    Raises
    ------
    StudyError
        On a wrong key or value, with the file, the table and the key; likewise `ExperimentError` and `RobotError` for the files
        that it names.
    """
    path = Path(path)
    return read_study(read_toml(path, StudyError), path)


def read_study(content: Mapping[str, Any], path: Path = Path("study")) -> StudySpec:
    """Read the content of a study file, or the same written in Python.

    Parameters
    ----------
    content : mapping
        Tables of the file.
    path : Path
        Name of the file in messages; paths in it are relative to its folder.

    Raises
    ------
    StudyError
        As for `load_study`.
    """
    canonical(content, path.name)
    table = Table(content, path.name, StudyError, keys=declared("study"))
    table.check_schema()
    # An included experiment, or a file beside the study.
    name = table.text("experiment")
    packaged = EXPERIMENTS / f"{name}.toml"
    where = packaged if packaged.is_file() else path.parent / name
    experiment = read_toml(where, ExperimentError)
    kind = (
        experiment.get("reference", {}).get("kind") if isinstance(experiment.get("reference"), dict) else None
    )
    if kind in (None, "recorded", "measured"):
        raise StudyError(
            f"{where.name}: a study simulates its logs, so the experiment needs a [reference] of its own, and not that of a "
            "recording"
        )
    experiment.pop("recording", None)
    robot, robot_where = _robot(Table(experiment, where.name, ExperimentError).text("robot"), where)
    repeat = table.table("repeat")
    seeds, root = repeat.integer("seeds"), repeat.integer("root")
    repeat.done()
    scenarios = _scenarios(table)
    methods = _methods(table)
    folders = tuple(dict.fromkeys(str(folder.resolve()) for folder in (path.parent, Path.cwd())))
    search(map(Path, folders))
    made = StudySpec(
        name=table.text("name", path.stem),
        experiment=experiment,
        robot=robot,
        files=(where.name, robot_where.name),
        parameters=table.text("parameters"),
        refinement=table.integer("refinement", LOG_REFINEMENT),
        noise_in_loop_hz=table.number("noise_in_loop_hz", None),
        other_motion=table.part("other_motion").content,
        scenarios=scenarios,
        methods=methods,
        seeds=seeds,
        root=root,
        folders=folders,
        sources={
            file: source
            for file in sorted(set(places([experiment, robot, content])))
            if (source := source_digest(file))
        },
    )
    table.done()
    return made


def _robot(name: str, experiment: Path) -> tuple[dict[str, Any], Path]:
    file = robot_place(name, experiment.parent)
    where = ROBOTS / f"{file}.toml" if isinstance(file, str) else file
    if where.suffix.lower() == ".urdf":
        raise StudyError(
            f"{where.name}: a study needs a robot file; write one with `didim robot {where.name} -o {where.stem}.toml`"
        )
    return read_toml(where, RobotError), where


def _scenarios(table: Table) -> tuple[Scenario, ...]:
    """Return the named scenarios combined with the grid."""
    axes = table.part("grid").content
    for key, values in axes.items():
        if not isinstance(values, list) or not values:
            table.fail(f"[grid] {key} must be a list of values, got {values!r}")
    count = prod(map(len, axes.values()))
    named = []
    for part in table.tables("scenario"):
        keys = part.content
        name = keys.pop("name", None)
        if not isinstance(name, str) or not name:
            part.fail("a scenario needs a name")
        named.append((name, keys))
    count *= max(1, len(named))
    if count > MOST_SCENARIOS:
        table.fail(f"[grid] makes {count} scenarios; at most {MOST_SCENARIOS} are possible")
    shown = [key for key, values in axes.items() if len(values) > 1]
    scenarios = []
    for name, keys in named or [("", {})]:
        both = sorted(set(keys) & set(axes))
        if both:
            table.fail(f"key {both[0]!r} stands in [grid] and in scenario {name!r}")
        for values in itertools.product(*axes.values()):
            chosen = dict(zip(axes, values, strict=True))
            varied = ", ".join(f"{key} = {_short(chosen[key])}" for key in shown)
            title = ", ".join(text for text in (name, varied) if text) or "as the files are"
            scenarios.append(Scenario(name=title, keys={**keys, **chosen}))
    _distinct(table, "scenario", [(scenario.name, canonical(scenario.keys)) for scenario in scenarios])
    return tuple(scenarios)


def _short(value: object) -> str:
    """Return a value as the names of scenarios and methods have it: a table as its keys and values."""
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_short(part)}" for key, part in value.items())
    return value if isinstance(value, str) else json.dumps(value)


def _methods(table: Table) -> tuple[MethodSpec, ...]:
    given = table.raw("method")
    if isinstance(given, str | Mapping):
        given = [given]
    if not isinstance(given, Sequence) or not given:
        table.fail("method must be a list of methods: names, or tables with a name and settings")
    methods = [_method(table, method) for method in given]
    contents = [canonical([method.name, method.settings, method.keys]) for method in methods]
    _distinct(table, "method", [(made.label, text) for made, text in zip(methods, contents, strict=True)])
    return tuple(methods)


def _method(table: Table, entry: object) -> MethodSpec:
    settings = (
        {"name": entry} if isinstance(entry, str) else dict(entry) if isinstance(entry, Mapping) else {}
    )
    name = settings.pop("name", None)
    if not isinstance(name, str):
        table.fail(f"a method must be a name, or a table with a name, got {brief(repr(entry))}")
    label, seeds = settings.pop("label", None), settings.pop("seeds", None)
    keys = {key: settings.pop(key) for key in list(settings) if "." in key}
    if label is None:
        details = ", ".join(f"{key} = {_short(value)}" for key, value in {**settings, **keys}.items())
        label = f"{name} ({details})" if details else name
    if not isinstance(label, str) or not label:
        table.fail(f"label of method {name!r} must be a text, got {brief(repr(label))}")
    if seeds is not None:
        key = declared("study", "repeat").rows["seeds"]
        seeds = whole(
            f"seeds of method {brief(label)!r}", seeds, StudyError, least=key.minimum, most=key.maximum
        )
    return MethodSpec(label=label, name=name, settings=settings, keys=keys, seeds=seeds)


def _distinct(table: Table, what: str, entries: Sequence[tuple[str, str]]) -> None:
    """Refuse duplicates in name or content."""
    names = [name for name, _ in entries]
    for values, how in ((names, "the same name"), ([text for _, text in entries], "the same content")):
        twice = sorted({name for name, value in zip(names, values, strict=True) if values.count(value) > 1})
        if twice:
            table.fail(f"two entries of {what!r} have {how}: {listing(twice)}")
