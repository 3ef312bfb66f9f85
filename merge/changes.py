"""Changes between the runs of a component: corridors and junctions that some runs passed and
others, which should have met them, did not.

For every corridor driven by some run, each run that passed one of its ends is checked for having
seen the branch there. An unseen branch was missed by the detector, or is not there. The probability
of a miss is the run's own rate of wrong branches divided by the number of branches of the junction.
Several passes of one run by one junction count once, because detectors repeat their errors at a
place. The evidence is -log2 of the probability that all of them missed it; the threshold allows for
the number of tests (Bonferroni).

A junction of three that lost a branch may be detected no more, for instance by a laser that sees
a straight corridor there. A run that drove through it undetected, and along all its corridors but
one, is missing that corridor: one change, not one for each of its ends.

Nothing is missing for a run that knows another junction beside it: fused maps show some places
twice. Saved maps, which nobody drove and which have no times, take no part.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from scipy.spatial import cKDTree

from ..topology.arrays import FloatArray, IntArray
from ..topology.digits import METRES, rounded
from ..topology.matching.likelihood import LIKELIHOOD
from ..topology.matching.structure import padded_branches
from ..topology.polyline import leaving_rad, way_of
from ..topology.se2 import wrap
from ..topology.topomap import TopoMap
from .change import Change, ChangeKind, Witness
from .component_map import component_map
from .fusion.joint_graph import measured_turn
from .result import MergeResult


@dataclass(frozen=True, slots=True)
class ChangeSettings:
    """When a difference is reported as a change."""

    false_rate: float = 0.05
    """Probability that a report holds any false change (family-wise error rate)."""
    least_fault_rate: float = 0.01
    """Lower bound of the rates of missed branches and junctions: a run of a hundred passes cannot
    show less."""
    beside_m: float = 1.5
    """Junctions no farther apart, or than the position of one is uncertain (1 sigma), may be one
    place. Doublets of fused maps are about 1 m apart; a corridor and its walls have 1.5 m."""


CHANGES = ChangeSettings()


Missing = tuple[Witness, float]
"""A run that did not find a thing, with the probability that it missed it."""


def changes(result: MergeResult, component: int, maps: Mapping[str, TopoMap]) -> tuple[Change, ...]:
    """Changes between the runs of a component, by decreasing evidence, including those below the
    threshold.

    maps: of all its runs, as they were merged (`stale_runs`). O(corridors · runs).
    """
    merged = component_map(result, component, "merged", maps)
    ids: Sequence[int] = merged.info["numbers"]
    (site,) = (c for c in result.components if c.id == component)
    seen = _Seen(merged, dict(sorted(maps.items())), site.poses)
    corridors, asked, explained = _corridors(seen)
    junctions, more = _junctions(seen, explained)
    found = [
        replace(
            change,
            component=component,
            junctions=tuple(ids[k] for k in change.junctions),
            needed=_needed(tests),
        )
        for doubtful, tests in ((corridors, asked), (junctions, more))
        for change in doubtful
    ]
    return tuple(sorted(found, key=lambda c: (-c.bits, c.thing, c.junctions)))


def all_changes(result: MergeResult, maps: Mapping[str, TopoMap]) -> list[Change]:
    """Changes between the runs of every component, as of `changes`."""
    several = (c for c in result.components if len(c.poses) > 1)
    found = (changes(result, c.id, {run: maps[run] for run in c.poses}) for c in several)
    return list(chain.from_iterable(found))


def last_found(
    result: MergeResult, component: int, maps: Mapping[str, TopoMap]
) -> dict[int, Witness]:
    """The corridors of a component that are gone, by their edges in its map (`component_map`), each
    with the run that found it last. maps: as in `changes`."""
    return {
        c.edge: c.between[0]
        for c in changes(result, component, maps)
        if c.sure and c.kind is ChangeKind.GONE and c.edge is not None and c.between is not None
    }


class _Seen:
    """A component's fused map with the observations of its vertices by every run."""

    def __init__(
        self, merged: TopoMap, maps: Mapping[str, TopoMap], poses: Mapping[str, FloatArray]
    ) -> None:
        self.merged, self.maps = merged, {run: m for run, m in maps.items() if m.is_driven}
        self.nodes, self.edges = (
            [{run: of for run, of in seen.items() if run in self.maps} for seen in members[:count]]
            for members, count in (
                (merged.info["members"]["nodes"], len(merged)),
                (merged.info["members"]["edges"], len(merged.source)),
            )
        )
        self.passes = {
            run: [np.sort(m.observation_time_ns[m.observation_vertex == v]) for v in range(len(m))]
            for run, m in self.maps.items()
        }
        self._headings = {run: padded_branches(m) for run, m in self.maps.items()}
        self._fused = padded_branches(merged)
        self._turn = {run: float(poses[run][2]) for run in self.maps}
        self._near = _neighbours(merged)
        self._at: list[list[int]] = [[] for _ in self.nodes]
        for e, ends in enumerate(zip(merged.source.tolist(), merged.target.tolist(), strict=True)):
            for node in {*ends}:
                self._at[node].append(e)

    def places(self, run: str, node: int) -> list[int]:
        """The fused vertices that a run saw where a fused vertex is: itself and those beside it."""
        return [k for k in self._near[node] if run in self.nodes[k]]

    def is_double(self, edge: int) -> bool:
        """Whether a fused edge joins two vertices that may be one place."""
        return int(self.merged.target[edge]) in self._near[int(self.merged.source[edge])]

    def times(self, run: str, node: int) -> IntArray:
        """Times [ns] at which a run passed the place of a fused vertex."""
        at = [v for k in self.places(run, node) for v in self.nodes[k][run]]
        rows = [self.passes[run][v] for v in at]
        return np.sort(np.concatenate([np.zeros(0, np.int64), *rows]))

    def saw(self, run: str, node: int, heading: float) -> bool:
        """Whether a run saw a branch at a fused vertex. heading: in the component's frame [rad]."""
        gate = LIKELIHOOD.branch_gate_rad
        for place, v in [(k, v) for k in self.places(run, node) for v in self.nodes[k][run]]:
            own = self._headings[run][v]
            expected = np.array([self._turn[run]])
            turn, count = measured_turn(self._fused[place][None], own[None], expected)
            local = own + (turn[0] if count[0] else self._turn[run])
            if np.any(np.abs(wrap(local[~np.isnan(local)] - heading)) <= gate):
                return True
        return False

    def driven_through(self, run: str, node: int) -> list[int]:
        """A run's own corridors that lead through the place of a fused vertex which it did not
        detect."""
        if self.places(run, node):
            return []
        driven = Counter(k for e in self._at[node] for k in self.edges[e].get(run, ()))
        return sorted(k for k, times in driven.items() if times > 1)

    def not_driven(self, run: str, node: int) -> list[int]:
        """Fused edges at a fused vertex that a run did not drive."""
        return [e for e in self._at[node] if run not in self.edges[e]]

    def sides(self, node: int) -> int:
        """Ends of fused edges at a fused vertex."""
        m = self.merged
        return sum((int(m.source[e]) == node) + (int(m.target[e]) == node) for e in self._at[node])

    def overlooked(self, run: str, node: int, passes: int) -> float:
        """Probability that a run drove through a junction so many times without detecting it: at
        least the share of visits at which the runs that know it missed it."""
        measured = self.maps[run].measured
        known = self.nodes[node].items()  # none where only a saved map shows it
        unseen = (_unseen_share(self.maps[r], ids) for r, ids in known)
        rate = _fault_rate(max([measured.miss_rate, *unseen]))
        floor = _fault_rate(measured.branch_fault_rate) ** 2
        return max(rate ** max(passes, 1), floor)

    def heading(self, edge: int, end: int) -> float:
        """Direction [rad] in which a fused edge leaves its source (end 0) or its target (1)."""
        m = self.merged
        node = int((m.source, m.target)[end][edge])
        branch = int((m.source_branch, m.target_branch)[end][edge])
        if branch >= 0:
            return float(m.branches[node][branch])
        return leaving_rad(m.paths[edge], end)


