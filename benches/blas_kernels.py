"""Run the published figures under every BLAS kernel that this processor supports.

    python benches/blas_kernels.py [--kernels Haswell SkylakeX] [--data FOLDER] [--tests PATH ...]

The OpenBLAS inside NumPy and the one inside SciPy choose their kernels by the processor. OPENBLAS_CORETYPE, set for
the child processes of this script only, chooses another. A child reports the kernels that were really taken, then
pytest runs the tests of the published figures. At the end the plain recipe of the TX40 log, whose friction of joints 2
and 3 depends on rounding, is fitted under each kernel: the two tables are those of docs/published.md. The exit status is 0
when every test has passed under every supported kernel and none was skipped.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np

PROJECT = Path(__file__).resolve().parent.parent
DATA = PROJECT.parent / "shared" / "data" / "tx40"
REFERENCE = PROJECT.parent / "shared" / "reference" / "table2.csv"
KERNELS = ("Haswell", "SkylakeX", "Zen", "Nehalem")
TESTS = ("tests/test_published.py", "tests/test_documented.py")
PLAIN = "tx40_log.toml"
LARGE_SPREAD = 0.3
"""Smallest spread, in standard deviations, of a parameter in the second table."""

PROBE = """
import json
import numpy as np
import scipy.linalg
import threadpoolctl
a = np.random.default_rng(0).standard_normal((200, 200))
np.linalg.svd(a @ a)
scipy.linalg.qr(a @ a)
blas = [pool for pool in threadpoolctl.threadpool_info() if pool["user_api"] == "blas"]
print(json.dumps({
    "numpy" if "numpy" in pool["filepath"] else "scipy": pool.get("architecture", pool["internal_api"]) for pool in blas
}))
"""


class Tests(NamedTuple):
    """Result of pytest: its exit status and its counts."""

    status: int
    counts: dict[str, int]
    output: str

    @property
    def passed(self) -> bool:
        """Whether tests ran, and all of them passed."""
        return self.status == 0 and self.counts.get("passed", 0) > 0 and not self.counts.get("skipped", 0)

    def __str__(self) -> str:
        return ", ".join(f"{count} {what}" for what, count in self.counts.items()) or "no test ran"


def child(arguments: Sequence[str], kernel: str) -> subprocess.CompletedProcess[str]:
    """Run Python in the folder of the project with a kernel asked for."""
    environment = {"OPENBLAS_NUM_THREADS": "1"} | os.environ | {"OPENBLAS_CORETYPE": kernel}
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=PROJECT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


def kernels_taken(kernel: str) -> dict[str, str] | None:
    """Kernel of NumPy's and of SciPy's BLAS when one is asked for; None where the processor cannot run it."""
    run = child(["-c", PROBE], kernel)
    if run.returncode > 0:
        raise SystemExit(f"blas_kernels: {run.stderr.strip().splitlines()[-1]}")
    # A negative status is a signal: the processor does not know an instruction of the kernel.
    taken: dict[str, str] | None = json.loads(run.stdout) if run.returncode == 0 else None
    return taken


def run_tests(kernel: str, tests: Sequence[str]) -> Tests:
    """Run pytest under a kernel."""
    run = child(["-m", "pytest", "-q", "-p", "no:cacheprovider", *tests], kernel)
    last = run.stdout.strip().splitlines()[-1:] or [""]
    counts = {what: int(count) for count, what in re.findall(r"(\d+) (passed|failed|skipped|error)", last[0])}
    return Tests(run.returncode, counts, run.stdout + run.stderr)


def measure(data: Path) -> Iterator[dict[str, Any]]:
    """Fit the plain recipe with both forms and both paddings of its filter, in this process."""
    import didim
    from didim.signal.processing import Convention, Form

    experiment = didim.load_experiment(PROJECT / "examples" / PLAIN, data=data)
    with REFERENCE.open(encoding="utf-8", newline="") as file:
        reference = {row["name"]: row for row in csv.DictReader(file)}
    for form, padding in product(get_args(Form), get_args(Convention)):
        signal = replace(experiment.signal, form=form, padding=padding)
        fit = didim.identify(experiment, didim.IDIMLS(signal=signal))
        expected = np.array([float(reference[name]["real_log_estimate"]) for name in fit.names])
        percent = np.array([float(reference[name]["real_log_sigma_percent"]) for name in fit.names])
        off = np.abs(fit.beta - expected) / np.abs(0.01 * percent * expected)
        worst = int(np.argmax(off))
        yield {
            "filter": f"{form}, {padding}",
            "names": fit.names,
            "units": fit.units,
            "beta": fit.beta.tolist(),
            "std": fit.std.tolist(),
            "errors": [f"{100.0 * error:.1f}" for error in fit.relative_error],
            "distance": f"{off[worst]:.3f} (`{fit.names[worst]}`)",
        }


def filters(measured: dict[str, list[dict[str, Any]]]) -> Iterator[list[str]]:
    """Rows of the first table: kernels with the same result share one."""
    yield ["filter", "BLAS kernel", *(f"joint {joint}" for joint in range(1, 7)), "largest distance"]
    for index, name in enumerate(fit["filter"] for fit in next(iter(measured.values()))):
        rows: dict[tuple[str, ...], list[str]] = {}
        for kernel, fits in measured.items():
            rows.setdefault((*fits[index]["errors"], fits[index]["distance"]), []).append(kernel)
        for cells, kernels in rows.items():
            yield [name, ", ".join(kernels), *cells]


def spread(measured: dict[str, list[dict[str, Any]]]) -> Iterator[list[str]]:
    """Rows of the second table: parameters that kernels, forms and paddings move."""
    fits = [fit for found in measured.values() for fit in found]
    beta = np.array([fit["beta"] for fit in fits])
    low, high = beta.min(axis=0), beta.max(axis=0)
    std = np.max([fit["std"] for fit in fits], axis=0)
    sigmas = (high - low) / std
    yield ["name", "unit", "smallest", "largest", "spread in sigma"]
    for k in np.flatnonzero(sigmas > LARGE_SPREAD):
        name, unit = fits[0]["names"][k], fits[0]["units"][k]
        yield [f"`{name}`", unit, f"{low[k]:.4g}", f"{high[k]:.4g}", f"{sigmas[k]:.2f}"]


def table(rows: Iterator[list[str]]) -> str:
    """Rows in Markdown, the first of them the heading."""
    lines = [f"| {' | '.join(row)} |" for row in rows]
    lines.insert(1, "|---" * (lines[0].count("|") - 1) + "|")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run everything; return the exit status."""
    parser = argparse.ArgumentParser(description="The published figures under every BLAS kernel.")
    parser.add_argument("--kernels", nargs="+", default=list(KERNELS), help="values of OPENBLAS_CORETYPE")
    parser.add_argument("--tests", nargs="+", default=list(TESTS), help="what pytest runs")
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the two CSV files of the TX40")
    parser.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args(arguments)
    if chosen.measure:
        print(json.dumps(list(measure(chosen.data))))
        return 0
    sound, measured = True, {}
    for kernel in chosen.kernels:
        taken = kernels_taken(kernel)
        if taken is None:
            print(f"{kernel}: the processor cannot run it", flush=True)
            continue
        used = ", ".join(f"{library} runs {name}" for library, name in sorted(taken.items()))
        tests = run_tests(kernel, chosen.tests)
        print(f"{kernel}: {used}: {tests}", flush=True)
        if not tests.passed:
            sound = False
            print(tests.output, file=sys.stderr)
        name = " and ".join(sorted(set(taken.values())))
        if name not in measured and chosen.data.is_dir():
            run = child([__file__, "--measure", "--data", str(chosen.data.resolve())], kernel)
            if run.returncode:
                raise SystemExit(f"blas_kernels: {run.stderr.strip()}")
            measured[name] = json.loads(run.stdout)
    if measured:
        print(
            f"\nexamples/{PLAIN} by its filter; relative torque errors in %",
            table(filters(measured)),
            sep="\n\n",
        )
        print("\nparameters by all of these", table(spread(measured)), sep="\n\n")
    return 0 if sound else 1


if __name__ == "__main__":
    sys.exit(main())
