"""Does the verdict name what is wrong, and is it silent where nothing is?

    python benches/verdicts.py [--seeds 10] [--arms arm7 gantry] [--faults WORD ...] [--method idim-ls|didim|cloe] [--workers 2]
    python benches/verdicts.py --sound [--seeds 4] [--arms arm7 gantry tx40 planar2 ur5e-like iiwa14-like]

Plants each fault of `tests/verdict_arms.py` in logs of a simulated 7R arm and a gantry with a wrist, whose truth is known, and
prints how many of the seeds (noise and motion) got a verdict that is not sound, a reason that names the fault, and one that names
another as its cause; and, of the remedies that were obeyed, how many have a smaller error on blocks left out and no such reason.
With ``--sound`` it identifies correct logs of both arms, the TX40 and the planar arm at three rates and five noise levels, and
prints how many are sound. The arms whose names end in `-like` are those that no threshold was chosen on. docs/verdict.md has the
figures.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import didim
from didim.experiment.specs import ReferenceSpec
from didim.loop.reference import Reference
from didim.monte_carlo.engine import run_all
from didim.monte_carlo.executors import pool
from didim.result.verdict import Verdict
from didim.studies.simulated_log import packaged_experiment, simulated_log

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from verdict_arms import ARMS as CHOSEN
from verdict_arms import INDEPENDENT, Arm, Fault, Log, built, expected_error, faults, obeyed, planted

ARMS = {**CHOSEN, **INDEPENDENT}

METHODS: dict[str, Callable[[], Any]] = {
    "idim-ls": didim.IDIMLS,
    "didim": didim.DIDIM,
    "cloe": partial(didim.CLOE, start="idim-ls"),
}
CLOSED_LOOP = {"didim": "cloe"}
"""The other method that meets the faults of one."""
LEVELS = (0.003, 0.006, 0.01, 0.02, 0.04)
"""Noise of the torques, as shares of their standard deviation."""
RATES_HZ = (100.0, 250.0, 500.0)


def named(fault: Fault, verdict: Verdict) -> bool:
    """Whether a grave reason names the fault, and its joint where it has one, alone or with causes that explain the log as well."""
    reported = [
        (code, tuple(joints))
        for reason in verdict.grave
        for code, joints in (
            (reason.code, reason.joints),
            *((tie["code"], tie["joints"]) for tie in reason.facts.get("ties", ())),
        )
    ]
    return any(
        code in fault.codes and (not fault.joints or joints == fault.joints) for code, joints in reported
    )


def try_fault(
    arm: Arm, fault: Fault, seeds: int, first: int, method_name: str
) -> tuple[dict[str, int], dict[str, int]]:
    """Return counts of verdicts: not sound, right, another cause, remedies obeyed, and better so; and the codes of the rest."""
    counts = dict.fromkeys(("alarmed", "named", "misnamed", "obeyed", "better"), 0)
    others: dict[str, int] = {}
    logs = [built(arm, fault, motion=first + motion) for motion in range(min(2, seeds))]
    for seed in range(seeds):
        experiment = planted(logs[seed % len(logs)], fault, first + seed)
        method = METHODS[method_name]()
        try:
            fit = didim.identify(experiment, method)
        except didim.DidimError as error:
            others[f"error: {error}"[:60]] = others.get(f"error: {error}"[:60], 0) + 1
            continue
        verdict = fit.verdict
        counts["alarmed"] += not verdict.sound
        causes = [reason for reason in verdict.grave if "ties" in reason.facts and reason.grade == "wrong"]
        if named(fault, verdict):
            counts["named"] += 1
            for reason in verdict.grave:
                if (
                    reason.code in fault.codes
                    and reason.remedy is not None
                    and isinstance(method, didim.IDIMLS)
                ):
                    edited = obeyed(experiment, method, reason.remedy)
                    if edited is not None:
                        after = didim.identify(*edited)
                        counts["obeyed"] += 1
                        counts["better"] += expected_error(after) < expected_error(fit) and not named(
                            fault, after.verdict
                        )
                    break
        else:
            counts["misnamed"] += bool(causes)
            code = verdict.grave[0].code if verdict.grave else "sound"
            others[code] = others.get(code, 0) + 1
    return counts, others


CORRECT = ("tx40", "planar2")
"""Further robots with correct logs."""


def tx40_motion(seed: int) -> Reference:
    """Motion of ten seconds within the limits of the packaged one, which has seed 1."""
    spec = packaged_experiment("tx40").reference
    assert isinstance(spec, ReferenceSpec)
    position, velocity, acceleration = (
        spec.settings[f"max_{key}"] for key in ("position_rad", "velocity_rad_s", "acceleration_rad_s2")
    )
    return Reference.random_fourier(
        harmonics=20,
        period_s=10.0,
        max_position=position,
        max_velocity=velocity,
        max_acceleration=acceleration,
        seed=seed + 1,
    )


def sound_log(name: str, rate_hz: float, motion: int) -> Log | didim.Experiment:
    """A correct log without noise."""
    if name in ARMS:
        return built(ARMS[name], None, motion=motion, rate_hz=rate_hz)
    if name == "tx40":
        packaged = packaged_experiment("tx40")
        factor = round(rate_hz / 20.0)
        signal = replace(
            packaged.signal,
            cutoff_hz=min(200.0, 0.4 * rate_hz),
            decimation=(factor,) if factor <= 10 else (5, factor // 5),
        )
        simulation = replace(packaged.simulation, rate_hz=rate_hz)
        packaged = replace(packaged, signal=signal, simulation=simulation, reference=tx40_motion(motion))
        return simulated_log(
            packaged, packaged.robot.parameter_set("didim_physical"), noise=False, refinement=1
        )
    from arm import arm_log

    return arm_log(motion, rate_hz=rate_hz)


def noisy(log: Log | didim.Experiment, seed: int, level: float) -> didim.Experiment:
    """The log with noise of a share of the torques."""
    if isinstance(log, Log):
        return log.noisy(seed, level)
    (recording,) = log.recordings
    assert recording.tau is not None
    rng = np.random.default_rng(seed)
    size = level * np.std(recording.tau, axis=0)
    tau = recording.tau + size * rng.standard_normal(recording.tau.shape)
    q = recording.q + 1e-6 * rng.standard_normal(recording.q.shape)
    return replace(log, recordings=(replace(recording, q=q, tau=tau),))


def one_fault(task: tuple[str, int, int, int, str]) -> tuple[dict[str, int], dict[str, int]]:
    """Try a fault by the name of its arm, its place among the faults of the arm, number of seeds, the first one, and the method."""
    name, place, seeds, first, method = task
    return try_fault(ARMS[name], list(faults(ARMS[name]))[place], seeds, first, method)


def main() -> None:
    parser = argparse.ArgumentParser(
        description="Faults that the verdict names, and correct logs that it calls sound."
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="first seed of motions and noise")
    parser.add_argument("--arms", nargs="+", choices=(*ARMS, *CORRECT), default=list(CHOSEN))
    parser.add_argument("--faults", nargs="+", help="words of the names of faults")
    parser.add_argument(
        "--method", choices=METHODS, help="faults that this method meets alone; cloe: those of didim"
    )
    parser.add_argument("--sound", action="store_true", help="correct logs instead of faults")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=["idim-ls"], help="for --sound")
    parser.add_argument(
        "--workers", type=int, default=1, help="processes for the faults (default: %(default)s)"
    )
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    if not arguments.sound and not set(arguments.arms).issubset(ARMS):
        parser.error(f"{' and '.join(CORRECT)} are for --sound: no faults are planted in them")
    table: list[dict[str, object]] = []
    if arguments.sound:
        for name in arguments.arms:
            for rate_hz in RATES_HZ:
                log = sound_log(name, rate_hz, arguments.first)
                for method in arguments.methods:
                    total = sound = 0
                    codes: list[str] = []
                    for level in LEVELS:
                        for seed in range(arguments.first, arguments.first + arguments.seeds):
                            verdict = didim.identify(noisy(log, seed, level), METHODS[method]()).verdict
                            total, sound = total + 1, sound + verdict.sound
                            codes += [f"{reason.code} at {level}" for reason in verdict.grave]
                    table.append(
                        {"arm": name, "rate_hz": rate_hz, "method": method, "sound": sound, "of": total}
                    )
                    print(
                        f"{name:8} {rate_hz:5.0f} Hz  {method:8} sound {sound} of {total}  {' '.join(codes)}",
                        flush=True,
                    )
    else:
        tasks = [
            (name, place, arguments.seeds, arguments.first, arguments.method or fault.method)
            for name in arguments.arms
            for place, fault in enumerate(faults(ARMS[name]))
            if (not arguments.faults or any(word in fault.name for word in arguments.faults))
            and (arguments.method or fault.method) in {fault.method, CLOSED_LOOP.get(fault.method)}
        ]
        with pool("serial" if arguments.workers == 1 else "process", arguments.workers) as some:
            for (name, place, *_), found, lost in run_all(one_fault, tasks, some):
                fault = list(faults(ARMS[name]))[place]
                if lost is not None:
                    raise SystemExit(f"{name}, {fault.name}: {lost}")
                counts, others = found
                table.append({"arm": name, "fault": fault.name, **counts, "of": arguments.seeds})
                print(
                    f"{name:12} {fault.name:28} not sound {counts['alarmed']:2}, named {counts['named']:2}, named another "
                    f"{counts['misnamed']:2} of {arguments.seeds}; obeyed {counts['obeyed']:2}, better {counts['better']:2}  "
                    f"{others or ''}",
                    flush=True,
                )
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
