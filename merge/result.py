"""What merging says: a verdict for every pair of runs, and the fused map of every component."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, Literal, TypeVar, overload

import numpy as np

from ..topology.arrays import BoolArray, FloatArray, IntArray
from ..topology.columns import columns_of, take
from ..topology.digits import BITS
from ..topology.frozen import freeze
from ..topology.quadratic_forms import ONE_SIGMA, quadratic_quantile
from ..topology.topomap import (
    EDGE_COLUMNS,
    MAP_EDGE_COLUMNS,
    MAP_VERTEX_COLUMNS,
    VERTEX_COLUMNS,
    Graph,
    TopoMap,
)

T = TypeVar("T")


class Verdict(StrEnum):
    """The three answers to "do these two runs share places, and where?"."""

    MERGED = "merged"
    AMBIGUOUS = "ambiguous"
    UNRELATED = "unrelated"


class Standing(StrEnum):
    """What became of a pair, for people: the verdict, and what other runs and later checks made of
    it. JOINED: unrelated by itself, and yet in one component; KEPT_OUT: it fits, but a later check
    kept it out."""

    MERGED = "merged"
    JOINED = "joined through others"
    AMBIGUOUS = "ambiguous"
    KEPT_OUT = "kept out"
    UNRELATED = "unrelated"


AcceptedBy = Literal["pair", "components", "runs", "lock"]
"""What an accepted pair was accepted by: its own evidence; that of the two components it joins;
other runs, which place the two as one of the pair's own alignments does; a person."""


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """One way to lay map b over map a.

    transform: (3,) T_a_b as x, y [m], theta [rad]; evidence_bits: log2 odds of the question that
    it answers worst: more than chance offers? and, asked where a building may repeat itself: this
    place, not a copy of it? (counted so that both need the same for merging); matched: (k, 2)
    int64 pairs (vertex of a, vertex of b), sorted; rmse_m: root mean square distance of the
    matched vertices under the transform; contradictions: sentences, one per disagreement found
    ("junction 12 of run2 falls inside corridor 3–4 of run1, unseen there"); contradicting: for each
    of these the vertices of a and of b that it speaks of, a corridor as its two ends; empty where
    that is not known.
    """

    transform: FloatArray
    evidence_bits: float
    matched: IntArray
    rmse_m: float
    corridors: int = 0
    contradictions: tuple[str, ...] = ()
    contradicting: tuple[tuple[tuple[int, ...], tuple[int, ...]], ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "matched", np.reshape(self.matched, (-1, 2)))
        freeze(self, np.float64, transform=(3,))
        freeze(self, np.int64, matched=(None, 2))
        if self.contradicting and len(self.contradicting) != len(self.contradictions):
            raise ValueError("every contradiction needs its vertices, or none of them")


