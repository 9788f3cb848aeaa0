"""How often the test for missing friction alarms, and whether intervals hold with the shift that it adds.

    python benches/missing_friction.py                          40 logs a row
    python benches/missing_friction.py --motions 25 --seeds 2   50 logs a row, as in docs/uncertainty.md
    python benches/missing_friction.py --choice                 the terms that ``auto`` chooses on three arms, and their intervals
    python benches/missing_friction.py --warm                   laws of a recorded temperature that ``auto`` chooses
    python benches/missing_friction.py --closed-loop            how often IDIM-LS and DIDIM name it on logs of closed loops

Logs of 10 s of a planar arm with 13 base parameters, or of other arms, IDIM-LS; each row has a friction law in the log that the
model lacks, or none.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from dataclasses import replace

import didim
from didim.experiment.specs import SimulationSettings
from didim.loop.reference import Reference
from didim.methods.method import Method
from didim.regression.friction.alarm import SHARES
from didim.result.identification import Identification
from didim.robot.friction import FrictionTerm
from didim.studies.simulated_log import measured, packaged_experiment, simulated_log
from friction_logs import (
    Law,
    atan,
    coulomb,
    dahl,
    load,
    logged,
    lugre,
    robot,
    stribeck,
    subject,
    truth,
)

CASES: dict[str, tuple[Law, dict[str, Any]]] = {
    "right, white noise": (coulomb, {}),
    "right, AR(1) 0.95": (coulomb, {"noise": "correlated"}),
    "right, 100 Hz": (coulomb, {"rate_hz": 100.0}),
    "right, 2^16 counts": (coulomb, {"counts": 65536}),
    "right, 4096 counts": (coulomb, {"counts": 4096}),
    "Stribeck 0.1 Fc": (stribeck(0.1), {}),
    "Stribeck 0.2 Fc": (stribeck(0.2), {}),
    "Stribeck 0.4 Fc": (stribeck(0.4), {}),
    "Stribeck 0.1 Fc, AR(1) 0.95": (stribeck(0.1), {"noise": "correlated"}),
    "Stribeck 0.2 Fc, AR(1) 0.95": (stribeck(0.2), {"noise": "correlated"}),
    "arctangent 0.4 Fc": (atan(0.4), {}),
    "memory, 2e-3 rad": (dahl(2e-3), {}),
    "memory, 2e-2 rad": (dahl(2e-2), {}),
    "load 0.08": (load(0.08), {}),
    "LuGre, Stribeck 0.3 Fc": (lugre(2e-2), {}),
}
STEADY = {
    "memory, 2e-3 rad": coulomb,
    "memory, 2e-2 rad": coulomb,
    "LuGre, Stribeck 0.3 Fc": stribeck(0.3),
}
"""Laws of steady sliding where they differ: memory has the sign of the motion."""
CHOSEN: dict[str, tuple[str, dict[str, float]]] = {
    "right, white noise": ("", {}),
    "Stribeck 0.2 Fc": ("curve", {"Fs": 0.2}),
    "Stribeck 0.4 Fc": ("curve", {"Fs": 0.4}),
    "arctangent 0.4 Fc": ("curve", {"Fa": 0.4}),
    "memory, 2e-3 rad": ("dahl", {"Fz": 1.0, "Fc": 0.0}),
    "memory, 2e-2 rad": ("dahl", {"Fz": 1.0, "Fc": 0.0}),
    "load 0.08": ("load", {"Fl": 0.08}),
    "LuGre, Stribeck 0.3 Fc": ("dahl", {}),
}
"""Law to be chosen at all joints, Stribeck and arctangent being one, and what differs from the plain robot, over Fc but for Fl."""
FIRST = 1000
"""First seed of the motions; those of the tests are below."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--motions", type=int, default=10)
    parser.add_argument("--seeds", type=int, default=4, help="draws of the noise for each motion")
    parser.add_argument("--only", nargs="*", default=(), help="rows whose name has one of these words")
    parser.add_argument("--choice", action="store_true", help="choose terms in place of testing for them")
    parser.add_argument(
        "--arms", nargs="+", help="planar2, or planar2, tx40 and ur5e-like for --choice; also iiwa14-like"
    )
    parser.add_argument(
        "--closed-loop", action="store_true", help="logs of the closed loop, by IDIM-LS and DIDIM"
    )
    parser.add_argument("--warm", action="store_true", help="choose terms of joints that warm up")
    given = parser.parse_args()
    if given.closed_loop:
        closed_loops(given.motions)
        return
    if given.warm:
        warm(given)
        return
    if given.choice:
        choose(given)
        return
    print(
        f"{'':36}{'logs':>5}{'alarms':>9}{'95 % before':>13}{'after':>8}{'width':>7}"
        f"{'F(v) before':>13}{'after':>8}{'half width':>12}  named"
    )
    for arm, name in itertools.product(given.arms or ["planar2"], CASES):
        law, settings = CASES[name]
        if given.only and not any(word in name for word in given.only):
            continue
        alarms, before, after, width = [], [], [], []
        at_speeds: list[tuple[bool, bool, float]] = []
        names: Counter[str] = Counter()
        for motion in range(given.motions):
            for seed in range(given.seeds):
                log = logged(robot(arm), law, FIRST + motion, draw=seed, of=arm, **settings)
                fit = didim.identify(log, didim.IDIMLS())
                assert fit.uncertainty is not None
                assert fit.uncertainty.friction is not None
                alarm, factor = fit.uncertainty.friction, fit.uncertainty.factor(0.95)
                plain = fit.uncertainty.without_shift(fit.std)
                error = np.abs(fit.beta - truth(arm))
                alarms.append(alarm.raised)
                names[alarm.law] += alarm.raised
                before.append(error <= factor * plain)
                after.append(error <= factor * fit.std)
                width.append(np.median(fit.std / plain))
                at_speeds += friction_at_speeds(arm, STEADY.get(name, law), log, fit)
        found = ", ".join(f"{law} {count}" for law, count in names.most_common() if count)
        print(
            f"{arm + ', ' + name:36}{len(alarms):5d}{100 * np.mean(alarms):7.1f} %{100 * np.mean(before):11.1f} %"
            f"{100 * np.mean(after):6.1f} %{np.median(width):7.2f}"
            f"{100 * np.mean([each[0] for each in at_speeds]):11.1f} %{100 * np.mean([each[1] for each in at_speeds]):6.1f} %"
            f"{100 * np.median([each[2] for each in at_speeds]):10.1f} %  {found}",
            flush=True,
        )


