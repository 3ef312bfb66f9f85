"""Things that light up one by one as time goes on, and stay selectable all along."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..topology.arrays import IntArray
from . import palette
from .palette import Colour, Colours
from .recording import PathParts, Recording

MOST_CELLS = 400_000
"""Colours logged for one entity at most, of 4 bytes each: where a thing for every time would take
more, several light up together."""


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
    """Log the colours of an entity of n things over time: dim before when_ns (n,), from then on
    each in its own of `colours`, or all in one; begin_ns: when the first row stands, if earlier.

    One entity and one row for each change: what is pointed at is always the same thing.
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
    """The same on the timeline JOIN, from step 0 on: things that are never dim have when = 0.
    now: colour of what lights up at the cursor."""
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
    """(times, things, 3) colours."""
    lit = (when[None, :] <= times[:, None])[:, :, None]
    return np.where(lit, np.asarray(colours, np.uint8), np.asarray(dim, np.uint8))


def colour_columns(archetype: Any, rows: NDArray[np.uint8]) -> Any:
    """(times, things, 3) colours as columns to log."""
    times, things = rows.shape[:2]
    return archetype.columns(colors=rows.reshape(-1, 3)).partition([things] * times)


def _rows(when_ns: IntArray, begin_ns: int | None) -> IntArray:
    """The times at which something changes, thinned to what may be logged; the last one stays."""
    times = np.unique(when_ns)
    most = max(MOST_CELLS // max(len(when_ns), 1), 2)
    if len(times) > most:
        times = times[np.unique(np.linspace(0, len(times) - 1, most).round().astype(np.int64))]
    if begin_ns is not None and begin_ns < times[0]:
        times = np.concatenate([[begin_ns], times])
    return times
