"""Scenarios: several runs in one world (and some elsewhere), all from one seed.

scenario = simulate_scenario(ScenarioSettings("maze", runs=3, overlap=0.4, seed=7))
scenario.runs["run1"]     # a topology.run.Run, as if read from a log
scenario.truth            # what really happened
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..topology.arrays import FloatArray, IntArray
from ..topology.connected import connected
from ..topology.errors import UsageError
from ..topology.odometry import Odometry
from ..topology.run import Detections, Run
from ..topology.se2 import compose, inverse, wrap
from .chance import Chance
from .detector import sightings
from .drift import measured
from .laser import Scans, scans
from .motion import drive
from .regions import chain_of_regions
from .settings import RunSettings, ScenarioSettings
from .truth import RunTruth, Truth, WorldChange
from .walk import Leg, explore
from .world import World
from .worlds import make_world

EPOCH_NS = 1_700_000_000 * 10**9
"""Start of the first run: November 2023."""
BETWEEN_RUNS_NS = 7200 * 10**9
"""Time from one run's start to the next one's: two hours."""

ROOM = (1.15, 1.4, 1.8)
"""Sizes of the worlds that are tried, as multiples of the junctions that the runs visit."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedRun:
    """A run as in its log, with its truth.

    twist: (n, 2) measured forward [m/s] and angular [rad/s] speed of every odometry row; scans:
    None without a laser; scans_ns: (k,) their stamps; tells_junctions: whether the log holds
    `run.detections`.
    """

    run: Run
    truth: RunTruth
    twist: FloatArray
    scans: Scans | None = None
    scans_ns: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    tells_junctions: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Scenario:
    """Simulated runs, sorted by name, the worlds they were driven in, and what changed there."""

    simulated: tuple[SimulatedRun, ...]
    worlds: Mapping[str, World]
    changes: tuple[WorldChange, ...] = ()

    @property
    def runs(self) -> dict[str, Run]:
        """The runs by name."""
        return {s.run.name: s.run for s in self.simulated}

    @property
    def truth(self) -> Truth:
        """The truth about all runs."""
        return Truth(self.worlds, {s.run.name: s.truth for s in self.simulated}, self.changes)


def simulate_scenario(settings: ScenarioSettings | None = None) -> Scenario:
    """The runs that the settings describe; deterministic on any machine.

    The runs' names are in random order, so that they do not tell which runs overlap. Raises
    UsageError if no world has room for them, or too few corridors can close or open.
    """
    s = settings or ScenarioSettings()
    world, regions = _world_with_regions(s)
    stem = s.prefix.rstrip("-_")
    worlds = {f"{stem}-world": world}
    plan = [(f"{stem}-world", region) for region in regions]
    for k in range(s.unrelated_runs):
        seed = Chance("elsewhere", s.seed, k).index(2**31)
        other, parts = _world_with_regions(replace(s, runs=1, seed=seed))
        worlds[f"{stem}-other{k + 1}"] = other
        plan.append((f"{stem}-other{k + 1}", parts[0]))
    digits = len(str(len(plan)))
    order = Chance("names", s.seed).order(len(plan)).tolist()
    between_ns = BETWEEN_RUNS_NS
    if s.days is not None:
        between_ns = round(s.days * 86_400 / max(len(plan) - 1, 1)) * 10**9
    start_ns = [EPOCH_NS + (order.index(k) + 1) * between_ns for k in range(len(plan))]
    changes = _changes(world, f"{stem}-world", regions, start_ns, s)
    simulated = []
    for number, place in enumerate(order, 1):
        where, region = plan[place]
        changed = changes if place < len(regions) else ()
        simulated.append(
            simulate_run(
                worlds[where],
                region,
                s,
                name=f"{s.prefix}{number:0{digits}d}",
                seed=Chance("run", s.seed, place).index(2**31),
                world_name=where,
                start_ns=start_ns[place],
                shut={c.edge for c in changed if c.open == (start_ns[place] < c.time_ns)},
            )
        )
    return Scenario(tuple(simulated), worlds, changes)


def _changes(
    world: World, name: str, regions: list[set[int]], start_ns: list[int], s: ScenarioSettings
) -> tuple[WorldChange, ...]:
    """Corridors that close or open between two runs whose regions hold them, by time.

    Every region stays connected without all of them. UsageError if there are too few.
    """
    chance, out, gone = Chance("changes", s.seed), list[WorldChange](), set[int]()
    for edge in chance.order(len(world.source)).tolist():
        if len(out) == s.changes:
            break
        ends = {int(world.source[edge]), int(world.target[edge])}
        holders = [k for k, region in enumerate(regions) if ends <= region]
        starts = [start_ns[k] for k in holders]
        without = gone | {edge}
        if len(starts) > 1 and all(_connected(world, regions[k], without) for k in holders):
            time_s = chance.one_uniform(min(starts) / 10**9 + 1, max(starts) / 10**9)
            out.append(WorldChange(name, edge, int(time_s) * 10**9, chance.one_happens(0.5)))
            gone = without
    if len(out) < s.changes:
        raise UsageError(
            f"only {len(out)} corridors that two runs pass can close: ask for fewer changes, or "
            "for more overlap"
        )
    return tuple(sorted(out, key=lambda change: change.time_ns))