def friction_at_speeds(
    arm: str, law: Law, log: didim.Experiment, fit: Identification
) -> list[tuple[bool, bool, float]]:
    """Return whether friction at speeds is inside its interval without bias and with it, and half the width over the friction.

    The speeds are the 10th, 50th and 90th percentiles of each joint's in the log; `law` is that of steady sliding.
    """
    (recording,) = log.recordings
    moving = np.abs(np.gradient(recording.measured_positions(), 1.0 / recording.rate_hz, axis=0))
    assert fit.uncertainty is not None
    assert fit.uncertainty.friction is not None
    unbiased = replace(
        fit.uncertainty.friction, missing=(), p_value=np.ones_like(fit.uncertainty.friction.p_value)
    )
    noise = replace(fit, uncertainty=replace(fit.uncertainty, friction=unbiased))
    found = []
    for joint, speeds in enumerate(moving.T):
        v = np.percentile(speeds[speeds > 0.0], SHARES)
        dq = np.zeros((len(v), len(moving.T)))
        dq[:, joint] = v
        load = np.tile(fit.uncertainty.load, (len(v), 1))
        still = np.zeros_like(dq)
        both = [
            didim.inverse_dynamics(robot(arm), still, way * dq, still, subject(arm).x) for way in (1.0, -1.0)
        ]
        true = (0.5 * (both[0] - both[1]) + law(still, dq, load, subject(arm).fc))[:, joint]
        before, after = noise.friction_at(joint, v), fit.friction_at(joint, v)
        inside = [(np.array(each.low) <= true) & (true <= np.array(each.high)) for each in (before, after)]
        half = 0.5 * np.subtract(after.high, after.low) / true
        found += list(zip(*(part.tolist() for part in (*inside, half)), strict=True))
    return found


