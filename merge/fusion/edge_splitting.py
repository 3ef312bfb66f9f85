"""Splitting corridors at junctions that their own run missed.

A run that misses a junction maps one long corridor through it. Where another run knows the
junction, the long corridor is replaced by its parts, which are recognised by the branches at both
ends or by the path.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ...topology.arrays import FloatArray
from ...topology.passes import NO_BRANCH
from ...topology.polyline import way_of
from ...topology.se2 import wrap
from .edges import CORRIDOR, SHORTEST_M, Corridor, fuse_corridors, oriented, same_corridor


@dataclass(frozen=True, slots=True)
class PassageSettings:
    """When a corridor passes through a junction that its run did not see."""

    pass_m: float = 0.8
    """Largest distance of the junction from the corridor's path."""
    pass_end_m: float = 1.2
    """Least distance of the junction from both ends, along the path."""
    pass_rad: float = 0.6
    """Largest angle between the path and a branch of the junction, in both directions."""
    junction_m: float = 0.3
    """Standard deviation of a corridor's length against the sum of its parts, per missed
    junction."""
    deepest: int = 4
    """Limit on junctions missed in one corridor, where its branches identify the parts."""
    rounds: int = 5
    """Limit on rounds: the parts of one corridor may be split in the next."""


PASSAGE = PassageSettings()

_STEP_M = 0.25
"""Spacing of the points at which a path is compared with places."""

_STOP_M = 0.1
"""Standard deviation of the position of a split along the path [m]."""


def split_at_places(
    corridors: list[Corridor], place_xy: FloatArray, branches: list[FloatArray]
) -> list[Corridor]:
    """Replace corridors through known places by the corridors between those.

    place_xy: (p, 2) [m]; branches: headings of every place [rad], in the frame of the corridors.
    The long corridor becomes a member of each part that is known; a part that no run drove on its
    own becomes a new corridor. A corridor stays whole if none of its parts is known, or if a place
    has no branches along its path.
    """
    world = _World(cKDTree(place_xy) if len(place_xy) else None, place_xy, branches)
    for _ in range(PASSAGE.rounds):
        replaced = _replaced_once(corridors, world)
        if len(replaced) == len(corridors) and all(
            x is y for x, y in zip(replaced, corridors, strict=True)
        ):
            break
        corridors = fuse_corridors(replaced)
    return corridors


@dataclass(frozen=True, slots=True, eq=False)
class _World:
    """The places at which corridors may be split; known: the parts of corridors computed so far,
    since most stay the same from round to round."""

    tree: Any
    xy: FloatArray
    branches: list[FloatArray]
    known: dict[Corridor, list[Corridor]] = field(default_factory=dict)

    def parts(self, c: Corridor) -> list[Corridor]:
        """`_parts`, cached."""
        if c not in self.known:
            self.known[c] = _parts(c, self)
        return self.known[c]


def _replaced_once(corridors: list[Corridor], world: _World) -> list[Corridor]:
    """One round, shortest corridors first; a corridor that became a part of another waits for the
    next round."""
    index, leaving = _by_ends(corridors), _by_branch(corridors)
    gone: set[int] = set()
    busy: dict[int, list[Corridor]] = {}
    fresh: list[Corridor] = []
    for number in sorted(range(len(corridors)), key=lambda k: (corridors[k].length, k)):
        if number in busy:
            continue
        c = corridors[number]
        chain = _chain(number, corridors, leaving)
        parts = [c] * len(chain) if chain else world.parts(c)
        known = (_known_part(p, number, corridors, index) for p in parts)
        found = list(chain) if chain else list(known)
        if len(parts) < 2 or all(f is None for f in found) or gone & {*found}:
            continue
        gone.add(number)
        for part, k in zip(parts, found, strict=True):
            if k is None:
                fresh.append(oriented(part))
            else:
                busy.setdefault(k, []).append(part)
    kept = [_with_extra(c, busy.get(k, [])) for k, c in enumerate(corridors) if k not in gone]
    return [*kept, *fresh]


def _by_ends(corridors: list[Corridor]) -> dict[tuple[int, int], list[int]]:
    index: dict[tuple[int, int], list[int]] = {}
    for k, c in enumerate(corridors):
        index.setdefault((c.u, c.v), []).append(k)
    return index


@dataclass(frozen=True, slots=True)
class _Way:
    """A corridor as it leaves a place: its index, and the place and branch at its other end."""

    number: int
    place: int
    branch: int


def _by_branch(corridors: list[Corridor]) -> dict[int, list[tuple[int, _Way]]]:
    """For every place its corridors: (branch, way)."""
    out: dict[int, list[tuple[int, _Way]]] = {}
    for k, c in enumerate(corridors):
        out.setdefault(c.u, []).append((c.branch_u, _Way(k, c.v, c.branch_v)))
        out.setdefault(c.v, []).append((c.branch_v, _Way(k, c.u, c.branch_u)))
    return out


