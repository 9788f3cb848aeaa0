"""What does the verdict say of real logs that nothing is wrong with?

    python benches/real_verdicts.py DATA [--logs WORD ...] [--method idim-ls|physical|didim|cloe] [--varied | --first]
    python benches/real_verdicts.py --picture

prints a row for each public log in DATA: what the model misses, state, reasons, and what the result is good for. With
``--varied`` the logs are cut in halves and thirds, thinned, filtered otherwise, exchanged as fit and held-out recording, and given
another friction: they are as good as the logs themselves, so that no cause may be named on any. With ``--first`` the files are
those that ``didim init`` writes, with its laws, unedited, and each log predicts a third of itself from the others by the laws that
these choose: the error promised for control, and that met. docs/verdict.md has the tables.
With ``--picture`` it makes the picture of that page from simulated logs.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

import didim
from didim.errors import DidimError
from didim.evidence.hypotheses.geometry import gravities
from didim.evidence.hypotheses.torques import exchanges, signs
from didim.evidence.loop.law_rows import with_law_torques
from didim.evidence.rows import LogRows
from didim.experiment.loop import closed_loop
from didim.log.recording import Recording
from didim.methods.method import Method
from didim.robot.friction import Friction

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent))

from friction_held_out import UR10E_GAINS, initialised, kr300, unisa, ur10e
from positions import QUADRUPED

from arm import arm_log
from verdict_arms import UR5E, built

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"
METHODS: dict[str, Callable[[], Method]] = {
    "idim-ls": didim.IDIMLS,
    "physical": lambda: didim.IDIMLS(physical=True),
    "didim": didim.DIDIM,
    "cloe": didim.CLOE,
}


def alone(experiment: didim.Experiment, number: int) -> didim.Experiment:
    """Return an experiment of one of its recordings."""
    return replace(experiment, recordings=(replace(experiment.recordings[number], role="fit"),))


def logs(data: Path) -> dict[str, Callable[[], didim.Experiment]]:
    """Return the real logs by name."""
    tiago = [data / f"tiago/tiago_{what}.csv" for what in ("position", "velocity", "effort")]
    return {
        "TX40": lambda: didim.load_experiment(EXAMPLES / "tx40_log_best.toml", data=data / "tx40"),
        "EMPS": lambda: didim.load_experiment(EXAMPLES / "emps.toml", data=data / "emps"),
        "EMPS, asymmetric friction": lambda: didim.load_experiment(
            EXAMPLES / "emps_asymmetric.toml", data=data / "emps"
        ),
        "UR10e without load": lambda: ur10e(data, "free"),
        "UR10e with load": lambda: ur10e(data, "loaded"),
        "UR10, exciting motion": lambda: alone(unisa(data, "ur10"), 0),
        "UR10, validation motion": lambda: alone(unisa(data, "ur10"), 1),
        "Panda": lambda: unisa(data, "panda"),
        "TIAGo": lambda: initialised(str(data / "tiago/tiago_48_hey5.urdf"), tiago, []),
        "KR300, A": lambda: alone(kr300(data, whole=True), 0),
        "KR300, B": lambda: alone(kr300(data, whole=True), 1),
        "KR300, A where it moves": lambda: alone(kr300(data), 0),
        "KR300, B where it moves": lambda: alone(kr300(data), 1),
        "Go2, legs by positions": lambda: quadruped(data / "go2"),
    }


def first_fits(data: Path) -> dict[str, Callable[[], didim.Experiment]]:
    """Return the real logs by name, as ``didim init`` writes them."""
    gains = ["--gain", *(str(gain) for gain in UR10E_GAINS), "--columns", "current=14-19"]
    bag = data / "unisa"
    commands = {
        "TX40": (
            "tx40",
            [data / f"tx40/motor_{what}.csv" for what in ("position", "torque")],
            ["--rate", "5000"],
        ),
        "EMPS": ("emps", [data / "emps/DATA_EMPS.mat"], []),
        "UR10e without load": ("ur10e", [data / "ur10e/free.csv"], gains),
        "UR10e with load": ("ur10e", [data / "ur10e/loaded.csv"], gains),
        "UR10, exciting motion": ("ur10", [bag / "ur10_exciting.db3"], []),
        "UR10, validation motion": ("ur10", [bag / "ur10_validation.db3"], []),
        "UR10, both motions": ("ur10", [bag / "ur10_exciting.db3", bag / "ur10_validation.db3"], []),
        "Panda": ("panda", [bag / "panda_exciting.db3"], []),
        "TIAGo": (
            str(data / "tiago/tiago_48_hey5.urdf"),
            [data / f"tiago/tiago_{what}.csv" for what in ("position", "velocity", "effort")],
            [],
        ),
    }
    return {name: partial(initialised, *command, plain=False) for name, command in commands.items()}


def thirds(experiment: didim.Experiment) -> Iterator[tuple[float, float]]:
    """Yield the error that two thirds of the first recording promise for control, and what they miss of the other one."""
    recording = experiment.recordings[0]
    friction = Friction.plain(experiment.robot.n_dof)
    auto = replace(experiment, robot=replace(experiment.robot, friction=replace(friction, auto=True)))
    for k in range(3):
        held = windows(recording, k, 3)
        kept = [windows(recording, other, 3).windows for other in range(3) if other != k]
        part = replace(recording, windows=tuple(one for some in kept for one in some))
        fit = didim.identify(replace(auto, recordings=(part,)), didim.IDIMLS())
        (seen,) = didim.validate(fit, replace(auto, recordings=(held,))).recordings
        yield (fit.verdict.uses[2].error or np.nan), seen.direct_overall


def quadruped(folder: Path) -> didim.Experiment:
    """Return the log of a quadruped's legs: commanded and measured positions."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "go2.toml"
        path.write_text(QUADRUPED.replace("go2.xml", str(folder / "go2.xml")), encoding="utf-8")
        return didim.load_experiment(path, data=folder)