def closed_loop_log(arm: str, share: float, seed: int) -> tuple[didim.Experiment, Any]:
    """Return a log whose joints have Stribeck friction, a share of Fc, which its model lacks, and the true base parameters.

    The planar arm moves otherwise for every seed; the packaged TX40 has one motion.
    """
    packaged = packaged_experiment("tx40") if arm == "tx40" else planar_loop(seed)
    plain = packaged.robot
    x = plain.parameter_set({"planar2": "reference", "tx40": "didim_physical"}[arm])
    values = dict(zip(plain.parameter_names, x, strict=True))
    joints = range(plain.n_dof) if share else ()
    made = plain.with_terms([FrictionTerm(law="stribeck", joint=joint, velocity=0.15) for joint in joints])
    all_x = [values.get(name, share * values.get(f"Fc{name[2:]}", 0.0)) for name in made.parameter_names]
    clean = simulated_log(replace(packaged, robot=made), np.array(all_x), noise=False)
    if arm == "tx40":
        log = measured(clean, FIRST + seed)
    else:
        (recording,) = clean.recordings
        assert recording.tau is not None
        noise = np.random.default_rng([seed, 7]).standard_normal(recording.tau.shape)
        tau = recording.tau + 0.1 * noise * [values["Fc1"], values["Fc2"]]
        log = replace(clean, recordings=(replace(recording, tau=tau),))
    return replace(log, robot=packaged.simulated_robot), plain.base_parameters.project(x)


def planar_loop(seed: int) -> didim.Experiment:
    """Return the closed loop of a planar arm along a motion of 10 s."""
    reference = Reference.random_fourier(
        harmonics=15, period_s=10.0, seed=FIRST + seed, **subject("planar2").motion
    )
    return didim.Experiment(
        name="arm",
        robot=didim.load_robot("planar2"),
        recordings=(),
        reference=reference,
        controller=didim.Controller.tuned([10.0] * 2, [0.7] * 2, [1.0, 0.2]),
        signal=didim.SignalProcessing(cutoff_hz=50.0, trim_start=25, trim_end=25, decimation=(10,)),
        simulation=SimulationSettings(
            rate_hz=500.0, smoothing=(0.02, 0.02), step_s=1e-3, fine_step_s=5e-4, start="reference"
        ),
    )


def closed_loops(motions: int) -> None:
    """Print how many results name missing friction, and whether their intervals hold with its shift and without."""
    print(f"{'':32}{'logs':>5}{'named':>6}{'95 % before':>13}{'after':>8}")
    methods: tuple[Method, ...] = (didim.IDIMLS(), didim.DIDIM())
    for arm, share, method in itertools.product(("planar2", "tx40"), (0.0, 0.1, 0.2), methods):
        count, before, after = 0, [], []
        for seed in range(motions):
            log, truth_ = closed_loop_log(arm, share, seed)
            fit = didim.identify(log, method)
            assert fit.uncertainty is not None
            count += any(item.code == "friction" for item in fit.evidence)
            error, factor = np.abs(fit.beta - truth_), fit.uncertainty.factor(0.95)
            before.append(error <= factor * fit.uncertainty.without_shift(fit.std))
            after.append(error <= factor * fit.std)
        name = f"{arm}, Stribeck {share:g} Fc, {method.name}"
        print(
            f"{name:32}{motions:5d}{count:6d}{100.0 * np.mean(before):11.1f} %{100.0 * np.mean(after):6.1f} %",
            flush=True,
        )


def warm(given: argparse.Namespace) -> None:
    """Print at how many joints that warm up by 8 K, with Coulomb friction that follows, its law is chosen, and coverage."""
    print(f"{'change of Fc':36}{'joints':>7}{'Fct':>6}{'Fvt':>6}{'95 % of Fct':>14}")

    def rise(n: int) -> np.ndarray:
        return np.asarray(8.0 * (1.0 - np.exp(-3.0 * np.arange(n) / n)) - 4.0)

    for arm, share in itertools.product(given.arms or ["planar2", "ur5e-like"], (0.0, 0.01, 0.03)):
        fc, inside, viscous = subject(arm).fc, [], 0

        def law(q: Any, dq: Any, rigid: Any, fc: Any, share: float = share) -> Any:
            return share * rise(len(q))[:, None] * fc * np.sign(dq)

        for motion in range(given.motions):
            log = logged(robot(arm), law, FIRST + motion, noise="correlated", of=arm)
            recording = log.recordings[0]
            recording = replace(recording, temperature=30.0 + rise(len(recording.t)))
            fit = didim.identify(replace(log, recordings=(recording,)), didim.IDIMLS(friction="auto"))
            low, high = fit.confidence_interval()
            for k, name in enumerate(fit.names):
                viscous += name.startswith("Fvt")
                if name.startswith("Fct"):
                    inside.append(bool(low[k] <= share * fc[int(name[3:]) - 1] <= high[k]))
        joints = given.motions * robot(arm).n_dof
        held = f"{100.0 * np.mean(inside):.0f} %" if inside else "-"
        print(
            f"{f'{arm}, {100.0 * share:g} % per K':36}{joints:7d}{len(inside):6d}{viscous:6d}{held:>14}",
            flush=True,
        )


