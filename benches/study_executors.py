"""The same study on every executor: are its rows the same bytes, what does the machinery cost, and what survives a kill?

    python benches/study_executors.py [--seeds 200] [--only process-1 process-2 thread loky dask ray mpi killed vanished]
    python benches/study_executors.py --seeds 20 --only process-1 process-2
    python benches/study_executors.py --tx40 --seeds 10 --only process-1 process-2

runs 4 scenarios of the planar arm with 3 methods on each executor that is installed; ``mpi`` needs Open MPI. ``killed`` kills the
program that runs a study of two processes, and then one of the workers of the next; ``vanished`` kills one of two workers of
Dask. The SHA-256 of the sorted rows must be the same for all. The overhead is the processor time of everything that is not a
task, program and workers together, over that of the tasks. ``--tx40`` takes three scenarios and methods of the benchmark instead,
whose tasks are fifty times as long. The figures are those of docs/studies.md, Many workers.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import json
import os
import pickle
import resource
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from didim.errors import StudyError
from didim.monte_carlo.rows import read_rows, times_path
from didim.monte_carlo.spec import StudySpec, canonical, load_study, read_study
from didim.monte_carlo.study import study
from didim.monte_carlo.tasks import count, tasks

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
RUNS = ("process-1", "process-2", "thread", "loky", "dask", "ray", "mpi", "killed", "vanished")
PATIENCE_S = 600.0
MPI_OPTIONS = ("--allow-run-as-root", "--oversubscribe")
"""Options of Open MPI in containers, and on fewer processors than processes."""
TX40_METHODS = ("IDIM-LS, 30 Hz", "IDIM-IV, 30 Hz", "DIDIM")


def spec_of(seeds: int, tx40: bool = False) -> StudySpec:
    """Planar arm, two seconds at 200 Hz: two noises times two controllers; or a part of the benchmark."""
    if tx40:
        spec = load_study(EXAMPLES / "study_tx40.toml")
        methods = tuple(item for item in spec.methods if item.label in TX40_METHODS)
        return replace(spec, scenarios=spec.scenarios[:3], methods=methods, seeds=seeds)
    return read_study(
        {
            "name": "executors",
            "experiment": "planar2_simulation.toml",
            "parameters": "reference",
            "refinement": 1,
            "method": [
                "idim-ls",
                {"name": "idim-ls", "label": "filtered", "signal.cutoff_hz": 20},
                {"name": "idim-ls", "label": "white", "uncertainty": "white"},
            ],
            "grid": {
                "measurement.torque_noise_n_m": [[0.1, 0.05], [0.5, 0.2]],
                "controller.natural_frequency_hz": [[8, 12], [5, 8]],
                "simulation.duration_s": [2.0],
                "simulation.rate_hz": [200],
                "simulation.step_s": [0.002],
                "simulation.fine_step_s": [0.002],
            },
            "repeat": {"seeds": seeds, "root": 20},
        },
        EXAMPLES / "study.toml",
    )


def fingerprint(path: Path) -> str:
    """SHA-256 of the sorted rows."""
    return hashlib.sha256("\n".join(sorted(path.read_text().splitlines())).encode()).hexdigest()[:16]


def processor_seconds() -> float:
    """Processor time of this program and of the children that have ended."""
    return sum(
        part.ru_utime + part.ru_stime
        for part in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    )


@contextmanager
def dask_cluster(workers: int) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A scheduler and workers as processes of their own, over TCP."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    one_thread = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    scheduler = [
        sys.executable,
        "-m",
        "distributed.cli.dask_scheduler",
        "--host",
        "127.0.0.1",
        "--port",
        str(port),
    ]
    worker = [
        sys.executable,
        "-m",
        "distributed.cli.dask_worker",
        address,
        "--nthreads",
        "1",
        "--no-nanny",
        "--no-dashboard",
    ]
    started = [subprocess.Popen([*scheduler, "--no-dashboard"], **quiet)]
    started += [subprocess.Popen(worker, env=one_thread, **quiet) for _ in range(workers)]
    try:
        distributed: Any = importlib.import_module("distributed")
        with distributed.Client(address, timeout=PATIENCE_S, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=PATIENCE_S)
        yield address, started[1:]
    finally:
        for process in started:
            process.kill()
            process.wait()


def rows_in(path: Path) -> int:
    return path.read_bytes().count(b"\n") if path.exists() else 0


def wait_for(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError
        time.sleep(0.02)


def children(parent: int) -> list[int]:
    """Worker processes of a program."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            if int((place / "stat").read_text().rpartition(")")[2].split()[1]) == parent:
                found.append((int(place.name), (place / "cmdline").read_bytes()))
        except OSError:
            continue
    return [pid for pid, command in found if b"spawn_main" in command]


