"""`method="paper"`: Huang & Beevers, *Topological Map Merging*, as published.

For every pair of maps: grow hypotheses (§2), estimate their transforms (§3.1), cluster them (§3.2),
take the best cluster. The paper leaves the final decision to its reader ("even the best cluster
choice may later turn out to be incorrect"); here a cluster has to exceed chance, and any cluster
that places the maps otherwise (`significance`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations
from math import log2

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.errors import UsageError
from ...topology.matching.correspondence import DEFAULT_GROWTH, GrowthSettings, candidate_nodes
from ...topology.matching.structure import Structure, prepare
from ...topology.se2 import apply, between
from ...topology.topomap import TopoMap
from ...topology.wording import counted
from ..locks import Lock, locks_among
from ..result import Alignment, PairVerdict, Verdict, shown_bits
from ..wording import describe_bits
from .clustering import DEFAULT_CLUSTERS, Clusters, ClusterSettings, cluster
from .hypotheses import Hypotheses, hypothesise
from .locking import with_locks
from .meeting import Meeting, near_vertices
from .significance import SelfSimilarity, cluster_bits, self_similarity


@dataclass(frozen=True, slots=True)
class PaperSettings:
    """The paper's method, and the significance required of its best cluster."""

    growth: GrowthSettings = DEFAULT_GROWTH
    clusters: ClusterSettings = DEFAULT_CLUSTERS
    false_merge_rate: float = 1e-3
    """Probability that a batch of maps holds any false merge. Clusters that chance explains more
    often are "generally not significant" (§3.2)."""
    rival_m: float = 3.0
    """A cluster is a rival if it moves the best cluster's vertices by more than this [m]."""
    rival_rad: float = 0.35
    """A cluster is also a rival if it rotates them by more than this [rad]."""
    meetings: tuple[Meeting, ...] = ()
    """Runs that met: matches are grown from pairs of vertices near both robots only (§4.2)."""

    def __post_init__(self) -> None:
        if not 0.0 < self.false_merge_rate < 1.0:
            raise UsageError(f"a rate lies between 0 and 1, not at {self.false_merge_rate}")

    def needed_bits(self, pairs: int = 1) -> float:
        """Threshold [bits] of the evidence, and of its lead, in a batch of so many pairs."""
        return log2(max(pairs, 1) / self.false_merge_rate)


DEFAULT_PAPER = PaperSettings()


@dataclass(frozen=True, slots=True, eq=False)
class PreparedMap:
    """All that matching needs of one map; a pure function of the map."""

    run: str
    structure: Structure
    xy: FloatArray
    alike: SelfSimilarity
    near: Mapping[Meeting, IntArray] = field(default_factory=dict)
    """Vertices near the robot at each of its meetings."""


@dataclass(frozen=True, slots=True, eq=False)
class Matching:
    """The hypotheses and clusters of two maps."""

    hypotheses: Hypotheses
    clusters: Clusters

    @property
    def bits(self) -> FloatArray:
        """(C,) evidence of each cluster against chance."""
        return cluster_bits(self.clusters.of, self.hypotheses.bits, len(self.clusters))


def prepare_map(topomap: TopoMap, settings: PaperSettings = DEFAULT_PAPER) -> PreparedMap:
    """Prepare a map for any number of comparisons."""
    near = {}
    for m in settings.meetings:
        if topomap.run in (m.run_a, m.run_b):
            time_ns = m.time_a_ns if topomap.run == m.run_a else m.time_b_ns
            near[m] = near_vertices(topomap, time_ns, m.range_m)
    structure = prepare(topomap)
    alike = self_similarity(structure, settings.growth)
    return PreparedMap(topomap.run, structure, topomap.xy, alike, near)


def match(a: PreparedMap, b: PreparedMap, settings: PaperSettings = DEFAULT_PAPER) -> Matching:
    """Hypotheses and their clusters, §2 and §3."""
    hypotheses = hypothesise(
        a.structure,
        b.structure,
        (a.xy, b.xy),
        settings.growth,
        near=_near(a, b, settings),
        alike=(a.alike, b.alike),
        weights=settings.clusters.weights,
    )
    return Matching(hypotheses, cluster(hypotheses, (a.xy, b.xy), settings.clusters))


def _near(
    a: PreparedMap, b: PreparedMap, settings: PaperSettings
) -> tuple[IntArray, IntArray] | None:
    """The vertices of both maps near a meeting of the two; None if they did not meet."""
    meeting = next((m for m in settings.meetings if m in a.near and m in b.near), None)
    return None if meeting is None else (a.near[meeting], b.near[meeting])


