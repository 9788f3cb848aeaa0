"""What `import didim` loads, and that every public name is there without having been loaded."""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest

import didim

PUBLIC_NAMES = 47
"""Number of names that the package has for people; another one needs a reason."""
SIMULATING = {"loop", "methods.cloe", "methods.didim", "studies", "formats", "plot", "report"}
"""Parts of the package that an identification by IDIM-LS does without."""


def loaded_by(code: str) -> set[str]:
    """Names of the modules that a new interpreter has loaded after `code`."""
    code += "\nimport sys; print('\\n'.join(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=60
    )
    return set(done.stdout.split())


def parts(modules: set[str]) -> set[str]:
    """Modules of the package among these."""
    return {name.removeprefix("didim.") for name in modules if name.startswith("didim.")}


def loaded_from(modules: set[str], folders: set[str]) -> set[str]:
    """Those of the folders and modules that something is loaded of."""
    return {
        folder
        for folder in folders
        if any(part == folder or part.startswith(f"{folder}.") for part in parts(modules))
    }


def test_a_bare_import_loads_errors_alone() -> None:
    modules = loaded_by("import didim")
    assert parts(modules) == {
        "_tools",
        "errors",
        *(f"_tools.{name}" for name in ("settings", "threads", "version", "words")),
    }
    assert not modules & {
        "numpy",
        "scipy",
        "csv",
        "difflib",
        "hashlib",
        "json",
        "subprocess",
        "tomllib",
        "zipfile",
    }


def test_idim_ls_loads_no_simulating_method_and_no_scipy() -> None:
    modules = loaded_by("from didim import IDIMLS, identify, load_experiment")
    assert {"methods.idim_ls", "experiment.experiment"} <= parts(modules)
    assert not loaded_from(modules, SIMULATING - {"loop"})
    assert "scipy" not in modules


def test_the_time_of_a_method_is_without_the_import_of_scipy() -> None:
    """The first method of a comparison would pay for all: a clock that is read notes what has been loaded by then."""
    simulated = Path(__file__).parents[1] / "examples" / "planar2_simulation.toml"
    code = (
        "import sys, didim\n"
        f"experiment = didim.load_experiment({str(simulated)!r})\n"
        "log = didim.simulated_log(experiment, experiment.robot.sets['reference'])\n"
        "didim.identify\n"
        "module = sys.modules['didim.methods.identify']\n"
        "seen = []\n"
        "class Clock:\n"
        "    @staticmethod\n"
        "    def perf_counter():\n"
        "        seen.append({name for name in sys.modules if name.startswith('scipy')})\n"
        "        return float(len(seen))\n"
        "module.time = Clock\n"
        "fit = didim.identify(log, verbose=False)\n"
        "assert fit.elapsed == len(seen) - 1 >= 1\n"
        "assert seen[0] == seen[-1] and 'scipy.special' in seen[0], seen[-1] - seen[0]\n"
        "assert not {'scipy.signal', 'scipy.stats'} & seen[0]\n"  # a second
    )
    assert "scipy.special" in loaded_by(code)


def test_a_regressor_loads_its_robot_alone() -> None:
    modules = loaded_by("from didim import load_robot, regressor")
    assert {"model.dynamics", "robot.robot"} <= parts(modules)
    floors = {"log", "signal", "regression", "experiment", "result", "methods", "diagnosis"}
    assert not loaded_from(modules, SIMULATING | floors)


def test_every_public_name_is_listed_before_it_is_loaded_and_found() -> None:
    code = (
        "import didim\n"
        "assert set(didim.__all__) <= set(dir(didim))\n"
        "assert 'CLOE' not in vars(didim)\n"
        "from didim import *\n"
        "assert all(name in globals() for name in didim.__all__)\n"
        "assert vars(didim)['CLOE'] is didim.CLOE"
    )
    assert loaded_from(loaded_by(code), SIMULATING) >= SIMULATING - {"formats", "plot", "report"}


