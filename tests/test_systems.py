"""Other machines: a log is simulated, identified and studied without what Linux has, and alike under each set of instructions."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import didim._core as _core
from arm import arm_file, arm_log
from didim._tools.files import path_from
from didim.errors import RobotError
from didim.robot.urdf.description import read_description

HIDDEN = """
import builtins, io, os, signal, sys
import numpy, scipy.optimize, scipy.signal, scipy.special, scipy.stats  # these know their system

for name in ("fcntl", "resource", "pwd", "grp", "termios", "tty", "pty"):
    sys.modules[name] = None
for name in (
    "O_NONBLOCK", "O_DIRECTORY", "O_CLOEXEC", "fork", "sched_getaffinity", "sched_setaffinity", "getuid", "geteuid",
    "getpgid", "setsid", "uname", "statvfs", "mkfifo", "link", "set_blocking", "posix_spawn", "sysconf", "getloadavg",
):
    if hasattr(os, name):
        delattr(os, name)
for name in ("SIGKILL", "SIGHUP", "SIGALRM", "SIGUSR1", "setitimer", "alarm", "pthread_sigmask", "pthread_kill"):
    if hasattr(signal, name):
        delattr(signal, name)

def without_folders(call):
    def opened(path, *arguments, **options):
        if str(path).startswith(("/proc", "/dev/fd", "/sys")):
            raise FileNotFoundError(2, "No such file or directory", str(path))
        if call is os_open and os.path.isdir(path):
            raise PermissionError(13, "Permission denied", str(path))
        return call(path, *arguments, **options)
    return opened

os_open = os.open
os.open = without_folders(os.open)
builtins.open = io.open = without_folders(io.open)
"""
"""Windows and macOS as far as Python can pretend: no such modules, names, files below /proc, or handles of folders."""

RUN = """
from didim.cli.main import main

assert "fcntl" in sys.modules and sys.modules["fcntl"] is None
for command in (
    "simulate ARM --parameters reference -o log.csv",
    "init planar2 log.csv",
    "check log.toml",
    "identify log.toml --json fit.json --save-parameters found.toml",
    "identify log.toml --json NULL",
    "study study.toml -o study.jsonl --workers 2",
    "study study.toml -o study.jsonl --executor serial",
):
    code = main([word.replace("ARM", ARM).replace("NULL", os.devnull) for word in command.split()])
    assert code <= command.startswith("check"), (command, code)  # it may find something
"""

STUDY = """schema = 1
experiment = "ARM"
parameters = "reference"
method = ["idim-ls"]
[repeat]
seeds = 2
root = 1
"""


@pytest.mark.slow
def test_nothing_of_linux_is_needed(project: Path, tmp_path: Path) -> None:
    arm = (project / "examples" / "planar2_simulation.toml").as_posix()
    (tmp_path / "study.toml").write_text(STUDY.replace("ARM", arm), encoding="utf-8")
    program = f"{HIDDEN}\nARM = {arm!r}\nif __name__ == '__main__':\n"
    program += "".join(f"    {line}\n" for line in RUN.strip().splitlines())
    (tmp_path / "elsewhere.py").write_text(program, encoding="utf-8")
    run = subprocess.run(
        [sys.executable, "elsewhere.py"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "study.jsonl").read_text(encoding="utf-8").count('"method":"idim-ls"') == 2
    assert "[parameters.found]" in (tmp_path / "found.toml").read_text(encoding="utf-8")


def test_a_path_on_another_drive_is_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert path_from(tmp_path, tmp_path / "logs" / "a.csv") == "logs/a.csv"

    def relpath(path: object, start: object) -> str:
        raise ValueError("path is on mount 'D:', start on mount 'C:'")

    monkeypatch.setattr(os.path, "relpath", relpath)
    assert path_from(tmp_path, tmp_path / "a.csv") == (tmp_path / "a.csv").as_posix()


def test_a_sentence_has_the_drive_of_its_file() -> None:
    joint = (
        b'<joint name="j" type="revolute"><parent link="a"/><child link="b"/><origin xyz="${x} 0 0"/></joint>'
    )
    text = b'<robot name="r"><link name="a"/><link name="b"/>' + joint + b"</robot>"
    with pytest.raises(RobotError, match=r"expand the file first: xacro C:\\arms\\arm\.urdf > arm\.urdf"):
        read_description(text, r"C:\arms\arm.urdf")


RESULTS = """
import sys
import numpy as np
import didim
import didim._core as core
from arm import arm_log
from didim.experiment.loop import closed_loop

