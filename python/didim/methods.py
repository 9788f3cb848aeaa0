"""The methods by name. Beside `identify` and not in it: ``import didim`` loads that, and should load no method."""

from __future__ import annotations

from collections.abc import Callable

from .cloe import CLOE
from .didim_method import DIDIM
from .identify import Method
from .idim_ls import IDIMLS

METHODS: dict[str, Callable[..., Method]] = {"idim-ls": IDIMLS, "didim": DIDIM, "cloe": CLOE}
"""Methods by name, with the settings of the experiment file."""
