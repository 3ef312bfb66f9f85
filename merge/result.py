"""The result of merging: a verdict for every pair of runs, and the fused map of every component."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, Literal, TypeVar

import numpy as np
from pydantic import Field

from ..topology.arrays import BoolArray, FloatArray, IntArray
from ..topology.columns import columns_of, take
from ..topology.digits import BITS
from ..topology.frozen import freeze
from ..topology.map_schema import Index, Model
from ..topology.posegraph.graph import NO_MEASUREMENTS, Measurements
from ..topology.quadratic_forms import ONE_SIGMA, quadratic_quantile
from ..topology.se2 import apply, fit_groups
from ..topology.topomap import (
    EDGE_COLUMNS,
    MAP_EDGE_COLUMNS,
    MAP_VERTEX_COLUMNS,
    VERTEX_COLUMNS,
    Graph,
    TopoMap,
)
from ..topology.views import Views
from ..topology.wording import counted

T = TypeVar("T")

ROUNDING = np.sqrt(np.finfo(float).eps)
"""Share of a variance below which a difference of variances is rounding error."""


class Verdict(StrEnum):
    """The three answers to the question whether, and where, two runs share places."""

    MERGED = "merged"
    AMBIGUOUS = "ambiguous"
    UNRELATED = "unrelated"


class Standing(StrEnum):
    """The final state of a pair, for people. JOINED: by itself it lacks evidence, but other runs
    bring it into one component; KEPT_OUT: it fits, but a later check refused it."""

    MERGED = "merged"
    JOINED = "joined through others"
    AMBIGUOUS = "ambiguous"
    KEPT_OUT = "kept out"
    UNRELATED = "unrelated"


AcceptedBy = Literal["pair", "components", "runs", "lock"]
"""By what an accepted pair was accepted: its own evidence; that of the two components it joins;
other runs, which place the two like one of the pair's own alignments; a lock."""


@dataclass(frozen=True, slots=True)
class CopyTest:
    """The test whether an alignment is a copy of the place.

    bits: evidence that it is not; needed_bits: the threshold of that; repetition: 0 to 1, how
    likely it is one by its size and the building.
    """

    bits: float
    needed_bits: float
    repetition: float


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """An alignment of map b with map a.

    transform: (3,) T_a_b as x, y [m], theta [rad]; evidence_bits: log2 odds of the weaker one of
    two answers: is it more than chance? and, where a building may repeat itself: is it this place,
    not a copy? (shifted so that both have the same threshold); matched: (k, 2) int64 pairs (vertex
    of a, vertex of b), sorted; rmse_m: root mean square distance of the matched vertices under the
    transform; corridors: number of matched ones; contradictions: sentences, one per disagreement
    found ("junction 12 of run2 falls inside corridor 3–4 of run1, unseen there"); contradicting:
    for each of these the vertices of a and of b concerned, a corridor as its two ends; empty if not
    known; copy_test: None if it was not tested for being a copy; ties: relative poses of vertices
    of a and of b that were measured otherwise than by matching them.
    """

    transform: FloatArray
    evidence_bits: float
    matched: IntArray
    rmse_m: float
    corridors: int = 0
    contradictions: tuple[str, ...] = ()
    contradicting: tuple[tuple[tuple[int, ...], tuple[int, ...]], ...] = ()
    copy_test: CopyTest | None = None
    ties: Measurements = NO_MEASUREMENTS

    def __post_init__(self) -> None:
        object.__setattr__(self, "matched", np.reshape(self.matched, (-1, 2)))
        freeze(self, np.float64, transform=(3,))
        freeze(self, np.int64, matched=(None, 2))
        if self.contradicting and len(self.contradicting) != len(self.contradictions):
            raise ValueError("every contradiction needs its vertices, or none of them")


