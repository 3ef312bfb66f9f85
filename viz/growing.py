"""Things that light up one by one as time goes on, and stay selectable all along."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import palette
from .palette import Colours
from .recording import PathParts, Recording

MOST_CELLS = 400_000
"""Colours logged for one entity at most, of 4 bytes each: where a thing for every time would take
more, several light up together."""


def light_up(
    recording: Recording,
    path: PathParts,
    archetype: Any,
    when_ns: NDArray[np.int64],
    colours: Colours,
    *,
    begin_ns: int | None,
    dim: tuple[int, int, int] = palette.UNLIT,
) -> None:
    """Log the colours of an entity of n things over time: dim before when_ns (n,), its own colour
    from then on; begin_ns: when the first row stands, if that is earlier.

    One entity and one row for each change: what is pointed at is always the same thing.
    """
    times = _rows(when_ns, begin_ns)
    lit = when_ns[None, :] <= times[:, None]
    rows = np.where(lit[:, :, None], colours[None], np.array(dim, np.uint8)[None, None])
    flat = rows.reshape(-1, 3).astype(np.uint8)
    columns = archetype.columns(colors=flat).partition([len(when_ns)] * len(times))
    recording.over_time(path, times, columns)


def _rows(when_ns: NDArray[np.int64], begin_ns: int | None) -> NDArray[np.int64]:
    """The times at which something changes, thinned to what may be logged; the last one stays."""
    times = np.unique(when_ns)
    most = max(MOST_CELLS // max(len(when_ns), 1), 2)
    if len(times) > most:
        times = times[np.unique(np.linspace(0, len(times) - 1, most).round().astype(np.int64))]
    if begin_ns is not None and begin_ns < times[0]:
        times = np.concatenate([[begin_ns], times])
    return times