def test_type_checkers_read_the_names_where_they_are_loaded_from() -> None:
    path = Path(str(didim.__file__))
    tree = ast.parse(path.read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    read = {
        alias.name: node.module
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    modules = {name for name, module in read.items() if module is None}
    # Names that are no longer public are an error to them.
    assert {name: module for name, module in read.items() if module is not None} == didim._LATER
    assert all((path.parent / name).is_dir() or (path.parent / f"{name}.py").is_file() for name in modules)
    # A folder or module with the name of a public function would take its place as soon as it is loaded.
    assert not {entry.stem for entry in path.parent.iterdir()} & set(didim._LATER)
    assert set(didim._LATER) <= set(didim.__all__)
    assert len(didim.__all__) == PUBLIC_NAMES
    assert not set(didim._MOVED) & set(didim.__all__)


@pytest.mark.parametrize("name", didim._MOVED)
def test_names_of_the_version_before_work_and_warn(name: str) -> None:
    with pytest.warns(DeprecationWarning, match=rf"didim.{name} is didim[.][a-z_.]+[.]{name} now"):
        assert getattr(didim, name).__name__ == name


def test_modules_of_the_package_are_found_too() -> None:
    loaded_by("import didim; assert didim.formats.FORMATS and didim.robot.__doc__")
    with pytest.raises(AttributeError, match="module 'didim' has no attribute 'robots_of_mine'"):
        _ = didim.robots_of_mine  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match="module 'didim' has no attribute '__main__'"):
        _ = didim.__main__  # type: ignore[attr-defined]


def test_a_module_that_fails_to_load_says_what_it_misses() -> None:
    code = (
        "import sys, didim\n"
        "sys.modules['csv'] = None\n"
        "try:\n"
        "    didim.load_experiment\n"
        "except ModuleNotFoundError as reason:\n"
        "    assert reason.name == 'csv'\n"
        "else:\n"
        "    raise AssertionError\n"
        "try:\n"
        "    import didim.log.data_file\n"
        "except ModuleNotFoundError as reason:\n"
        "    assert reason.name == 'csv'\n"
        "else:\n"
        "    raise AssertionError"
    )
    assert "didim.log.data_file" not in loaded_by(code)


def functions_of(thing: object) -> list[Callable[..., Any]]:
    """Functions and methods of a public name that people may call."""
    if inspect.isfunction(thing):
        return [thing]
    if inspect.ismodule(thing):
        own = [member for name, member in inspect.getmembers(thing, inspect.isfunction) if name[0] != "_"]
        return [member for member in own if member.__module__.startswith(thing.__name__)]
    if not inspect.isclass(thing):
        return []
    members = [member for name, member in inspect.getmembers(thing) if name[0] != "_"]
    return [member for member in members if inspect.isfunction(member) and member.__module__[:5] == "didim"]


@pytest.mark.parametrize("name", didim.__all__)
def test_type_hints_can_be_read(name: str) -> None:
    thing = getattr(didim, name)
    for function in functions_of(thing):
        hints = get_type_hints(function)
        assert "return" in hints, function
    if inspect.isclass(thing):
        get_type_hints(thing)


def test_type_hints_name_the_classes() -> None:
    hints = get_type_hints(didim.identify)
    assert didim.Experiment in get_args(hints["experiment"])
    assert hints["return"] is didim.Identification
    assert {function.__name__ for function in functions_of(didim.Reference)} >= {"at"}


def test_type_checkers_refuse_names_that_do_not_exist() -> None:
    tree = ast.parse(Path(str(didim.__file__)).read_text(encoding="utf-8"))
    (hidden,) = (
        node
        for node in tree.body
        if isinstance(node, ast.If) and ast.unparse(node.test) == "not TYPE_CHECKING"
    )
    assert [node.name for node in hidden.body if isinstance(node, ast.FunctionDef)] == ["__getattr__"]
    assert not [
        node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == "__getattr__"
    ]
