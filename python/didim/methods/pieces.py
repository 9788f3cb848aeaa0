"""IDIM-LS on a text log of any length: rows of (7) piece by piece, from file to the triangles of `Recursive`.

A piece is read with an overlap at both ends, in which what its filters know of the cut fades to `FADED`; its rows are those of the
whole log. Memory is that of one piece. Tested in ``tests/test_pieces.py``; measured in docs/performance.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .._tools.arrays import Array
from .._tools.keys import declared
from .._tools.toml import Table, read_toml
from ..errors import ExperimentError, FitError, RecordingError
from ..experiment.experiment_file import read_experiment
from ..log.csv_file import CsvFile
from ..log.data_folder import SOURCES, DataFolder, expanded
from ..log.formats.text_rows import TextRows
from ..log.recording import Recording
from ..log.recording_file import read_recording, read_reduction
from ..log.sampling import slices
from ..regression.recursive import Recursive
from ..signal.filters import decimation_stages, least_samples
from ..signal.processing import SignalProcessing
from ..signal.spikes import WINDOW
from ..signal.window import windows_of
from ..terms.model import Model
from .idim_ls import IDIMLS
from .job import Job

RECORDING = declared("experiment", "recording")
"""Keys of a recording."""
ROWS = 100_000
"""Samples of a piece without its overlap: some 200 MB for seven joints."""
FADED = 1e-13
"""Share of the state of a filter that is left after the overlap."""


def fold_log(path: str | Path, *, rows: int = ROWS) -> Recursive:
    """Fold the text logs of an experiment file into triangles, in the memory of a piece.

    Parameters
    ----------
    path : str or Path
        Experiment file; its recordings with role "fit" are read.
    rows : int
        Samples of a piece without its overlaps.

    Returns
    -------
    Recursive
        Its `estimate` is IDIM-LS of the whole log with weights per joint, with standard deviations for white noise.

    Raises
    ------
    ExperimentError, RecordingError, FitError
        As for `didim.load_experiment` and IDIM-LS, and for what takes the whole log: other formats than text, resampling, rollouts,
        payloads, parameters of single recordings, drive gains, load friction and friction with a memory, estimated delays.

    Notes
    -----
    ``test_pieces.py`` compares estimate and residuals with IDIM-LS, windows, both conventions of decimation and delays included.
    `spikes` are compared with the typical window of their piece, not of the log.
    """
    log = _Log(Path(path), rows)
    job = log.job
    given = job.model.unknowns.given
    every, recursive = Model(job.robot), Recursive(job.robot, fixed=given("fixed"), dropped=given("dropped"))
    for piece, inside in log.pieces():
        delay = job.declared_delay
        (part,) = windows_of(piece, job.signal, delay=delay.samples, hold_s=delay.hold_s)
        system = every.rows([part], job.signal)
        w = system.w.reshape(job.robot.n_dof, -1, system.w.shape[1]).transpose(1, 0, 2)
        recursive.update_rows(w[inside], system.y.reshape(job.robot.n_dof, -1).T[inside])
    return recursive


class _Log:
    """The recordings of an experiment file, of which ranges of rows are read."""

    def __init__(self, path: Path, rows: int) -> None:
        content = read_toml(path, ExperimentError)
        self._folder, self._rows, self._files = path.parent, rows, dict[str, TextRows]()
        entries = [
            pair
            for number, entry in enumerate(content.get("recording", []))
            if entry.get("role", "fit") == "fit"
            for pair in expanded(
                Table(entry, path.name, ExperimentError, keys=RECORDING),
                f"recording {number + 1}",
                path.parent,
            )
        ]
        self._tables = [{"name": title, **table.content_unread} for table, title in entries]
        for table in self._tables:
            sources = [table[key] for key in SOURCES if key in table]
            plain = all(
                isinstance(part.get("file"), str) and "values_per_sample" not in part for part in sources
            )
            if not plain or "rollouts" in table or table.get("time", {}).get("resample"):
                raise ExperimentError(
                    f"{path.name}: rollouts, resample = true, values_per_sample and a file for each column need the whole log"
                )
        # The first rows are enough for the settings.
        first = {**content, "recording": [_without_windows(table) for table in self._tables]}
        experiment = read_experiment(first, path, data=self._part(0, rows))
        self._recordings, self.job = experiment.recordings, IDIMLS().job(experiment)
        _check_job(self.job)
        matrix = (
            None
            if (drives := content.get("transmission")) is None
            else Table(drives, path.name, ExperimentError, keys=declared("experiment", "transmission"))
        )
        self._reduction = read_reduction(matrix, self.job.robot.reduction, self.job.robot.n_dof)

    def pieces(self) -> Iterator[tuple[Recording, slice]]:
        """Give pieces in order: a recording with one window, and which rows of (7) are its own."""
        for table, first in zip(self._tables, self._recordings, strict=True):
            whole = Table(table, first.name, ExperimentError)
            count = min(self._files[str(part["file"])].count for key in SOURCES if (part := table.get(key)))
            delay = (
                np.abs(self.job.declared_delay.samples).max() + 0.5
            )  # and the hold, of half a sample at most
            overlap = _overlap(self.job.signal, first.rate_hz) + math.ceil(delay)
            for window in slices(whole, table.get("windows_s", []), first.rate_hz, count) or ((0, count),):
                for start, stop, inside in _cuts(window, self.job.signal, overlap, self._rows):
                    part = Table(
                        {**_without_windows(table), "rate_hz": first.rate_hz},
                        first.name,
                        ExperimentError,
                        keys=RECORDING,
                    )
                    folder = self._part(start, stop)
                    yield read_recording(part, first.name, self.job.robot, self._reduction, folder), inside

    def _part(self, start: int, stop: int) -> DataFolder:
        """Return the folder of the data files, as if they had these rows only."""

        def opened(path: Path, name: str, *, topic: str | None, **options: Any) -> CsvFile:
            if topic is not None:
                raise RecordingError(f"{name}: topic is for ROS bags only")
            if name not in self._files:
                self._files[name] = TextRows(path, name, **options)
            return self._files[name].rows(start, min(stop, self._files[name].count))

        return DataFolder(self._folder, opened)


def _without_windows(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table of a recording whose windows are those of the whole log."""
    return {key: value for key, value in table.items() if key != "windows_s"}


