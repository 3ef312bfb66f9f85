"""A merge to be shown: its components in order and on a sheet, and colours of runs."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from ..merge.result import Component, MergeResult
from ..topology.arrays import FloatArray, IntArray
from . import palette
from .sheet import Cell, arrange, upright_rad


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A component and its place on the sheet. vertices, edges: its rows in the fused
    map."""

    component: Component
    cell: Cell
    vertices: IntArray
    edges: IntArray

    @property
    def name(self) -> str:
        """Name of its entity."""
        return f"component_{self.component.id}"

    @property
    def title(self) -> str:
        """Its site and how many runs it has, or its only run."""
        runs = list(self.component.poses)
        return runs[0] if len(runs) == 1 else f"{self.component.name}: {len(runs)} runs"


def in_order(result: MergeResult) -> list[Component]:
    """The components by name, those of several runs first."""
    return sorted(result.components, key=lambda c: (len(c.poses) == 1, c.name, c.id))


def lay_out(
    result: MergeResult, to_hold: Mapping[int, FloatArray], shown: Collection[int] | None = None
) -> list[Part]:
    """Components on one sheet, `in_order`: all, or those with the ids `shown`. to_hold: points
    (k, 2) that the cell of a component, by its id, is to hold beside its map [m]."""
    fused = result.fused
    order = [c for c in in_order(result) if shown is None or c.id in shown]
    of_edge = fused.component[fused.source] if len(fused.source) else np.zeros(0, np.int64)
    vertices, edges = (rows_of(own, [c.id for c in order]) for own in (fused.component, of_edge))
    paths = [[fused.paths[i] for i in rows.tolist()] for rows in edges]
    points = [
        np.concatenate([fused.xy[rows].reshape(-1, 2), *lines, to_hold.get(c.id, np.zeros((0, 2)))])
        for c, rows, lines in zip(order, vertices, paths, strict=True)
    ]
    turns = [upright_rad(p) for p in paths]
    cells = arrange(points, turns)
    return [Part(*row) for row in zip(order, cells, vertices, edges, strict=True)]


def rows_of(owner: IntArray, wanted: list[int]) -> list[IntArray]:
    """For each wanted owner the rows that it owns, ascending. O(rows log rows)."""
    order = np.argsort(owner, kind="stable")
    begin, end = (np.searchsorted(owner[order], wanted, side) for side in ("left", "right"))
    return [order[i:j] for i, j in zip(begin.tolist(), end.tolist(), strict=True)]


def colours_of(
    result: MergeResult, theme: palette.Theme = palette.DARK
) -> dict[str, palette.Colour]:
    """The colour of each run by its rank in its component, the viewer's by default; runs that
    merged with none are grey."""
    return {
        run: theme.run(rank) if len(c.poses) > 1 else theme["single"]
        for c in result.components
        for rank, run in enumerate(sorted(c.poses))
    }


def runs_in_order(result: MergeResult) -> list[str]:
    """All runs by component, `in_order`."""
    return [run for component in in_order(result) for run in sorted(component.poses)]
