"""Tables: dataclasses whose fields are columns with one row per item.

A column is an array, a `Ragged`, another sequence, a table, or None where it is not known.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from .ragged import Ragged


class _Dataclass(Protocol):
    __dataclass_fields__: ClassVar[dict[str, Any]]


Table = TypeVar("Table", bound=_Dataclass)


def take(table: Table, rows: NDArray[Any] | slice) -> Table:
    """The given rows of a table: indices, a mask or a slice."""
    return type(table)(*(_taken(getattr(table, name), rows) for name in table.__dataclass_fields__))


def joined(tables: Sequence[Table]) -> Table:
    """The rows of one or more tables of the same type, concatenated."""
    first = tables[0]
    columns = ([getattr(part, name) for part in tables] for name in first.__dataclass_fields__)
    return type(first)(*map(_end_to_end, columns))


def columns_of(table: object, names: Iterable[str], rows: NDArray[Any]) -> dict[str, Any]:
    """The given rows of the named columns of a table, by name."""
    return {name: _taken(getattr(table, name), rows) for name in names}


def columns_and(table: object, more: Mapping[str, Any]) -> dict[str, Any]:
    """The columns named in `more`, each with the rows given there appended."""
    return {name: _end_to_end([getattr(table, name), rows]) for name, rows in more.items()}


def _taken(column: Any, rows: NDArray[Any] | slice) -> Any:
    if isinstance(column, Ragged):
        return column.take(np.arange(len(column))[rows])
    if isinstance(column, Sequence):
        return tuple(column[k] for k in np.arange(len(column))[rows].tolist())
    if hasattr(column, "__dataclass_fields__"):
        return take(column, rows)
    return None if column is None else column[rows]


def _end_to_end(parts: Sequence[Any]) -> Any:
    first = parts[0]
    if isinstance(first, Ragged):
        return Ragged.joined(parts)
    if isinstance(first, Sequence):
        return tuple(chain.from_iterable(parts))
    return None if first is None else np.concatenate(parts)
