"""What a person decided on pairs of runs, for every later merge.

A lock overrules the evidence; "never" keeps two runs apart whatever else is known. A discarded
match is treated as not found: others may still join the two (§4.1).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar, Literal

from pydantic import ConfigDict, Field

from ..topology.errors import DocumentError, UsageError
from ..topology.map_schema import Model, validated
from ..topology.topomap import TopoMap
from .result import PairVerdict

LOCKS_SCHEMA: Literal["topobatch.locks/1"] = "topobatch.locks/1"


@dataclass(frozen=True, slots=True, order=True)
class Lock:
    """A decision on runs `a < b`.

    "same": the two runs are joined, by their best alignment; with `at` (vertex of a, vertex of b)
    by the best one that identifies these two vertices, if any has more for it than against it.
    "never": they never share a component, not even through other runs; `at` must be None then.
    Raises UsageError otherwise.
    """

    # Documents allow keys that nobody knows; values have no room for them.
    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="ignore")

    a: str
    b: str
    decision: Literal["same", "never"]
    at: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        if self.a == self.b:
            raise UsageError(f"a lock needs two runs, got {self.a!r} twice")
        if self.decision not in ("same", "never"):
            raise UsageError(f"a lock is 'same' or 'never', not {self.decision!r}")
        if self.at is not None and (len(self.at) != 2 or min(self.at) < 0):
            raise UsageError(f"a lock names one vertex of each run, got {self.at!r}")
        if self.at is not None and self.decision == "never":
            raise UsageError("a 'never' lock is about whole runs: leave the vertices out")
        if self.b < self.a:
            swapped = None if self.at is None else (self.at[1], self.at[0])
            named = (("a", self.b), ("b", self.a), ("at", swapped))
            for name, value in named:
                object.__setattr__(self, name, value)

    def __str__(self) -> str:
        at = f", junction {self.at[0]} = junction {self.at[1]}" if self.at else ""
        return f"{self.a} + {self.b}: {self.decision}{at}"


def lock_table(locks: Iterable[Lock]) -> dict[tuple[str, str], Lock]:
    """The locks by pair. Raises UsageError where two locks of one pair disagree."""
    table: dict[tuple[str, str], Lock] = {}
    for lock in locks:
        known = table.setdefault((lock.a, lock.b), lock)
        if known != lock:
            raise UsageError(
                f"runs {lock.a!r} and {lock.b!r} are locked in two ways; remove one of the locks"
            )
    return table


def locks_among(locks: Iterable[Lock], maps: Mapping[str, TopoMap]) -> dict[tuple[str, str], Lock]:
    """The locks of pairs of these maps, by pair. Raises UsageError where two locks of one pair
    disagree, or one names a vertex that does not exist."""
    table = {pair: lock for pair, lock in lock_table(locks).items() if maps.keys() >= {*pair}}
    for (a, b), lock in table.items():
        for run, vertex in zip((a, b), lock.at or (), strict=False):
            if vertex >= len(maps[run]):
                raise UsageError(
                    f"the lock of {a!r} and {b!r} names junction {vertex} of {run!r}, which has "
                    f"{len(maps[run])}: lock by the numbers in its map document"
                )
    return table


def with_lock(locks: Sequence[Lock], lock: Lock) -> tuple[Lock, ...]:
    """The locks with one more, which replaces that of the same pair; sorted."""
    return tuple(sorted([*without_lock(locks, lock.a, lock.b), lock]))


def without_lock(locks: Sequence[Lock], a: str, b: str) -> tuple[Lock, ...]:
    """The locks without that of the pair {a, b}."""
    pair = (min(a, b), max(a, b))
    return tuple(k for k in locks if (k.a, k.b) != pair)


class LocksDocument(Model):
    """`locks.json`."""

    schema_name: Literal["topobatch.locks/1"] = Field(alias="schema")
    locks: list[Lock]


def locks_to_document(locks: Sequence[Lock]) -> dict[str, Any]:
    """The document of a set of locks, sorted; inverse of `locks_from_document`."""
    entries = (asdict(lock) for _, lock in sorted(lock_table(locks).items()))
    known = [{name: v for name, v in entry.items() if v is not None} for entry in entries]
    return {"schema": LOCKS_SCHEMA, "locks": known}


def locks_from_document(doc: Any, name: str = "locks document") -> tuple[Lock, ...]:
    """The locks of a parsed document; DocumentError if it does not follow the schema."""
    try:
        table = lock_table(validated(LocksDocument, doc, name).locks)
    except UsageError as error:
        raise DocumentError(f"{name}: {error}") from error
    return tuple(table[pair] for pair in sorted(table))


DISCARDS_SCHEMA: Literal["topobatch.discards/1"] = "topobatch.discards/1"

DISCARDED = "the match was discarded by a person"

Names = tuple[str, str]


class DiscardEntry(Model):
    """One match in the document."""

    a: str
    b: str


class DiscardsDocument(Model):
    """`discards.json`."""

    schema_name: Literal["topobatch.discards/1"] = Field(alias="schema")
    discarded: list[DiscardEntry]


def discards_to_document(pairs: Iterable[Names]) -> dict[str, Any]:
    """The document of some pairs, sorted; inverse of `discards_from_document`."""
    entries = [{"a": a, "b": b} for a, b in sorted(set(pairs))]
    return {"schema": DISCARDS_SCHEMA, "discarded": entries}


def discards_from_document(doc: Any, name: str = "discards document") -> frozenset[Names]:
    """The pairs of runs, by name; DocumentError if the document follows no such schema."""
    pairs = validated(DiscardsDocument, doc, name).discarded
    return frozenset((min(p.a, p.b), max(p.a, p.b)) for p in pairs)


def discarded(verdict: PairVerdict) -> bool:
    """Whether a person discarded the match of a pair."""
    return DISCARDED in verdict.reason
