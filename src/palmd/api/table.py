"""Tables: columns of equal length under published names."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from palmd.api.errors import PalmdError
from palmd.console.extras import install_line
from palmd.record.tables import flat

Column = npt.NDArray[Any]
_BLANK: dict[type, Any] = {float: np.nan, bool: False, str: "", list: []}


class DataTable(Mapping[str, Column]):
    """A mapping from names to NumPy arrays of equal length: `table["psi_rad"]`, `dict(table)`, `table.to_pandas()`.

    Names end in their unit (SI). Numbers are float64 with NaN for "no value", truth values bool, texts and lists of
    unequal length object; lists of equal length make a two-dimensional column. Nested maps are flattened: `sd.psi_rad`.
    """

    def __init__(self, columns: Mapping[str, Column]) -> None:
        """All `columns` must have the same length."""
        self._columns = dict(columns)

    def __getitem__(self, name: str) -> Column:
        try:
            return self._columns[name]
        except KeyError:
            raise KeyError(f"there is no column {name!r}; the columns are {', '.join(self._columns)}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        """Number of columns, as of any mapping; see `rows`."""
        return len(self._columns)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(next(iter(self._columns.values()), ()))

    def to_pandas(self) -> Any:
        """A pandas DataFrame; two-dimensional columns become columns of arrays. PalmdError without pandas."""
        try:
            import pandas
        except ModuleNotFoundError:
            line = install_line("pandas", "pandas")
            raise PalmdError(f"a data frame needs pandas, which is not installed: {line}") from None
        return pandas.DataFrame({name: list(column) if column.ndim > 1 else column for name, column in self.items()})

    def __repr__(self) -> str:
        return f"<DataTable of {self.rows} rows: {', '.join(self._columns)}>"


def table_of(messages: Iterable[Mapping[str, Any]]) -> DataTable:
    """A table with one row per message; missing fields have no value."""
    rows = [dict(flat(dict(message))) for message in messages]
    names = dict.fromkeys(name for row in rows for name in row)
    return DataTable({name: _column([row.get(name) for row in rows]) for name in names})


def _column(values: list[Any]) -> Column:
    kind: type = next((type(value) for value in values if value is not None), float)
    kind = float if kind is int else kind
    filled = [_BLANK[kind] if value is None else value for value in values]
    if kind in (float, bool):
        return np.array(filled, dtype=kind)
    if kind is list and len({len(value) for value in filled}) == 1 and not isinstance(filled[0][:1], str):
        return np.array(filled)
    column = np.empty(len(filled), dtype=object)
    column[:] = filled
    return column
