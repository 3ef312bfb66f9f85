"""A small world, seen by several runs, and a merge of their maps."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.result import Alignment, Component, FusedMap, MergeResult, PairVerdict, Verdict
from topobatch.topology.odometry import Odometry
from topobatch.topology.ragged import Ragged
from topobatch.topology.se2 import apply, compose, inverse, wrap
from topobatch.topology.topomap import Closure, TopoMap

STEP_NS = 10**9

# A square with a stub: 0-1-2-3-0 and 2-4; vertex 0 has a branch (down) that nobody drove.
CORNERS = np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 6.0), (0.0, 6.0), (16.0, 6.0)])
HEADINGS = [
    [-np.pi / 2, 0.0, np.pi / 2],
    [-np.pi, np.pi / 2],
    [-np.pi, -np.pi / 2, 0.0],
    [-np.pi / 2, 0.0],
    [-np.pi],
]
ENDS = np.array([(0, 1), (1, 2), (2, 3), (3, 0), (2, 4)])


def _turned(headings: list[float], turn: float) -> np.ndarray:
    return np.sort(wrap(np.array(headings) + turn))


DRIVEN = (((10, 11), (16, 17)), ((11, 12),), ((14, 15),), ((15, 16),), ((12, 13), (14, 13)))
"""When the square's robot was at either end of each corridor, in steps."""


