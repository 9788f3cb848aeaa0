"""Errors made on purpose: each must be caught by a test.

    python benches/mutations.py [--rust] [--only NAME]
    python benches/mutations.py --constants 150 [--seed 0] [--seconds 60]

A mutation changes one place of the package in a scratch copy of the project: a sign, an index, a unit, a weight. The tests named
beside it are run there, first as it is, which must pass, then changed, which must not. ``--rust`` takes those of the core
instead, by ``cargo test --release`` in the copy (minutes each; the first build apart, which all share).

``--constants`` draws module constants of heuristics, doubled or halved (``benches/constants.py``), and runs the tests that run a
line with each (``benches/reach.py``), the shortest first, for so many seconds of the processor at most. Where one fails, it is
run once more without the change, and must pass. What is not caught needs a test, is not needed, or has a reason, such as a bound
that only saves time. What became of each stands in ``out/mutations/``: ``--resume`` leaves out those that are there.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from constants import Planted, drawn, lines_using
from reach import tests_of

PROJECT = Path(__file__).resolve().parent.parent
FIRST_TESTS = 40
"""Tests that a changed constant meets first; five times as many each time after."""
ESCAPED = "NOT CAUGHT"


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
        'POSITION = {"rad": 1.0, "deg": math.pi / 180.0',
        'POSITION = {"rad": 1.0, "deg": math.pi / 200.0',
        "tests/test_recording.py",
    ),
    Mutation(
        "a reduction is not transposed for positions",
        "python/didim/log/recording_file.py",
        "np.linalg.inv(matrix).T)",
        "np.linalg.inv(matrix))",
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
        "python/didim/signal/window.py",
        "whole = math.floor(delay)",
        "whole = math.floor(-delay)",
        "tests/test_delay.py",
    ),
    Mutation(
        "the hold of a digital controller makes its torque late instead of early",
        "python/didim/signal/window.py",
        "else delay - hold",
        "else delay + hold",
        "tests/test_hold.py",
    ),
    Mutation(
        "a standard MDH row takes its angle from the wrong joint",
        "python/didim/robot/standard_dh.py",
        "return (0.0, *self.alpha[:-1]), (0.0, *self.a[:-1])",
        "return (0.0, *self.alpha[1:]), (0.0, *self.a[:-1])",
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
        "python/didim/robot/parameters.py",
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
        "python/didim/methods/didim/problem.py",
        "quotient(here, real, 1.0)",
        "quotient(real, here, 1.0)",
        "tests/test_didim.py",
    ),
    Mutation(
        "Levenberg-Marquardt goes uphill",
        "python/didim/methods/cloe/levenberg_marquardt.py",
        "-slope) / size",
        "slope) / size",
        "tests/test_cloe.py",
    ),
    Mutation(
        "the simplex contracts to the wrong side",
        "python/didim/methods/cloe/nelder_mead.py",
        "(1.0, chi, psi, -psi)",
        "(1.0, chi, psi, psi)",
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
        "limits of a reference in degrees or millimetres are taken as SI",
        "python/didim/log/units.py",
        "values[joint] = number * factor",
        "values[joint] = number",
        "tests/test_closed_loop.py",
    ),
    Mutation(
        "errors of a simulation take in the trimmed end",
        "python/didim/studies/run.py",
        "inside = slice(signal.trim_start, stop - start - signal.trim_end)",
        "inside = slice(signal.trim_start, stop - start)",
        "tests/test_simulate_command.py",
    ),
    Mutation(
        "the integral of a cascade takes its time the wrong way",
        "python/didim/loop/controller.py",
        "[p * d, d, d / ti, a, w,",
        "[p * d, d, d * ti, a, w,",
        "tests/test_control.py",
    ),
    Mutation(
        "steps of a coarsely quantised torque are spikes",
        "python/didim/signal/spikes.py",
        "floor, _resolution(cleaned[:, column])",
        "floor, 0.0",
        "tests/test_spikes.py",
    ),
    Mutation(
        "moves of a points design are not looked at between the samples of the search",
        "python/didim/excitation/points.py",
        "if value > best and all(self.verified(*ends[j]) for j in around):",
        "if value > best:",
        "tests/test_excitation.py",
    ),
    Mutation(
        "the damping of Levenberg and Marquardt is never raised",
        "python/didim/methods/cloe/levenberg_marquardt.py",
        "damping *= 1e4",
        "pass",
        "tests/test_cloe.py",
    ),
    Mutation(
        "a derivative at the edge of the feasible set is zero",
        "python/didim/methods/cloe/output_error.py",
        "slopes = np.where(inside[:, None], (errors - other) / steps[back, None], 0.0)",
        "slopes = 0.0 * other",
        "tests/test_cloe.py",
    ),
    Mutation(
        "consistent DIDIM takes no secant step",
        "python/didim/methods/didim/steps.py",
        "wanted = self._secant(ahead, inverse(solved.fit.covariance)) if iterate.iteration >= 2 else 1.0",
        "wanted = 1.0",
        "tests/test_didim_endings.py",
    ),
    Mutation(
        "consistent DIDIM goes uphill as far as it likes",
        "python/didim/methods/didim/steps.py",
        "tried[-1][0] <= RISE * cost",
        "tried[-1][0] <= 1e9 * cost",
        "tests/test_didim_endings.py",
    ),
    Mutation(
        "what is left of a contraction is called smaller than it is",
        "python/didim/methods/didim/convergence.py",
        "left = SAFETY * expected",
        "left = 0.2 * expected",
        "tests/test_didim_endings.py tests/test_slack_loop.py",
    ),
    Mutation(
        "held-out recordings may fit twice as badly",
        "python/didim/evidence/residual.py",
        "LARGER = 1.5",
        "LARGER = 3.0",
        "tests/test_thresholds.py",
    ),
    Mutation(
        "records of a digital controller are not late by its hold",
        "python/didim/evidence/loop/law_rows.py",
        "return digital.sample_time_s * digital.delay_samples + held",
        "return digital.sample_time_s * digital.delay_samples",
        "tests/test_thresholds.py",
    ),
    Mutation(
        "another log contradicts a cause where it agrees",
        "python/didim/evidence/causes.py",
        "float(np.sum(np.log(after / before))) > OTHER_LOG",
        "float(np.sum(np.log(before / after))) > OTHER_LOG",
        "tests/test_evidence_causes.py",
    ),
    Mutation(
        "the growth of a trial is that of squares",
        "python/didim/evidence/causes.py",
        "growth = float(np.sqrt(judged.unseen.sum() / products.seen(*hypothesis.channels).sum()))",
        "growth = float(judged.unseen.sum() / products.seen(*hypothesis.channels).sum())",
        "tests/test_evidence_causes.py",
    ),
    Mutation(
        "the best held-out recording says what to expect",
        "python/didim/evidence/uses.py",
        "worst = max(outside,",
        "worst = min(outside,",
        "tests/test_evidence_result.py",
    ),
    Mutation(
        "the error of gravity is that of all joints together",
        "python/didim/evidence/uses.py",
        "_gravity(still, missed / root, evidence)",
        "_gravity(still, missed * root, evidence)",
        "tests/test_evidence_result.py",
    ),
    Mutation(
        "correlation that is known of the noise counts as the model's",
        "python/didim/evidence/whiteness.py",
        "expected[: len(known)] = known",
        "pass",
        "tests/test_verdict.py",
    ),
    Mutation(
        "torques of a digital hold are behind the motion",
        "python/didim/evidence/lasting.py",
        '"held": -HOLD[1] < late < -HOLD[0]',
        '"held": HOLD[0] < late < HOLD[1]',
        "tests/test_evidence_causes.py",
    ),
    Mutation(
        "a change along a log has the variance of one side",
        "python/didim/methods/positions/intervals.py",
        "np.sqrt(sum(variances))",
        "np.sqrt(variances[0])",
        "tests/test_position_intervals.py",
    ),
    Mutation(
        "intervals are those of the first cut",
        "python/didim/methods/positions/intervals.py",
        "    for cut in cuts:\n",
        "    for cut in cuts[:1]:\n",
        "tests/test_position_intervals.py",
    ),
    Mutation(
        "an effect is compared over the rows of all limbs",
        "python/didim/methods/positions/knowledge.py",
        "own = rows * len(limbs) / len(problem.limbs)",
        "own = rows",
        "tests/test_position_intervals.py",
    ),
    Mutation(
        "the jackknife of robots forgets their conditions",
        "python/didim/regression/covariance.py",
        "information[:k, :k] += precision",
        "information[:k, :k] += 1e-9 * precision",
        "tests/test_consistent.py",
    ),
    Mutation(
        "a joint that alarms may have no law",
        "python/didim/regression/friction/alarm.py",
        "(alarmed[joint] or best.gain",
        "(best.gain",
        "tests/test_friction_exchange.py",
    ),
    Mutation(
        "velocities of laws that a file gives hide missing friction",
        "python/didim/evidence/judge.py",
        'return "chosen" in fit.settings.get("friction", {})',
        'return bool(fit.settings.get("friction", {}))',
        "tests/test_evidence_result.py",
    ),
    Mutation(
        "friction at speeds moves without the law that is missing",
        "python/didim/regression/friction/alarm.py",
        "bias, errors = bias + law.amount * unit, errors + np.outer(law.by_block, unit)",
        "bias, errors = bias, errors",
        "tests/test_friction_exchange.py",
    ),
    Mutation(
        "a bias is a deviation: its square is added",
        "python/didim/regression/friction/alarm.py",
        "size = quotient(np.abs(bias), std)",
        "size = 0.5 * quotient(np.abs(bias), std)",
        "tests/test_friction_alarm.py",
    ),
    Mutation(
        "a law that moves links and rotors elsewhere is kept",
        "python/didim/regression/friction/screen.py",
        'return term.law == "hold" or worth.shift <= LARGEST_SHIFT',
        "return True",
        "tests/test_friction_choice.py",
    ),
    Mutation(
        "friction that drives the joint is kept",
        "python/didim/regression/friction/choice.py",
        'if term.law not in ("load", "dahl", "spring") or',
        "if True or",
        "tests/test_friction_choice.py",
    ),
    Mutation(
        "dynamic friction for Isaac Lab is viscous friction",
        "python/didim/export/configuration.py",
        '"dynamic_friction": "coulomb"',
        '"dynamic_friction": "viscous"',
        "tests/test_export_drives.py",
    ),
    Mutation(
        "a smooth sign that is kept has no dead zone before",
        "python/didim/model/memory.py",
        "return np.asarray(sign * (np.abs(dq) > np.asarray(friction.dead_zone)))",
        "return np.asarray(sign * (smooth | (np.abs(dq) > np.asarray(friction.dead_zone))))",
        "tests/test_base_parameters.py",
    ),
    Mutation(
        "a payload is as certain as if the robot were known",
        "python/didim/studies/loads/payload.py",
        "covariance = of_log + from_robot @ from_robot.T",
        "covariance = of_log",
        "tests/test_payload.py",
    ),
    Mutation(
        "a gear that is declared too small makes torques too large",
        "python/didim/evidence/hypotheses/positions.py",
        "            factors=diagonal(n, joint, 1.0 / f),\n",
        "            factors=diagonal(n, joint, f),\n",
        "tests/test_check.py",
    ),
    Mutation(
        "millimetres that are declared as metres are kilometres",
        "python/didim/evidence/hypotheses/positions.py",
        '("prismatic", "m", "mm", 1e-3)',
        '("prismatic", "m", "mm", 1e3)',
        "tests/test_evidence_causes.py",
    ),
    Mutation(
        "the side of positions is exchanged where it is right",
        "python/didim/evidence/hypotheses/positions.py",
        'np.linalg.inv(r) if side["position"] == "joint" else r,',
        'np.linalg.inv(r) if side["position"] != "joint" else r,',
        "tests/test_check.py",
    ),
    Mutation(
        "recordings are validated with the payload of the first",
        "python/didim/studies/validation.py",
        "strict=True):\n        direct, overall = None",
        "strict=True):\n        x = loaded[0]\n        direct, overall = None",
        "tests/test_validate.py",
    ),
)

RUST = (
    Mutation(
        "gravity pushes instead of pulling",
        "rust/src/model/motion.rs",
        "let a = Vector::splat([-x, -y, -z])",
        "let a = Vector::splat([x, y, z])",
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
    Mutation(
        "a kept sign has the friction of the other direction",
        "rust/src/model/remembered.rs",
        "(z.min(zero) - s.min(zero)).mul_add(d[j], forward)",
        "(z.min(zero) - s.min(zero)).mul_add(b[j], forward)",
        "",
    ),
    Mutation(
        "what is taken implicitly is the friction of the other direction",
        "rust/src/model/steep.rs",
        "dry[j].or_where_not_above(dry_back[j], s)",
        "dry_back[j].or_where_not_above(dry[j], s)",
        "",
    ),
    Mutation(
        "a motor of three joints couples two of them the wrong way in an implicit step",
        "rust/src/model/steep.rs",
        "matrix[other.max(i)][other.min(i)] += slope.scale(c * factor);",
        "matrix[other.max(i)][other.min(i)] += slope.scale(-c * factor);",
        "",
    ),
    Mutation(
        "the slope of a balancing weight has the wrong sign in the design's gradient",
        "rust/src/model/friction_terms.rs",
        "Law::Cosine => -q.sin_cos().0,",
        "Law::Cosine => q.sin_cos().0,",
        "",
    ),
    Mutation(
        "the slope of a gas spring's stiffness has the wrong sign in the design's gradient",
        "rust/src/model/friction_terms.rs",
        "cosine - bend(cylinder, q).scale(cylinder.rest)",
        "cosine + bend(cylinder, q).scale(cylinder.rest)",
        "",
    ),
    Mutation(
        "no state of the base parameters is inside a dead zone",
        "rust/src/regression/base.rs",
        "let zone = friction.dead_zone[joint];",
        "let zone = 0.0;",
        "",
    ),
    Mutation(
        "no state of the base parameters is where a smooth sign turns",
        "rust/src/regression/base.rs",
        "curved.chain([friction.smoothing[joint]])",
        "curved.chain([0.0])",
        "",
    ),
    Mutation(
        "a torque at standstill always has a base parameter of its own",
        "rust/src/regression/base.rs",
        "Law::Rest => robot.friction().dead_zone[term.joint] <= 0.0,",
        "Law::Rest => true,",
        "",
    ),
    Mutation(
        "a sign that is kept through rest has a dead zone among the base parameters",
        "rust/src/regression/base.rs",
        "let kept = robot.with_signs_kept();",
        "let kept = robot.clone();",
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


def run(folder: Path, tests: Sequence[str], rust: bool, seconds: float | None = None) -> tuple[bool, str]:
    """Run tests in a copy; return whether they pass, and the first that does not. Out of processor time counts as passed."""
    environment = {**os.environ, "PYTHONPATH": str(folder / "python")}
    if rust:
        command = ["cargo", "test", "--release", *tests]
        pattern = r"^test (\S+) \.\.\. FAILED|^(error.*)"
    else:
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
        pattern = r"^FAILED (.+?::.+?)(?: - .*)?$|^ERROR (.*)"
    if seconds is not None:
        # Of the processor: other programs may share it.
        command = ["bash", "-c", f'ulimit -t {max(1, round(seconds))} && exec "$@"', "-", *command]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return True, "out of time"
    found = re.search(pattern, done.stdout + done.stderr, re.MULTILINE)
    first = next((group for group in found.groups() if group), "") if found else "?"
    # 5: no test was chosen, which is none that fails.
    return done.returncode in (0, 5), first


def run_in_turn(folder: Path, tests: list[str], seconds: float) -> tuple[bool, str]:
    """Run tests, the first ones by themselves: most errors are caught there."""
    if not tests:
        return True, "no test reaches it"
    start, size, end = 0, FIRST_TESTS, _spent() + seconds
    while start < len(tests):
        passed, first = run(folder, tests[start : start + size], False, end - _spent())
        if not passed or first == "out of time" or _spent() >= end:
            return passed, first if not passed else "out of time"
        start, size = start + size, 5 * size
    return True, f"{len(tests)} tests"


def _spent() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def stale(project: Path = PROJECT) -> list[str]:
    """Return the mutations whose place is not there exactly once: the code has moved on, and they must follow."""
    lost = []
    for mutation in (*PYTHON, *RUST):
        path = project / mutation.file
        count = path.read_text(encoding="utf-8").count(mutation.old) if path.exists() else 0
        if count != 1:
            lost.append(f"{mutation.file}: {count} times {mutation.old!r}, for '{mutation.name}'")
        absent = [name for name in mutation.tests.split() if not (project / name).exists()]
        lost += [f"{name}, for '{mutation.name}', is not there" for name in absent]
    return lost


def named(folder: Path, chosen: list[Mutation], rust: bool) -> int:
    """Plant the mutations one after the other; return how many were not caught."""
    escaped = 0
    sound: set[str] = set()
    for mutation in chosen:
        if mutation.tests not in sound:
            passed, first = run(folder, mutation.tests.split(), rust)
            if not passed:
                raise SystemExit(f"without any mutation {mutation.tests or 'the tests'} fail: {first}")
            sound.add(mutation.tests)
        path = folder / mutation.file
        text = path.read_text(encoding="utf-8")
        path.write_text(text.replace(mutation.old, mutation.new), encoding="utf-8")
        passed, first = run(folder, mutation.tests.split(), rust)
        path.write_text(text, encoding="utf-8")
        escaped += passed
        print(f"{mutation.name} ({mutation.file}): {ESCAPED if passed else first}", flush=True)
    return escaped


def changed_constants(folder: Path, chosen: list[Planted], seconds: float, known: Path) -> int:
    """Change the constants one after the other, but for those whose end stands in a file; return how many no test noticed."""
    ends = dict(json.loads(line) for line in known.read_text(encoding="utf-8").splitlines())
    sound: set[str] = set()
    for planted in chosen:
        if str(planted) not in ends:
            ends[str(planted)] = _changed(folder, planted, seconds, sound)
            with known.open("a", encoding="utf-8") as file:
                file.write(json.dumps([str(planted), ends[str(planted)]]) + "\n")
        print(f"{planted}: {ends[str(planted)]}", flush=True)
    return sum(ends[str(planted)].startswith(ESCAPED) for planted in chosen)


def _changed(folder: Path, planted: Planted, seconds: float, sound: set[str]) -> str:
    """Plant one; return the test that notices it, or why none does. ``sound`` are tests that pass as it is."""
    path = folder / planted.file
    text = path.read_text(encoding="utf-8")
    path.write_text(planted.apply(text), encoding="utf-8")
    passed, first = run_in_turn(folder, tests_of(lines_using(planted, PROJECT)), seconds)
    path.write_text(text, encoding="utf-8")
    if not passed and "::" in first and first not in sound:
        if not run(folder, [first], False)[0]:
            return f"{ESCAPED} ({first} fails without it too)"
        sound.add(first)
    return f"{ESCAPED} ({first})" if passed else first


def main() -> int:
    """Run the mutations that were asked for; 1 when one is not caught."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--rust", action="store_true", help="those of the core; builds it once for each")
    parser.add_argument("--only", default="", metavar="NAME", help="those whose name has this in it")
    parser.add_argument(
        "--constants", type=int, metavar="N", help="so many module constants, doubled or halved"
    )
    parser.add_argument("--seed", type=int, default=0, help="which constants are drawn")
    parser.add_argument(
        "--seconds", type=float, default=60.0, help="of the processor for each constant at most"
    )
    parser.add_argument(
        "--resume", action="store_true", help="leave out constants that an earlier run has changed"
    )
    options = parser.parse_args()
    lost = stale()
    if lost:
        raise SystemExit("\n".join(lost))
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch, "didim")
        copy(folder)
        if options.constants is not None:
            count = len(planted := drawn(PROJECT, options.constants, options.seed))
            known = Path("out", "mutations", f"seed-{options.seed}.jsonl")
            known.parent.mkdir(parents=True, exist_ok=True)
            known.open("a" if options.resume else "w", encoding="utf-8").close()
            escaped = changed_constants(folder, planted, options.seconds, known)
        else:
            chosen = [item for item in (RUST if options.rust else PYTHON) if options.only in item.name]
            count = len(chosen)
            escaped = named(folder, chosen, options.rust)
    print(f"{count - escaped} of {count} caught")
    return 1 if escaped else 0


if __name__ == "__main__":
    sys.exit(main())
