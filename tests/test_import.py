"""What `import didim` loads, and that every public name is there without having been loaded."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import didim

ALL_PARTS = {"cloe", "closed_loop", "didim_method", "formats", "output_error", "plot", "report", "simulation"}


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


def test_a_bare_import_loads_three_functions_and_what_they_stand_on() -> None:
    modules = loaded_by("import didim")
    assert parts(modules) == {"compare", "errors", "files", "identify", "validate", "version"}
    more = modules - loaded_by("import numpy, numpy.typing, dataclasses")
    assert not more & {"csv", "difflib", "hashlib", "json", "subprocess", "tomllib", "zipfile", "scipy"}


def test_idim_ls_loads_no_simulating_method_and_no_scipy() -> None:
    modules = loaded_by("from didim import IDIMLS, identify, load_experiment")
    assert {"idim_ls", "experiment"} <= parts(modules)
    assert not parts(modules) & {"cloe", "didim_method", "output_error", "methods", "simulate_command"}
    assert "scipy" not in modules


def test_a_regressor_loads_its_robot_alone() -> None:
    modules = loaded_by("from didim import load_robot, regressor")
    assert {"model", "robot"} <= parts(modules)
    assert not parts(modules) & (ALL_PARTS | {"idim_ls", "experiment", "least_squares", "signals"})


def test_every_public_name_is_listed_before_it_is_loaded_and_found() -> None:
    code = (
        "import didim\n"
        "assert set(didim.__all__) <= set(dir(didim))\n"
        "assert 'CLOE' not in vars(didim)\n"
        "from didim import *\n"
        "assert all(name in globals() for name in didim.__all__)\n"
        "assert vars(didim)['CLOE'] is didim.CLOE"
    )
    assert parts(loaded_by(code)) >= ALL_PARTS


def test_type_checkers_read_the_names_where_they_are_loaded_from() -> None:
    path = Path(str(didim.__file__))
    (block,) = (node for node in ast.parse(path.read_text(encoding="utf-8")).body if isinstance(node, ast.If))
    read = {
        alias.name: node.module
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    modules = {name for name, module in read.items() if module is None}
    assert {name: module for name, module in read.items() if module is not None} == didim._LATER
    assert all((path.parent / name).is_dir() or (path.parent / f"{name}.py").is_file() for name in modules)
    assert {*didim._LATER, *modules} <= set(didim.__all__)


@pytest.mark.parametrize("name", ["compare", "identify", "validate"])
def test_a_function_keeps_its_name_when_its_module_is_loaded(name: str) -> None:
    loaded_by(f"import didim.{name}; assert didim.{name}.__name__ == '{name}' and callable(didim.{name})")


def test_modules_of_the_package_are_found_too() -> None:
    loaded_by("import didim; assert didim.parameter_files.load_parameters and didim.robot.load_robot")
    with pytest.raises(AttributeError, match="module 'didim' has no attribute 'robots_of_mine'"):
        _ = didim.robots_of_mine
    with pytest.raises(AttributeError, match="module 'didim' has no attribute '__main__'"):
        _ = didim.__main__


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
        "    didim.data_files\n"
        "except ModuleNotFoundError as reason:\n"
        "    assert reason.name == 'csv'\n"
        "else:\n"
        "    raise AssertionError"
    )
    assert "didim.data_files" not in loaded_by(code)