def _check_job(job: Job) -> None:
    """Refuse settings that need the whole log."""
    friction = job.robot.friction
    if not job.model.simple or friction.has_load or friction.has_memory or friction.open:
        raise FitError(
            "payloads, parameters of single recordings, drive gains, load friction, friction with a memory and open friction terms "
            "need the whole log: not in pieces"
        )
    if job.delay_setting == "estimate":
        raise FitError("the delay is estimated on the whole log, not in pieces: give compensate_samples")


def _cuts(
    window: tuple[int, int], signal: SignalProcessing, overlap: int, rows: int
) -> Iterator[tuple[int, int, slice]]:
    """Cut a window: first and last sample of each piece with its overlaps, and which of its rows are its own.

    Pieces begin at multiples of the decimation, and their lengths differ from the window's by multiples of it, so that both
    conventions keep the samples that they keep in the window.
    """
    count, factor = window[1] - window[0], math.prod(signal.decimation)
    edge = signal.edge_rows if signal.decimation else 0
    overlap = factor * -(-overlap // factor)
    step = factor * -(-rows // factor)
    for begin in range(0, count, step):
        start, end = max(0, begin - overlap), begin + step
        stop = min(count, end + overlap + count % factor)
        last = (end - start) // factor - edge if end < count else None
        yield (
            window[0] + start,
            window[0] + stop,
            slice((begin - start) // factor - edge if begin else 0, last),
        )


def _overlap(signal: SignalProcessing, rate_hz: float) -> int:
    """Return the samples after which no row depends on where a piece was cut."""
    from scipy.signal import butter

    samples, factor = WINDOW + signal.trim_start + signal.trim_end, 1
    if signal.cutoff_hz is not None:
        samples += _fading(butter(signal.order, 2.0 * signal.cutoff_hz / rate_hz, output="sos"))
    for sections, _, padding, step, _ in decimation_stages(least_samples(signal), signal):
        samples += factor * (_fading(sections) + padding)
        factor *= step
    return samples + 2 * factor * (signal.edge_rows + 1)


def _fading(sections: Array) -> int:
    """Return the samples in which the slowest pole of second-order sections, (s, 6), fades to `FADED`."""
    slowest = max(np.abs(np.roots(section)).max() for section in sections[:, 3:])
    return math.ceil(math.log(FADED) / math.log(slowest))
