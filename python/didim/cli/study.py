"""``didim study``."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from .._tools.progress import shows_progress
from .._tools.words import counted
from .options import (
    CONVERGED,
    INTERRUPTED,
    NOT_CONVERGED,
    Commands,
    add_command,
    add_flag,
    add_format,
    add_option,
    add_report,
    check_report,
)
from .outputs import Saved, check_outputs
from .terminal.messages import message, progress_lines

if TYPE_CHECKING:
    from ..monte_carlo.results import StudyResults
    from ..monte_carlo.study import Progress
STUDY_PROGRESS_S = 2.0
"""Time (s) between two progress lines of a study."""


def add(commands: Commands) -> None:
    """Add the command and its options."""
    parser = add_command(
        commands,
        "study",
        run,
        "identify many simulated logs by several methods",
        "didim study study.toml -o rows.jsonl",
        "didim study rows_a.jsonl rows_b.jsonl --report study.html",
        "didim study study.toml --dask tcp://host:8786",
    )
    add_option(
        parser,
        "study STUDY.toml|ROWS.jsonl",
        "study file to run, or rows of finished studies to summarise",
        Path,
        nargs="+",
    )
    add_option(
        parser,
        "-o --output ROWS.jsonl",
        "file that rows are appended to (default: beside the study); rows that it has are not made again",
        Path,
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--executor",
        choices=("process", "thread", "serial", "loky"),
        default="process",
        help="executor of the tasks on this machine (default: %(default)s)",
    )
    add_option(where, "--dask ADDRESS", "run on the workers of a Dask scheduler, such as tcp://host:8786")
    add_option(
        where,
        "--ray ADDRESS",
        "run on Ray: on this machine, or on the cluster at ADDRESS",
        nargs="?",
        const="",
    )
    add_flag(where, "--mpi", "run on the ranks of MPI (python -m mpi4py.futures -m didim study ...)")
    add_option(parser, "--workers N", "processes or threads (default: all cores)", int)
    add_option(parser, "--parquet FILE.parquet", "also write the figures as Parquet (needs pyarrow)", Path)
    add_option(
        parser,
        "--columns NAMES",
        "columns of the printed table and of the report, such as rms,coverage,seconds (default: all)",
    )
    add_format(parser)
    add_report(parser)
    add_flag(parser, "--quiet", "no progress on stderr")


def run(options: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from ..errors import StudyError
    from ..monte_carlo.results import StudyResults
    from ..monte_carlo.text import HEAD, columns_named

    check_report(options)
    check_outputs(options.parquet)
    # Before the work: a misspelt name must not cost a study.
    head = HEAD if options.columns is None else columns_named(options.columns.split(","))
    if all(path.suffix == ".jsonl" for path in options.study):
        results, code = StudyResults.read(*options.study), CONVERGED
    elif len(options.study) > 1:
        raise StudyError("give one study file, or files of rows that end in .jsonl")
    else:
        results, code = _run(options)
    results = replace(results, head=head)
    for remark in results.rows.remarks:
        message(remark, "note")
    saved = Saved()
    saved.save(options.parquet, results.write_parquet)
    saved.save_report(options.report, results)
    saved.show_result(results, options.format)
    return saved.code(code)


def _run(options: argparse.Namespace) -> tuple[StudyResults, int]:
    """Run a study, and return its results at the end or after an interruption."""
    from ..monte_carlo.results import StudyResults
    from ..monte_carlo.rows import times_path
    from ..monte_carlo.spec import load_study
    from ..monte_carlo.study import study

    (path,) = options.study
    spec = load_study(path)
    output = options.output or path.with_suffix(".jsonl")
    check_outputs(output, times_path(output))
    executor, address = options.executor, None
    if options.dask is not None:
        executor, address = "dask", options.dask
    elif options.ray is not None:
        executor, address = "ray", options.ray or None
    elif options.mpi:
        executor = "mpi"
    lost = 0
    line = None if options.quiet or shows_progress() else progress_lines(STUDY_PROGRESS_S)

    def progress(state: Progress) -> None:
        nonlocal lost
        lost = state.lost
        if line is not None:
            line(str(state), state.done >= state.total)

    try:
        results = study(
            spec,
            output,
            executor=executor,
            workers=options.workers,
            address=address,
            progress=progress,
            verbose=False if options.quiet else None,
        )
    except KeyboardInterrupt:
        message(f"interrupted; '{output}' has the rows so far, and the same command goes on")
        return StudyResults.read(output, appended=True), INTERRUPTED
    except OSError as error:
        reason = error.strerror or str(error)
        message(f"{output}: {reason}; the table is of the rows so far, and the same command goes on")
        return StudyResults.read(output, appended=True), NOT_CONVERGED
    if lost:
        message(
            f"{counted(lost, 'task')} lost with the workers that ran them; the same command tries them again"
        )
    return results, NOT_CONVERGED if lost else CONVERGED
