"""`topobatch transfer`: places that people named in one map, carried to another.

They are tables `name,x,y` or `name,x,y,theta`, metres and radians, as CSV.
"""

from __future__ import annotations

import csv
import io
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from math import isnan, nan
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ..merge.component_map import component_map
from ..merge.transfer import (
    WITHIN_SIGMAS,
    MatchedJunctions,
    Transferred,
    junctions_of_merged,
    junctions_of_runs,
)
from ..merge.transfer import transfer as carried
from ..topology.errors import DataError, UsageError
from ..topology.files import read_bytes
from ..topology.map_schema import FARTHEST_M
from ..topology.se2 import wrap
from ..topology.wording import quoted_formula
from .options import RUNS, Extra, HereWithMerge, QuietOption, verb
from .output import checked_output, complain, say, say_text, show, write_files
from .workspace import MERGED, Workspace


@verb
def transfer(
    places: Annotated[Path, "PLACES.csv", "Table name,x,y[,theta]."],
    source: Annotated[str, "--from RUN", "The run in whose map the places are.", RUNS],
    target: Annotated[
        str,
        "--to RUN|SITE",
        "The run, or the site of --from (its name, or merged), to carry them to.",
        RUNS,
    ],
    within: Annotated[
        float,
        "--within METRES",
        "A place that may be off by more (95 % bound) is not carried.",
        Extra(min=0.01),
    ] = 0.5,
    output: Annotated[
        Path | None, "--output -o FILE", "File to write; default: -, the standard output."
    ] = None,
    *,
    place: HereWithMerge,
    quiet: QuietOption = False,
) -> None:
    """Carry named places from one map to another.

    From a run's map to another run's, or to the merged map. Each place goes through the matched
    junctions nearest to it, for maps bend. Writes the table again with the places' new coordinates
    (metres, radians), sigma_m (1 sigma of each coordinate), sigma_rad, nearest_m (to the nearest
    matched junction); what could not be carried keeps its row, without coordinates, and note says
    why. The exit code is then 1.

    \b
      topobatch transfer docks.csv --from run1 --to run2
      topobatch transfer docks.csv --from run1 --to merged --output site.csv
    """
    show(quiet=quiet)
    out = None if output is None or str(output) == "-" else checked_output(output)
    columns, known = read_places(places)
    matched, why = _matched(place, source, target)
    found = None if matched is None else carried(np.array([(p.x, p.y) for p in known]), matched)
    rows = [_row(p, found, k, within, why) for k, p in enumerate(known)]
    text = places_text(_header(columns), rows)
    if out is None:
        say_text(text)
    else:
        write_files({out: text})
        say(str(out))
    if found is None:
        complain(f"{places}: nothing was carried: {why}")
        raise typer.Exit(1)
    left = [(p, row["note"]) for p, row in zip(known, rows, strict=True) if row["note"]]
    for p, note in left:
        complain(f"{places}:{p.line}: {p.cells['name']}: not carried: {note}")
    if left:
        raise typer.Exit(1)


def _header(columns: Sequence[str]) -> list[str]:
    theta, sigma = (["theta"], ["sigma_rad"]) if "theta" in columns else ([], [])
    own = ["name", "x", "y", *theta, "sigma_m", *sigma, "nearest_m"]
    return [*own, *(c for c in columns if c not in (*own, "note")), "note"]


def _row(
    place: Place, found: Transferred | None, k: int, within: float, why: str
) -> dict[str, str]:
    """The row of the k-th place: with new coordinates, or with a note."""
    gone = dict.fromkeys(("x", "y", "theta", "sigma_m", "sigma_rad", "nearest_m"), "")
    row = {**place.cells, **gone, "note": why}
    if found is None:
        return row
    reach = WITHIN_SIGMAS * float(found.sigma_m[k])
    row["nearest_m"] = f"{found.nearest_m[k]:.2f}"
    row["sigma_m"] = f"{found.sigma_m[k]:.3f}"
    if reach > within:
        row["note"] = (
            f"the nearest matched junction is {found.nearest_m[k]:.1f} m away: it would be "
            f"right to {reach:.2f} m (95 %), not to {within:g} m"
        )
        return row
    row["x"], row["y"] = (f"{v:.3f}" for v in found.xy[k].tolist())
    if not isnan(place.theta):
        row["theta"] = f"{float(wrap(place.theta + found.turn[k])):.4f}"
        row["sigma_rad"] = f"{found.sigma_rad[k]:.4f}"
    return row


