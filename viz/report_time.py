"""The time line of a report: when each run was recorded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..topology.topomap import TopoMap
from ..topology.wording import legible, utc
from .pages import minutes
from .palette import Colour

MOST_TICKS = 3
"""At most so many times stand above the time line, also on a telephone."""


@dataclass(frozen=True, slots=True)
class TimeLine:
    """bars: of each run its name, begin and length in per cent of the line, its colour and its
    times in words; ticks: their places in per cent, and their texts."""

    bars: Sequence[tuple[str, float, float, Colour, str]]
    ticks: Sequence[tuple[float, str]]


def time_line(
    runs: Sequence[str], maps: Mapping[str, TopoMap], colours: Mapping[str, Colour]
) -> TimeLine:
    """When runs were recorded, those whose maps have times, in the given order.

    Gaps between recordings are shortened to the mean time recorded between two of them, so that
    years without any take no more room than the runs.
    """
    times = {run: maps[run].observation_time_ns for run in runs if run in maps}
    spans = {run: (int(own.min()), int(own.max())) for run, own in times.items() if len(own)}
    if not spans:
        return TimeLine((), ())
    whole: list[list[int]] = []
    for begin, end in sorted(spans.values()):
        if whole and begin <= whole[-1][1]:
            whole[-1][1] = max(end, whole[-1][1])
        else:
            whole.append([begin, max(end, begin + 1)])
    knots = np.array(whole).ravel()
    step = np.diff(knots, prepend=knots[0]) / 1e9
    step[2::2] = np.minimum(step[2::2], step[1::2].mean())
    places = 100 * np.cumsum(step) / step.sum()

    def place(time_ns: int) -> float:
        return round(float(np.interp(time_ns - knots[0], knots - knots[0], places)), 2)

    bars = [
        (
            *(run, place(begin), round(place(end) - place(begin), 2), colours[run]),
            legible(f"{run}: {utc(begin)} UTC, {minutes(end - begin)}"),
        )
        for run, (begin, end) in spans.items()
    ]
    ticks: list[tuple[float, str]] = []
    for at, begin in zip(places[::2].tolist(), knots[::2].tolist(), strict=True):
        if not ticks or at - ticks[-1][0] >= 100 / MOST_TICKS:
            ticks.append((round(at, 2), utc(begin, "%Y-%m-%d\n%H:%M")))
    return TimeLine(bars, ticks)