@pytest.fixture
def make_map() -> Callable[..., TopoMap]:
    """make_map(run, T_map_world): the square in a run's own frame, driven round once and a half."""

    def make(run: str, T_map_world: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> TopoMap:
        xy = apply(np.array(T_map_world), CORNERS)
        seen = np.array([0, 1, 2, 4, 2, 3, 0, 1])
        return TopoMap(
            run=run,
            frame="odom",
            xy=xy,
            branches=Ragged.from_rows(_turned(h, T_map_world[2]) for h in HEADINGS),
            kind=("junction", "bend", "junction", "bend", "dead_end"),
            source=ENDS[:, 0],
            target=ENDS[:, 1],
            source_branch=np.full(5, -1),
            target_branch=np.full(5, -1),
            length=np.array([10.0, 6.0, 10.0, 6.0, 6.0]),
            length_sigma=np.full(5, 0.1),
            traversals=np.array([2, 1, 1, 1, 2]),
            paths=tuple(xy[[u, v]] for u, v in ENDS),
            observation_vertex=seen,
            observation_time_ns=(10 + np.arange(len(seen))) * STEP_NS,
            traversal_ns=tuple(np.array(driven) * STEP_NS for driven in DRIVEN),
            closures=(
                Closure(10 * STEP_NS, 16 * STEP_NS, True, 21.5, "the square closes"),
                Closure(12 * STEP_NS, 17 * STEP_NS, False, -3.0, "2 | 1 have *other* branches"),
            ),
            info={
                "warnings": ["2 messages were empty"],
                "source": {"odometry": {"topic": "/odom", "messages": 140}, "time": "header"},
            },
        )

    return make


@pytest.fixture
def empty_map() -> TopoMap:
    """A run that met no junction."""
    none = np.zeros(0, np.int64)
    return TopoMap(
        run="nowhere",
        frame="odom",
        xy=np.zeros((0, 2)),
        branches=Ragged.from_rows([]),
        kind=(),
        source=none,
        target=none,
        source_branch=none,
        target_branch=none,
        length=np.zeros(0),
        length_sigma=np.zeros(0),
        traversals=none,
        paths=(),
        observation_vertex=none,
        observation_time_ns=none,
    )


@pytest.fixture
def one_vertex(empty_map: TopoMap) -> TopoMap:
    """A run that passed one junction."""
    return replace(
        empty_map,
        run="one",
        xy=np.array([(3.0, -2.0)]),
        branches=Ragged.from_rows([[0.0, 1.5]]),
        kind=("bend",),
        observation_vertex=np.array([0]),
        observation_time_ns=np.array([7 * STEP_NS]),
        confidence=np.ones(1),
    )


@pytest.fixture
def drive() -> Callable[[TopoMap], Odometry]:
    """drive(map): odometry that passes the map's vertices at their times, in its frame."""

    def make(topomap: TopoMap) -> Odometry:
        at = topomap.xy[topomap.observation_vertex]
        times = topomap.observation_time_ns
        every = np.arange(times[0], times[-1] + 1, STEP_NS // 20)
        xy = [np.interp((every - times[0]) / 1e9, (times - times[0]) / 1e9, c) for c in at.T]
        heading = np.arctan2(np.gradient(xy[1]), np.gradient(xy[0]))
        return Odometry(every, np.column_stack([*xy, heading]), np.zeros(0, np.int64))

    return make


def _fused(parts: list[tuple[TopoMap, ...]]) -> FusedMap:
    """Fused squares, one for each tuple of runs, in the frame of its first run."""
    n, m = len(CORNERS), len(ENDS)
    first = [maps[0] for maps in parts]
    return FusedMap(
        component=np.repeat(np.arange(len(parts)), n),
        xy=np.concatenate([m.xy for m in first]),
        branches=Ragged.from_rows(m.branches[i] for m in first for i in range(n)),
        kind=tuple(k for m in first for k in m.kind),
        members=tuple({m.run: (i,) for m in maps} for maps in parts for i in range(n)),
        observations=tuple(((maps[0].run, STEP_NS),) for maps in parts for _ in range(n)),
        source=np.concatenate([ENDS[:, 0] + n * c for c in range(len(parts))]),
        target=np.concatenate([ENDS[:, 1] + n * c for c in range(len(parts))]),
        source_branch=np.full(m * len(parts), -1),
        target_branch=np.full(m * len(parts), -1),
        length=np.concatenate([m.length for m in first]),
        length_sigma=np.full(m * len(parts), 0.1),
        traversals=np.full(m * len(parts), 2),
        paths=tuple(p for m in first for p in m.paths),
        edge_members=tuple(tuple((m.run, e) for m in maps) for maps in parts for e in range(m)),
    )


@pytest.fixture
def merge_of(make_map: Callable[..., TopoMap]) -> Callable[..., tuple[MergeResult, list[TopoMap]]]:
    """merge_of([["a", "b"], ["c"]], ambiguous=[("a", "c")]): a merge with these components."""

    def make(
        groups: list[list[str]], ambiguous: Sequence[tuple[str, str]] = ()
    ) -> tuple[MergeResult, list[TopoMap]]:
        names = sorted(run for group in groups for run in group)
        frame = {run: (5.0 * i, -3.0 * i, 0.7 * i) for i, run in enumerate(names)}
        maps = {run: make_map(run, frame[run]) for run in names}
        home = {run: c for c, group in enumerate(groups) for run in group}
        every = np.repeat(np.arange(5), 2).reshape(-1, 2)
        verdicts = []
        for i, a in enumerate(names):
            for b in names[i + 1 :]:
                right = compose(np.array(frame[a]), inverse(np.array(frame[b])))
                bits = 40.0 - i
                best = Alignment(right, bits, every, 0.1, 5)
                other = Alignment(compose(right, [3.0, 0.0, np.pi]), bits - 1, every[:2], 0.2, 1)
                if home[a] == home[b]:
                    pair = PairVerdict(
                        a, b, Verdict.MERGED, True, bits, "all fits", best, other, 1.0
                    )
                elif (a, b) in ambiguous:
                    pair = PairVerdict(
                        a, b, Verdict.AMBIGUOUS, False, bits, "two ways", best, other, 1.0, "go on"
                    )
                else:
                    pair = PairVerdict(a, b, Verdict.UNRELATED, False, -2.0, "nothing fits")
                verdicts.append(pair)
        components = [
            Component(
                c,
                {
                    run: compose(np.array(frame[group[0]]), inverse(np.array(frame[run])))
                    for run in group
                },
            )
            for c, group in enumerate(groups)
        ]
        fused = _fused([tuple(maps[run] for run in group) for group in groups])
        result = MergeResult(tuple(components), fused, tuple(verdicts), {"warnings": ["take care"]})
        return result, [maps[run] for run in names]

    return make
