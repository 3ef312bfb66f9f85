"""The quality of a run's odometry as states over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..topology.arrays import IntArray
from ..topology.odometry import Odometry
from ..topology.topomap import TopoMap

GAP_STEPS, GAP_S = 5.0, 0.5
"""A gap is a step longer than GAP_STEPS median steps and than GAP_S."""

STANDING_M_PER_S, STANDING_S = 0.02, 5.0
"""The robot stands if its mean speed over STANDING_S is below STANDING_M_PER_S."""

SHOWN_SHARE = 1 / 200
"""A momentary state is shown for at least this share of the run, so that it is visible."""

STEADY, GAP, JUMP, BROKEN = "steady", "gap", "jump", "broken"
DRIVING, STANDING = "driving", "standing"
NEW, KNOWN = "new ground", "known ground"


@dataclass(frozen=True, slots=True, eq=False)
class Lane:
    """A state that holds from each time until the next. time_ns: (k,), ascending."""

    name: str
    time_ns: IntArray
    states: tuple[str, ...]


def lanes(odometry: Odometry, topomap: TopoMap) -> list[Lane]:
    """The odometry's continuity, the robot's motion, and whether it was on new or known ground."""
    if len(odometry) < 2:
        return []
    return [_continuity(odometry), _motion(odometry), *_ground(topomap)]


def _lane(name: str, first: tuple[int, str], changes: list[tuple[int, str]]) -> Lane:
    """A lane from changes in any order; of several at one time the last is used."""
    at: dict[int, str] = dict([first, *sorted(changes, key=lambda change: change[0])])
    times = sorted(at)
    kept = [t for k, t in enumerate(times) if k == 0 or at[t] != at[times[k - 1]]]
    return Lane(name, np.array(kept, np.int64), tuple(at[t] for t in kept))


def _continuity(odometry: Odometry) -> Lane:
    times = odometry.time_ns
    step_s = np.diff(times) / 1e9
    usual = float(np.median(step_s))
    shown_ns = round(SHOWN_SHARE * float(times[-1] - times[0]))
    found = [(int(k) + 1, GAP) for k in np.flatnonzero(step_s > max(GAP_STEPS * usual, GAP_S))]
    found += [(int(k), JUMP) for k in odometry.jumps]
    found += [(int(k), BROKEN) for k in odometry.breaks]
    worst = {STEADY: 0, GAP: 1, JUMP: 2, BROKEN: 3}
    spans = [
        (int(times[k - 1]), max(int(times[k]), int(times[k - 1]) + shown_ns), state)
        for k, state in found
    ]
    edges = sorted({t for begin, end, _ in spans for t in (begin, end)})
    changes = []
    for t in edges:
        here = [state for begin, end, state in spans if begin <= t < end]
        changes.append((t, max(here, key=worst.__getitem__, default=STEADY)))
    return _lane("odometry", (int(times[0]), STEADY), changes)


def _motion(odometry: Odometry) -> Lane:
    """Standing or driving: a row stands if it lies in a window of STANDING_S whose path is too
    short. O(n)."""
    times = odometry.time_ns
    way = np.cumsum(odometry.step_m)
    end = times + round(STANDING_S * 1e9)
    ahead = np.searchsorted(times, end).clip(max=len(times) - 1)
    stands = (way[ahead] - way < STANDING_M_PER_S * STANDING_S) & (end <= times[-1])
    # Mark all rows of the standing windows by differences at their ends.
    rises = np.zeros(len(times) + 1, np.int64)
    np.add.at(rises, np.flatnonzero(stands), 1)
    np.add.at(rises, ahead[stands], -1)
    still = np.cumsum(rises)[:-1] > 0
    rows = np.flatnonzero(np.diff(still)) + 1
    word = {True: STANDING, False: DRIVING}
    changes = [(int(times[k]), word[bool(still[k])]) for k in rows]
    return _lane("motion", (int(times[0]), word[bool(still[0])]), changes)


def _ground(topomap: TopoMap) -> list[Lane]:
    times, at = topomap.observation_time_ns, topomap.observation_vertex
    if len(times) == 0:
        return []
    first = np.zeros(len(times), bool)
    first[np.unique(at, return_index=True)[1]] = True
    word = {True: NEW, False: KNOWN}
    changes = [(int(t), word[bool(new)]) for t, new in zip(times, first, strict=True)]
    return [_lane("ground", (int(times[0]), NEW), changes)]
