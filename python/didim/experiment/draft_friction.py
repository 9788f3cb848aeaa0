"""Friction laws and the delay of the torques that a log supports, as lines of an experiment file, each with its reason.

The choice is that of ``terms = "auto"``: `didim init` writes what `identify` would choose. Velocities are comments: each fit
estimates them, and its intervals include theirs. Tested in ``tests/test_init_friction.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from .._tools.toml import quoted
from .._tools.words import percent_text, series
from ..log.recording import Recording
from ..regression.friction.choice import REFUSED, FirstFit, TermGain, first_fit
from ..regression.least_squares import estimated
from ..robot.friction import KEYS
from ..robot.robot import Robot
from ..signal.noise import coarsest_steps
from ..signal.processing import SignalProcessing
from ..signal.window import Window, windows_of
from ..terms.model import Model


def fitted_friction(
    robot: Robot, recordings: Sequence[Recording], signal: SignalProcessing, say: Callable[[str], None]
) -> FirstFit:
    """Return the laws and the delay that recordings support.

    Parameters
    ----------
    robot : Robot
        Robot of the log.
    recordings : sequence of Recording
        At least one, with torques, joint side.
    signal : SignalProcessing
        Filters of the log.
    say : callable
        Receiver of sentences on the progress.

    Raises
    ------
    DidimError
        For a log whose rows determine too little (``test_init_friction.py``).
    """

    def windows(delay: float) -> list[Window]:
        return [
            part
            for number, recording in enumerate(recordings)
            for part in windows_of(recording, signal, number=number, delay=delay)
        ]

    steps = coarsest_steps(recording.measured_positions() for recording in recordings)
    return first_fit(Model(robot), windows, signal, estimated, steps, say)


def friction_lines(robot: Robot, fit: FirstFit) -> list[str]:
    """Return the tables ``[friction]`` and ``[springs]`` with the chosen laws; laws that were refused are comments."""
    own = {term.parameter for term in robot.friction.terms}
    friction = fit.choice.friction
    chosen = [term for term in friction.terms if term.parameter not in own]
    worth = {gain.parameter: gain for gain in fit.choice.gains}
    before, after = _errors(fit)
    tables: dict[str, list[str]] = {"friction": [], "springs": []}
    if fit.rest is not None:
        what = fit.rest.parameter
        tables["friction"] += [f"# {_gains([fit.rest])}", f'coulomb = "{friction.coulomb}"']
        for kind, unit in (("revolute", "rad_s"), ("prismatic", "m_s")):
            pairs = zip(getattr(friction, what), robot.joint_kinds, strict=True)
            speeds = [speed * (own == kind) for speed, own in pairs]
            if any(speeds):
                alike = speeds.count(max(speeds)) == robot.joint_kinds.count(kind)
                tables["friction"].append(f"{what}_{unit} = {max(speeds) if alike else speeds}")
    for law, key in (*KEYS.items(), ("spring", "linear")):
        terms = sorted((term for term in chosen if term.law == law), key=lambda term: term.joint)
        if terms:
            joints = {term.joint + 1 for term in (*terms, *robot.friction.of(law))}
            reason = _gains([worth[term.parameter] for term in terms])
            per = "" if law == "dahl" else "/s"
            units = {"revolute": f"rad{per}", "prismatic": f"m{per}"}
            scales = [
                f"{term.velocity:.3g} {units[robot.joint_kinds[term.joint]]}"
                for term in terms
                if term.velocity
            ]
            lines = tables["springs" if law == "spring" else "friction"]
            if scales:
                lines.append(f"# {KEYS[law]}: {series(scales, 100)} by this log, estimated in each fit")
            lines.append(f"{key} = {quoted(sorted(joints))} # {reason}")
    lines = (
        [f"# Relative error of blocks left out of the fit: {before}, with these laws {after}."]
        if chosen
        else []
    )
    for table, found in tables.items():
        lines += [f"[{table}]", *found] if found else []
    return [*lines, *(_refusal(gain) for gain in fit.choice.untold)]


def _gains(gains: Sequence[TermGain]) -> str:
    squares = series([f"-{_percent(gain.gain)}" for gain in gains], 40)
    shifts = series([f"{100.0 * gain.shift:.2g}" for gain in gains], 40)
    return f"left-out blocks: {squares} % squared error; links' torque in other poses: +-{shifts} %"


def _refusal(gain: TermGain) -> str:
    if gain.parameter.startswith("Ks"):
        return f"# {gain.parameter} is seen, and takes less than a tenth of the squared error: not taken for a spring."
    return (
        f"# {gain.parameter} is seen (gain {gain.significance:.2g} times its error), and not separated from the links, "
        f"whose torque in other poses would move by {100.0 * gain.shift:.2g} %: record more combinations of poses."
    )


def _percent(share: float) -> str:
    """Return a share in per cent, with two digits."""
    return f"{100.0 * share:.0f}" if share >= 0.0995 else f"{100.0 * share:.2g}"


def _errors(fit: FirstFit) -> tuple[str, str]:
    """Return the relative errors of blocks left out, without laws and with them."""
    before, after = fit.choice.held_out_before, fit.choice.held_out_after
    return f"{percent_text(100.0 * before)} %", f"{percent_text(100.0 * after)} %"


def delay_lines(fit: FirstFit) -> list[str]:
    """Return the table ``[delay]``, or none where the log has no delay after its friction."""
    if fit.delay is None:
        return []
    return [
        "",
        "[delay]",
        f"compensate_samples = {fit.samples:.3g} # after friction; left-out blocks: -{_percent(fit.delay.gain)} % squared error",
    ]


def physical_lines(fit: FirstFit) -> list[str]:
    """Return the table with which `identify` solves among parameters of a robot, as laws were chosen; none without laws."""
    if not fit.choice.gains:
        return []
    return [
        "",
        "# The laws were chosen among parameters of robots, and are fitted among these.",
        "[least_squares]",
        "physical = true",
    ]


def friction_sentences(fit: FirstFit) -> list[str]:
    """Return the sentence of `didim init` on the laws."""
    before, after = _errors(fit)
    names = series([gain.parameter for gain in fit.choice.gains], 70)
    if fit.choice.refused:
        return [
            f"no friction law was tried: blocks left out of the fit miss {before}, {REFUSED[fit.choice.refused]}"
        ]
    if not names:
        return [f"no further friction law: blocks left out of the fit miss {before}"]
    return [
        f"friction {names}: blocks left out of the fit miss {after} in place of {before} (--plain adds none)"
    ]