@dataclass(frozen=True, slots=True, eq=False)
class PairVerdict:
    """The verdict on one pair of runs, `a < b` by name.

    accepted: the pair joins a component (verdict MERGED and kept by every later check), for the
    reason accepted_by. threshold_bits: evidence required for merging, None if a method has no such
    threshold. best: the alignment that the verdict refers to, None for most unrelated pairs;
    runner_up: the next best one with another position of b; evidence_bits: of best; margin_bits:
    its lead over runner_up (negative if a lock or other runs overruled the pair's own evidence).
    For runs joined by their components best, its bits and margin_bits are those of the two
    components, and there is no runner_up. advice: what would settle an ambiguous pair; locked:
    "same" or "never" if there is a lock. through: for two runs joined only through others, the runs
    of the shortest chain of accepted pairs from a to b, without these two; placed: then the
    distance [m] within which the middle of one's map lies in 68.3 % of cases, relative to the
    other's (root mean square of both ways to see it), and 1 sigma [rad] of the rotation between
    them. together: the runs of the two components whose evidence joined the pair. transform_sigma:
    like `placed`, for an accepted pair, given all maps of its component. lacks: what the two maps
    lack for being merged, as a clause, "" if nothing; lead_needed_bits: the lead that their best
    alignment needs.
    """

    a: str
    b: str
    verdict: Verdict
    accepted: bool
    evidence_bits: float
    reason: str
    best: Alignment | None = None
    runner_up: Alignment | None = None
    margin_bits: float | None = None
    advice: str | None = None
    locked: str | None = None
    threshold_bits: float | None = None
    accepted_by: AcceptedBy | None = None
    through: tuple[str, ...] = ()
    placed: tuple[float, float] | None = None
    together: tuple[tuple[str, ...], tuple[str, ...]] | None = None
    transform_sigma: tuple[float, float] | None = None
    lacks: str = ""
    lead_needed_bits: float | None = None

    def __post_init__(self) -> None:
        if not self.a < self.b:
            raise ValueError(f"a pair is ordered by name: {self.a!r}, {self.b!r}")
        if self.accepted and self.best is None:
            raise ValueError("an accepted pair needs its alignment")

    @property
    def same_place_bits(self) -> float:
        """Evidence that its alignment is no copy of the place [bits]; inf if none is likely."""
        tested = None if self.best is None else self.best.copy_test
        return np.inf if tested is None or not tested.repetition else tested.bits

    @property
    def standing(self) -> Standing:
        """The final state of the pair."""
        if self.accepted:
            return Standing.MERGED
        if self.verdict is Verdict.MERGED:
            return Standing.KEPT_OUT
        is_refused = self.verdict is Verdict.AMBIGUOUS and not self.lacks
        return Standing.JOINED if self.through and not is_refused else Standing(self.verdict)


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """Joint errors of the placements of r runs, sorted by name, in one frame.

    middle: (r, 2) middles of their maps [m]; error: (r, 3, s) sampled errors of x, y of the middle
    and of the rotation of each map [m, rad].
    """

    runs: tuple[str, ...]
    middle: FloatArray
    error: FloatArray

    def relative(self, pairs: Sequence[tuple[str, str]]) -> FloatArray:
        """(k, 3, 3) covariances of the position of the second map's middle relative to the first
        map, and of the rotation between them, in the axes of the common frame [m, rad]; 0 up to
        rounding, and so 0, for maps of the same places alone, as of one recording under two
        names."""
        i, j = self._rows(pairs)
        x, y = (self.middle[j] - self.middle[i]).T
        off = _seen_from(x, y) @ self.error[i] + self.error[j]
        whole = off @ off.transpose(0, 2, 1) / off.shape[2]
        own = np.mean(self.error[j] ** 2, axis=2)
        significant = np.einsum("kii->ki", whole) > ROUNDING * own
        return np.asarray(whole * significant[:, :, None] * significant[:, None, :])

    def sigmas(
        self, pairs: Sequence[tuple[str, str]], share: float = ONE_SIGMA
    ) -> list[tuple[float, float]]:
        """For each pair the distance [m] within which the middle of one's map lies, relative to the
        other's, with the probability `share` (root mean square of both ways to see it), and 1 sigma
        of the rotation [rad]."""
        i, j = self._rows(pairs)
        x, y = (self.middle[j] - self.middle[i]).T
        covariance = self.relative(pairs)
        # Seen the other way round the middle is off by as much, less the turn about the step.
        back = np.zeros((len(i), 2, 3)) - np.eye(2, 3)
        back[:, 0, 2], back[:, 1, 2] = -y, x
        form = (np.diag([1.0, 1.0, 0.0]) + back.transpose(0, 2, 1) @ back) / 2
        metres = np.sqrt(quadratic_quantile(covariance @ form, share))
        turn = np.sqrt(covariance[:, 2, 2])
        return list(zip(metres.tolist(), turn.tolist(), strict=True))

    def _rows(self, pairs: Sequence[tuple[str, str]]) -> tuple[IntArray, IntArray]:
        ends = [[bisect_left(self.runs, run) for run in pair] for pair in pairs]
        i, j = np.array(ends, np.int64).reshape(-1, 2).T
        return i, j


