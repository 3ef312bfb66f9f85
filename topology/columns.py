"""Tables: dataclasses whose fields are columns with one row for each thing.

A column is an array, a `Ragged`, or a sequence of other values; one that a table does not know is
None, whichever rows are asked for.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from .ragged import Ragged


class _Dataclass(Protocol):
    __dataclass_fields__: ClassVar[dict[str, Any]]


Table = TypeVar("Table", bound=_Dataclass)


def take(table: Table, rows: NDArray[Any]) -> Table:
    """The given rows of a table, by their numbers or a mask."""
    return type(table)(*(_taken(getattr(table, name), rows) for name in table.__dataclass_fields__))


def joined(tables: Sequence[Table]) -> Table:
    """The rows of one or more tables of one kind, one table after the other."""
    first = tables[0]
    columns = ([getattr(part, name) for part in tables] for name in first.__dataclass_fields__)
    return type(first)(*map(_end_to_end, columns))


def columns_of(table: object, names: Iterable[str], rows: NDArray[Any]) -> dict[str, Any]:
    """The given rows of some columns, by name: of a table that has columns of several things."""
    return {name: _taken(getattr(table, name), rows) for name in names}


def columns_and(table: object, more: Mapping[str, Any]) -> dict[str, Any]:
    """The columns named, each with more rows behind its own."""
    return {name: _end_to_end([getattr(table, name), rows]) for name, rows in more.items()}


def _taken(column: Any, rows: NDArray[Any]) -> Any:
    if column is None or isinstance(column, np.ndarray):
        return None if column is None else column[rows]
    numbers = np.arange(len(column))[rows]
    if isinstance(column, Ragged):
        return column.take(numbers)
    return tuple(column[k] for k in numbers.tolist())


def _end_to_end(parts: Sequence[Any]) -> Any:
    first = parts[0]
    if first is None:
        return None
    if isinstance(first, Ragged):
        return Ragged.joined(parts)
    if isinstance(first, np.ndarray):
        return np.concatenate(parts)
    return tuple(value for part in parts for value in part)
