"""Measurements of `since_0_1_0.py`: rows 15 to 17 and section 5, files and outputs; with names that both versions have."""

from __future__ import annotations

import copy
import json
import os
import pickle
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from since_edges import NO_KEY, REFUSED, Value, load, moved, plain, refusal, watched

import didim
from didim import CLOE, IDIMLS, Experiment, Identification


def command(
    *arguments: str | Path, folder: Path, size: int | None = None
) -> subprocess.CompletedProcess[str]:
    """Run the command line, on a disk that takes files of `size` bytes at most."""

    def limit() -> None:
        if size is not None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    line = [sys.executable, "-m", "didim", *map(str, arguments)]
    return subprocess.run(line, cwd=folder, capture_output=True, text=True, preexec_fn=limit, check=False)


# Rows 15 to 17.


def right_angles(folder: Path) -> Value:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        full, rounded = (
            len(didim.load_robot(folder / f"ur_{digits}.toml").base_parameters.names)
            for digits in ("1.5707963267948966", "1.5708")
        )
    return float(rounded - full)


def another_robot(folder: Path) -> Value:
    fit = didim.identify(load(folder, "arm"), IDIMLS())
    other = load(folder, "arm_longer")
    refused = refusal(lambda: didim.validate(fit, other))
    if refused:
        return refused
    text = str(didim.validate(fit, other))
    return "told" if "another robot" in text or "digest" in text else "accepted without a word"


def impossible_variances(folder: Path) -> Value:
    fit = didim.identify(load(folder, "arm"), IDIMLS())
    accepted = 0
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "fit.json"
        for value in (float("nan"), -1.0):
            fit.save(path)
            data = json.loads(path.read_text(encoding="utf-8"))
            data["covariance"][2][2] = value
            path.write_text(json.dumps(data), encoding="utf-8")
            accepted += refusal(lambda: Identification.load(path)) != REFUSED
    return float(accepted)


def uncounted_simulations(folder: Path) -> Value:
    with watched(moved("simulation", "loop.closed_loop").ClosedLoop, "run") as runs:
        fit = didim.identify(load(folder, "arm"), plain(start="unit"))
    return float(len(runs) - fit.n_simulations)


def reweightings(folder: Path) -> Value:
    with watched(IDIMLS, "run") as runs:
        didim.identify(load(folder, "arm"), plain(start="idim-ls", weights="per-joint", reweightings=3))
    return 3.0 - float(runs[0][0].reweightings or 0)


def repeated_iterations(folder: Path) -> Value:
    """Let the simulation after the second solution end early, as where the steps in time are too large for it."""
    loop = moved("simulation", "loop.closed_loop").ClosedLoop
    run, calls, heard = loop.run, 0, []

    def failing(self: Any, x: Any, *arguments: Any, **options: Any) -> Any:
        nonlocal calls
        calls += 1
        return run(self, 1e-4 * x if calls == 3 else x, *arguments, **options)

    def hear(item: Any) -> None:
        heard.append(item.iteration)

    loop.run = failing
    try:
        didim.identify(load(folder, "arm"), plain(start="unit", tolerance=1e-6), callback=hear)
    finally:
        loop.run = run
    return float(len(heard) - len(set(heard)))


def kinds_of_errors(folder: Path) -> Value:
    log = load(folder, "hold")
    log = replace(log, recordings=())
    comparison = didim.compare(log, parameters="reference", methods=[IDIMLS()])
    return "one kind" if hasattr(comparison, "torque_errors") else NO_KEY


# Section 5: nothing may be lost.


def work_before_refusal(folder: Path) -> Value:
    module = import_module("didim.cli")
    entry: Any = (
        module.main if callable(getattr(module, "main", None)) else import_module("didim.cli.main").main
    )
    output = str(folder / "absent" / "fit.toml")
    with watched(IDIMLS, "run") as runs:
        for option in ("--json", "--save-parameters"):
            entry(["identify", str(folder / "arm.toml"), "--method", "idim-ls", option, output])
    return float(len(runs))


def full_disk(folder: Path) -> Value:
    run = command("identify", folder / "arm.toml", "--quiet", "--json", "fit.json", folder=folder, size=512)
    return "table printed" if "base parameters" in run.stdout else "table lost"


SEARCH = """
import signal, resource, sys, didim
log = didim.load_experiment(sys.argv[1])
method = didim.CLOE(start="reference", checkpoint=sys.argv[2], max_iterations=3)
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (64, 64))
print(didim.identify(log, method))
"""


def full_checkpoint(folder: Path) -> Value:
    line = [sys.executable, "-c", SEARCH, str(folder / "arm.toml"), str(folder / "search.npz")]
    run = subprocess.run(line, cwd=folder, capture_output=True, text=True, check=False)
    return "best point printed" if "base parameters" in run.stdout else "best point lost"