log = arm_log(1)
(recording,) = log.recordings
x = log.robot.parameter_set("reference")
candidates = x * np.linspace(0.9, 1.1, 11)[:, None]
ones = np.ones(2)
costs, _ = closed_loop(log, recording).costs(
    candidates, recording.q, recording.tau, weight_q=ones, weight_tau=ones, threads=1
)
alone, _ = closed_loop(log, recording).costs(
    candidates[4:5], recording.q, recording.tau, weight_q=ones, weight_tau=ones, threads=1
)
arm = didim.load_robot("tx40")
motion = [np.random.default_rng(k).normal(size=(13, 6)) for k in range(3)]
np.savez(
    sys.argv[1],
    set=core.instruction_set(),
    costs=costs,
    alone=alone,
    regressor=didim.regressor(arm, *motion),
    torques=didim.inverse_dynamics(arm, *motion, arm.parameter_set("didim")),
)
"""


def _under(name: str, arguments: list[str]) -> subprocess.CompletedProcess[str]:
    """Run Python with a set of instructions."""
    tests = str(Path(__file__).parent)
    path = os.pathsep.join(filter(None, [tests, os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "PYTHONPATH": path, "DIDIM_ISA": name}
    return subprocess.run(
        [sys.executable, *arguments], env=environment, capture_output=True, text=True, check=False
    )


def test_every_set_has_the_same_results(tmp_path: Path) -> None:
    """Wider vectors give the same bits; code for any processor rounds products and sums one by one."""
    found: dict[str, dict[str, Any]] = {}
    for name in _core.instruction_sets():
        run = _under(name, ["-c", RESULTS, str(tmp_path / f"{name}.npz")])
        assert run.returncode == 0, run.stderr
        found[name] = dict(np.load(tmp_path / f"{name}.npz"))
        assert found[name].pop("set") == name
        assert found[name]["costs"][4] == found[name]["alone"][0]
        assert len(set(found[name]["costs"])) == 11
    widest = found[_core.instruction_sets()[-1]]
    for name, results in found.items():
        for what, value in results.items():
            if name == "portable":
                np.testing.assert_allclose(value, widest[what], rtol=1e-8, atol=1e-9, err_msg=what)
            else:
                np.testing.assert_array_equal(value, widest[what], err_msg=f"{name}, {what}")


def test_the_widest_is_the_default() -> None:
    code = "import didim._core as core; print(core.instruction_set() == core.instruction_sets()[-1])"
    assert _under("auto", ["-c", code]).stdout == "True\n"
    assert _core.instruction_sets()[0] == "portable"


@pytest.mark.parametrize("name", ["", "sse9", "AVX2 "])
def test_a_wrong_variable_is_one_sentence(name: str, tmp_path: Path) -> None:
    file = arm_file(arm_log(1), tmp_path, tmp_path / "arm.toml")
    run = _under(name, ["-m", "didim", "identify", str(file)])
    assert (run.returncode, run.stdout) == (2, "")
    assert run.stderr == f'didim: DIDIM_ISA must be auto, portable, avx2 or avx512, got "{name}"\n'


def test_a_wrong_variable_is_an_error_of_the_package() -> None:
    code = "import didim\ntry:\n    didim.load_robot('tx40')\nexcept didim.errors.InstructionSetError as e: print(e)"
    assert _under("none", ["-c", code]).stdout.startswith("DIDIM_ISA must be auto, ")
