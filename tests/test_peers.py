"""The comparison with Pinocchio runs, once both have computed the same; how fast is not tested."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path


def test_one_round(project: Path, tmp_path: Path) -> None:
    result = tmp_path / "peers.json"
    command = [sys.executable, str(project / "benches" / "peers.py"), "--rounds", "1", "--json", str(result)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(result.read_text(encoding="utf-8"))
    assert set(found) == {"rounds", "pinocchio", "times_us", "ratios"}
    for name in (*found["times_us"], *found["ratios"]):
        assert name in done.stdout
    times = found["times_us"]
    ratio = 4.0 * times["Pinocchio abaInParallel"] / times["closed-loop RK4 step, 1 candidate"]
    assert found["ratios"]["4 aba / RK4 step, 1 candidate"] == ratio
