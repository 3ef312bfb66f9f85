"""A robot's exploration: which corridor it takes next."""

from __future__ import annotations

import heapq
from collections.abc import Set
from dataclasses import dataclass

import numpy as np
from scipy.cluster.hierarchy import DisjointSet

from ..topology.se2 import wrap
from .chance import Chance
from .settings import Faults, WalkSettings
from .world import CLEAR_M, World


@dataclass(frozen=True, slots=True)
class Leg:
    """A corridor driven from `source` to `target`; with turn_back_m, driven this far and back to
    `source`."""

    edge: int
    source: int
    target: int
    turn_back_m: float | None = None


def explore(
    world: World,
    region: set[int],
    settings: WalkSettings,
    faults: Faults,
    chance: Chance,
    *,
    shut: Set[int] = frozenset(),
) -> tuple[list[Leg], set[int]]:
    """The legs of one run inside a connected region, and the corridors closed during it: those
    `shut`, and some at random.

    Where the robot is it takes an undriven corridor, preferably ahead; else it drives the shortest
    known path to the nearest place that has one.
    """
    inside = [
        e
        for e, (u, v) in enumerate(zip(world.source.tolist(), world.target.tolist(), strict=True))
        if u in region and v in region and e not in shut
    ]
    closed = _closed(world, inside, faults.closed_share, chance) | shut
    open_edges = set(inside) - closed
    starts = sorted({int(end[e]) for e in open_edges for end in (world.source, world.target)})
    if not starts:
        return [], closed
    walker = _Walker(world, open_edges, starts[chance.index(len(starts))])
    while len(walker.driven) < settings.coverage * len(open_edges):
        if len(walker.known) > 6 and chance.one_happens(settings.detour_rate):
            walker.drive_to(_some_known(walker, chance))
        elif not walker.try_here(chance) and not walker.drive_to(
            {vertex for vertex in walker.known if walker.untried(vertex)}
        ):
            break
    stop = walker.way_m * (1 + settings.revisit_share)
    while walker.way_m < stop and len(walker.known) > 1:
        walker.drive_to(_some_known(walker, chance))
    return _with_turns_back(world, walker.legs, faults.turn_back_rate, chance), closed


def _closed(world: World, inside: list[int], share: float, chance: Chance) -> set[int]:
    """Corridors to close: a random share, without those that a spanning forest of the rest needs.

    Dead ends may be closed as well: loops are opened, but the region stays connected.
    """
    if share == 0:
        return set()
    drawn = {e for e, hit in zip(inside, chance.happens(share, len(inside)), strict=True) if hit}
    degree = world.branches.counts
    joined, closed = DisjointSet(range(len(world))), set()
    for e in sorted(inside, key=lambda e: (e in drawn, e)):
        u, v = int(world.source[e]), int(world.target[e])
        if e in drawn and (joined.connected(u, v) or min(degree[u], degree[v]) == 1):
            closed.add(e)
        else:
            joined.merge(u, v)
    return closed


def _some_known(walker: _Walker, chance: Chance) -> set[int]:
    options = sorted(walker.known - {walker.here})
    return {options[chance.index(len(options))]}


def _with_turns_back(world: World, legs: list[Leg], rate: float, chance: Chance) -> list[Leg]:
    """The legs, with some of them preceded by an aborted attempt."""
    out = []
    turns, parts = chance.happens(rate, len(legs)), chance.uniform(0.0, 1.0, len(legs))
    for leg, turn, part in zip(legs, turns.tolist(), parts.tolist(), strict=True):
        length = float(world.length[leg.edge])
        if turn and length > 5.0:
            least = 2.4
            way = float(np.round(least + part * (length - least - CLEAR_M), 3))
            out.append(Leg(leg.edge, leg.source, leg.target, way))
        out.append(leg)
    return out


class _Walker:
    """The state of an exploring robot: its position, legs, known vertices and driven corridors."""

    def __init__(self, world: World, edges: set[int], start: int) -> None:
        self.world, self.edges, self.here = world, edges, start
        self.legs: list[Leg] = []
        self.known, self.driven = {start}, set[int]()
        self.way_m = 0.0

    def go(self, edge: int, target: int) -> None:
        self.legs.append(Leg(edge, self.here, target))
        self.driven.add(edge)
        self.known.add(target)
        self.here = target
        self.way_m += float(self.world.length[edge])

    def untried(self, vertex: int) -> list[tuple[int, int, float]]:
        ends = self.world.ends(vertex)
        return [end for end in ends if end[0] in self.edges and end[0] not in self.driven]

    def try_here(self, chance: Chance) -> bool:
        """Take an undriven corridor at the current vertex; False if there is none."""
        options = self.untried(self.here)
        if not options:
            return False
        came_by = self.legs[-1].edge if self.legs else None
        back = [h for e, _, h in self.world.ends(self.here) if e == came_by]
        turns = np.array([wrap(h - (back[0] + np.pi)) if back else 0.0 for _, _, h in options])
        edge, target, _ = options[chance.weighted_index(1.3 + np.cos(np.round(turns, 6)))]
        self.go(edge, target)
        return True

    def drive_to(self, goals: set[int]) -> bool:
        """Drive to the nearest goal but here by Dijkstra over the corridors driven so far; False if
        none is reached."""
        reached = {self.here: 0.0}
        heap: list[tuple[float, int, tuple[tuple[int, int], ...]]] = [(0.0, self.here, ())]
        while heap:
            way, vertex, steps = heapq.heappop(heap)
            if vertex in goals and steps:
                for edge, target in steps:
                    self.go(edge, target)
                return True
            for edge, other, _ in self.world.ends(vertex):
                new = way + float(self.world.length[edge])
                if edge in self.driven and new < reached.get(other, np.inf):
                    reached[other] = new
                    heapq.heappush(heap, (new, other, (*steps, (edge, other))))
        return False