def _seen_from(x: FloatArray, y: FloatArray) -> FloatArray:
    """(k, 3, 3) A, of which A e_i + e_j is the error of map j seen from map i; x, y: (k,) from the
    middle of i to that of j [m]."""
    A = np.zeros((len(x), 3, 3)) - np.eye(3)
    A[:, 0, 2], A[:, 1, 2] = y, -x
    return A


@dataclass(frozen=True, slots=True, eq=False)
class Component:
    """Runs that were merged; `poses[run]` is T_component_run (3,); spread: joint errors, if known;
    site: its name (`sites.site_names`), if it was given one."""

    id: int
    poses: Mapping[str, FloatArray]
    spread: Spread | None = None
    site: str = ""

    @property
    def name(self) -> str:
        """What it is called: its site, or its number."""
        return self.site or f"component {self.id}"

    @property
    def is_site(self) -> bool:
        """Whether it is called a site: it has several runs, or another name than its run."""
        return len(self.poses) > 1 or self.site not in ("", *self.poses)

    @property
    def alone(self) -> str:
        """A run that is merged with none, with the name of its site if that has another."""
        (run,) = self.poses
        return run if self.site in (None, run) else f"{run} ({self.site})"


@dataclass(frozen=True, slots=True, eq=False)
class FusedMap(Graph):
    """The fused vertices and edges of all components.

    component: (n,) id of the component in whose frame the vertex is; members: for each vertex the
    vertices of the runs' maps that it fuses; observations: for each vertex (run, time_ns) sorted;
    edge_members: for each edge the (run, edge index) pairs it fuses; position_sigma: (n,) as in
    TopoMap, for each component by itself, NaN where not known. Turning points of runs
    (`TopoMap.turning_points`) are the last vertices, and the corridors to them the last edges;
    their members are numbered as in documents, after all vertices of their run.
    """

    component: IntArray
    members: Sequence[Mapping[str, tuple[int, ...]]]
    observations: Sequence[tuple[tuple[str, int], ...]]
    edge_members: Sequence[tuple[tuple[str, int], ...]]
    position_sigma: FloatArray | None = None

    @property
    def turned(self) -> int:
        """Number of its vertices, and of its edges, that belong to turning points."""
        return int(self.is_turned.sum())

    @property
    def junctions(self) -> int:
        """Number of the other vertices."""
        return len(self) - self.turned

    @property
    def corridors(self) -> int:
        """Number of the other edges, which come first."""
        return len(self.source) - self.turned

    @property
    def lengths_m(self) -> tuple[float, float]:
        """Length of all corridors, and of all ways to turning points."""
        return float(self.length[: self.corridors].sum()), float(
            self.length[self.corridors :].sum()
        )


def of_sites(result: MergeResult, components: Collection[int]) -> MergeResult:
    """The part of a merge that is about some components. O(n + m + pairs)."""
    fused = result.fused
    chosen = np.isin(fused.component, [*components])
    own = tuple(c for c in result.components if c.id in components)
    runs = {run for c in own for run in c.poses}
    more = columns_of(fused, ("component", "members", "observations", "position_sigma"), chosen)
    edges = columns_of(fused, ("edge_members",), chosen[fused.source])
    return replace(
        result,
        components=own,
        fused=FusedMap(**graph_part(fused, chosen), **more, **edges),
        verdicts=tuple(v for v in result.verdicts if {v.a, v.b} <= runs),
        unlisted=None,
    )


MOST_PAIRS = 5000
"""Of more pairs only those are matched to which an index gives a chance, and only those with any
evidence are listed: 100 runs take some seconds without."""


