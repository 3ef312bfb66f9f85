"""Scenarios: several runs in one world (and some elsewhere), all from one seed.

scenario = simulate_scenario(ScenarioSettings("maze", runs=3, overlap=0.4, seed=7))
scenario.runs["run1"]     # a topology.run.Run, as if read from a log
scenario.truth            # what really happened
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np

from ..topology.arrays import FloatArray, IntArray
from ..topology.errors import UsageError
from ..topology.odometry import Odometry
from ..topology.run import Detections, Run
from ..topology.se2 import compose, inverse, wrap
from .chance import Chance
from .detector import sightings
from .drift import DRIFTS, Drift, measured
from .faults import FAULTS, Faults
from .laser import LASERS, LaserSettings, Scans, scans
from .motion import MotionSettings, drive
from .regions import chain_of_regions
from .truth import RunTruth, Truth
from .walk import Leg, WalkSettings, explore
from .world import World
from .worlds import WORLDS, make_world

EPOCH_NS = 1_700_000_000 * 10**9
"""Start of the first run: November 2023."""
BETWEEN_RUNS_NS = 7200 * 10**9
"""Time from one run's start to the next one's: two hours."""
Level = TypeVar("Level", Drift, Faults, LaserSettings)


LEVELS: Mapping[str, Mapping[str, Any]] = {"drift": DRIFTS, "faults": FAULTS, "laser": LASERS}
"""Levels that settings may name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSettings:
    """How a run is driven and recorded. Raises UsageError on invalid values."""

    drift: str | Drift = "mid"
    """A level (none, low, mid, high, real) or a Drift."""
    faults: str | Faults = "mild"
    """A level (none, mild, harsh) or a Faults."""
    walk: WalkSettings = field(default_factory=WalkSettings)
    motion: MotionSettings = field(default_factory=MotionSettings)
    odometry_hz: float = 20.0
    detector_hz: float = 7.0
    laser: str | LaserSettings | None = None
    """A level (none, mild, harsh) or a LaserSettings; None for no laser."""
    tells_junctions: bool = True
    """Whether the log holds the detector's messages."""

    def __post_init__(self) -> None:
        for name, known in LEVELS.items():
            value = getattr(self, name)
            if isinstance(value, str):
                _one_of(name, value, known)
        for name in ("odometry_hz", "detector_hz"):
            _check_range(self, name, 1, 1000)


@dataclass(frozen=True, slots=True)
class ScenarioSettings(RunSettings):
    """What to simulate: a world, and runs with common settings. Raises UsageError on invalid
    values."""

    world: str = "maze"
    """Kind of world: maze, office, organic, city, rows or tiles."""
    runs: int = 3
    overlap: float = 0.4
    """Share of a run's junctions that the run before it also visits, 0 … 0.9."""
    junctions_per_run: int = 50
    unrelated_runs: int = 0
    """Further runs, each in a world of its own."""
    world_junctions: int | None = None
    """Size of the world; by default as large as the runs need."""
    prefix: str = "run"
    """Prefix of the runs' names, before a number."""
    seed: int = 0
    """Seed of the world, the paths and the errors."""

    def __post_init__(self) -> None:
        RunSettings.__post_init__(self)
        _one_of("world", self.world, WORLDS)
        _check_range(self, "runs", 1, 10_000)
        _check_range(self, "unrelated_runs", 0, 10_000)
        _check_range(self, "junctions_per_run", 5, 100_000)
        if self.world_junctions is not None:
            _check_range(self, "world_junctions", 5, 1_000_000)
        _check_range(self, "overlap", 0.0, 0.9)
        _check_range(self, "seed", 0, 2**63 - 1)
        if not self.prefix or "/" in self.prefix or self.prefix.startswith("."):
            raise UsageError(f"prefix {self.prefix!r} cannot begin the name of a file")


def _check_range(settings: RunSettings, name: str, least: float, most: float) -> None:
    value = getattr(settings, name)
    if not least <= value <= most:
        raise UsageError(f"{name} must lie in {least} … {most}, not {value}")


def _one_of(name: str, value: str, known: Mapping[str, Any]) -> None:
    if value not in known:
        raise UsageError(f"no {name} {value!r}: choose one of {', '.join(known)}")


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
    """Simulated runs, sorted by name, and the worlds they were driven in."""

    simulated: tuple[SimulatedRun, ...]
    worlds: Mapping[str, World]

    @property
    def runs(self) -> dict[str, Run]:
        """The runs by name."""
        return {s.run.name: s.run for s in self.simulated}

    @property
    def truth(self) -> Truth:
        """The truth about all runs."""
        return Truth(self.worlds, {s.run.name: s.truth for s in self.simulated})


def joined(*scenarios: Scenario) -> Scenario:
    """Several scenarios as one; UsageError if two of their runs or worlds have the same name."""
    simulated = [s for scenario in scenarios for s in scenario.simulated]
    worlds = {name: w for scenario in scenarios for name, w in scenario.worlds.items()}
    if len({s.run.name for s in simulated}) < len(simulated):
        raise UsageError("two scenarios have runs of the same name: give them another prefix")
    if len(worlds) < sum(len(scenario.worlds) for scenario in scenarios):
        raise UsageError("two scenarios have worlds of the same name: give them another prefix")
    return Scenario(tuple(sorted(simulated, key=lambda s: s.run.name)), worlds)


