"""The components of a merge, each with its place on one sheet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..merge.result import Component, MergeResult
from ..topology.arrays import FloatArray, IntArray
from . import palette
from .sheet import ASPECT, MIN_SIDE_M, Cell, arrange, corners_of, sheet_margin_m, upright_rad

MOST_LEGENDS = 6
"""Up to this many components of several runs get a legend beside them."""

MOST_NAMES = 24
"""Longest legend."""

LEGEND_LINES = 26
"""A sheet as high as its view has room for this many lines of text."""

FEW, FLEET_MARGIN = 12, 0.22
"""Up to so many maps have margins by the largest of them, more by the usual one."""

TITLE_SHARE = 0.02
"""Height of a title over the width of a view."""

PAPER_MARGIN, ALONE_MARGIN = 0.18, 0.04
"""Margin of a cell on paper, in extents of the usual map: a title has room in it; of a map that is
the only one, which has none."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """One component and its place on the sheet; vertices, edges: its rows of the fused map;
    junctions: how many of its vertices are no turning points of runs."""

    component: Component
    cell: Cell
    vertices: IntArray
    edges: IntArray
    legend_m: float
    junctions: int

    @property
    def name(self) -> str:
        """Its entity's name."""
        return f"component_{self.component.id}"

    @property
    def titles(self) -> tuple[str, ...]:
        """What stands above it, from the longest to the shortest."""
        runs = list(self.component.poses)
        if len(runs) == 1:
            return (runs[0],)
        short = f"{self.component.id}: {len(runs)} runs"
        junctions = f"{self.junctions} junctions"
        return (f"component {short} merged, {junctions}", f"component {short}", short)


def lay_out(result: MergeResult, *, for_paper: bool = False) -> list[Part]:
    """All components on one sheet, those of many runs first.

    for_paper: without room for legends, and with margins that go by the usual map, not the largest.
    """
    fused = result.fused
    order = sorted(result.components, key=lambda c: (-len(c.poses), c.id))
    of_edge = fused.component[fused.source] if len(fused.source) else np.zeros(0, np.int64)
    vertices, edges = (rows_of(own, [c.id for c in order]) for own in (fused.component, of_edge))
    paths = [[fused.paths[i] for i in rows.tolist()] for rows in edges]
    points = [
        np.concatenate([fused.xy[rows].reshape(-1, 2), *lines])
        for rows, lines in zip(vertices, paths, strict=True)
    ]
    turns = [upright_rad(p) for p in paths]
    usual_m = _usual_extent(points)
    margin = _fleet_margin_m(points) if len(order) > FEW else sheet_margin_m(points)
    room = [0.0] * len(order)
    if for_paper:
        share = PAPER_MARGIN if len(order) > 1 else ALONE_MARGIN
        cells = arrange(points, turns, share * usual_m)
    else:
        room = _legends(order, points)
        cells = arrange(points, turns, margin, room)
        if not _legends_fit(order, cells, room):
            room = [0.0] * len(order)
            cells = arrange(points, turns, margin)
    junction = ~fused.is_turned
    places = [int(junction[rows].sum()) for rows in vertices]
    return [Part(*row) for row in zip(order, cells, vertices, edges, room, places, strict=True)]


def rows_of(owner: IntArray, wanted: list[int]) -> list[IntArray]:
    """The rows of each of the wanted owners, ascending. O(rows log rows)."""
    order = np.argsort(owner, kind="stable")
    begin, end = (np.searchsorted(owner[order], wanted, side) for side in ("left", "right"))
    return [order[i:j] for i, j in zip(begin.tolist(), end.tolist(), strict=True)]


def _fleet_margin_m(points: list[FloatArray]) -> float:
    """By the usual map, and so that a title has room above a map where the sheet fills a view."""
    usual_m = FLEET_MARGIN * _usual_extent(points)
    area = sum(float(np.prod(np.ptp(p, axis=0) + 2 * usual_m)) for p in points if len(p))
    return max(usual_m, TITLE_SHARE * float(np.sqrt(ASPECT * area)))


def _legends_fit(order: list[Component], cells: list[Cell], room: list[float]) -> bool:
    """Is every legend as high as its cell at most?"""
    if not any(room):
        return True
    step_m = legend_step_m(cells)
    return all(
        step_m * len(c.poses) <= cell.high[1] - cell.low[1]
        for c, cell, legend in zip(order, cells, room, strict=True)
        if legend > 0
    )


def legend_step_m(cells: list[Cell]) -> float:
    """The distance of two lines of a legend, on a sheet that fills its view [m]."""
    width, height = np.ptp(corners_of(cells), axis=0)
    return float(max(width / ASPECT, height)) / LEGEND_LINES


def _usual_extent(points: list[FloatArray]) -> float:
    extents = [float(np.ptp(p, axis=0).max()) for p in points if len(p)]
    return max(float(np.median(extents)) if extents else 0.0, MIN_SIDE_M)


def _legends(order: list[Component], points: list[FloatArray]) -> list[float]:
    """Room for each component's legend [m]; none where there are too many."""
    several = [2 <= len(c.poses) <= MOST_NAMES for c in order]
    if sum(several) > MOST_LEGENDS:
        return [0.0] * len(order)
    area = sum(float(np.prod(np.ptp(p, axis=0))) for p in points if len(p))
    sheet_m = 1.3 * np.sqrt(ASPECT * area)
    return [
        sheet_m * _legend_share(c) if shown else 0.0
        for c, shown in zip(order, several, strict=True)
    ]


def _legend_share(component: Component) -> float:
    """A legend's width over the sheet's: about as much as the longest name takes in a view."""
    return 0.04 + 0.008 * min(max(map(len, component.poses)), 40)


def ranks(result: MergeResult) -> dict[str, int]:
    """The rank of each run among those of its component; colours go by it."""
    return {run: k for c in result.components for k, run in enumerate(sorted(c.poses))}


def colours_of(result: MergeResult) -> dict[str, palette.Colour]:
    """The viewer's colour of each run; runs that were merged with none are grey."""
    rank = ranks(result)
    return {
        run: palette.of_rank(rank[run]) if len(c.poses) > 1 else palette.SINGLE
        for c in result.components
        for run in c.poses
    }
