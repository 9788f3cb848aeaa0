"""Reports: one HTML page with a verdict, tables and pictures, readable offline.

    didim.report.write("fit.html", fit, experiment)

is what ``--report fit.html`` does on the command line. Needs matplotlib, the extra ``plot``. Tested in ``tests/test_report.py``.
"""

from __future__ import annotations

from pathlib import Path

from .._tools.files import check_output, keep_sources, write_atomically
from ..errors import PlotError
from ..excitation.design import Excitation
from ..experiment.experiment import Experiment
from ..monte_carlo.results import StudyResults
from ..plot.style import require
from ..result.identification import Identification
from ..result.positions.record import PositionRecord
from ..studies.comparison import Comparison
from ..studies.validation import Validation

__all__ = ["check", "render", "write"]


def render(
    result: Identification | Comparison | Validation | Excitation | StudyResults,
    experiment: Experiment | None = None,
) -> str:
    """Return a report as HTML.

    Parameters
    ----------
    result : Identification, Comparison, Validation, Excitation or StudyResults
        From `identify`, `compare`, `validate`, `excite` or `study`.
    experiment : Experiment, optional
        The log of an identification or a validation, needed for pictures of torques; a comparison contains its log, and a
        designed motion needs none.

    Returns
    -------
    str
        A whole page. The same result gives the same text on the same date; ``SOURCE_DATE_EPOCH`` sets the date.

    Raises
    ------
    PlotError
        Without matplotlib, or without the experiment of a validation or an identification.
    DidimError
        When the experiment is of another robot.
    """
    from ..studies.comparison import Comparison

    require()
    if isinstance(result, Comparison):
        from .comparison import comparison_page

        return comparison_page(result)
    if isinstance(result, Excitation):
        from .excitation import excitation_page

        return excitation_page(result)
    if isinstance(result, StudyResults):
        from .study import study_page

        return study_page(result)
    if experiment is None:
        raise PlotError("a report needs the experiment that the result was made of")
    if isinstance(result, Validation):
        from .validation import validation_page

        return validation_page(result, experiment)
    record = PositionRecord.of(result.settings)
    if record is not None:
        from .positions import positions_page

        return positions_page(result, experiment, record)
    from .fit import fit_page

    return fit_page(result, experiment)


def write(
    path: str | Path,
    result: Identification | Comparison | Validation | Excitation | StudyResults,
    experiment: Experiment | None = None,
) -> None:
    """Write a report: whole, or not at all. Parameters and errors as for `render`.

    Raises
    ------
    OSError
        When the file cannot be written.
    """
    own = result.experiment if isinstance(result, Comparison) else result
    sources = {**getattr(own, "digests", {}), **({} if experiment is None else experiment.digests)}
    keep_sources(Path(path), sources.values())  # before seconds of drawing
    write_atomically(Path(path), render(result, experiment), sources.values())


def check(path: str | Path) -> None:
    """Check in advance whether a report can be written, before a long identification.

    Raises
    ------
    PlotError
        Without matplotlib.
    OSError
        When there is no such folder.
    """
    require()
    check_output(Path(path))