def _neighbours(merged: TopoMap) -> list[list[int]]:
    """For every fused vertex, itself and those that may be the same place by where they lie."""
    sigma = np.zeros(len(merged)) if merged.position_sigma is None else merged.position_sigma
    reach = np.maximum(np.nan_to_num(sigma), CHANGES.beside_m)
    found: list[list[int]] = cKDTree(merged.xy).query_ball_point(merged.xy, reach).tolist()
    return [sorted(near) for near in found]


def _fault_rate(rate: float) -> float:
    """A rate of faults as measured, between `least_fault_rate` and one half."""
    return min(max(rate, CHANGES.least_fault_rate), 0.5)


def _corridors(seen: _Seen) -> tuple[list[Change], int, set[tuple[int, str]]]:
    """Corridors with runs that passed an end without seeing the branch, or that drove through an
    end along all its other corridors; the number of tests; the vertices that were driven through,
    each with the run."""
    out, asked, m = [], 0, seen.merged
    explained: set[tuple[int, str]] = set()
    for e, members in enumerate(seen.edges):
        if seen.is_double(e) or not members:
            continue
        missing = []
        ends = [int(m.source[e]), int(m.target[e])]
        headings = [seen.heading(e, k) for k in (0, 1)]
        for run in seen.maps:
            passed = [k for k in (0, 1) if seen.places(run, ends[k])]
            lost = [v for v in {*ends} if seen.not_driven(run, v) == [e]]
            through = {v: k for v in lost if (k := seen.driven_through(run, v))}
            if run in members or not (passed or through):
                continue
            asked += 1
            if any(seen.saw(run, ends[k], headings[k]) for k in passed):
                continue
            explained |= {(node, run) for node in through}
            missing.append(_missed(seen, run, {ends[k] for k in passed}, through))
        if missing:
            there = [_drove(seen, run, ids) for run, ids in sorted(members.items())]
            length = float(rounded(float(m.length[e]), METRES))
            out.append(
                _change(
                    "corridor", ends, _middle(m.paths[e]), there, missing, length=length, edge=e
                )
            )
    return out, asked, explained