def _chain(
    number: int, corridors: list[Corridor], leaving: dict[int, list[tuple[int, _Way]]]
) -> tuple[int, ...]:
    """Known corridors that together are this one: same first and last branch, same length.

    Only one corridor leaves by a branch, so that a shorter one by the same branch ends at a
    junction on the way. Of several chains the one nearest in length; () if there is none.
    """
    c = corridors[number]
    if NO_BRANCH in {c.branch_u, c.branch_v} or c.u == c.v:
        return ()
    best: tuple[float, tuple[int, ...]] = (np.inf, ())
    for chain in _chains(c, number, corridors, leaving):
        parts = [corridors[k] for k in chain]
        missed = (len(parts) - 1) * PASSAGE.junction_m**2
        sigma = float(np.sqrt(sum(p.sigma**2 for p in parts) + c.sigma**2 + missed))
        off = abs(sum(p.length for p in parts) - c.length)
        if off <= CORRIDOR.allowed_m(c.length, sigma):
            best = min(best, (off, chain))
    return best[1]


def _chains(
    c: Corridor, number: int, corridors: list[Corridor], leaving: dict[int, list[tuple[int, _Way]]]
) -> Iterator[tuple[int, ...]]:
    """All chains of corridors from one end of a corridor to the other, by its own first and last
    branch."""
    longest = 1.2 * c.length + 1.0
    stack: list[tuple[int, int | None, float, tuple[int, ...]]] = [(c.u, None, 0.0, ())]
    while stack:
        place, arrived, way, chain = stack.pop()
        for branch, step in leaving[place]:
            total = way + corridors[step.number].length
            onwards = branch == c.branch_u if arrived is None else branch != arrived
            if not onwards or step.number == number or step.number in chain or total > longest:
                continue
            longer = (*chain, step.number)
            if (step.place, step.branch) == (c.v, c.branch_v):
                if len(longer) > 1:
                    yield longer
            elif len(longer) <= PASSAGE.deepest:
                stack.append((step.place, step.branch, total, longer))


def _with_extra(c: Corridor, parts: list[Corridor]) -> Corridor:
    if not parts:
        return c
    members = tuple(sorted({*c.members, *(m for p in parts for m in p.members)}))
    return replace(c, traversals=c.traversals + sum(p.traversals for p in parts), members=members)


def _known_part(
    part: Corridor, number: int, corridors: list[Corridor], index: dict[tuple[int, int], list[int]]
) -> int | None:
    """The existing corridor between the ends of a part by the same branches, None if there is
    none."""
    p = oriented(part)
    for k in index.get((p.u, p.v), []):
        if k != number and same_corridor([corridors[k]], p):
            return k
    return None


class _Stop(NamedTuple):
    """Where a corridor is split: distance along its path [m], place, the branches by which the path
    enters and leaves it, and the row of the path's point."""

    way: float
    place: int
    back: int
    on: int
    row: int


def _parts(c: Corridor, world: _World) -> list[Corridor]:
    """The corridor split at the places on its path; itself alone if there are none."""
    way = way_of(c.path)
    if way[-1] < 2 * PASSAGE.pass_end_m:
        return [c]
    fine = np.linspace(0.0, way[-1], max(2, int(np.ceil(way[-1] / _STEP_M)) + 1))
    points = np.column_stack([np.interp(fine, way, c.path[:, k]) for k in (0, 1)])
    near = {k for hits in world.tree.query_ball_point(points, PASSAGE.pass_m) for k in hits}
    stops = []
    for place in sorted(near - {c.u, c.v}):
        at = int(np.argmin(np.hypot(*(points - world.xy[place]).T)))
        if PASSAGE.pass_end_m <= fine[at] <= way[-1] - PASSAGE.pass_end_m:
            back, on = _along(points, at, world.branches[place])
            if back is not None and on is not None and back != on:
                stops.append(_Stop(float(fine[at]), place, back, on, at))
    return _split(c, sorted(stops), points, float(way[-1])) if stops else [c]


def _along(points: FloatArray, at: int, headings: FloatArray) -> tuple[int | None, int | None]:
    """The branches by which a path through a place enters and leaves it, None without a fitting
    one."""
    if len(headings) == 0:
        return None, None
    low, high = max(at - 4, 0), min(at + 4, len(points) - 1)
    out = []
    for other in (low, high):
        step = points[other] - points[at]
        off = np.abs(wrap(headings - np.arctan2(step[1], step[0])))
        best = int(off.argmin())
        out.append(best if off[best] <= PASSAGE.pass_rad else None)
    return out[0], out[1]


def _split(c: Corridor, inner: list[_Stop], points: FloatArray, drawn_m: float) -> list[Corridor]:
    """The corridor split at these stops; lengths are in proportion to those on its path.

    points: (k, 2) of the path, which is drawn_m long.
    """
    stops = [
        _Stop(0.0, c.u, NO_BRANCH, c.branch_u, 0),
        *inner,
        _Stop(drawn_m, c.v, c.branch_v, NO_BRANCH, len(points) - 1),
    ]
    scale = c.length / drawn_m
    parts = []
    for s, t in pairwise(stops):
        share = (t.way - s.way) / drawn_m
        path = points[s.row : t.row + 1] if t.row > s.row else points[[s.row, t.row]]
        parts.append(
            replace(
                c,
                u=s.place,
                v=t.place,
                branch_u=s.on,
                branch_v=t.back,
                length=max((t.way - s.way) * scale, SHORTEST_M),
                sigma=float(np.hypot(c.sigma * np.sqrt(share), _STOP_M)),
                way=float(np.hypot(c.way * np.sqrt(share), _STOP_M)),
                path=path.copy(),
            )
        )
    return parts