def _matched(place: Workspace, source: str, target: str) -> tuple[MatchedJunctions | None, str]:
    """The common junctions of source and target, or why there are none."""
    if source == target:
        raise UsageError(f"the places are in {source} already")
    result = place.read_result()
    home = result.component_of
    names = {run: c.name for run, c in home.items()}
    to_site = target not in home and target in (MERGED, place.merge, *names.values())
    named = [source] if to_site else [source, target]
    for run in named:
        if run not in home:
            place.chosen_runs([run])
            raise UsageError(f"{place.merged_json}: has no run {run!r}; merge it first")
    if to_site and target in names.values() and target != names[source]:
        return None, f"{source} is of the site {names[source]}, not of {target}"
    if len({home[run].id for run in named}) > 1:
        found = (v for v in result.verdicts if {v.a, v.b} == {source, target})
        why = next((f": {v.verdict}, {v.reason}" for v in found), "")
        return None, f"{source} and {target} are not merged{why}"
    component = home[source].id
    maps = place.maps_as_merged(result, component, named)
    if len(named) == 2:
        matched = junctions_of_runs(result, maps, source, target)
    else:
        with place.document_at_fault():
            fused = component_map(result, component, MERGED)
        matched = junctions_of_merged(result, maps[source], fused)
    if not len(matched):
        why = f"no junction of {source} is matched to one of {target}"
        site = "" if to_site else f"; --to {shlex.quote(names[source])} carries to the map of both"
        return None, f"{why}{site}"
    return matched, ""


MOST_PLACES = 100_000
"""Most places of a table: each takes about 1 kB."""


@dataclass(frozen=True, slots=True)
class Place:
    """A named place in a map, in metres and radians. line: number of its row; cells: texts of the
    row, by column; theta: NaN where none is given."""

    line: int
    cells: Mapping[str, str]
    x: float
    y: float
    theta: float


def read_places(path: Path) -> tuple[list[str], list[Place]]:
    """The columns and the places of a CSV file; DataError with the line number if it is
    invalid."""
    try:
        raw = read_bytes(path.resolve())
    except RuntimeError as error:  # of Python before 3.13
        raise DataError(f"{path}: is a link that leads to itself") from error
    try:
        reader = csv.DictReader(io.StringIO(raw.decode("utf-8-sig"), newline=""), strict=True)
        names = [_unquoted(name.strip()) for name in reader.fieldnames or ()]
        missing = [name for name in ("name", "x", "y") if name not in names]
        if missing or len(set(names)) < len(names):
            wrong = f"has no column {missing[0]!r}" if missing else "has a column twice"
            raise DataError(
                f"{path}:1: {wrong}; the first line is {','.join(names)[:60]!r}, and must be "
                "name,x,y or name,x,y,theta, with commas"
            )
        reader.fieldnames = names
        places = [_place(path, reader.line_num, row) for row in islice(reader, MOST_PLACES)]
        if next(reader, None) is not None:
            raise DataError(f"{path}: holds more than {MOST_PLACES:,} places")
    except (csv.Error, UnicodeDecodeError) as error:
        raise DataError(f"{path}: is not CSV in UTF-8: {error}") from error
    if not places:
        raise DataError(f"{path}: holds no place")
    return names, places


def _place(path: Path, line: int, row: Mapping[Any, Any]) -> Place:
    if None in row or None in row.values():
        raise DataError(f"{path}:{line}: has more or fewer values than the first line has names")
    cells = {name: _unquoted(cell) for name, cell in row.items()}
    pose = []
    for column in ("x", "y", "theta"):
        text = cells.get(column, "").strip()
        if column == "theta" and not text:
            pose.append(nan)
            continue
        try:
            pose.append(float(text))
        except ValueError:
            raise DataError(f"{path}:{line}: {column} is {text[:40]!r}, not a number") from None
        if not abs(pose[-1]) <= FARTHEST_M:  # nor NaN
            raise DataError(f"{path}:{line}: {column} is {text[:40]!r}, which is nowhere")
    return Place(line, cells, *pose)


def places_text(header: Sequence[str], rows: Sequence[Mapping[str, str]]) -> str:
    """A table as CSV, its formulas quoted (`quoted_formula`); `read_places` takes that away."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(map(quoted_formula, header))
    writer.writerows([quoted_formula(row[name]) for name in header] for row in rows)
    return out.getvalue()


def _unquoted(cell: str) -> str:
    return cell[1:] if cell[:1] == "'" and quoted_formula(cell[1:]) == cell else cell
