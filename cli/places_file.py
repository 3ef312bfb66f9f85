"""Tables of named places: `name,x,y` or `name,x,y,theta`, metres and radians, as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from math import isfinite
from pathlib import Path
from typing import TextIO

from ..topology.errors import DataError
from ..topology.map_schema import FARTHEST_M
from ..topology.wording import quoted_formula

MOST_BYTES = 16 << 20
MOST_PLACES = 100_000
"""A row takes a kilobyte in memory; a site has some hundreds."""
MOST_VALUES = 1 << 20
"""Limit on cells of the table, of a hundred bytes each."""
OWN = ("name", "x", "y", "theta")


@dataclass(frozen=True, slots=True)
class Place:
    """A named place in a map; more: the other columns of its row."""

    line: int
    name: str
    x: float
    y: float
    theta: float | None
    more: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Places:
    """The rows of a table; columns: the other columns, in order."""

    rows: tuple[Place, ...]
    columns: tuple[str, ...]
    headings: bool


def read_places(path: Path) -> Places:
    """The places of a CSV file; DataError with the line number if it is invalid."""
    try:
        with path.open("rb") as file:
            raw = file.read(MOST_BYTES + 1)  # devices have a size of 0, and no end
    except FileNotFoundError as error:
        raise DataError(f"{path}: no such file or folder") from error
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from error
    if len(raw) > MOST_BYTES:
        raise DataError(f"{path}: is larger than {MOST_BYTES >> 20} MiB; not a table of places")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: is no UTF-8 text ({error.reason})") from error
    return _places(path, io.StringIO(text, newline=""))


def _places(path: Path, file: TextIO) -> Places:
    reader = csv.DictReader(file, strict=True)
    try:
        names = [_unquoted(name.strip()) for name in reader.fieldnames or ()]
        reader.fieldnames = names
        missing = [name for name in OWN[:3] if name not in names]
        if missing or len(set(names)) < len(names):
            wrong = f"has no column {missing[0]!r}" if missing else "has a column twice"
            raise DataError(f"{path}:1: {wrong}; the first line must be name,x,y or name,x,y,theta")
        most = min(MOST_PLACES, MOST_VALUES // len(names))
        rows = tuple(_place(path, reader.line_num, row) for row in islice(reader, most))
        if next(reader, None) is not None:
            raise DataError(
                f"{path}: holds more than {most:,} places of {len(names):,} columns; cut it into "
                "parts"
            )
    except csv.Error as error:
        raise DataError(f"{path}:{reader.line_num}: is not CSV: {error}") from error
    if not rows:
        raise DataError(f"{path}: holds no place")
    columns = tuple(name for name in names if name not in OWN)
    return Places(rows, columns, "theta" in names)


def _place(path: Path, line: int, row: Mapping[str | None, str | None]) -> Place:
    if None in row or None in row.values():
        raise DataError(f"{path}:{line}: has more or fewer values than the first line")
    values = {str(key): _unquoted(str(value)) for key, value in row.items()}
    theta = values.get("theta", "").strip()
    return Place(
        line=line,
        name=values["name"],
        x=_number(path, line, "x", values["x"]),
        y=_number(path, line, "y", values["y"]),
        theta=_number(path, line, "theta", theta) if theta else None,
        more={key: value for key, value in values.items() if key not in OWN},
    )


def _number(path: Path, line: int, column: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise DataError(f"{path}:{line}: {column} is {text[:40]!r}, not a number") from None
    if not isfinite(value) or abs(value) > FARTHEST_M:
        raise DataError(f"{path}:{line}: {column} is {text[:40]!r}, which is nowhere")
    return value


def places_text(header: Sequence[str], rows: Sequence[Mapping[str, str]]) -> str:
    """A table as CSV, its formulas quoted (`quoted_formula`); `read_places` takes that away."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(map(quoted_formula, header))
    writer.writerows([quoted_formula(row[name]) for name in header] for row in rows)
    return out.getvalue()


def _unquoted(cell: str) -> str:
    return cell[1:] if cell[:1] == "'" and quoted_formula(cell[1:]) == cell else cell