def simulate_scenario(settings: ScenarioSettings | None = None) -> Scenario:
    """The runs that the settings describe; deterministic on any machine.

    The runs' names are in random order, so that they do not tell which runs overlap. Raises
    UsageError if no world has room for them.
    """
    s = settings or ScenarioSettings()
    world, regions = _world_with_regions(s)
    stem = s.prefix.rstrip("-_")
    worlds = {f"{stem}-world": world}
    plan = [(f"{stem}-world", region) for region in regions]
    for k in range(s.unrelated_runs):
        alone = replace(s, runs=1, world_junctions=None, seed=0)
        other, parts = _world_with_regions(alone, Chance("elsewhere", s.seed, k).index(2**31))
        worlds[f"{stem}-other{k + 1}"] = other
        plan.append((f"{stem}-other{k + 1}", parts[0]))
    digits = len(str(len(plan)))
    simulated = []
    for number, place in enumerate(Chance("names", s.seed).order(len(plan)).tolist(), 1):
        where, region = plan[place]
        simulated.append(
            simulate_run(
                worlds[where],
                region,
                s,
                name=f"{s.prefix}{number:0{digits}d}",
                seed=Chance("run", s.seed, place).index(2**31),
                world_name=where,
                start_ns=EPOCH_NS + number * BETWEEN_RUNS_NS,
            )
        )
    return Scenario(tuple(simulated), worlds)


def _world_with_regions(
    s: ScenarioSettings, seed: int | None = None
) -> tuple[World, list[set[int]]]:
    """A world and the region of each run; larger worlds are tried until the regions fit."""
    world_seed = s.seed if seed is None else seed
    size, chance = s.junctions_per_run, Chance("regions", world_seed)
    wanted = size * (1 + (s.runs - 1) * (1 - s.overlap))
    asked = [s.world_junctions] if s.world_junctions else [wanted * f for f in (1.15, 1.4, 1.8)]
    for junctions in asked:
        aspect = max(1.0, 0.8 * wanted / size)
        world = make_world(s.world, round(junctions), world_seed, aspect)
        regions = chain_of_regions(world, s.runs, size, s.overlap, chance)
        if len(regions) == s.runs and min(len(r) for r in regions) >= 0.9 * size:
            return world, regions
    larger = ", or a larger world" if s.world_junctions else ""
    raise UsageError(
        f"no room for {s.runs} runs of {size} junctions in a world of {len(world)} junctions: "
        f"ask for fewer or smaller runs{larger}"
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
) -> SimulatedRun:
    """One robot explores a connected region of a world (by default all of it) and records a run;
    with a route it drives that instead.

    O(path length), vectorised: about 50 ms for 100 junctions. Raises UsageError if the region has
    no corridor.
    """
    s = settings or RunSettings()
    drift, faults = _level(DRIFTS, s.drift), _level(FAULTS, s.faults)
    laser = None if s.laser is None else _level(LASERS, s.laser)
    inside = set(range(len(world))) if region is None else region
    if route is None:
        legs, closed = explore(world, inside, s.walk, faults, Chance("walk", seed))
    else:
        legs, closed = list(route), set()
    if not legs:
        raise UsageError(f"{name}: the region of {len(inside)} junctions has no corridor to drive")
    driven = drive(world, legs, s.motion, Chance("motion", seed))
    track = measured(driven, drift, s.odometry_hz, Chance("odometry", seed))
    seen = sightings(
        world, driven, closed, faults, rate_hz=s.detector_hz, chance=Chance("detector", seed)
    )

    def stamps(time_s: FloatArray) -> Any:
        return start_ns + np.round(time_s * 1e6).astype(np.int64) * 1000

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
        doors=_shut(seen_by_laser, stamps),
        settings={"seed": seed, **_told(s, drift, faults, laser)},
    )
    return SimulatedRun(
        Run(name, odometry, detections),
        truth,
        track.twist,
        seen_by_laser,
        stamps(seen_by_laser.time_s if seen_by_laser else np.zeros(0)),
        s.tells_junctions,
    )


def _level(known: Mapping[str, Level], value: str | Level) -> Level:
    return known[value] if isinstance(value, str) else value


def _told(
    settings: RunSettings, drift: Drift, faults: Faults, laser: LaserSettings | None
) -> dict[str, Any]:
    """The run's settings for the truth, with levels replaced by their values."""
    by_name = {f.name: getattr(settings, f.name) for f in fields(RunSettings)}
    told = asdict(RunSettings(**by_name | {"drift": drift, "faults": faults, "laser": laser}))
    if laser is None:
        del told["laser"], told["tells_junctions"]
    return told


def _shut(scans: Scans | None, stamps: Any) -> tuple[tuple[int, int, int, int], ...]:
    """Corridor, vertex, from and to [ns] of every interval in which a door was shut."""
    if scans is None:
        return ()
    doors, which = scans.doors, scans.doors.door
    columns = (doors.edge[which], doors.vertex[which], stamps(doors.from_s), stamps(doors.to_s))
    return tuple(zip(*(column.tolist() for column in columns), strict=True))