def visible(log: didim.Experiment) -> list[float]:
    """Load friction of each joint in its standard deviations, where every joint has the law: below 3 no choice is possible."""
    terms = [FrictionTerm(law="load", joint=joint) for joint in range(log.robot.n_dof)]
    fit = didim.identify(replace(log, robot=log.robot.with_terms(terms)), didim.IDIMLS())
    return [
        float(value / std)
        for name, value, std in zip(fit.names, fit.beta, fit.std, strict=True)
        if name[:2] == "Fl"
    ]


def choose(given: argparse.Namespace) -> None:
    """Print at how many joints the law of the log is chosen, other terms, coverage, and widths over the true one.

    Of load friction also: at how many it is above 3 standard deviations where it is given at every joint.
    """
    print(
        f"{'':36}{'joints':>7}{'chosen':>9}{'others a joint':>16}{'95 % of parameters':>20}  width of memory / true"
    )
    for arm, name in itertools.product(given.arms or ["planar2", "tx40", "ur5e-like"], CHOSEN):
        if given.only and not any(word in name for word in given.only):
            continue
        law, more = CHOSEN[name]
        n = robot(arm).n_dof
        values = dict(zip(robot(arm).base_parameters.names, truth(arm), strict=True))
        for key, share in more.items():
            values |= {
                f"{key}{j + 1}": share * (1.0 if key == "Fl" else subject(arm).fc[j]) for j in range(n)
            }
        true_width = float(name.split()[-2]) if name.startswith("memory") else np.nan
        right, others, inside, widths, sigmas = [], [], [], [], []
        for motion, seed in itertools.product(range(given.motions), range(given.seeds)):
            function, settings = CASES[name]
            log = logged(robot(arm), function, FIRST + motion, draw=seed, of=arm, **settings)
            fit = didim.identify(log, didim.IDIMLS(friction="auto"))
            terms = fit.settings["robot"]["friction"]["terms"]
            kinds = {
                ("curve" if one["law"] in ("atan", "stribeck") else one["law"], one["joint"]) for one in terms
            }
            sigmas += visible(log) if law == "load" else []
            right += [not law or (law, joint) in kinds for joint in range(n)]
            others.append(sum(kind not in (law, "hold") for kind, _ in kinds) / n)
            widths += [one["velocity"] / true_width for one in terms if one["law"] == "dahl"]
            # With an arctangent in the place of Stribeck's law Fv and Fc of the joint are others: no parameter of it counts.
            known = {one[2:] for one in fit.names if one[:2] == next(iter(more), "Fc")}
            if not name.startswith("LuGre"):
                factor = fit.uncertainty.factor(0.95)  # type: ignore[union-attr]
                for parameter, value, std in zip(fit.names, fit.beta, fit.std, strict=True):
                    own = parameter[:2] not in ("Fv", "Fc", *more) or parameter[2:] in known
                    if own and parameter in values and std > 0.0:
                        inside.append(abs(value - values[parameter]) <= factor * std)
        covered = f"{100 * np.mean(inside):.1f} %" if inside else "-"
        clear = np.array(sigmas) > 3.0
        spread = (
            f"chosen at {np.sum(clear & right)} of {np.sum(clear)} above 3 sigma"
            if sigmas
            else f"{np.median(widths):.3f} ({np.min(widths):.2f} to {np.max(widths):.2f})"
            if law == "dahl" and np.isfinite(true_width) and widths
            else ""
        )
        print(
            f"{arm + ', ' + name:36}{len(right):7d}{100 * np.mean(right):7.1f} %{np.mean(others):16.2f}{covered:>20}  {spread}",
            flush=True,
        )


if __name__ == "__main__":
    main()
