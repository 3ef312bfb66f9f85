"""The merged maps of components, prepared for matching; each is fused and matched once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property, partial
from itertools import combinations

import numpy as np

from ...topology.topomap import RunNoise, TopoMap
from ..fusion.fuse import component_digest, fuse
from ..packs import Kept, Key, Kind, arrays_from_bytes, arrays_to_bytes
from ..result import Alignment, FusedMap, PairVerdict, Verdict, fused_confidence, graph_part
from .alignment import Candidate, match
from .mirror import mirrored
from .prepare import Extent, Prepared, prepare
from .records import from_bytes, in_short, to_bytes
from .settings import RobustSettings

Pair = tuple[int, int]
Runs = tuple[int, ...]


class MergedMap:
    """The merged map of some runs, made on first access. inside: the verdicts that join them."""

    def __init__(
        self,
        runs: Runs,
        own: Sequence[TopoMap],
        inside: Sequence[PairVerdict],
        prepared: Callable[[], Prepared] | None,
        kept: Kept | None,
    ) -> None:
        self.runs = runs
        self.maps = dict(zip(runs, own, strict=True))
        self._inside = inside
        self._prepared = prepared
        self._kept = kept

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its runs."""
        return tuple(m.run for m in self.maps.values())

    @cached_property
    def digest(self) -> bytes:
        """Digest of all that it follows from; empty if nothing is kept."""
        own, kept = list(self.maps.values()), self._kept
        if kept is None:
            return b""
        return component_digest([kept.digest(m) for m in own], own, self._inside)

    @cached_property
    def _fused(self) -> FusedMap:
        return fuse(list(self.maps.values()), self._inside, kept=self._kept)[1]

    @cached_property
    def members(self) -> Sequence[Mapping[str, tuple[int, ...]]]:
        """For each vertex, the vertices of the runs behind it."""
        if len(self.runs) > 1:
            return self._fused.members
        (alone,) = self.maps.values()
        return tuple({alone.run: (v,)} for v in range(len(alone)))

    @cached_property
    def as_map(self) -> TopoMap:
        """As the map of one run that saw everything."""
        own = list(self.maps.values())
        return own[0] if len(own) == 1 else _as_map(self._fused, own)

    @cached_property
    def extent(self) -> Extent:
        """Its size."""
        return Extent.of(self._fused if len(self.runs) > 1 else self.as_map)

    @cached_property
    def prepared(self) -> Prepared:
        """Prepared for matching."""
        return self._prepared() if self._prepared else prepare(self.as_map)


class MergedMaps:
    """The merged maps of groups of runs, and their matches. kept: results of earlier merges."""

    def __init__(
        self,
        maps: Sequence[TopoMap],
        prepared: Sequence[Prepared] = (),
        kept: Kept | None = None,
    ) -> None:
        self._maps = maps
        self._prepared = prepared
        self._kept = kept
        self._made: dict[tuple[Runs, tuple[tuple[Pair, bytes], ...]], MergedMap] = {}
        self._matched: dict[tuple[MergedMap, MergedMap], tuple[Candidate, ...]] = {}
        self._images: dict[tuple[MergedMap, MergedMap], float] = {}

    def of(self, runs: Runs, accepted: Mapping[Pair, Alignment]) -> MergedMap:
        """The merged map of some runs, sorted, by the accepted alignments between them."""
        known = [(pair, accepted[pair]) for pair in _inside(runs, accepted)]
        key = runs, tuple((pair, a.matched.tobytes()) for pair, a in known)
        if key not in self._made:
            maps = self._maps
            inside = [
                PairVerdict(
                    maps[i].run, maps[j].run, Verdict.MERGED, True, len(a.matched), "", best=a
                )
                for (i, j), a in known
            ]
            alone = None
            if self._prepared and len(runs) == 1:
                alone = partial(self._prepared.__getitem__, runs[0])
            own = [maps[i] for i in runs]
            self._made[key] = MergedMap(runs, own, inside, alone, self._kept)
        return self._made[key]

    def matched(
        self, one: MergedMap, two: MergedMap, settings: RobustSettings
    ) -> tuple[Candidate, ...]:
        """The candidates of two of them that are beyond chance."""
        if (one, two) not in self._matched:
            self._matched[one, two] = self._candidates(one, two, settings)
        return self._matched[one, two]

    def _candidates(
        self, one: MergedMap, two: MergedMap, settings: RobustSettings
    ) -> tuple[Candidate, ...]:
        data = self._find(Kind.PAIR, one, two)
        if data == b"":
            return ()
        found = None if data is None else from_bytes(data, one.extent, two.extent)
        if found is None:
            every = match(one.prepared, two.prepared, settings, rivals=True)
            found = in_short(every, settings).candidates
            self._keep(Kind.PAIR, one, two, to_bytes(found))
        return found

    def image_bits(self, one: MergedMap, two: MergedMap, settings: RobustSettings) -> float:
        """Evidence of the best alignment of the first with the mirror image of the second
        [bits]."""
        if (one, two) not in self._images:
            self._images[one, two] = self._image_bits(one, two, settings)
        return self._images[one, two]

    def _image_bits(self, one: MergedMap, two: MergedMap, settings: RobustSettings) -> float:
        data = self._find(Kind.IMAGE, one, two)
        known = None if data is None else arrays_from_bytes(data, "f")
        if known is not None and len(known[0]) < 2:
            return float(max(known[0], default=-np.inf))
        found = match(one.prepared, prepare(mirrored(two.as_map)), settings)
        best = np.array([c.bits for c in found[:1]])
        self._keep(Kind.IMAGE, one, two, arrays_to_bytes([best]))
        return float(max(best, default=-np.inf))

    def _find(self, kind: Kind, one: MergedMap, two: MergedMap) -> bytes | None:
        return None if self._kept is None else self._kept.find(kind, _key(one, two))

    def _keep(self, kind: Kind, one: MergedMap, two: MergedMap, payload: bytes) -> None:
        if self._kept is not None:
            self._kept.add(kind, _key(one, two), payload)


def _key(one: MergedMap, two: MergedMap) -> Key:
    return one.digest, two.digest


def _inside(runs: Runs, accepted: Mapping[Pair, Alignment]) -> Iterator[Pair]:
    """The accepted pairs of some sorted runs, in order, by the shorter of two searches."""
    if len(runs) ** 2 < len(accepted):
        return (pair for pair in combinations(runs, 2) if pair in accepted)
    those = set(runs)
    return (pair for pair in sorted(accepted) if those.issuperset(pair))


def _as_map(fused: FusedMap, own: Sequence[TopoMap]) -> TopoMap:
    """A fused map as the map of one run that saw everything, with the noise of the worst run."""
    observations = np.array([len(seen) for seen in fused.observations])
    times = np.arange(int(observations.sum()), dtype=np.int64)
    fields = RunNoise.__dataclass_fields__
    noise = RunNoise(**{name: max(getattr(m.noise, name) for m in own) for name in fields})
    return TopoMap(
        run="+".join(m.run for m in own),
        frame="component",
        observation_vertex=np.repeat(np.arange(len(observations)), observations),
        observation_time_ns=times,
        noise=noise,
        shows_bends=any(m.shows_bends for m in own),
        confidence=fused_confidence(fused.members, {m.run: m for m in own}),
        **graph_part(fused, np.ones(len(fused), np.bool_)),
    )