def _missed(
    seen: _Seen, run: str, passed: Collection[int], through: Mapping[int, Sequence[int]]
) -> Missing:
    """The passes of a run by the ends of a corridor that it did not find, and the probability that
    it missed the branch at all ends that it passed, and the junction at all that it drove through
    (by the given own corridors)."""
    # The fault rate is per junction: divide it among the branches.
    rate = seen.maps[run].measured.branch_fault_rate
    chance = [_fault_rate(rate / len(seen.merged.branches[node])) for node in passed]
    times = [np.zeros(0, np.int64), *(seen.times(run, node) for node in passed)]
    by_ends = [_witness(run, np.sort(np.concatenate(times)))]
    for node, own in through.items():
        drives = _drove(seen, run, own)
        by_ends.append(drives)
        chance.append(seen.overlooked(run, node, drives.passes))
    known = [w for w in by_ends if w.passes] or by_ends
    first, last = min(w.first_ns for w in known), max(w.last_ns for w in known)
    witness = Witness(run, sum(w.passes for w in known), first, last)
    return witness, float(np.prod(chance))


def _junctions(seen: _Seen, explained: Set[tuple[int, str]]) -> tuple[list[Change], int]:
    """Junctions that runs drove through without detecting them, and the number of tests: one for
    each run that passed a junction known to several, or drove through one undetected, and one for
    each corridor that several drove, in which a junction may have been invented. explained: by a
    corridor that the run did not find (`_corridors`)."""
    out, m = [], seen.merged
    asked = sum(len(members) for members in seen.nodes if len(members) > 1)
    asked += sum(len(members) > 1 for members in seen.edges)
    for node, members in enumerate(seen.nodes):
        missing = []
        for run in seen.maps:
            through = seen.driven_through(run, node)
            if not through or (node, run) in explained:
                continue
            asked += 1
            witness = _drove(seen, run, through)
            missing.append((witness, seen.overlooked(run, node, witness.passes)))
        if missing and members:
            there = [_witness(run, seen.times(run, node)) for run in sorted(members)]
            invented = 1.0
            for w in there:
                rate = _fault_rate(seen.maps[w.run].measured.phantom_rate)
                invented *= rate**w.passes
            if seen.sides(node) > 2:
                invented = 0.0  # a run that turned off there proves it
            out.append(_change("junction", (node,), m.xy[node], there, missing, invented=invented))
    return out, asked