def _connected(world: World, region: set[int], without: set[int]) -> bool:
    """Whether a region is connected without some corridors."""
    inside = sorted(region)
    own = np.isin(world.source, inside) & np.isin(world.target, inside)
    own[sorted(without)] = False
    part = connected(world.source[own], world.target[own], len(world))[inside]
    return bool(np.all(part == part[0]))


def _world_with_regions(s: ScenarioSettings) -> tuple[World, list[set[int]]]:
    """A world and the region of each run; larger worlds are tried until the regions fit."""
    size, chance = s.junctions_per_run, Chance("regions", s.seed)
    wanted = size * (1 + (s.runs - 1) * (1 - s.overlap))
    aspect = max(1.0, 0.8 * wanted / size)
    for room in ROOM:
        world = make_world(s.world, round(wanted * room), s.seed, aspect)
        regions = chain_of_regions(world, s.runs, size, s.overlap, chance)
        if len(regions) == s.runs and min(len(r) for r in regions) >= 0.9 * size:
            return world, regions
    raise UsageError(
        f"no room for {s.runs} runs of {size} junctions in a world of {len(world)} junctions: "
        "ask for fewer or smaller runs"
    )


def simulate_run(
    world: World,
    region: set[int] | None = None,
    settings: RunSettings | None = None,
    *,
    name: str = "run",
    seed: int = 0,
    world_name: str | None = None,
    start_ns: int = EPOCH_NS,
    route: Sequence[Leg] | None = None,
    shut: Set[int] = frozenset(),
) -> SimulatedRun:
    """One robot explores a connected region of a world (by default all of it) and records a run;
    with a route it drives that instead. Corridors that are `shut` are closed during it.

    O(path length), vectorised: about 50 ms for 100 junctions. Raises UsageError if the region has
    no corridor.
    """
    s = settings or RunSettings()
    drift, faults, laser = s.values()
    inside = set(range(len(world))) if region is None else region
    if route is None:
        legs, closed = explore(world, inside, s.walk, faults, Chance("walk", seed), shut=shut)
    else:
        legs, closed = list(route), set(shut)
    if not legs:
        raise UsageError(f"{name}: the region of {len(inside)} junctions has no corridor to drive")
    driven = drive(world, legs, s.motion, Chance("motion", seed))
    track = measured(driven, drift, s.odometry_hz, Chance("odometry", seed))
    seen = sightings(
        world, driven, closed, faults, rate_hz=s.detector_hz, chance=Chance("detector", seed)
    )

    def stamps(time_s: FloatArray) -> Any:
        return start_ns + np.round(time_s * 10**6).astype(np.int64) * 1000

    odometry = Odometry(time_ns=stamps(track.time_s), pose=track.pose, breaks=track.breaks)
    detections = Detections(stamps(seen.time_s), seen.centre, seen.branches)
    seen_by_laser = scans(world, driven, closed, laser, Chance("laser", seed)) if laser else None
    every = np.arange(0, len(track.time_s), max(1, round(s.odometry_hz / 2)))
    wrapped = np.column_stack([track.true_pose[:, :2], wrap(track.true_pose[:, 2])])
    truth = RunTruth(
        name=name,
        world=world_name or world.name,
        T_world_odom=np.round(compose(wrapped[0], inverse(track.pose[0])), 6),
        start_ns=stamps(seen.start_s),
        end_ns=stamps(seen.end_s),
        vertex=seen.vertex,
        messages=seen.messages,
        fault=seen.fault,
        drive_edge=driven.leg_edge,
        drive_start_ns=stamps(driven.last_at(driven.leg_from_m)),
        drive_end_ns=stamps(driven.first_at(driven.leg_to_m)),
        path_ns=odometry.time_ns[every],
        path=wrapped[every],
        closed_edges=tuple(sorted(closed)),
        break_ns=tuple(odometry.time_ns[track.breaks].tolist()),
        jump_ns=tuple(odometry.time_ns[track.jumps].tolist()),
        settings={**s.recorded(), "seed": seed},
    )
    return SimulatedRun(
        Run(name, odometry, detections),
        truth,
        track.twist,
        seen_by_laser,
        stamps(seen_by_laser.time_s if seen_by_laser else np.zeros(0)),
        s.tells_junctions,
    )
