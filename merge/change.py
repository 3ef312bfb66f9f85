"""A corridor or a junction that some runs of a site found and others did not."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

from ..topology.digits import BITS, rounded
from ..topology.wording import counted, listed, utc


class ChangeKind(StrEnum):
    """Order in time of the runs that passed a thing and those that did not find it."""

    GONE = "gone"
    NEW = "new"
    DIFFERS = "differs"


@dataclass(frozen=True, slots=True)
class Witness:
    """One run's passes by a thing: their number, and the first and last time."""

    run: str
    passes: int
    first_ns: int
    last_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """A corridor or a junction that exists for some runs and not for others.

    thing: "corridor" or "junction"; junctions: its ends, or itself, as ids of the merged document;
    xy: (2,) its middle [m]; length [m], None for a junction; there, missing: runs that passed it,
    and runs that should have found it and did not, by time; bits: -log2 of the probability that the
    latter missed it (or that it was invented); needed: the threshold for the number of tests; edge:
    of a corridor, its row in the map of its site (`component_map`).
    """

    thing: str
    kind: ChangeKind
    component: int
    junctions: tuple[int, ...]
    xy: tuple[float, float]
    length: float | None
    there: tuple[Witness, ...]
    missing: tuple[Witness, ...]
    bits: float
    needed: float
    edge: int | None = None

    @property
    def sure(self) -> bool:
        """Whether the evidence exceeds the threshold."""
        return self.bits > self.needed

    @property
    def between(self) -> tuple[Witness, Witness] | None:
        """The last run that found it one way and the first that found it the other way: the change
        lies between `last_ns` of the one and `first_ns` of the other; None if it came and went."""
        if self.kind is ChangeKind.DIFFERS:
            return None
        gone = self.kind is ChangeKind.GONE
        old, new = (self.there, self.missing) if gone else (self.missing, self.there)
        return max(old, key=lambda w: w.last_ns), min(new, key=lambda w: w.first_ns)

    def differs_for(self, a: str, b: str) -> bool:
        """Whether one of two runs found it and the other one did not."""
        there, missing = ({w.run for w in side} for side in (self.there, self.missing))
        return (a in there and b in missing) or (b in there and a in missing)

    def words(self, site: str) -> tuple[str, ...]:
        """What changed and where; between which dates (UTC); who found it and who did not; the
        evidence."""
        verb = {"gone": "gone", "new": "new", "differs": "there at times"}[str(self.kind)]
        x, y = self.xy
        what = f"junction {self.junctions[0]}"
        if self.length is not None:
            ends = " and ".join(map(str, self.junctions))
            what = f"corridor of {self.length:.1f} m between junctions {ends}"
        return (
            f"{'' if self.sure else 'perhaps '}{verb}: {what} of {site}, at ({x:.1f}, {y:.1f}) m",
            self._when(),
            f"{'seen' if self.length is None else 'driven'} by {_who(self.there)}; "
            f"missing for {_who(self.missing)} in {_passes(self.missing)}",
            f"evidence {self.bits:.1f} bits, {self.needed:.1f} needed",
        )

    def _when(self) -> str:
        """Between which passes it changed; of what came and went, all findings."""
        if self.between is None:
            found = sorted(
                [(w.first_ns, w.run, "found") for w in self.there]
                + [(w.first_ns, w.run, "missing") for w in self.missing]
            )
            findings = [f"{how} {utc(t, _MINUTE)} ({run})" for t, run, how in found]
            return "; ".join(findings)
        before, after = self.between
        old, new = ("found", "missing") if self.kind is ChangeKind.GONE else ("missing", "found")
        return (
            f"last {old} {utc(before.last_ns, _MINUTE)} ({before.run}), "
            f"first {new} {utc(after.first_ns, _MINUTE)} ({after.run})"
        )


_MINUTE = "%Y-%m-%d %H:%M"


def _who(witnesses: tuple[Witness, ...]) -> str:
    return listed([w.run for w in witnesses])


def _passes(witnesses: tuple[Witness, ...]) -> str:
    return counted(sum(w.passes for w in witnesses), "pass", "passes")


def numbered(found: Iterable[Change]) -> list[tuple[int, Change]]:
    """Changes with their numbers, by which lists and pictures call them: from 1 on, site by site as
    given, of a site the sure ones first, by time."""
    by_site: dict[int, list[Change]] = {}
    for change in found:
        by_site.setdefault(change.component, []).append(change)
    ordered = [change for own in by_site.values() for change in sorted(own, key=_in_time)]
    return list(enumerate(ordered, 1))


def _in_time(change: Change) -> tuple[bool, int, tuple[int, ...]]:
    return not change.sure, change.between[1].first_ns if change.between else 0, change.junctions


def change_to_document(change: Change) -> dict[str, Any]:
    """A change as JSON values."""
    return {
        "thing": change.thing,
        "kind": str(change.kind),
        "component": change.component,
        "junctions": list(change.junctions),
        "x": change.xy[0],
        "y": change.xy[1],
        "length": change.length,
        "there": [asdict(witness) for witness in change.there],
        "missing": [asdict(witness) for witness in change.missing],
        "bits": rounded(change.bits, BITS),
        "needed_bits": rounded(change.needed, BITS),
        "sure": change.sure,
    }
