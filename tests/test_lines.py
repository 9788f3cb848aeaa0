"""How much of the package a run enters: a number that only falls."""

from __future__ import annotations

from pathlib import Path

import didim
from scripts import script

BENCHES = Path(__file__).resolve().parents[1] / "benches"
MOST_FILES = 45
"""Files that `run` of IDIM-LS entered when it was last counted."""


def test_idim_ls_enters_no_more_files_than_before() -> None:
    lines = script(BENCHES / "lines.py")
    seen = lines.entered(didim.IDIMLS(), lines.simulated_tx40())
    assert len({file for file, _ in seen}) <= MOST_FILES
