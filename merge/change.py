"""A corridor or a junction that some runs of a site found and others did not."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

from ..topology.digits import BITS, rounded


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
    latter missed it (or that it was invented); needed: the threshold for the number of tests.
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

    @property
    def sure(self) -> bool:
        """Whether the evidence exceeds the threshold."""
        return self.bits > self.needed


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
