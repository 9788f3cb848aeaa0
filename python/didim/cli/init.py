"""``didim init``."""

from __future__ import annotations

import argparse
from contextlib import closing
from pathlib import Path

from .options import (
    CONVERGED,
    NOT_CONVERGED,
    Commands,
    Options,
    add_chain,
    add_command,
    add_flag,
    add_option,
    add_robot,
    locked,
    refuse,
    tell,
)
from .outputs import Saved
from .terminal.messages import message


def add(commands: Commands) -> None:
    """Add the command and its options."""
    parser = add_command(
        commands,
        "init",
        run,
        "write a first experiment file for a log, to be confirmed",
        "didim init ur5e log.csv",
        "didim init arm.urdf log1.csv log2.csv -o logs.toml",
        "didim init go2.xml traj_0.pt --kp 20 --kv 1.5",
        "didim init ur10e free.csv --columns current=14-19 --gain 14.87 13.26 11.13 10.62 11.03 11.47",
    )
    add_robot(parser)
    add_option(
        parser,
        "logs LOG",
        "text with one sample a line, .npz, .mat, .h5, .json of BAM, or a ROS bag; "
        "several are recordings, or the signals of one recording",
        Path,
        nargs="+",
    )
    add_option(parser, "-o --output FILE.toml", "experiment file (default: LOG.toml beside the log)", Path)
    _add_log(parser)
    tree = parser.add_argument_group("robot of a URDF with several chains")
    add_chain(tree, "that whose joints the log names")
    add_flag(parser, "--plain", "choose neither friction laws nor a delay")
    add_flag(parser, "--force", "overwrite an existing file")


def _add_log(parser: Options) -> None:
    """Add what a log does not say of itself."""
    add_option(parser, "--rate HZ", "sampling rate, for a log without time stamps", float)
    add_option(
        parser,
        "--columns KIND=COLUMNS",
        "columns of a signal by name or number: --columns position=2-7, in one of several files torque=drives.csv:1-6; "
        "kinds: time, position, velocity, torque, current, voltage, reference",
        action="append",
        default=[],
    )
    add_option(
        parser,
        "--gain GAIN",
        "drive gains, N.m or N per A or V: one for all joints, one for each, or estimate",
        nargs="+",
        default=[],
    )
    for gain, words in (("kp", "position error, N.m/rad"), ("kv", "velocity, N.m.s/rad")):
        parser.add_argument(
            f"--{gain}",
            metavar=gain.upper(),
            nargs="+",
            type=float,
            default=[],
            help=f"gain of position servos on the {words}, for a log without torques: one for all joints, or one for each",
        )
    add_option(
        parser,
        "--side TABLE=SIDE",
        "side of the gears on which positions or torques were logged: --side torque=motor",
        action="append",
        default=[],
    )
    add_option(
        parser, "--values-per-sample N", "values in each sample, for a text with one value a line", int
    )
    add_option(parser, "--topic TOPIC", "topic of joint states, for a ROS bag with several")


def run(options: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from .._tools.files import write_atomically
    from .._tools.progress import ProgressLine
    from .._tools.words import did_you_mean, number_of
    from ..experiment.draft import initialise
    from ..log.units import ESTIMATE

    chosen: dict[str, dict[str, str]] = {"columns": {}, "side": {}}
    wanted = (("columns", "KIND=COLUMNS", "torque=14-19"), ("side", "TABLE=SIDE", "torque=motor"))
    for option, form, example in wanted:
        for text in getattr(options, option):
            key, sign, value = text.partition("=")
            if not sign or not value:
                return refuse(f"--{option} takes {form}, such as --{option} {example}, got {text!r}")
            chosen[option][key] = value
    numbers = [number_of(text) for text in options.gain]
    estimated = options.gain == [ESTIMATE]
    if None in numbers and not estimated:
        wrong = options.gain[numbers.index(None)]
        return refuse(f"--gain takes numbers or {ESTIMATE!r}, got {wrong!r}{did_you_mean(wrong, [ESTIMATE])}")
    chain = {"tip": options.tip, "base": options.base, "lock": locked(options) or None, "open": options.open}
    saved = Saved()
    with closing(ProgressLine()) as line:
        path, draft = initialise(
            options.robot,
            options.logs,
            options.output,
            rate_hz=options.rate,
            columns=chosen["columns"],
            gains=ESTIMATE if estimated else [number for number in numbers if number is not None],
            servo={key: getattr(options, key) for key in ("kp", "kv") if getattr(options, key)},
            sides=chosen["side"],
            values_per_sample=options.values_per_sample,
            topic=options.topic,
            chain=chain if any(chain.values()) else None,
            plain=options.plain,
            force=options.force,
            write=lambda path, text: saved.save(path, lambda target: write_atomically(target, text)),
            say=lambda text: line.show(f"init: {text}"),
        )
    if not saved.failed:
        saved.show(f"{path}: written", exact=True)
    elif saved.lost:
        saved.show(draft.text, exact=True)
    tell(draft.notes)
    for sentence in draft.read:
        saved.show(f"- {sentence}")
    for question in draft.questions:
        message(question, "open")
    return saved.code(NOT_CONVERGED if draft.questions else CONVERGED)
