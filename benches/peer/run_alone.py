"""A whole run of ours in a process of its own; the result is JSON.

    python run_alone.py import | didim | (idim-ls | memory) EXPERIMENT DATA

The process has imported everything before it starts the clock. ``first`` is what a user of a script waits for, ``again`` the
same work once more: the difference is what a process does once, such as loading shared code and filling pages.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path


def main() -> None:
    what, *rest = sys.argv[1:]
    runs: dict[str, Callable[..., dict[str, float]]] = {
        "import": import_time,
        "didim": didim_simulated,
        "idim-ls": idim_ls,
        "memory": memory,
    }
    print(json.dumps(runs[what](*rest)))


def import_time() -> dict[str, float]:
    """Seconds once NumPy is there, (s): of `import didim`, which loads little, and with what IDIM-LS needs of it."""
    import numpy  # noqa: F401

    start = time.perf_counter()
    import didim  # noqa: F401

    bare = time.perf_counter() - start
    from didim import IDIMLS, identify, load_experiment  # noqa: F401

    return {"s": bare, "idim-ls": time.perf_counter() - start}


def idim_ls(experiment: str, data: str) -> dict[str, float]:
    """IDIM-LS from the CSV files to the table twice, (s): all of it, and the part between reading and printing."""
    _import_scipy()
    from didim import IDIMLS, identify, load_experiment

    found = []
    for _ in range(2):
        start = time.perf_counter()
        loaded = load_experiment(experiment, data=data)
        read = time.perf_counter()
        fit = identify(loaded, IDIMLS())
        fitted = time.perf_counter()
        table = str(fit)
        found.append((time.perf_counter() - start, fitted - read))
        if not fit.converged or fit.names[0] not in table:
            raise SystemExit("IDIM-LS gave no table")
    (first, numerics), (again, numerics_again) = found
    return {"first": first, "again": again, "numerics": numerics, "numerics again": numerics_again}


def didim_simulated() -> dict[str, float]:
    """DIDIM on the simulated TX40 of `didim compare` twice, (s), without the making of the log."""
    _import_scipy()
    import didim
    from didim.studies.simulated_log import LOG_REFINEMENT, packaged_experiment, simulated_log

    experiment = packaged_experiment("tx40")
    log = simulated_log(experiment, experiment.robot.parameter_set("didim"), refinement=LOG_REFINEMENT)
    found = []
    for _ in range(2):
        start = time.perf_counter()
        fit = didim.identify(log, didim.DIDIM())
        found.append(time.perf_counter() - start)
        if not fit.converged:
            raise SystemExit(f"DIDIM: {fit.status.value}")
    return {"first": found[0], "again": found[1], "simulations": fit.n_simulations}


def memory(experiment: str, data: str) -> dict[str, float]:
    """Peak of IDIM-LS, and of `import didim`, above an interpreter that has imported NumPy and SciPy, (MB)."""
    _import_scipy()
    before = _megabytes("VmRSS")
    import didim

    fit = didim.identify(didim.load_experiment(experiment, data=data), didim.IDIMLS())
    if not fit.converged:
        raise SystemExit("IDIM-LS gave no table")
    return {"MB": _megabytes("VmHWM") - before}


def _import_scipy() -> None:
    import numpy  # noqa: F401
    import scipy.fft
    import scipy.linalg
    import scipy.signal  # noqa: F401


def _megabytes(what: str) -> float:
    """Return a line of this process's status: `getrusage` would tell the peak of the process that started it, if that is larger."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith(what):
            return float(line.split()[1]) * 1024e-6
    raise SystemExit(f"this system does not tell {what}")


if __name__ == "__main__":
    main()
