"""Entities whose elements change colour as time goes on."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..topology.arrays import IntArray
from . import palette
from .palette import Colour, Colours
from .recording import PathParts, Recording

MOST_CELLS = 400_000
"""Limit on logged colours (4 bytes each) of one entity; above it, changes are grouped in time."""


def light_up(
    recording: Recording,
    path: PathParts,
    archetype: Any,
    when_ns: IntArray,
    colours: Colours | Colour,
    *,
    begin_ns: int | None,
    dim: Colour = palette.UNLIT,
) -> None:
    """Log the colours of an entity of n elements over time: `dim` before when_ns (n,), from then on
    `colours`, one each or one for all; begin_ns: time of the first row, if earlier.

    All elements are in one entity with one row for each change, so that an element's index is the
    same at any time.
    """
    times = _rows(when_ns, begin_ns)
    recording.over_time(path, times, colour_columns(archetype, _lit(times, when_ns, colours, dim)))


def light_up_by_step(
    recording: Recording,
    path: PathParts,
    archetype: Any,
    when: IntArray,
    colours: Colours | Colour,
    *,
    now: Colour | None = None,
    dim: Colour = palette.UNLIT,
) -> None:
    """`light_up` on the timeline JOIN, from step 0 on; when (n,): step of each element, 0 for never
    dim. now: colour of the elements whose step is the current one."""
    more = [when + 1] if now is not None else []
    numbers = np.unique(np.concatenate([[0], when, *more]))
    rows = _lit(numbers, when, colours, dim)
    if now is not None:
        rows[numbers[:, None] == when[None, :]] = now
    recording.over_steps(path, numbers, colour_columns(archetype, rows))


def _lit(
    times: IntArray,
    when: IntArray,
    colours: Colours | Colour,
    dim: Colour,
) -> NDArray[np.uint8]:
    """(times, elements, 3) colours."""
    lit = (when[None, :] <= times[:, None])[:, :, None]
    return np.where(lit, np.asarray(colours, np.uint8), np.asarray(dim, np.uint8))


def colour_columns(archetype: Any, rows: NDArray[np.uint8]) -> Any:
    """Colours (times, elements, 3) as rerun columns."""
    times, things = rows.shape[:2]
    return archetype.columns(colors=rows.reshape(-1, 3)).partition([things] * times)


def _rows(when_ns: IntArray, begin_ns: int | None) -> IntArray:
    """The times at which a colour changes, thinned to the limit MOST_CELLS; the last one is
    kept."""
    times = np.unique(when_ns)
    most = max(MOST_CELLS // max(len(when_ns), 1), 2)
    if len(times) > most:
        times = times[np.unique(np.linspace(0, len(times) - 1, most).round().astype(np.int64))]
    if begin_ns is not None and begin_ns < times[0]:
        times = np.concatenate([[begin_ns], times])
    return times