def home_of(components: Iterable[Component]) -> dict[str, int]:
    """The component of every run, by its number."""
    return {run: c.id for c in components for run in c.poses}


def pairs_of(runs: int) -> int:
    """Number of pairs of so many runs."""
    return runs * (runs - 1) // 2


def by_run(members: Iterable[tuple[str, int]]) -> dict[str, tuple[int, ...]]:
    """(run, index) pairs grouped by run, in their order."""
    out: dict[str, tuple[int, ...]] = {}
    for run, index in members:
        out[run] = (*out.get(run, ()), index)
    return out


def graph_part(graph: Graph, chosen: BoolArray) -> dict[str, Any]:
    """The chosen vertices of a graph and the edges between them, as fields of a TopoMap."""
    number, edges = np.cumsum(chosen) - 1, chosen[graph.source]
    if isinstance(graph, TopoMap):
        part = columns_of(graph, MAP_VERTEX_COLUMNS, chosen)
        part |= columns_of(graph, MAP_EDGE_COLUMNS, edges)
        turned = take(graph.turning_points, chosen[graph.turning_points.vertex])
        part["turning_points"] = replace(turned, vertex=number[turned.vertex])
    else:
        part = columns_of(graph, VERTEX_COLUMNS, chosen) | columns_of(graph, EDGE_COLUMNS, edges)
    return part | {end: number[part[end]] for end in ("source", "target")}


def fused_of(members: Sequence[Mapping[str, Iterable[int]]]) -> dict[tuple[str, int], int]:
    """The fused vertex of every (run, vertex) that is a member."""
    return {(run, v): k for k, of in enumerate(members) for run, own in of.items() for v in own}


def fused_confidence(
    members: Sequence[Mapping[str, Sequence[int]]], maps: Mapping[str, TopoMap]
) -> FloatArray:
    """(n,) confidence of fused vertices: the mean of their members', weighted by passes."""
    passes = {run: m.passes for run, m in maps.items()}
    out = np.ones(len(members))
    for k, of in enumerate(members):
        rows = [(run, v) for run, vertices in sorted(of.items()) for v in vertices]
        weight = [max(int(passes[run][v]), 1) for run, v in rows]
        sure = [float(maps[run].confidence[v]) for run, v in rows]
        out[k] = np.average(sure, weights=weight)
    return out


class UnlistedPairs(Model):
    """Pairs of runs that a merge of more than 5,000 pairs counts and does not list in `merges`."""

    joined: Index = Field(description="In one component, through other runs.")
    unrelated: Index = Field(
        description="Not in one component; matched, without a significant match."
    )
    screened: Index = Field(
        description="Not in one component and not matched: no corridors that hang together look "
        "alike enough for the two runs to be merged. They count in threshold_bits like all pairs."
    )


@dataclass(frozen=True, slots=True, eq=False)
class MergeResult:
    """All that `merged.json` holds.

    verdicts: one per pair of runs, sorted by (a, b), without those that a large merge counts in
    `unlisted`. info: other entries of the document's `graph` (method, settings, warnings, layers).
    JSON values only.
    """

    components: tuple[Component, ...]
    fused: FusedMap
    verdicts: tuple[PairVerdict, ...]
    info: Mapping[str, Any] = field(default_factory=dict)
    unlisted: UnlistedPairs | None = None

    @property
    def component_of(self) -> dict[str, Component]:
        """The component of every run."""
        return {run: c for c in self.components for run in c.poses}

    @property
    def home(self) -> dict[str, int]:
        """The component of every run, by its number."""
        return home_of(self.components)

    @property
    def sites(self) -> dict[str, str]:
        """The site of every run, where it has a name."""
        return {run: c.site for c in self.components for run in c.poses if c.site}

    @property
    def described_sites(self) -> str:
        """ "3 sites, 2 runs alone"."""
        sites = sum(c.is_site for c in self.components)
        rest = len(self.components) - sites
        alone = f", {counted(rest, 'run')} alone" if rest else ""
        return f"{counted(sites, 'site')}{alone}"

    def standings(self) -> dict[Standing, int]:
        """Number of pairs, listed or not, in each state."""
        count = Counter(pair.standing for pair in self.verdicts)
        if (rest := self.unlisted) is not None:
            count[Standing.JOINED] += rest.joined
            count[Standing.UNRELATED] += rest.unrelated + rest.screened
        return {standing: count[standing] for standing in Standing}

    def __repr__(self) -> str:
        """One line."""
        runs = sum(len(c.poses) for c in self.components)
        pairs = ", ".join(f"{n} {standing}" for standing, n in self.standings().items() if n)
        return (
            f"<merge of {counted(runs, 'run')}: {self.described_sites}; pairs: {pairs or 'none'}>"
        )

    @property
    def threshold_bits(self) -> float | None:
        """What merging two runs by themselves takes; those that components joined took less."""
        thresholds = (pair.threshold_bits for pair in self.verdicts)
        return max((bits for bits in thresholds if bits is not None), default=None)


