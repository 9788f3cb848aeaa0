"""Errors made on purpose: each must be caught by a test.

    python benches/mutations.py [--rust] [--only NAME]

A mutation changes one place of the package in a scratch copy of the project: a sign, an index, a unit, a weight. The tests named
beside it are run there, first as it is, which must pass, then changed, which must not. ``--rust`` takes those of the core
instead, by ``cargo test --release`` in the copy (minutes each; the first build apart, which all share).
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Mutation:
    """One changed place, and the tests that must see it.

    Attributes
    ----------
    name : str
        What is wrong.
    file, old, new : str
        Where; the text that is there once, and what comes instead.
    tests : str
        Arguments of pytest, or the filter of ``cargo test``.
    """

    name: str
    file: str
    old: str
    new: str
    tests: str


PYTHON = (
    Mutation(
        "degrees are gradians",
        "python/didim/log/units.py",
        "math.pi / 180.0",
        "math.pi / 200.0",
        "tests/test_recording.py",
    ),
    Mutation(
        "a reduction is not transposed for positions",
        "python/didim/log/recording_file.py",
        "np.linalg.inv(matrix).T.astype",
        "np.linalg.inv(matrix).astype",
        "tests/test_recording.py",
    ),
    Mutation(
        "a window is one sample short",
        "python/didim/log/sampling.py",
        "start, stop = (round(edge * rate_hz) for edge in window)",
        "start, stop = round(window[0] * rate_hz), round(window[1] * rate_hz) - 1",
        "tests/test_recording.py",
    ),
    Mutation(
        "central differences over one step instead of two",
        "python/didim/signal/filters.py",
        "(x[2:] - x[:-2]) / (2.0 * dt)",
        "(x[2:] - x[:-2]) / dt",
        "tests/test_signals.py",
    ),
    Mutation(
        "the delay of the torque has the other sign",
        "python/didim/signal/align.py",
        "whole = math.floor(delay)",
        "whole = math.floor(-delay)",
        "tests/test_delay.py",
    ),
    Mutation(
        "the hold of a digital controller makes its torque late instead of early",
        "python/didim/methods/job.py",
        "return self.samples - hold",
        "return self.samples + hold",
        "tests/test_hold.py",
    ),
    Mutation(
        "a standard MDH row takes its angle from the wrong joint",
        "python/didim/robot/robot_file.py",
        "alpha, d = (0.0, *alpha[:-1]), (0.0, *d[:-1])",
        "alpha, d = (0.0, *alpha[1:]), (0.0, *d[:-1])",
        "tests/test_robot.py",
    ),
    Mutation(
        "the variance divides by r - 1 instead of r - b",
        "python/didim/regression/settings.py",
        'return rows - columns if self.variance == "r-b" else rows - 1',
        "return rows - 1",
        "tests/test_least_squares.py",
    ),
    Mutation(
        "weights are the sigma of a joint instead of its reciprocal",
        "python/didim/regression/least_squares.py",
        "per_row(system, 1.0 / joint_sigma(system, residual))",
        "per_row(system, joint_sigma(system, residual))",
        "tests/test_least_squares.py",
    ),
    Mutation(
        "a regrouped coefficient has the wrong sign",
        "python/didim/robot/base_parameters.py",
        "matrix[row, other] = coefficient",
        "matrix[row, other] = -coefficient",
        "tests/test_base_parameters.py",
    ),
    Mutation(
        "damping of a tuned PD is halved",
        "python/didim/loop/controller.py",
        "2.0 * ratio * omega * j / gain",
        "ratio * omega * j / gain",
        "tests/test_control.py",
    ),
    Mutation(
        "gain updating divides instead of multiplying",
        "python/didim/methods/didim/loops.py",
        "here / np.where(real > 0.0, real, 1.0), 1.0)",
        "real / np.where(here > 0.0, here, 1.0), 1.0)",
        "tests/test_didim.py",
    ),
    Mutation(
        "Levenberg-Marquardt goes uphill",
        "python/didim/methods/cloe/levenberg_marquardt.py",
        "-gradient / size) / size",
        "gradient / size) / size",
        "tests/test_cloe.py",
    ),
    Mutation(
        "the simplex contracts to the wrong side",
        "python/didim/methods/cloe/nelder_mead.py",
        "(1 - psi) * centre + psi * worst",
        "(1 + psi) * centre - psi * worst",
        "tests/test_nelder_mead.py",
    ),
    Mutation(
        "noise passes the filter of a decimation once",
        "python/didim/signal/noise.py",
        "power *= gain * gain",
        "power *= gain",
        "tests/test_signals.py",
    ),
    Mutation(
        "millimetres of a reference are centimetres",
        "python/didim/experiment/loop_tables.py",
        '"mm": 1e-3}',
        '"mm": 1e-2}',
        "tests/test_closed_loop.py",
    ),
    Mutation(
        "errors of a simulation take in the trimmed end",
        "python/didim/studies/run.py",
        "kept = slice(signal.trim_start, stop - start - signal.trim_end)",
        "kept = slice(signal.trim_start, stop - start)",
        "tests/test_simulate_command.py",
    ),
    Mutation(
        "the integral of a cascade takes its time the wrong way",
        "python/didim/loop/controller.py",
        "[p * d, d, d / ti, a, w,",
        "[p * d, d, d * ti, a, w,",
        "tests/test_control.py",
    ),
)

RUST = (
    Mutation(
        "gravity pushes instead of pulling",
        "rust/src/model/motion.rs",
        "Vector::splat([-x, -y, -z])",
        "Vector::splat([x, y, z])",
        "",
    ),
    Mutation(
        "Coriolis acceleration of a prismatic joint has the wrong sign",
        "rust/src/model/motion.rs",
        "a.x = omega.y.mul_add(twice, a.x);",
        "a.x = omega.y.neg_mul_add(twice, a.x);",
        "",
    ),
    Mutation(
        "a coupled motor rubs at the speed of the wrong joint",
        "rust/src/model/friction.rs",
        "tau[m] = (speed - dq[m]).mul_add(fvm,",
        "tau[m] = (speed - dq[0]).mul_add(fvm,",
        "",
    ),
    Mutation(
        "the middle stages of Runge-Kutta weigh as much as the outer ones",
        "rust/src/closed_loop/runge_kutta.rs",
        "weighted[j] += ddq[j] + ddq[j];",
        "weighted[j] += ddq[j];",
        "",
    ),
)


def copy(target: Path) -> None:
    """Copy what tests need: no builds, no results."""
    leave = shutil.ignore_patterns(
        ".git", ".venv", "target", "site", "dist", "out", "__pycache__", ".*_cache", ".hypothesis"
    )
    shutil.copytree(PROJECT, target, ignore=leave)
    # Measured data stay where they are: tests look for them beside the project.
    shared = PROJECT.parent / "shared"
    if shared.is_dir():
        (target.parent / "shared").symlink_to(shared.resolve())


def run(folder: Path, mutation: Mutation, rust: bool) -> tuple[bool, str]:
    """Run the tests of a mutation in a copy; return whether they pass, and the first that does not."""
    environment = {**os.environ, "PYTHONPATH": str(folder / "python"), "PYTHONDONTWRITEBYTECODE": "1"}
    if rust:
        command = ["cargo", "test", "--release", *mutation.tests.split()]
        pattern = r"^test (\S+) \.\.\. FAILED|^(error.*)"
    else:
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-x",
            "-q",
            "-p",
            "no:cacheprovider",
            *mutation.tests.split(),
        ]
        pattern = r"^FAILED \S+?::(\w+)|^ERROR (.*)"
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    found = re.search(pattern, done.stdout + done.stderr, re.MULTILINE)
    first = next((group for group in found.groups() if group), "") if found else "?"
    return done.returncode == 0, first


def mutate(folder: Path, mutation: Mutation) -> str:
    """Change the place; return the whole text as it was.

    Raises
    ------
    SystemExit
        When the place is not there exactly once: the code has moved on, and the mutation must follow.
    """
    path = folder / mutation.file
    text = path.read_text(encoding="utf-8")
    if text.count(mutation.old) != 1:
        raise SystemExit(
            f"{mutation.file}: {text.count(mutation.old)} times {mutation.old!r}, for '{mutation.name}'"
        )
    path.write_text(text.replace(mutation.old, mutation.new), encoding="utf-8")
    return text


def main() -> int:
    """Run the mutations that were asked for; 1 when one is not caught."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--rust", action="store_true", help="those of the core; builds it once for each")
    parser.add_argument("--only", default="", metavar="NAME", help="those whose name has this in it")
    options = parser.parse_args()
    chosen = [item for item in (RUST if options.rust else PYTHON) if options.only in item.name]
    escaped = 0
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch, "didim")
        copy(folder)
        sound: set[str] = set()
        for mutation in chosen:
            if mutation.tests not in sound:
                passed, first = run(folder, mutation, options.rust)
                if not passed:
                    raise SystemExit(f"without any mutation {mutation.tests or 'the tests'} fail: {first}")
                sound.add(mutation.tests)
            text = mutate(folder, mutation)
            passed, first = run(folder, mutation, options.rust)
            (folder / mutation.file).write_text(text, encoding="utf-8")
            escaped += passed
            print(f"{mutation.name} ({mutation.file}): {'NOT CAUGHT' if passed else first}", flush=True)
    print(f"{len(chosen) - escaped} of {len(chosen)} caught")
    return 1 if escaped else 0


if __name__ == "__main__":
    sys.exit(main())
