"""Tables: frozen dataclasses of which every field is an array with one row for each thing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray


class _Dataclass(Protocol):
    __dataclass_fields__: ClassVar[dict[str, Any]]


Table = TypeVar("Table", bound=_Dataclass)


def take(table: Table, rows: NDArray[Any]) -> Table:
    """The given rows of a table, by their numbers or a mask."""
    return type(table)(*(getattr(table, name)[rows] for name in table.__dataclass_fields__))


def joined(tables: Sequence[Table]) -> Table:
    """The rows of one or more tables of one kind, one table after the other."""
    first = tables[0]
    columns = ([getattr(part, name) for part in tables] for name in first.__dataclass_fields__)
    return type(first)(*(np.concatenate(column) for column in columns))
