"""Limits of threads: by call, by environment, in worker processes; the results have the same bits."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import didim
from arm import arm_file, arm_log
from didim import DIDIM, _core, identify
from didim._tools.threads import core_threads
from didim.cli.main import main
from didim.errors import ThreadsError
from didim.signal.filters import decimation_stages
from didim.signal.processing import SignalProcessing


@pytest.fixture(autouse=True)
def unlimited(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.delenv("DIDIM_THREADS", raising=False)
    didim.set_threads(None)
    yield
    didim.set_threads(None)


def test_a_number_asked_for_comes_before_the_call_before_the_environment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert core_threads() is None
    monkeypatch.setenv("DIDIM_THREADS", "3")
    assert core_threads() == 3
    didim.set_threads(2)
    assert core_threads() == 2
    assert core_threads(5) == 5
    didim.set_threads(None)
    assert core_threads() == 3


def test_the_result_has_the_same_bits() -> None:
    arm = arm_log(1)
    fits = []
    for limit in (1, 2, None):
        didim.set_threads(limit)
        fits.append(identify(arm, DIDIM()))
    for fit in fits[1:]:
        np.testing.assert_array_equal(fit.beta, fits[0].beta)
        np.testing.assert_array_equal(fit.covariance, fits[0].covariance)


def _filtered(_: int = 0) -> np.ndarray[Any, Any]:
    x = np.sin(np.arange(30000.0)).reshape(1000, 30)
    return _core.decimate(x, decimation_stages(1000, SignalProcessing(decimation=(5,))), 4)


@pytest.mark.skipif(
    "fork" not in multiprocessing.get_all_start_methods(), reason="processes cannot be forked"
)
def test_a_forked_process_has_threads_of_its_own() -> None:
    expected = _filtered()
    with ProcessPoolExecutor(1, multiprocessing.get_context("fork")) as pool:
        np.testing.assert_array_equal(pool.submit(_filtered).result(timeout=60), expected)


@pytest.mark.parametrize("number", [0, -1, 1.5, "2", True, 2**70])
def test_wrong_numbers(number: Any) -> None:
    with pytest.raises(ThreadsError, match="the number of threads must be a whole number from 1 to 4096"):
        didim.set_threads(number)


@pytest.mark.parametrize("text", ["", "many", "0", "1.5", "-2", "9" * 30])
def test_a_wrong_variable_is_one_sentence(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = arm_file(arm_log(1), tmp_path, tmp_path / "arm.toml")
    monkeypatch.setenv("DIDIM_THREADS", text)
    assert main(["identify", str(file)]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith("didim: DIDIM_THREADS must be a whole number from 1 to 4096, got ")


def test_worker_processes_take_one_thread() -> None:
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        assert pool.submit(core_threads).result() == 1
    assert core_threads() is None


def test_numpy_follows_where_it_is_loaded_later() -> None:
    """The kernel counts the threads of the process, those of the linear algebra included."""
    code = (
        "import os, didim; r = didim.load_robot('planar2'); import numpy as np; a = np.ones((600, 600)); a @ a;"
        "print(len(os.listdir('/proc/self/task')))"
    )
    if not Path("/proc/self/task").exists():
        pytest.skip("this system does not list the threads of a process")
    hidden = {"OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"}
    environment = {key: value for key, value in os.environ.items() if key not in hidden}
    run = subprocess.run(
        [sys.executable, "-c", code],
        env={**environment, "DIDIM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout == "1\n"