def killed(spec: StudySpec, options: list[str], path: Path) -> None:
    """Kill the program after a third of the rows, and a worker of the next program after two thirds."""
    total = count(spec)
    command = [sys.executable, __file__, *options, "--run", str(path)]
    with subprocess.Popen(command) as first:
        wait_for(lambda: rows_in(path) >= total // 3)
        first.send_signal(signal.SIGKILL)
    with subprocess.Popen(command) as second:
        wait_for(lambda: rows_in(path) >= 2 * total // 3)
        os.kill(children(second.pid)[0], signal.SIGKILL)
        if second.wait() != 0:
            raise SystemExit("the second program failed")


def mpi(options: list[str], path: Path) -> None:
    """The program and two workers as processes of MPI."""
    launcher = shutil.which("mpiexec")
    if launcher is None or importlib.util.find_spec("mpi4py") is None:
        raise StudyError("needs mpi4py and mpiexec")
    program = [sys.executable, "-m", "mpi4py.futures", __file__, *options]
    command = [launcher, *MPI_OPTIONS, "-n", "3", *program, "--executor", "mpi", "--run", str(path)]
    if subprocess.run(command, check=False).returncode != 0:
        raise SystemExit("the program under MPI failed")


def vanished(spec: StudySpec, path: Path) -> None:
    """Kill one of two workers of Dask after half of the rows."""
    with dask_cluster(2) as (address, workers):
        gone: list[int] = []

        def progress(_: object) -> None:
            if not gone and rows_in(path) >= count(spec) // 2:
                workers[0].kill()
                gone.append(workers[0].pid)

        study(spec, path, executor="dask", address=address, progress=progress)


def run(name: str, spec: StudySpec, options: list[str], path: Path) -> None:
    if name.startswith("process"):
        study(spec, path, executor="process", workers=int(name[-1]))
    elif name == "thread":
        study(spec, path, executor="thread", workers=2)
    elif name == "loky":
        study(spec, path, executor="loky", workers=2)
    elif name == "dask":
        with dask_cluster(2) as (address, _):
            study(spec, path, executor="dask", address=address)
    elif name == "ray":
        study(spec, path, executor="ray", workers=2)
    elif name == "mpi":
        mpi(options, path)
    elif name == "killed":
        killed(spec, options, path)
    else:
        vanished(spec, path)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument(
        "--tx40", action="store_true", help="a part of the benchmark, with tasks fifty times as long"
    )
    parser.add_argument("--only", nargs="+", choices=RUNS, default=RUNS)
    parser.add_argument("--run", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--executor", default="process", help=argparse.SUPPRESS)
    options = parser.parse_args()
    spec = spec_of(options.seeds, options.tx40)
    same = ["--seeds", str(options.seeds), *(["--tx40"] if options.tx40 else [])]
    if options.run is not None:
        study(spec, options.run, executor=options.executor, workers=2)
        return 0
    first = next(tasks(spec))
    size, text = len(pickle.dumps(first)), len(canonical(spec.shared()))
    print(
        f"{count(spec)} tasks, {size} bytes each as a pickle ({text} bytes of files, compressed); load {os.getloadavg()[0]:.1f}"
    )
    print(
        f"{'executor':10} {'rows':>6} {'wall s':>8} {'tasks cpu s':>12} {'overhead %':>11} {'ms a task':>10} {'MB':>6}  sorted rows"
    )
    found = set()
    with tempfile.TemporaryDirectory() as folder:
        for name in options.only:
            path = Path(folder) / f"{name}.jsonl"
            start, spent = time.perf_counter(), processor_seconds()
            try:
                run(name, spec, same, path)
            except StudyError as reason:
                print(f"{name:10} not run: {reason}")
                continue
            wall, spent = time.perf_counter() - start, processor_seconds() - spent
            times = [json.loads(line) for line in times_path(path).read_text().splitlines()]
            work = sum(item["cpu_seconds"] for item in times)
            memory = max(item["memory_mb"] or 0.0 for item in times)
            rows = read_rows(path)
            lines = rows_in(path)
            assert lines == len(rows.fits) + len(rows.truths) == count(spec), (
                "a row is missing, or there twice"
            )
            found.add(fingerprint(path))
            print(
                f"{name:10} {lines:>6} {wall:>8.1f} {work:>12.1f} {100.0 * (spent / work - 1.0):>11.1f} "
                f"{1e3 * work / lines:>10.1f} {memory:>6.0f}  {fingerprint(path)}",
                flush=True,
            )
    print("all the same" if len(found) == 1 else "DIFFERENT")
    return 0 if len(found) == 1 else 1


if __name__ == "__main__":
    sys.exit(main())