def shown_bits(bits: float, digits: int = 1) -> str:
    """Bits for people: those of the documents with fewer decimals, so that a number reads alike
    before and after it went through a document (3.846 is 3.85 there, and 3.9 here)."""
    return f"{round(bits, BITS):z.{digits}f}"


def shown_lead(bits: float, other: float, digits: int = 1) -> float:
    """The lead over another placement's evidence: the difference of the two as they are shown."""
    one, two = (float(shown_bits(b, digits)) for b in (bits, other))
    return round(one - two, digits) + 0.0


NEAR_M = 5.0
"""Distance of a matched junction from a view at which its weight has fallen to a quarter: corridors
between junctions are as long."""

RIGID_M, RIGID_WEIGHT = 10.0, 0.2
"""The pose of the whole run counts as four junctions at this distance, which weigh this much
together: for shifts a tenth of what junctions near a view weigh, for turns as much."""


def site_views(fused: FusedMap, component: Component, maps: Mapping[str, TopoMap]) -> list[Views]:
    """The views of the runs of a component, posed in its frame, by run.
    maps: as they were merged; runs that are not among them, or without views, are left out."""
    return [
        maps[run].views.moved(placed_at(fused, component, maps[run], maps[run].views.pose[:, :2]))
        for run in sorted(component.poses)
        if run in maps and len(maps[run].views)
    ]


def placed_at(
    fused: FusedMap, component: Component, topomap: TopoMap, xy: FloatArray
) -> FloatArray:
    """(k, 3) T_component_run near points (k, 2) of a run's map [m].

    A run's map bends as it is fused with others: each point moves as the junctions near it do, by a
    rigid fit with weights (moving least squares: Schaefer, McPhail, Warren, 2006). The pose of the
    whole run counts as well, which two junctions near each other hardly turn.
    """
    own, common = _members(fused, component, topomap)
    k, n = len(xy), len(own) + len(AROUND)
    around = xy[:, None] + RIGID_M * AROUND
    here = np.concatenate([np.broadcast_to(topomap.xy[own], (k, len(own), 2)), around], axis=1)
    T = component.poses[topomap.run]
    there = np.broadcast_to(fused.xy[common], (k, len(own), 2))
    there = np.concatenate([there, apply(T, around)], axis=1)
    away = np.hypot(*(topomap.xy[own][None] - xy[:, None]).transpose(2, 0, 1))
    weight = np.full((k, n), RIGID_WEIGHT / len(AROUND))
    weight[:, : len(own)] = (1 + (away / NEAR_M) ** 2) ** -2
    group = np.arange(k).repeat(n)
    return fit_groups(there.reshape(-1, 2), here.reshape(-1, 2), group, weight.ravel())


AROUND = np.array([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)])
"""Directions of the four points by which the pose of the whole run counts."""


def _members(fused: FusedMap, component: Component, topomap: TopoMap) -> tuple[IntArray, IntArray]:
    """Vertices of a run's map, and the fused vertices that they are part of."""
    pairs = [
        (vertex, row)
        for row in np.flatnonzero(fused.component == component.id).tolist()
        for vertex in fused.members[row].get(topomap.run, ())
        if vertex < len(topomap)
    ]
    own, common = np.array(pairs, np.int64).reshape(-1, 2).T
    return own, common