@dataclass(frozen=True, slots=True, eq=False)
class PairVerdict:
    """What is known about one pair of runs, `a < b` by name.

    accepted: the pair joins a component (verdict MERGED and kept by every later check), by what
    accepted_by says. threshold_bits: the evidence that merging needs, None where a method has no
    such threshold. best: the alignment the verdict speaks of, None for most unrelated pairs;
    runner_up: the next best one that places b elsewhere; evidence_bits: those of best; margin_bits:
    how many more they are than those of runner_up (negative where a person or other runs chose
    against the pair's own evidence). Of runs joined by what their components say together best, its
    bits and margin_bits are those of the two components, and there is no runner_up. advice: what
    would settle an ambiguous pair; locked: "same" or "never" where a person decided. through: of
    two runs that only others place in one component, the runs of the shortest chain of accepted
    pairs from a to b, without these two; placed: how far off [m] the middle of one's map
    then lies at most in 68.3 % of cases, seen from the other's (the root mean square of both ways
    to see it), and 1 sigma [rad] of the turn between them. together: the runs of the two components
    whose evidence joined the pair. transform_sigma: the same as `placed` of an accepted pair, as
    all maps of its component place it together. extra: JSON values that a method adds to its entry.
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
    extra: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.a < self.b:
            raise ValueError(f"a pair is ordered by name: {self.a!r}, {self.b!r}")
        if self.accepted and self.best is None:
            raise ValueError("an accepted pair needs its alignment")

    @property
    def standing(self) -> Standing:
        """What became of the pair."""
        if self.accepted:
            return Standing.MERGED
        if self.verdict is Verdict.AMBIGUOUS:
            return Standing.AMBIGUOUS
        if self.verdict is Verdict.MERGED:
            return Standing.KEPT_OUT
        return Standing.JOINED if self.through else Standing.UNRELATED


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """Errors of the placements of r runs, sorted by name, all in one frame.

    middle: (r, 2) middles of their maps [m]; own: (r, 3, 3) covariance of x, y of the middle and
    of the turn of each map [m, rad]; cross: (k, 3, 3) covariance of
    run i with run j, of those pairs i < j of which something is stated; key: (k,) i r + j of each,
    ascending.
    """

    runs: tuple[str, ...]
    middle: FloatArray
    own: FloatArray
    key: IntArray
    cross: FloatArray

    def relative(self, pairs: Sequence[tuple[str, str]]) -> FloatArray:
        """(k, 3, 3) covariances of where the middle of the second map of each pair lies, seen from
        the first, and of the turn between them, in the axes of the common frame [m, rad]. Raises
        KeyError of pairs that were not asked for."""
        i, j = self._rows(pairs)
        x, y = (self.middle[j] - self.middle[i]).T
        # What is seen is A e_i + e_j, of the errors of the two.
        A = np.zeros((len(i), 3, 3)) - np.eye(3)
        A[:, 0, 2], A[:, 1, 2] = y, -x
        both = A @ self._cross(i, j)
        whole = A @ self.own[i] @ A.transpose(0, 2, 1) + both + both.transpose(0, 2, 1)
        return np.asarray(whole + self.own[j])

    def sigmas(
        self, pairs: Sequence[tuple[str, str]], share: float = ONE_SIGMA
    ) -> list[tuple[float, float]]:
        """[m] how far off the middle of one's map lies, seen from the other's (root mean square of
        both ways to see it), no farther in `share` of all cases; [rad] 1 sigma of the turn."""
        i, j = self._rows(pairs)
        x, y = (self.middle[j] - self.middle[i]).T
        covariance = self.relative(pairs)
        # Seen the other way round the middle is off by as much, less the turn about the step.
        back = np.zeros((len(i), 2, 3)) - np.eye(2, 3)
        back[:, 0, 2], back[:, 1, 2] = -y, x
        form = (np.diag([1.0, 1.0, 0.0]) + back.transpose(0, 2, 1) @ back) / 2
        metres = np.sqrt(quadratic_quantile(covariance @ form, share))
        return list(zip(metres.tolist(), np.sqrt(covariance[:, 2, 2]).tolist(), strict=True))

    def _rows(self, pairs: Sequence[tuple[str, str]]) -> tuple[IntArray, IntArray]:
        ends = [[bisect_left(self.runs, run) for run in pair] for pair in pairs]
        i, j = np.array(ends, np.int64).reshape(-1, 2).T
        return i, j

    def _cross(self, i: IntArray, j: IntArray) -> FloatArray:
        """(k, 3, 3) covariances of runs i with runs j."""
        key = np.minimum(i, j) * len(self.runs) + np.maximum(i, j)
        row = np.searchsorted(self.key, key)
        known = row < len(self.key)
        known[known] = self.key[row[known]] == key[known]
        if not known.all():
            k = int(np.argmin(known))
            raise KeyError((self.runs[i[k]], self.runs[j[k]]))
        cross = self.cross[row]
        return np.where((i < j)[:, None, None], cross, cross.transpose(0, 2, 1))


@dataclass(frozen=True, slots=True, eq=False)
class Component:
    """Runs that were merged; `poses[run]` is T_component_run (3,); spread: how sure they are, if
    asked for; text: what the document says of its places (`document.places_text`), where that is
    known."""

    id: int
    poses: Mapping[str, FloatArray]
    spread: Spread | None = None
    text: bytes = b""


class Late(Sequence[T]):
    """Some entries, which are made when somebody first asks for one: of a component that was kept
    nobody may ever ask."""

    __slots__ = ("_count", "_made", "_make")

    def __init__(self, count: int, make: Callable[[], Sequence[T]]) -> None:
        self._count = count
        self._make = make
        self._made: Sequence[T] | None = None

    def _whole(self) -> Sequence[T]:
        if self._made is None:
            self._made = self._make()
        return self._made

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, k: int) -> T: ...
    @overload
    def __getitem__(self, k: slice) -> Sequence[T]: ...
    def __getitem__(self, k: int | slice) -> T | Sequence[T]:
        return self._whole()[k]

    def __iter__(self) -> Iterator[T]:
        return iter(self._whole())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and tuple(self) == tuple(other)

    __hash__ = None  # type: ignore[assignment]


@dataclass(frozen=True, slots=True, eq=False)
class FusedMap(Graph):
    """The fused vertices and edges of all components.

    component: (n,) id of the component whose frame the vertex is drawn in; members: for each
    vertex the vertices of the runs' maps that it fuses; observations: for each vertex
    (run, time_ns) sorted; edge_members: for each edge the (run, edge index) pairs it fuses;
    position_sigma: (n,) as in TopoMap with each component for itself, NaN where not known.
    Turning points of runs (`TopoMap.turning_points`) are the last vertices, and the ways to them
    the last edges; their members are numbered as in documents, after all vertices of their run.
    """

    component: IntArray
    members: Sequence[Mapping[str, tuple[int, ...]]]
    observations: Sequence[tuple[tuple[str, int], ...]]
    edge_members: Sequence[tuple[tuple[str, int], ...]]
    position_sigma: FloatArray | None = None

    @property
    def turned(self) -> int:
        """How many of its vertices, and of its edges, are of turning points."""
        return int(self.is_turned.sum())

    @property
    def junctions(self) -> int:
        """How many of its vertices are not."""
        return len(self) - self.turned


def pairs_of(runs: int) -> int:
    """How many pairs of runs there are."""
    return runs * (runs - 1) // 2


def by_run(members: Iterable[tuple[str, int]]) -> dict[str, tuple[int, ...]]:
    """(run, index) pairs as the indices of every run, in the order of the pairs."""
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
    """The fused vertex of every (run, vertex) that is a member of one."""
    return {(run, v): k for k, of in enumerate(members) for run, own in of.items() for v in own}


def fused_confidence(
    members: Sequence[Mapping[str, Sequence[int]]], maps: Mapping[str, TopoMap]
) -> FloatArray:
    """(n,) confidence of fused vertices: the mean of their members', by passes."""
    passes = {run: m.passes for run, m in maps.items()}
    out = np.ones(len(members))
    for k, of in enumerate(members):
        rows = [(run, v) for run, vertices in sorted(of.items()) for v in vertices]
        weight = [max(int(passes[run][v]), 1) for run, v in rows]
        sure = [float(maps[run].confidence[v]) for run, v in rows]
        out[k] = np.average(sure, weights=weight)
    return out


