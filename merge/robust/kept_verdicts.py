"""Verdicts on two maps by themselves, kept from merge to merge as entries of the document.

Such a verdict follows from the two maps and their threshold (`Threshold`), which one more run
leaves unchanged for most pairs. It is kept as its entry in the merged document with all digits:
read again it is the same to the last bit, and the entry need not be made again. What is read is
validated against the two maps.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, field, fields
from functools import lru_cache
from math import isfinite
from types import MappingProxyType
from typing import Annotated, Any, Literal, NotRequired

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, TypeAdapter
from typing_extensions import TypedDict

from ...topology.arrays import FloatArray
from ...topology.files import Json, encoded
from ...topology.map_schema import Finite, Index
from ...topology.topomap import TopoMap
from ..digests import digested
from ..document import EXTRA, entry_of
from ..packs import LARGEST, Key, Kind, PackWriter, Store
from ..result import Alignment, PairVerdict, Verdict
from .repetition import CopyModel
from .verdict import Threshold

Pair = tuple[int, int]
MatchedRows = NDArray[np.uint32]

NONE: Mapping[Pair, int] = MappingProxyType({})

NUMBERS = 3 + 2 * 5
HEAD = struct.Struct(f"<{NUMBERS}d2I")
"""Binary header before the entry: evidence, threshold and margin [bits] of a verdict; x, y, theta,
evidence and error of its alignment and of the runner-up, 0 if there is none; numbers of matched
junctions of both. The matched junctions follow, then the entry without them: validating numbers as
JSON would take two thirds of the time."""

NO_MATCHED = b'"matched":[]'
"""Placeholder for them in the entry; cannot occur inside a string, where quotes are escaped."""


def to_bytes(verdict: PairVerdict) -> bytes:
    """Serialised verdict on two maps alone."""
    both = [_numbers(verdict.best), _numbers(verdict.runner_up)]
    own = [verdict.evidence_bits, verdict.threshold_bits or 0.0, verdict.margin_bits or 0.0]
    numbers = np.concatenate([own, *both])
    entry = entry_of(verdict)
    matched = []
    for part in (entry, entry.get("runner_up", {})):
        matched.append(np.array(part.get("matched", ()), "<u4"))
        if "matched" in part:
            part["matched"] = []
    head = HEAD.pack(*numbers.tolist(), *map(len, matched))
    return b"".join([head, *(rows.tobytes() for rows in matched), encoded(entry)])


def _numbers(alignment: Alignment | None) -> FloatArray:
    if alignment is None:
        return np.zeros(5)
    return np.array([*alignment.transform, alignment.evidence_bits, alignment.rmse_m])


def entry_text(data: bytes) -> Json:
    """The document entry of a serialised verdict."""
    known, start = _known(data)
    parts = data[start:].split(NO_MATCHED)
    out = parts[:1]
    for rows, part in zip(_matched(data, *known[NUMBERS:]), parts[1:], strict=False):
        out += [b'"matched":', encoded(rows.tolist()), part]
    return Json(b"".join(out))


def _known(data: bytes) -> tuple[tuple[Any, ...], int]:
    """The header of a serialised verdict, and the offset of its entry."""
    known = HEAD.unpack_from(data)
    return known, HEAD.size + 8 * sum(known[NUMBERS:])


def _matched(data: bytes, best: int, second: int) -> tuple[MatchedRows, MatchedRows]:
    """The (k, 2) matched junctions of both alignments."""
    rows = np.frombuffer(data, "<u4", 2 * (best + second), HEAD.size).reshape(-1, 2)
    return rows[:best], rows[best:]


def held_text(verdict: PairVerdict) -> Json | None:
    """`entry_text` of a verdict that was deserialised, if its alignment holds the bytes."""
    return entry_text(verdict.best.data) if isinstance(verdict.best, _Late) else None


Ends = Annotated[list[Index], Field(min_length=1, max_length=2)]


class _Sides(TypedDict):
    a: Ends
    b: Ends


class _Aligned(TypedDict):
    """An entry's alignment, without the numbers in the header."""

    matched: tuple[()]
    corridors: Index
    contradictions: list[str]
    contradicting: NotRequired[list[_Sides]]