def damaged_parameters(folder: Path) -> Value:
    fit = didim.identify(load(folder, "arm"), IDIMLS())
    path = folder / "damaged.npz"
    tracebacks = 0
    for offset, value in ((8, 99), (6, 1)):
        fit.save_parameters(path)
        data = bytearray(path.read_bytes())
        for mark, place in ((b"PK\x03\x04", offset), (b"PK\x01\x02", offset + 2)):
            at = data.find(mark)
            while at >= 0:
                data[at + place : at + place + 2] = value.to_bytes(2, "little")
                at = data.find(mark, at + 4)
        path.write_bytes(bytes(data))
        run = command("simulate", folder / "arm.toml", "--parameters", path, folder=folder)
        tracebacks += "Traceback" in run.stderr
    return float(tracebacks)


def saves_of_threads(folder: Path) -> Value:
    fit = didim.identify(load(folder, "arm"), IDIMLS())
    path, failures = folder / "threads.json", 0

    def save() -> None:
        nonlocal failures
        for _ in range(40):
            try:
                fit.save(path)
            except OSError:
                failures += 1

    threads = [threading.Thread(target=save) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return float(failures)


def numbers_of_threads(folder: Path) -> Value:
    log = load(folder, "arm")
    numbers: list[Any] = ["2", 1.5, 2**70]
    ends = [refusal(partial(searched, log, number)) for number in numbers]
    return float(sum(end != REFUSED for end in ends))


def searched(log: Experiment, number: Any) -> Identification:
    return didim.identify(log, CLOE(start="reference", max_iterations=1, threads=number))


def interrupted_import(folder: Path) -> Value:
    del folder
    with tempfile.TemporaryDirectory() as place:
        (Path(place) / "numpy").mkdir()
        text = (
            "import signal, sys, time\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
            "print('loading', file=sys.stderr, flush=True)\ntime.sleep(30)\n"
        )
        (Path(place) / "numpy" / "__init__.py").write_text(text, encoding="utf-8")
        path = os.pathsep.join([place, os.environ["PYTHONPATH"]])
        process = subprocess.Popen(
            [sys.executable, "-m", "didim", "base", "tx40"],
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": path},
        )
        with process:
            assert process.stderr is not None
            process.stderr.readline()
            process.send_signal(signal.SIGINT)
            return float(len(process.stderr.read().splitlines()))


def control_characters(folder: Path) -> Value:
    text = (folder / "arm.toml").read_text(encoding="utf-8")
    path = folder / "control.toml"
    path.write_text(text.replace('name = "arm"', 'name = "a\\u001b[31mrm"', 1), encoding="utf-8")
    run = command("identify", path, folder=folder)
    return float((run.stdout + run.stderr).count("\x1b"))


def mode_of_a_result(folder: Path) -> Value:
    fit = didim.identify(load(folder, "arm"), IDIMLS())
    path = folder / "mode.json"
    fit.save(path)
    path.chmod(0o600)
    fit.save(path)
    return f"{path.stat().st_mode & 0o777:04o}"


def pickled(item: Any) -> Any:
    return pickle.loads(pickle.dumps(item))


def copies(folder: Path) -> Value:
    log = load(folder, "arm")
    still = didim.Reference.point_to_point([[0.0], [1.0]], max_velocity=[1.0], max_acceleration=[3.0])
    items: tuple[Any, ...] = (log.robot, log, still, didim.identify(log, IDIMLS()))
    routes: tuple[Callable[[Any], Any], ...] = (pickled, copy.deepcopy)
    failures = 0
    for item in items:
        for route in routes:
            try:
                route(item)
            except Exception:
                failures += 1
    return float(failures)


def limit_of_threads(folder: Path) -> Value:
    del folder
    return "set_threads, DIDIM_THREADS" if hasattr(didim, "set_threads") else NO_KEY


# What has to be as it was.


def names_of_the_tx40(folder: Path) -> Value:
    del folder
    return " ".join(didim.load_robot("tx40").base_parameters.names)


def recipe(folder: Path, data: Path, name: str, digits: int) -> str:
    version = "old" if didim.__version__ == "0.1.0" else "now"
    log = didim.load_experiment(folder / f"{name}_{version}.toml", data=data / name.split("_")[0])
    fit = didim.identify(log, IDIMLS())
    table = [
        f"{n} {b:.{digits}f} {s:.{digits}f}" for n, b, s in zip(fit.names, fit.beta, fit.std, strict=True)
    ]
    errors = " ".join(f"{100.0 * error:.4f}" for error in fit.relative_error)
    whole = f"condition {fit.condition_number:.4f} error {errors} sigma {fit.error_std:.4f} norm {fit.error_norm:.4f}"
    return "; ".join([*table, whole])