def decide(
    maps: Sequence[TopoMap],
    settings: PaperSettings = DEFAULT_PAPER,
    *,
    locks: Sequence[Lock] = (),
    on_pair: Callable[[int, int], None] | None = None,
    executor: Executor | None = None,
) -> tuple[PairVerdict, ...]:
    """A verdict for every pair of maps, sorted by name. on_pair(done, total) after each pair.

    Raises UsageError on locks that contradict each other or name a junction that does not exist,
    and on a meeting of a run that is not among the maps.
    """
    ordered = sorted(maps, key=lambda m: m.run)
    by_run = {m.run: m for m in ordered}
    for run in (run for m in settings.meetings for run in (m.run_a, m.run_b)):
        if run not in by_run:
            raise UsageError(f"a meeting names run {run!r}, which is not among the maps")
    table = locks_among(locks, by_run)
    prepared = [prepare_map(m, settings) for m in ordered]
    pairs = list(combinations(prepared, 2))
    out = []
    for verdict in _judged(pairs, settings, executor):
        out.append(verdict)
        if on_pair is not None:
            on_pair(len(out), len(pairs))
    return with_locks(out, table, lambda lock: _forced(by_run, lock, settings))


def _forced(by_run: Mapping[str, TopoMap], lock: Lock, settings: PaperSettings) -> Alignment | None:
    """The best cluster that satisfies a "same" lock; None if there is none."""
    a, b = (prepare_map(by_run[run], settings) for run in (lock.a, lock.b))
    found = match(a, b, settings)
    h, c = found.hypotheses, found.clusters
    if lock.at is None:
        return alignment(a, b, found, int(np.argmax(found.bits))) if len(c) else None
    rows = np.flatnonzero((h.vertex_a == lock.at[0]) & (h.vertex_b == lock.at[1]))
    numbers = c.of[h.of[rows]]
    numbers = numbers[numbers >= 0]
    return alignment(a, b, found, int(numbers.min())) if len(numbers) else None