class _Unrelated(TypedDict):
    """The entry of an unrelated pair. A subset of `MergeEntry`, validated three times as fast."""

    a: str
    b: str
    verdict: Literal["unrelated"]
    accepted: Literal[False]
    reason: str


class _Placed(_Aligned):
    """The entry of a merged or ambiguous pair."""

    a: str
    b: str
    verdict: Literal["ambiguous", "merged"]
    accepted: bool
    reason: str
    accepted_by: NotRequired[Literal["pair", "runs"]]
    advice: NotRequired[str]
    runner_up: NotRequired[_Aligned]
    margin_bits: NotRequired[Finite]
    against_chance_bits: NotRequired[Finite]
    same_place_bits: NotRequired[Finite]


_ENTRY: TypeAdapter[_Unrelated | _Placed] = TypeAdapter(
    Annotated[_Unrelated | _Placed, Field(discriminator="verdict")]
)

_PLACED: TypeAdapter[_Placed] = TypeAdapter(_Placed)


def from_bytes(data: bytes, a: TopoMap, b: TopoMap) -> PairVerdict | None:
    """The verdict on two maps; None if the bytes cannot be theirs."""
    try:
        known, start = _known(data)
        entry = _ENTRY.validate_json(data[start:])
    except (ValueError, struct.error):  # of pydantic, or too short
        return None
    if (entry["a"], entry["b"]) != (a.run, b.run) or not (
        isfinite(sum(known)) and -LARGEST <= min(known) <= max(known) <= LARGEST
    ):
        return None
    bits, need, margin, sizes = *known[:3], known[NUMBERS:]
    own = (a.run, b.run, Verdict(entry["verdict"]), entry["accepted"], bits, entry["reason"])
    if entry["verdict"] == "unrelated":
        return None if any(sizes) else PairVerdict(*own, threshold_bits=need)
    second, by = entry.get("runner_up"), entry.get("accepted_by")
    merged = entry["verdict"] == "merged"
    if entry["accepted"] != merged or (by is not None) != merged:
        return None
    parts = [entry] if second is None else [entry, second]
    rows = np.frombuffer(data, "<u4", 2 * sum(sizes), HEAD.size).reshape(-1, 2)
    most = len(a), len(b)
    if (
        data.count(NO_MATCHED, start) != len(parts)
        or any(sizes[len(parts) :])
        or not (rows < most).all()
        or not all(_fits(part, most) for part in parts)
    ):
        return None
    return PairVerdict(
        *own,
        threshold_bits=need,
        accepted_by=by,
        best=_aligned(entry, known[3:8], rows[: sizes[0]]) if merged else _Late.of(data, "best"),
        runner_up=None if second is None else _Late.of(data, "runner_up"),
        margin_bits=margin if "margin_bits" in entry else None,
        advice=entry.get("advice"),
        extra=_extra(entry),
    )


class _Late(Alignment):
    """An alignment of a kept verdict that is decoded on first access. Most pairs that are not
    merged never need it, and the encoded bytes take less memory."""

    __slots__ = ("_which", "data")

    data: bytes

    @classmethod
    def of(cls, data: bytes, which: Literal["best", "runner_up"]) -> _Late:
        """data: of the serialised verdict, already validated."""
        out = object.__new__(cls)
        object.__setattr__(out, "data", data)
        object.__setattr__(out, "_which", which)
        return out

    def __getattr__(self, name: str) -> Any:
        """Decodes all attributes; Python calls it for those that are not set yet."""
        known, start = _known(self.data)
        entry = _PLACED.validate_json(self.data[start:])
        first, second = _matched(self.data, *known[NUMBERS:])
        best = self._which == "best"
        part, own = (entry, known[3:8]) if best else (entry["runner_up"], known[8:NUMBERS])
        made = _aligned(part, own, first if best else second)
        for one in fields(Alignment):
            object.__setattr__(self, one.name, getattr(made, one.name))
        return object.__getattribute__(self, name)