def _unseen_share(topomap: TopoMap, vertices: Sequence[int]) -> float:
    """Share of a run's visits to some of its own vertices without a detection."""
    ends = [np.isin(end, vertices) for end in (topomap.source, topomap.target)]
    visits = sum(int(topomap.traversals[end].sum()) for end in ends) // 2
    seen = int(np.isin(topomap.observation_vertex, vertices).sum())
    return max(0.0, 1 - seen / visits) if visits else 0.0


def _middle(path: FloatArray) -> FloatArray:
    """The point half-way along a path (2,) [m]."""
    way = way_of(path)
    return np.array([np.interp(way[-1] / 2, way, path[:, k]) for k in (0, 1)])


def _witness(run: str, times: IntArray) -> Witness:
    first, last = (int(times[0]), int(times[-1])) if len(times) else (0, 0)
    return Witness(run, len(times), first, last)


def _drove(seen: _Seen, run: str, edges: Sequence[int]) -> Witness:
    """A run's traversals of edges of its own map."""
    m = seen.maps[run]
    if m.traversal_ns is not None:
        return _witness(
            run, np.sort(np.concatenate([m.traversal_ns[k].max(axis=1) for k in edges]))
        )
    # Without times of the corridors, those of their ends.
    ends = {int(v) for k in edges for v in (m.source[k], m.target[k])}
    times = np.sort(np.concatenate([seen.passes[run][v] for v in ends]))
    seen_at = _witness(run, times)
    return Witness(run, int(m.traversals[list(edges)].sum()), seen_at.first_ns, seen_at.last_ns)


def _needed(tests: int) -> float:
    """Threshold [bits] for the number of tests: half of the false rate is for corridors, half for
    junctions. It exceeds what one junction can contribute, so that it takes two."""
    several = float(np.log2(2 * max(tests, 1) / CHANGES.false_rate))
    return max(several, -float(np.log2(CHANGES.least_fault_rate)))


def _change(
    thing: str,
    vertices: Sequence[int],
    xy: FloatArray,
    there: Sequence[Witness],
    missing: Sequence[Missing],
    *,
    invented: float = 0.0,
    length: float | None = None,
    edge: int | None = None,
) -> Change:
    """The change, by vertices of the component: GONE if all who did not find the thing passed after
    the last who did, NEW if before the first, else DIFFERS; with the evidence of all of them.

    invented: probability that those who passed it invented it.
    """
    kind, runs = ChangeKind.DIFFERS, [w for w, _ in missing]
    if min(w.first_ns for w in runs) > max(w.last_ns for w in there):
        kind = ChangeKind.GONE
    elif max(w.last_ns for w in runs) < min(w.first_ns for w in there):
        kind = ChangeKind.NEW
    chance = float(np.prod([p for _, p in missing])) + invented
    x, y = rounded(xy, METRES)
    return Change(
        thing=thing,
        kind=kind,
        component=0,
        junctions=tuple(vertices),
        xy=(x, y),
        length=length,
        there=tuple(sorted(there, key=lambda w: (w.first_ns, w.run))),
        missing=tuple(sorted(runs, key=lambda w: (w.first_ns, w.run))),
        bits=max(0.0, -float(np.log2(min(chance, 1.0)))),
        needed=0.0,
        edge=edge,
    )
