"""Structure of a map for matching: branches, and corridors as seen from both ends.

A *dart* is a directed corridor (half-edge): dart 2k leads along edge k from source to target, dart
2k + 1 from target to source. Preparing a map is linear in its size and done once for all
comparisons.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import BoolArray, ComplexArray, FloatArray, IntArray
from ..passes import NO_BRANCH
from ..polyline import leaving_rad
from ..se2 import wrap
from ..topomap import TopoMap
from .branches import unit_headings


@dataclass(frozen=True, slots=True)
class StructureSettings:
    """When a map is rectilinear, and how unknown branches of edges are inferred."""

    rectilinear_share: float = 0.88
    """A map is rectilinear if at least this share of its branches lies near the directions of one
    grid; of uniformly distributed branches a third does."""
    rectilinear_rad: float = np.pi / 12
    """Largest deviation of a branch near a direction of the grid: 15°; the largest possible is
    three times as much."""
    inferred_rad: float = np.pi / 4
    """An edge with an unknown branch is assigned a free one within this angle of its path."""


STRUCTURE = StructureSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """A prepared map of n vertices with at most D branches each, and 2 m darts.

    heading: (n, D) branch headings [rad], NaN beyond a vertex's degree; unit: (n, D) the same as
    unit complex numbers, 0 beyond it; degree: (n,); explored: (n, D) whether a corridor was driven
    by that branch. start, end: (2 m,) vertices of each dart; out_branch, in_branch: (2 m,) branch
    of its start by which it leaves, and of its end by which it arrives; length, sigma: (2 m,) [m].
    Edges with an unknown branch that cannot be inferred from the path have no darts.

    grid_rad: direction of the grid in [0, pi/2) if the map is rectilinear, else None; slot: (n, D)
    quarter turn 0..3 of each branch on that grid, -1 beyond the degree; mask, explored_mask: (n,)
    bit s is set if a branch (a driven branch) lies in slot s; out_slot, in_slot: (2 m,) slots of
    out_branch and in_branch; slot_kind: (2 m,) invariant under quarter turns, as one number: the
    turn between leaving and arriving (times 256) and the slots at both ends.
    """

    heading: FloatArray
    unit: ComplexArray
    degree: IntArray
    explored: BoolArray
    start: IntArray
    end: IntArray
    out_branch: IntArray
    in_branch: IntArray
    length: FloatArray
    sigma: FloatArray
    grid_rad: float | None
    slot: IntArray
    mask: IntArray
    explored_mask: IntArray
    out_slot: IntArray
    in_slot: IntArray
    slot_kind: IntArray

    def __len__(self) -> int:
        """Number of vertices."""
        return len(self.degree)


def prepare(topomap: TopoMap) -> Structure:
    """The structure of a map. O(n D + m)."""
    heading = padded_branches(topomap)
    n, width = heading.shape
    degree = topomap.degree
    edge, ends, branches = _known_edges(topomap, heading)
    start, end = ends.reshape(-1), ends[:, ::-1].reshape(-1)
    out_branch, in_branch = branches.reshape(-1), branches[:, ::-1].reshape(-1)
    grid = grid_direction(topomap.branches.values)
    slot = np.full((n, width), -1, np.int64)
    if grid is not None:
        inside = np.arange(width) < degree[:, None]
        slot[inside] = np.rint(wrap(heading[inside] - grid) / (np.pi / 2)).astype(np.int64) % 4
    explored = np.zeros((n, width), np.bool_)
    explored[start, out_branch] = True
    bit = np.where(slot >= 0, 1 << np.maximum(slot, 0), 0)
    mask = np.bitwise_or.reduce(bit, axis=1)
    out_slot, in_slot = slot[start, out_branch], slot[end, in_branch]
    return Structure(
        heading=heading,
        unit=unit_headings(heading),
        degree=degree,
        explored=explored,
        start=start,
        end=end,
        out_branch=out_branch,
        in_branch=in_branch,
        length=np.repeat(topomap.length[edge], 2),
        sigma=np.repeat(topomap.length_sigma[edge], 2),
        grid_rad=grid,
        slot=slot,
        mask=mask,
        explored_mask=np.bitwise_or.reduce(np.where(explored, bit, 0), axis=1),
        out_slot=out_slot,
        in_slot=in_slot,
        slot_kind=_slot_kind(out_slot, in_slot, mask[start], mask[end]),
    )


def _slot_kind(
    out_slot: IntArray, in_slot: IntArray, mask_start: IntArray, mask_end: IntArray
) -> IntArray:
    """(2 m,) slots of the darts after turning them to leave by slot 0; see `Structure`."""
    out = np.maximum(out_slot, 0)
    at_start, at_end = (((m << 4 | m) >> out) & 15 for m in (mask_start, mask_end))
    turn = (in_slot - out_slot) % 4
    return np.asarray((turn * 16 + at_start) * 16 + at_end)


def padded_branches(topomap: TopoMap) -> FloatArray:
    """(n, D) headings [rad] of all vertices, NaN beyond their degree; D is at least 1."""
    rows = topomap.branches
    width = int(rows.counts.max(initial=1))
    headings = np.full((len(topomap), width), np.nan)
    headings[np.arange(width) < rows.counts[:, None]] = rows.values
    return headings


def grid_direction(heading_rad: FloatArray) -> float | None:
    """Direction [rad] in [0, pi/2) of the grid that the headings (k,) lie on, None if there is
    none.

    The argument of the mean fourth power of the headings as unit numbers, divided by 4.
    """
    if len(heading_rad) == 0:
        return None
    grid = float(np.angle(np.exp(4j * heading_rad).mean())) / 4 % (np.pi / 2)
    deviation = np.abs(wrap(4 * (heading_rad - grid))) / 4
    near = np.mean(deviation <= STRUCTURE.rectilinear_rad)
    return grid if near >= STRUCTURE.rectilinear_share else None


def _known_edges(topomap: TopoMap, heading: FloatArray) -> tuple[IntArray, IntArray, IntArray]:
    """Edges whose branches are known at both ends: indices (k,), ends (k, 2), branches (k, 2)."""
    ends = np.stack([topomap.source, topomap.target], axis=1)
    branches = np.stack([topomap.source_branch, topomap.target_branch], axis=1)
    if np.any(branches == NO_BRANCH):
        branches = _with_inferred(topomap, heading, ends, branches)
    known = np.flatnonzero((branches != NO_BRANCH).all(axis=1))
    return known, ends[known], branches[known]


def _with_inferred(
    topomap: TopoMap, heading: FloatArray, ends: IntArray, branches: IntArray
) -> IntArray:
    """`branches` with unknown ones set to the free branch nearest to the direction of the edge's
    path."""
    inferred = branches.copy()
    known = branches != NO_BRANCH
    used = set(zip(ends[known].tolist(), branches[known].tolist(), strict=True))
    for k, side in np.argwhere(~known).tolist():
        vertex = int(ends[k, side])
        deviation = np.abs(wrap(heading[vertex] - leaving_rad(topomap.paths[k], side)))
        candidates = [
            int(i) for i in np.argsort(deviation) if deviation[i] <= STRUCTURE.inferred_rad
        ]
        free = [i for i in candidates if (vertex, i) not in used]
        if free:
            inferred[k, side] = free[0]
            used.add((vertex, free[0]))
    return inferred
