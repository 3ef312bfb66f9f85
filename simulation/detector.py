"""The simulated junction detector: the messages sent while the robot passes a junction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..topology.arrays import FloatArray, IntArray
from ..topology.ragged import Ragged
from ..topology.se2 import apply, inverse, wrap
from .chance import Chance, quantised
from .motion import Drive
from .settings import Faults
from .world import BRANCH_REACH_M, CLEAR_M, World

REACH_M = 1.0
"""A junction is detected from this distance before to this distance after it, along the path."""

NO_VERTEX = -1
"""Vertex of a phantom, or of no pass."""

LEAST_GAP_RAD = 0.7
"""Least angle between an invented branch and the others."""


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """Messages and passes; times in seconds of the detector's clock (true time + lag).

    Messages: time_s (k,); centre (k, 2) [m] and branches, k rows [rad], in the robot's frame.
    Passes by time: start_s, end_s (p,); vertex (p,), NO_VERTEX for phantoms; messages (p,): their
    number, 0 for a missed pass; fault (p,): "", "missed", "wrong pass", "wrong vertex" or
    "phantom".
    """

    time_s: FloatArray
    centre: FloatArray
    branches: Ragged
    start_s: FloatArray
    end_s: FloatArray
    vertex: IntArray
    messages: IntArray
    fault: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Pass:
    """One pass without message noise, in the world's frame."""

    start_s: float
    end_s: float
    vertex: int
    centre: tuple[float, float]
    branches: tuple[float, ...]
    fault: str


def sightings(
    world: World, drive: Drive, closed: set[int], faults: Faults, *, rate_hz: float, chance: Chance
) -> Sightings:
    """The detector's messages during a drive, and the truth about its passes."""
    passes = _visits(world, drive, closed, faults, chance) + _phantoms(drive, faults, chance)
    passes.sort(key=lambda p: p.start_s)
    time, owner = _message_times(passes, float(drive.time_s[-1]), rate_hz, faults, chance)
    pose = drive.at(time)
    half = np.sqrt(0.5) * faults.centre_m
    centre = np.array([p.centre for p in passes])
    centre = centre + chance.normal(half, centre.size).reshape(-1, 2)
    seen = apply(inverse(pose), centre[owner]) + chance.normal(half, 2 * len(time)).reshape(-1, 2)
    return Sightings(
        time_s=time + faults.lag_s,
        centre=quantised(seen, 16),
        branches=_branch_rows(passes, owner, pose[:, 2], faults, chance),
        start_s=np.array([p.start_s for p in passes]) + faults.lag_s,
        end_s=np.array([p.end_s for p in passes]) + faults.lag_s,
        vertex=np.array([p.vertex for p in passes], np.int64),
        messages=np.bincount(owner, minlength=len(passes)),
        fault=tuple(p.fault for p in passes),
    )


def _visits(
    world: World, drive: Drive, closed: set[int], faults: Faults, chance: Chance
) -> list[_Pass]:
    """A pass for every visit of a vertex; it ends before half-way to the next visit."""
    way = drive.visit_way_m
    reach = np.minimum(REACH_M, 0.45 * np.concatenate([[np.inf], np.diff(way), [np.inf]]))
    start, end = drive.first_at(way - reach[:-1]), drive.last_at(way + reach[1:])
    by_vertex = {}  # the branches that can be seen in this run, and their fault
    for v in sorted(set(drive.visit_vertex.tolist())):
        branches = tuple(h for e, _, h in world.ends(v) if e not in closed)
        by_vertex[v] = branches, ""
        if chance.one_happens(faults.wrong_vertex_rate):
            by_vertex[v] = _altered(branches, chance), "wrong vertex"
    missed = chance.happens(faults.missed_pass_rate, len(way))
    wrong = chance.happens(faults.wrong_pass_rate, len(way))
    passes = []
    for i, v in enumerate(drive.visit_vertex.tolist()):
        branches, fault = by_vertex[v]
        if wrong[i]:
            branches, fault = _altered(branches, chance), "wrong pass"
        if missed[i] or not branches:
            branches, fault = (), "missed"
        x, y = world.xy[v].tolist()
        passes.append(_Pass(float(start[i]), float(end[i]), v, (x, y), branches, fault))
    return passes


