"""A reader of logs: JSON lines, one sample a line, such as ``{"t": 0.002, "q": [0.1, 0.2], "tau": [3.1, -0.4]}``.

A row in the table of readers is all that the package needs to know:

    didim.log.data_file.READERS[".jsonl"] = "json_lines:JsonLines"

In the experiment file ``file = "log.jsonl"`` with ``variable = "q"`` then reads all joints, and ``columns = ["q1", "q2"]``
values that stand alone. Tested in ``tests/test_extensions.py``.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from didim.log.array_file import ArrayFile


class JsonLines(ArrayFile):
    """Text with one JSON object a line; every object has the same keys."""

    kind = "JSON lines"

    def variables(self) -> list[str]:
        """Keys of the first sample, which all have."""
        self.samples: list[dict[str, Any]] = []
        for number, line in enumerate(self.raw.decode("utf-8").splitlines(), start=1):
            try:
                sample = json.loads(line)
            except ValueError as reason:
                self.fail(f"line {number} is not JSON ({reason})")
            if not isinstance(sample, dict) or (self.samples and sample.keys() != self.samples[0].keys()):
                self.fail(f"line {number} does not have the keys of the first line")
            self.samples.append(sample)
        return list(self.samples[0])

    def array(self, name: str) -> Any:
        """Values of a key: (n_samples,) for numbers, (n_samples, n_dof) for lists of numbers."""
        return np.array([sample[name] for sample in self.samples])