def windows(recording: Recording, part: int, parts: int) -> Recording:
    """Return a recording of which one of equal parts of its windows is used."""
    start, stop = recording.windows[0][0], recording.windows[-1][1]
    low, high = (start + (stop - start) * k // parts for k in (part, part + 1))
    kept = [(max(a, low), min(b, high)) for a, b in recording.windows if min(b, high) > max(a, low)]
    return replace(recording, windows=tuple(kept))


def thinned(recording: Recording, factor: int) -> Recording:
    """Return a recording of every so many samples, its torques averaged over as many."""
    q, tau = recording.q, recording.tau
    assert q is not None
    assert tau is not None
    n = len(q) // factor * factor
    mean = tau[:n].reshape(-1, factor, tau.shape[1]).mean(axis=1)
    middle = q[:n].reshape(-1, factor, q.shape[1]).mean(axis=1)
    start, stop = (k // factor for k in (recording.windows[0][0], recording.windows[-1][1]))
    made = Recording.from_arrays(middle, mean, rate_hz=recording.rate_hz / factor)
    return replace(made, windows=((start, min(stop, len(mean))),), name=recording.name)


def varied(experiment: didim.Experiment) -> Iterator[tuple[str, Callable[[], didim.Experiment]]]:
    """Yield other logs of the same robot, as good as the one there is."""
    recordings, signal, robot = experiment.recordings, experiment.signal, experiment.robot
    made = didim.Experiment.from_arrays
    for parts in (2, 3):
        for part in range(parts):

            def cut(part: int = part, parts: int = parts) -> didim.Experiment:
                return replace(experiment, recordings=tuple(windows(one, part, parts) for one in recordings))

            yield f"part {part + 1} of {parts}", cut

    def outside(first: int) -> didim.Experiment:
        halves = [replace(windows(recordings[0], k, 2), name=f"half {k}") for k in (first, 1 - first)]
        return replace(experiment, recordings=(halves[0], replace(halves[1], role="held-out")))

    yield "second half held out", lambda: outside(0)
    yield "first half held out", lambda: outside(1)
    for factor in (0.5, 0.7, 1.5, 2.5):
        if signal.cutoff_hz is not None and factor * signal.cutoff_hz < 0.45 * recordings[0].rate_hz:
            filtered = replace(signal, cutoff_hz=factor * signal.cutoff_hz)
            yield f"cut-off times {factor}", partial(replace, experiment, signal=filtered)
    if len(signal.decimation) == 1 and signal.decimation[0] > 3:
        yield (
            "half the decimation",
            lambda: replace(experiment, signal=replace(signal, decimation=(signal.decimation[0] // 2,))),
        )
    for factor in (2, 4):
        if recordings[0].rate_hz / factor > 20.0:
            thin = thinned(recordings[0], factor)
            rate_hz = recordings[0].rate_hz / factor
            yield f"every {factor} samples", partial(made, robot, thin.q, thin.tau, rate_hz=rate_hz)
    yield (
        "filters of init",
        partial(made, robot, recordings[0].q, recordings[0].tau, rate_hz=recordings[0].rate_hz),
    )
    tau = recordings[0].tau
    assert tau is not None

    def scaled(factor: float) -> didim.Experiment:
        torques = [one.tau for one in recordings if one.tau is not None]
        return replace(
            experiment,
            recordings=tuple(
                replace(one, tau=factor * tau) for one, tau in zip(recordings, torques, strict=True)
            ),
        )

    yield "torques in mN.m", lambda: scaled(1e3)
    yield "torques over 80", lambda: scaled(1.0 / 80.0)
    yield "asymmetric friction", lambda: replace(experiment, robot=robot.with_friction(model="asymmetric"))
    noise = 0.05 * np.std(tau, axis=0) * np.random.default_rng(0).standard_normal(tau.shape)
    yield "more noise", lambda: replace(experiment, recordings=(replace(recordings[0], tau=tau + noise),))


def row(name: str, fit: didim.Identification) -> str:
    """Return the row of a result."""
    verdict = fit.verdict
    reasons = [
        f"{item.code}{' of ' + ' '.join(map(str, item.joints)) if item.joints else ''}"
        + ("" if item.effect is None or item.code == "size" else f" ({item.effect:.2g})")
        + (f" [{item.grade}]" if item.grade == "wrong" else "")
        for item in verdict.grave
    ]
    uses = [
        "no"
        if use.error is None
        else f"{use.error:.2g} kg"
        if use.name == "payload"
        else f"{100 * use.error:.2g}"
        for use in verdict.uses
    ]
    missed = 100.0 * fit.overall_relative_error
    return f"| {name} | {missed:.2g} % | {verdict.state} | {', '.join(reasons)} | {' / '.join(uses)} |"


def picture() -> None:
    """Draw three of the worked cases: causes that were tried, friction that was missed, a contact that positions show."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 3.4), layout="constrained")
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.4, 0.7, 1.2))
    log = built(UR5E, None).noisy(0)
    (recording,) = log.recordings
    assert recording.tau is not None
    wrong = replace(log, recordings=(replace(recording, tau=recording.tau * [1, -1, 1, 1, 1, 1]),))
    job = didim.IDIMLS().job(wrong)
    rows = LogRows(job.robot, job.signal, job.parts("fit", job.declared_delay))
    errors = []
    for item in (*signs(rows), *exchanges(rows), *gravities(rows)):
        found = rows.exact(item)
        if found is not None:
            d = found.products.judged(*item.channels).against(rows.declared)
            what = f"{item.code.replace('-', ' ')} {' '.join(map(str, item.joints))}"
            errors.append((100.0 * float(np.exp(d / (2.0 * rows.n))), what))
    errors = sorted(errors)[:9]
    left.barh([text for _, text in errors][::-1], [value for value, _ in errors][::-1], color="#4477aa")
    left.axvline(100.0, color="0.4", linewidth=1.0)
    left.set(xlabel="% of the error that is left, blocks left out", title="1  torque 2 has the wrong sign")

    arm = arm_log(1)
    (recording,) = arm.recordings
    x = arm.robot.parameter_set("reference")
    q, dq, _ = closed_loop(arm, recording).reference.at(recording.t)
    for name, push in (
        ("falls", -3.0 * np.tanh(dq / 0.02) * np.exp(-((dq / 0.5) ** 2)) * [1.0, 0.45]),
        ("contact", -8.0 * ((recording.t > 1.6) & (recording.t < 2.2))[:, None] * [1.0, 0.3]),
    ):
        (moved, _, _, tau), _ = closed_loop(arm, replace(recording, external=push)).run(x[None])
        noise = np.random.default_rng(0).standard_normal(q.shape)
        if name == "falls":
            seen = replace(arm, recordings=(replace(recording, q=moved[0], tau=tau[0] + 0.1 * noise),))
            fits = [didim.identify(seen, didim.IDIMLS(friction=terms)) for terms in (None, "auto")]
            values = [100.0 * (fit.verdict.uses[2].error or 0.0) for fit in fits]
            middle.bar(["plain", 'terms = "auto"'], values, color=["#cc6677", "#228833"])
            middle.set(ylabel="% of the torques, blocks left out", title="2  friction falls with speed")
            continue
        seen = replace(arm, recordings=(replace(recording, q=moved[0] + 2e-6 * noise, tau=None),))
        fit = didim.identify(seen, didim.CLOE(start=x, max_iterations=20))
        made = with_law_torques(seen).recordings[0]
        (part,) = didim.IDIMLS().job(replace(seen, recordings=(made,))).parts("fit")
        missed = part.tau - didim.inverse_dynamics(arm.robot, part.q, part.dq, part.ddq, fit.parameters)
        for joint, colour in enumerate(("#4477aa", "#cc6677")):
            right.plot(
                np.arange(len(missed)) / part.rate_hz,
                missed[:, joint],
                color=colour,
                label=f"joint {joint + 1}",
                linewidth=1.0,
            )
        right.set(xlabel="s", ylabel="missed torque, N.m", title="3  a contact, in a log without torques")
        right.legend(frameon=False, fontsize=8)
    for axes in (left, middle, right):
        axes.spines[["top", "right"]].set_visible(False)
        axes.title.set_fontsize(10)
        axes.tick_params(labelsize=8)
    figure.savefig(ROOT / "docs" / "img" / "verdict.png", dpi=75, facecolor="white")


def main() -> int:
    """Print the table; 1 where a log is wrong."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, nargs="?")
    parser.add_argument("--picture", action="store_true", help="make docs/img/verdict.png")
    parser.add_argument("--logs", nargs="+", help="words of their names")
    parser.add_argument("--method", choices=METHODS, default="idim-ls")
    parser.add_argument("--varied", action="store_true")
    parser.add_argument("--first", action="store_true", help="as didim init writes the files")
    asked = parser.parse_args()
    if asked.picture:
        picture()
        return 0
    if asked.data is None:
        parser.error("DATA is missing: the folder of the logs")
    print("| log | missed | verdict | reasons | simulation / gravity compensation / control (%) / payload |")
    print("|---|---|---|---|---|")
    wrong = 0
    for name, load in (first_fits if asked.first else logs)(asked.data).items():
        if asked.logs and not any(word in name for word in asked.logs):
            continue
        with contextlib.redirect_stdout(io.StringIO()):  # what didim init says
            experiment = load()
        positions = experiment.links == "fixed"
        if asked.varied and positions:
            continue
        for variant, made in varied(experiment) if asked.varied else [("", lambda: experiment)]:  # noqa: B023
            title = f"{name}: {variant}" if variant else name
            try:
                fit = didim.identify(made(), None if positions else METHODS[asked.method]())
            except DidimError as error:
                print(f"| {title} | | refused: {error} | | |", flush=True)
                continue
            wrong += fit.verdict.state == "wrong"
            print(row(title, fit), flush=True)
            if asked.first:
                pairs = [f"{100.0 * met:.2g} of {100.0 * told:.2g} %" for told, met in thirds(experiment)]
                print(f"  thirds met of promised: {', '.join(pairs)}", flush=True)
    print(f"\n{wrong} wrong")
    return wrong > 0


if __name__ == "__main__":
    sys.exit(main())