def _judged(
    pairs: Sequence[tuple[PreparedMap, PreparedMap]],
    settings: PaperSettings,
    executor: Executor | None,
) -> Iterator[PairVerdict]:
    """Verdicts in the order of the pairs; with an executor in batches, to keep messages few."""
    judged = partial(_judge_pair, settings=settings, pairs=len(pairs))
    if executor is None:
        return map(judged, pairs)
    return executor.map(judged, pairs, chunksize=max(1, min(32, len(pairs) // 64)))


def _judge_pair(
    pair: tuple[PreparedMap, PreparedMap], settings: PaperSettings, pairs: int
) -> PairVerdict:
    return judge(*pair, settings, pairs)


def judge(
    a: PreparedMap, b: PreparedMap, settings: PaperSettings = DEFAULT_PAPER, pairs: int = 1
) -> PairVerdict:
    """The most significant cluster of a pair, and whether it suffices to merge.

    pairs: number of pairs of maps in the batch.
    """
    found = match(a, b, settings)
    if len(found.clusters) == 0:
        reason = _nothing(a, b, settings)
        needed = settings.needed_bits(pairs)
        return PairVerdict(
            a.run, b.run, Verdict.UNRELATED, False, 0.0, reason, threshold_bits=needed
        )
    ranked = np.argsort(-found.bits, kind="stable").tolist()
    best = alignment(a, b, found, ranked[0])
    rival = _rival(found, ranked, b, settings)
    second = None if rival is None else alignment(a, b, found, rival)
    lead = best.evidence_bits - (0.0 if second is None else second.evidence_bits)
    needed = settings.needed_bits(pairs)
    verdict = _verdict(best.evidence_bits, lead, needed)
    related = verdict is not Verdict.UNRELATED
    return PairVerdict(
        a=a.run,
        b=b.run,
        verdict=verdict,
        accepted=verdict is Verdict.MERGED,
        evidence_bits=best.evidence_bits,
        reason=_reason(best, second, needed, found),
        best=best if related else None,
        runner_up=second if related else None,
        margin_bits=None if second is None else lead,
        advice=_advice(best.evidence_bits, needed) if verdict is Verdict.AMBIGUOUS else None,
        threshold_bits=needed,
        accepted_by="pair" if verdict is Verdict.MERGED else None,
    )


def _nothing(a: PreparedMap, b: PreparedMap, settings: PaperSettings) -> str:
    """Why two maps have no hypothesis."""
    near = _near(a, b, settings)
    nodes = candidate_nodes(a.structure, b.structure, settings.growth, near)
    pairs = len(set(zip(nodes.vertex_a.tolist(), nodes.vertex_b.tolist(), strict=True)))
    where = "" if near is None else " near both robots"
    if pairs == 0:
        return f"no pair of junctions{where} is compatible"
    compatible = f"{counted(pairs, 'compatible pair')} of junctions{where}"
    return f"{compatible}, none of which fits along its corridors"


def _verdict(bits: float, lead: float, needed: float) -> Verdict:
    """The verdict by a cluster's evidence and its lead over the best rival [bits]."""
    if bits <= 0:
        return Verdict.UNRELATED
    return Verdict.MERGED if min(bits, lead) >= needed else Verdict.AMBIGUOUS


def _reason(best: Alignment, second: Alignment | None, needed: float, found: Matching) -> str:
    """The evidence of the best cluster in words."""
    what = (
        f"the best of {counted(len(found.clusters), 'cluster')} matches "
        f"{counted(len(best.matched), 'junction')} and {counted(best.corridors, 'corridor')}: "
        f"{describe_bits(best.evidence_bits, needed)}"
    )
    if best.evidence_bits <= 0:
        return f"{what}; chance offers as much"
    if best.evidence_bits < needed:
        return f"{what}; chance offers as much in one of {2**best.evidence_bits:.0f} such pairs"
    if second is None:
        return f"{what}; none places the runs otherwise"
    lead = best.evidence_bits - second.evidence_bits
    return f"{what}; the next that places the runs otherwise has {shown_bits(lead)} less"


def _advice(bits: float, needed: float) -> str:
    """What would settle an ambiguous pair."""
    if bits < needed:
        return "drive more of the places that both runs know"
    return "drive on to where the two placements differ"


def _rival(
    found: Matching, ranked: Sequence[int], b: PreparedMap, settings: PaperSettings
) -> int | None:
    """The first of the ranked clusters with another placement of b than the first."""
    h, c = found.hypotheses, found.clusters
    points = b.xy[np.unique(h.vertex_b[c.of[h.of] == ranked[0]])]
    at = c.transform[ranked[0]]
    home = apply(at, points)
    for k in ranked[1:]:
        moved = np.sqrt(((apply(c.transform[k], points) - home) ** 2).sum(axis=1).mean())
        turned = abs(between(at, c.transform[k])[2])
        if moved > settings.rival_m or turned > settings.rival_rad:
            return k
    return None


def alignment(a: PreparedMap, b: PreparedMap, found: Matching, number: int) -> Alignment:
    """A cluster as an alignment: its transform and its pairs, one to one."""
    h, c = found.hypotheses, found.clusters
    rows = np.flatnonzero(c.of[h.of] == number)
    T = c.transform[number]
    error = np.hypot(*(a.xy[h.vertex_a[rows]] - apply(T, b.xy[h.vertex_b[rows]])).T)
    rows = rows[one_to_one(h.vertex_a[rows], h.vertex_b[rows], h.size[h.of[rows]], error)]
    matched = np.column_stack([h.vertex_a[rows], h.vertex_b[rows]])
    residual = a.xy[matched[:, 0]] - apply(T, b.xy[matched[:, 1]])
    corridors = int(h.corridors[c.of == number].sum())
    return Alignment(
        transform=T,
        evidence_bits=float(found.bits[number]),
        matched=matched[np.lexsort((matched[:, 1], matched[:, 0]))],
        rmse_m=float(np.sqrt((residual**2).sum(axis=1).mean())),
        corridors=corridors,
    )


def one_to_one(
    vertex_a: IntArray, vertex_b: IntArray, size: IntArray, error: FloatArray
) -> IntArray:
    """Rows that pair no vertex twice: larger hypotheses first, then the nearer pair."""
    taken_a: set[int] = set()
    taken_b: set[int] = set()
    keep = []
    for row in np.lexsort((vertex_b, vertex_a, error, -size)).tolist():
        u, v = int(vertex_a[row]), int(vertex_b[row])
        if u not in taken_a and v not in taken_b:
            taken_a.add(u)
            taken_b.add(v)
            keep.append(row)
    return np.array(sorted(keep), np.int64)