def _fits(part: _Aligned, sizes: tuple[int, int]) -> bool:
    """Whether the positions of contradictions, if given, are as many as these and within maps of
    such sizes."""
    where = part.get("contradicting")
    if not where:
        return True
    n, m = sizes
    return len(where) == len(part["contradictions"]) and all(
        max(sides["a"]) < n and max(sides["b"]) < m for sides in where
    )


def _aligned(part: _Aligned, numbers: Sequence[float], matched: MatchedRows) -> Alignment:
    *transform, bits, rmse_m = numbers
    where = ((tuple(sides["a"]), tuple(sides["b"])) for sides in part.get("contradicting", ()))
    own = np.array(transform), bits, matched.astype(np.int64), rmse_m
    return Alignment(*own, part["corridors"], tuple(part["contradictions"]), tuple(where))


def _extra(entry: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(entry[name]) for name in EXTRA if name in entry}


@dataclass(slots=True, eq=False)
class KeptVerdicts:
    """Verdicts kept by earlier merges.

    maps: of a batch, with their digests; threshold: of each pair; keys: filled with the key of
    every verdict found or kept.
    """

    store: Store
    maps: Sequence[TopoMap]
    digests: Sequence[bytes]
    threshold: Callable[[Pair], Threshold]
    keys: dict[PairVerdict, Key]
    _thresholds: dict[tuple[float, CopyModel, bool], bytes] = field(default_factory=dict)
    _names: list[bytes] = field(init=False)

    def __post_init__(self) -> None:
        self._names = [f"{m.run}\n".encode() for m in self.maps]

    def find(
        self, pairs: Iterable[Pair], which: Mapping[Pair, int] = NONE
    ) -> dict[Pair, PairVerdict]:
        """The kept verdicts on some pairs. which: the candidates by which other runs corroborate
        them."""
        out = {}
        for pair in pairs:
            own, threshold = self._of(pair, which.get(pair)), self.threshold(pair)
            for copies in (True, False):  # most verdicts hang on how copies differ
                key = own, self._threshold(threshold, copies=copies)
                data = self.store.find(Kind.VERDICT, key)
                found = None if data is None else from_bytes(data, *(self.maps[k] for k in pair))
                if found is not None:
                    out[pair] = found
                    self.keys[found] = key
                    break
        return out

    def keep(
        self, verdicts: Mapping[Pair, PairVerdict], which: Mapping[Pair, int] = NONE
    ) -> dict[Pair, PairVerdict]:
        """Keep verdicts for later merges. Returns them as these will read them, which takes less
        memory."""
        out, again = PackWriter(self.store.era), {}
        for pair, verdict in verdicts.items():
            asked = self._threshold(self.threshold(pair), copies="same_place_bits" in verdict.extra)
            key = self._of(pair, which.get(pair)), asked
            payload = to_bytes(verdict)
            found = from_bytes(payload, *(self.maps[k] for k in pair))
            again[pair] = verdict if found is None else found
            if self.store.find(Kind.VERDICT, key) is None:  # else one that is not believed
                self.keys[again[pair]] = key
            out.add(key, Kind.VERDICT, payload=payload)
        if len(out):
            self.store.keep(out.pack())
        return again

    def _of(self, pair: Pair, second: int | None) -> bytes:
        """Digest of the maps, of their names, which appear in the text, and of the candidate."""
        (i, j), own, names = pair, self.digests, self._names
        return digested(own[i], own[j], names[i], names[j], str(second).encode())

    def _threshold(self, threshold: Threshold, *, copies: bool) -> bytes:
        """Digest of the threshold; copies: whether the verdict depends on the copy model."""
        key = threshold.copied, threshold.copies, copies
        if key not in self._thresholds:
            self._thresholds[key] = threshold_digest(threshold, copies=copies)
        return self._thresholds[key]


@lru_cache(maxsize=256)
def threshold_digest(threshold: Threshold, *, copies: bool) -> bytes:
    """Digest of a threshold; copies: including its copy model."""
    more = (threshold.need_copy_bits, astuple(threshold.copies)) if copies else ()
    return digested(repr((threshold.need_bits, threshold.copied, more)).encode())