def _altered(branches: tuple[float, ...], chance: Chance) -> tuple[float, ...]:
    """The branches with one less (probability 0.6) or one more; a single branch only gains one."""
    ordered = np.sort(np.array(branches))
    gaps = np.diff(np.append(ordered, ordered[:1] + 2 * np.pi))
    room: FloatArray = np.maximum(gaps - 2 * LEAST_GAP_RAD, 0.0)
    if len(branches) > 1 and (chance.one_happens(0.6) or room.sum() == 0):
        gone = chance.index(len(branches))
        return branches[:gone] + branches[gone + 1 :]
    if room.sum() == 0:
        return branches
    at = chance.weighted_index(quantised(room, 30))
    new = ordered[at] + LEAST_GAP_RAD + chance.one_uniform() * room[at]
    return (*branches, float(np.round(wrap(new), 9)))


def _phantoms(drive: Drive, faults: Faults, chance: Chance) -> list[_Pass]:
    """Invented junctions in corridors, with the corridor's two directions and up to two more
    branches."""
    length = drive.leg_to_m - drive.leg_from_m
    hit = chance.happens(faults.phantom_rate, len(length)) & (length > 4.5)
    clear = REACH_M + BRANCH_REACH_M
    passes = []
    for i in np.flatnonzero(hit).tolist():
        way = chance.one_uniform(drive.leg_from_m[i] + clear, drive.leg_to_m[i] - CLEAR_M)
        span = np.array([way, way + chance.one_uniform(0.3, 0.9)])
        start, end = drive.first_at(span[:1])[0], drive.last_at(span[1:])[0]
        x, y, theta = drive.at(np.array([0.5 * (start + end)]))[0].tolist()
        branches: tuple[float, ...] = (float(wrap(theta)), float(wrap(theta + np.pi)))
        for _ in range(chance.index(3)):
            sideways = wrap(theta + np.pi / 2 * (1 if len(branches) == 2 else -1))
            branches = (*branches, float(wrap(sideways + chance.around(0.6, 1)[0])))
        passes.append(_Pass(float(start), float(end), NO_VERTEX, (x, y), branches, "phantom"))
    return passes


def _message_times(
    passes: list[_Pass], end_s: float, rate_hz: float, faults: Faults, chance: Chance
) -> tuple[FloatArray, IntArray]:
    """(k,) ascending message times within passes that are seen, and (k,) the pass of each."""
    count = int(end_s * rate_hz)
    ticks = np.arange(count) + 0.5 + chance.around(0.15, count)
    time = quantised(ticks[~chance.happens(faults.lost_message_rate, count)] / rate_hz, 20)
    start = np.array([p.start_s for p in passes])
    end = np.array([p.end_s if p.branches else -1.0 for p in passes])
    owner = np.searchsorted(start, time, side="right") - 1
    seen = (owner >= 0) & (time <= end[owner])
    return time[seen], owner[seen]


def _branch_rows(
    passes: list[_Pass], owner: IntArray, theta: FloatArray, faults: Faults, chance: Chance
) -> Ragged:
    """Each message's branches in the robot's frame, with noise, in random order.

    All rows are computed at once; only messages with a wrong number of branches are made one by
    one.
    """
    half = np.radians(np.sqrt(0.5) * faults.branch_deg)
    by_pass = Ragged.from_rows([p.branches for p in passes])
    skewed = Ragged(by_pass.offsets, by_pass.values + chance.normal(half, len(by_pass.values)))
    rows = skewed.take(owner)
    wrong = chance.happens(faults.wrong_message_rate, len(owner))
    if wrong.any():
        listed = [rows[i] for i in range(len(rows))]
        for i in np.flatnonzero(wrong).tolist():
            listed[i] = np.array(_altered(tuple(rows[i].tolist()), chance))
        rows = Ragged.from_rows(listed)
    flat = rows.values + chance.normal(half, len(rows.values)) - theta[rows.owner]
    order = np.lexsort((chance.uniform(0.0, 1.0, len(flat)), rows.owner))
    return Ragged(rows.offsets, quantised(wrap(flat[order]), 16))
