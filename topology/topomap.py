"""The topological map of one run: junctions joined by corridors, laid out in the plane."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .arrays import BoolArray, FloatArray, IntArray
from .frozen import freeze, frozen_array, frozen_rows
from .passes import NO_BRANCH
from .ragged import Ragged
from .turning_points import KINDS, NO_TURNING_POINTS, TurningPoints
from .views import NO_VIEWS, Views
from .wording import counted

VERTEX_COLUMNS = ("xy", "branches", "kind")
EDGE_COLUMNS = (
    *("source", "target", "source_branch", "target_branch"),
    *("length", "length_sigma", "traversals", "paths"),
)
"""Fields of `Graph` with one row per vertex, and per edge."""

MAP_VERTEX_COLUMNS = (
    *VERTEX_COLUMNS,
    *("position_sigma", "branch_sigma", "confidence", "area_m2", "width_m"),
)
MAP_EDGE_COLUMNS = (*EDGE_COLUMNS, "traversal_ns")
"""The same of `TopoMap`."""

ALL_SURE = frozen_array(np.ones(1), np.float64, (1,), "confidence")
"""Default confidence: 1 for every vertex."""


@dataclass(frozen=True, slots=True)
class RunNoise:
    """Noise of a run's measurements: 1 sigma values and rates, estimated from the run itself."""

    along_m_per_sqrt_m: float = 0.01
    """Odometry: random walk of the position along the way."""
    heading_rad_per_sqrt_m: float = 0.009
    """Odometry: random walk of the heading with the distance driven."""
    heading_rad_per_sqrt_rad: float = 0.014
    """Odometry: random walk of the heading with the angle turned."""
    scale: float = 0.005
    """Odometry: relative error of lengths, constant over the run."""
    centre_m: float = 0.05
    """Junction centre of one pass, per axis."""
    branch_rad: float = 0.05
    """Branch heading of one pass."""
    miss_rate: float = 0.02
    """Share of passes in which a junction was not detected."""
    phantom_rate: float = 0.005
    """False detections of junctions per corridor driven."""
    branch_fault_rate: float = 0.03
    """Share of passes with a branch missing or invented."""
    shared_centre_m: float = 0.0
    """Error of a junction centre, per axis, that all of its passes have in common (median): scans
    see the same walls at each pass, so that it does not average out."""

    def straight_covariance(self, distance_m: FloatArray) -> FloatArray:
        """(k, 3, 3) isotropic covariance of x, y, theta after driving straight on (k,) [m]."""
        turn = self.heading_rad_per_sqrt_m**2 * distance_m
        covariance = np.zeros((len(distance_m), 3, 3))
        shift = self.along_m_per_sqrt_m**2 * distance_m + turn * distance_m**2 / 3
        covariance[:, 0, 0] = covariance[:, 1, 1] = shift
        covariance[:, 2, 2] = turn
        return covariance


@dataclass(frozen=True, slots=True)
class Closure:
    """The question whether two passes were by the same place, and its answer.

    round: of the loop closure in which it was answered, from 1 on; accepted_round: the round in
    which it had been accepted, if this takes it back; revised: whether another answer on the
    places of the two stands.
    """

    time_a_ns: int
    time_b_ns: int
    accepted: bool
    bits: float
    reason: str
    round: int | None = None
    accepted_round: int | None = None
    revised: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Graph:
    """`n` vertices and `m` edges laid out in the plane (a multigraph, loops allowed).

    xy: (n, 2) vertex positions [m]. branches: n rows of headings [rad], ascending in [-pi, pi).
    kind: n names ("junction", "room", "door", "dead_end", "bend"). source, target: (m,) vertex
    indices. source_branch, target_branch: (m,) row-local branch by which the edge leaves its source
    / target, NO_BRANCH where unknown. length: (m,) length along the corridor [m]; length_sigma:
    (m,) 1 sigma [m]; traversals: (m,) times driven. paths: m polylines (k, 2) [m] from source to
    target, k >= 2.
    """

    xy: FloatArray
    branches: Ragged
    kind: tuple[str, ...]
    source: IntArray
    target: IntArray
    source_branch: IntArray
    target_branch: IntArray
    length: FloatArray
    length_sigma: FloatArray
    traversals: IntArray
    paths: tuple[FloatArray, ...]

    def __len__(self) -> int:
        """Number of vertices."""
        return len(self.xy)

    @property
    def degree(self) -> IntArray:
        """(n,) number of branches seen at each vertex, explored or not."""
        return self.branches.counts

    @property
    def is_turned(self) -> BoolArray:
        """(n,) whether a vertex is a turning point of a run."""
        return np.array([kind in KINDS for kind in self.kind], bool)


