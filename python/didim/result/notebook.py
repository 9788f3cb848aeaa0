"""A result in a notebook and in pandas. Tested in ``tests/test_notebook.py``."""

from __future__ import annotations

from typing import Any, Protocol

from .._tools.notebook import page, pandas


class _Result(Protocol):
    """Attributes of a result used here."""

    def parameter_rows(self) -> list[tuple[str, ...]]: ...
    def error_rows(self) -> list[tuple[str, ...]]: ...
    def lines_after_tables(self) -> list[str]: ...
    def value_rows(self) -> list[dict[str, Any]]: ...


class InNotebook:
    """Tables of a result as HTML and as a ``DataFrame``."""

    def _repr_html_(self: _Result) -> str:
        title = str(self).partition("\n")[0]
        after = "\n".join(self.lines_after_tables())
        return page(title, self.parameter_rows(), self.error_rows(), after.strip("\n"))

    def to_dataframe(self: _Result) -> Any:
        """Return the tables of parameters as a pandas ``DataFrame`` with their names as its index.

        Base parameters come first, then those of the logs: payloads, own offsets and friction of recordings, drive gains.

        Returns
        -------
        DataFrame
            Columns ``unit``, ``value``, ``std``, ``relative_std_percent``, ``low``, ``high``, ``std_white`` and ``role``, as in the
            JSON of a result (SI units, joint side), and ``group``: "robot", "payload", "offset", "friction" or "gain".

        Raises
        ------
        DidimError
            Without pandas (``tests/test_notebook.py``).
        """
        return (
            pandas().DataFrame(self.value_rows()).rename(columns={"name": "parameter"}).set_index("parameter")
        )