@dataclass(frozen=True, slots=True)
class Unlisted:
    """Pairs of runs that a large merge counts instead of listing: none of them is accepted, or
    speaks for an alignment, or was spoken of by a person.

    joined: in one component, through other runs; of the others: unrelated: matched, with nothing
    that chance would not offer; screened: not matched, as no corridors that hang together look
    alike enough for the two to be merged.
    """

    joined: int = 0
    unrelated: int = 0
    screened: int = 0


def nothing_kept(_: PairVerdict) -> bytes | None:
    """Where no entries of the document are known already."""
    return None


@dataclass(frozen=True, slots=True, eq=False)
class MergeResult:
    """Everything `merged.json` holds.

    verdicts: one per pair of runs, sorted by (a, b), but for those that a large merge counts in
    `unlisted`. info: what else the document's `graph` says (method, settings, warnings, layers).
    JSON values only. kept_entry: what the document says of a verdict, as JSON, where that is known
    already.
    """

    components: tuple[Component, ...]
    fused: FusedMap
    verdicts: tuple[PairVerdict, ...]
    info: Mapping[str, Any] = field(default_factory=dict)
    unlisted: Unlisted | None = None
    kept_entry: Callable[[PairVerdict], bytes | None] = nothing_kept

    def standings(self) -> dict[Standing, int]:
        """How many pairs, listed or not, stand how."""
        count = Counter(pair.standing for pair in self.verdicts)
        rest = self.unlisted or Unlisted()
        count[Standing.JOINED] += rest.joined
        count[Standing.UNRELATED] += rest.unrelated + rest.screened
        return {standing: count[standing] for standing in Standing}


def shown_bits(bits: float, digits: int = 1) -> str:
    """Bits as people read them: those of the documents with no more decimals, so that a number
    reads alike before and after it went through a document (3.846 is 3.85 there, and 3.9 here)."""
    return f"{round(bits, BITS):.{digits}f}"