@dataclass(frozen=True, slots=True, eq=False)
class TopoMap(Graph):
    """The topological map of a run.

    run: name, unique in a workspace; frame: name of the map frame (the run's own, arbitrary).
    observation_vertex, observation_time_ns: (k,) one row per pass, by time. noise: used by loop
    closure and matching, conservative; fitted_noise: estimated from the closed run, None if it is
    not known. position_sigma: (n,) 1 sigma [m] of each coordinate of a vertex, branch_sigma: n
    rows, 1 sigma of each branch heading [rad], both with the map as a whole aligned to the truth;
    None where not known. traversal_ns: m arrays (t, 2), by time: when the robot was at the edge's
    source and at its target on each traversal (driven from target to source, the second is the
    earlier one); None where not known. confidence: (n,) in (0, 1], probability that a vertex has
    exactly its branches, or one number for all: 1 for maps from detections. shows_bends: whether
    the detector reports places with two branches; those of scans and grids do not. turning_points:
    dead ends of the track that are not vertices; `turning_vertices.with_turning_points` makes
    vertices of them. views: what a laser or a grid shows around places of the run, posed in the
    map's frame. area_m2: (n,) of rooms, 0 of other vertices; width_m: (n,) of doors, likewise; None
    where not known. Raises ValueError where shapes, indices or values do not fit.
    """

    run: str
    frame: str
    observation_vertex: IntArray
    observation_time_ns: IntArray
    noise: RunNoise = field(default_factory=RunNoise)
    closures: tuple[Closure, ...] = ()
    fitted_noise: RunNoise | None = None
    position_sigma: FloatArray | None = None
    branch_sigma: Ragged | None = None
    traversal_ns: tuple[IntArray, ...] | None = None
    confidence: FloatArray = field(default_factory=lambda: ALL_SURE)
    shows_bends: bool = True
    turning_points: TurningPoints = NO_TURNING_POINTS
    views: Views = NO_VIEWS
    area_m2: FloatArray | None = None
    width_m: FloatArray | None = None
    info: Mapping[str, Any] = field(default_factory=dict)
    """Other entries of the document's `graph`: source, settings, warnings. JSON values only."""

    def __post_init__(self) -> None:
        n, m, k = len(self.xy), len(self.source), len(self.observation_vertex)
        freeze(self, np.float64, xy=(n, 2), length=(m,), length_sigma=(m,))
        freeze(self, np.int64, source=(m,), target=(m,), traversals=(m,))
        freeze(self, np.int64, source_branch=(m,), target_branch=(m,))
        freeze(self, np.int64, observation_vertex=(k,), observation_time_ns=(k,))
        paths = frozen_rows(self.paths, np.float64, 2, "path")
        object.__setattr__(self, "paths", paths)
        if len(self.branches) != n or len(self.kind) != n or len(paths) != m:
            raise ValueError("one branch row and kind per vertex, one path per edge are needed")
        if any(len(p) < 2 for p in paths):
            raise ValueError("a path needs two points or more")
        for name, end in (("source", self.source), ("target", self.target)):
            if np.any(end < 0) or np.any(end >= n):
                raise ValueError(f"{name} names a vertex that does not exist")
            branch = getattr(self, f"{name}_branch")
            if np.any(branch < NO_BRANCH) or np.any(branch >= self.branches.counts[end]):
                raise ValueError(f"{name}_branch names a branch that its vertex does not have")
        seen = self.observation_vertex
        if np.any(seen < 0) or np.any(seen >= n):
            raise ValueError("an observation names a vertex that does not exist")
        self._check_certainty(n)
        if self.traversal_ns is not None:
            driven = frozen_rows(self.traversal_ns, np.int64, 2, "times")
            object.__setattr__(self, "traversal_ns", driven)
            if len(driven) != m:
                raise ValueError("traversal_ns needs one array per edge")
        if np.any(self.length <= 0) or np.any(self.length_sigma <= 0):
            raise ValueError("lengths and their sigmas must be positive")
        turned = self.turning_points
        if np.any(turned.vertex >= n) or np.any(
            turned.branch >= self.branches.counts[turned.vertex]
        ):
            raise ValueError("a turning point names a vertex or a branch that does not exist")

    @property
    def is_driven(self) -> bool:
        """Whether it is of a recorded run; nobody drove a saved map, which has no times."""
        return len(self.observation_time_ns) > 0

    def __repr__(self) -> str:
        """One line: an array of a map fills a page."""
        corridors = f"{counted(len(self.source), 'corridor')} of {self.length.sum():.0f} m"
        return f"<map of {self.run}: {counted(len(self), 'junction')}, {corridors}>"

    def _check_certainty(self, n: int) -> None:
        if self.position_sigma is not None:
            freeze(self, np.float64, position_sigma=(n,))
        for name in ("area_m2", "width_m"):
            if getattr(self, name) is not None:
                freeze(self, np.float64, **{name: (n,)})
                if np.any(getattr(self, name) < 0):
                    raise ValueError(f"{name} must not be negative")
        if self.branch_sigma is not None and not np.array_equal(
            self.branch_sigma.offsets, self.branches.offsets
        ):
            raise ValueError("branch_sigma needs one value per branch")
        given = np.asarray(self.confidence, np.float64)
        if given.size == 1:
            object.__setattr__(self, "confidence", np.full(n, given))
        freeze(self, np.float64, confidence=(n,))
        if np.any(self.confidence <= 0) or np.any(self.confidence > 1):
            raise ValueError("a confidence lies between 0 and 1")

    @property
    def measured(self) -> RunNoise:
        """The most likely noise: `fitted_noise`, or `noise` where nothing better is known."""
        return self.fitted_noise or self.noise

    @property
    def pieces(self) -> int:
        """Number of parts whose relative poses are unknown: more than 1 where the odometry broke
        and the parts are only drawn side by side."""
        count: int = self.info.get("pieces", 1)
        return count

    @property
    def views_lost(self) -> bool:
        """Whether the map was made with views, and they could not be read."""
        return "views" in self.info and not len(self.views)

    @property
    def passes(self) -> IntArray:
        """(n,) number of passes by each vertex."""
        return np.bincount(self.observation_vertex, minlength=len(self))

    @property
    def centre_variance(self) -> FloatArray:
        """(n,) variance of each coordinate of a vertex [m²] from its own passes alone: their
        scatter, averaged, and the error that they have in common."""
        noise = self.measured
        own = noise.centre_m**2 / np.maximum(self.passes, 1) + noise.shared_centre_m**2
        return np.asarray(own)
