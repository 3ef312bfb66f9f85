"""Matches discarded by the user: later merges treat them as not found.

A lock "never" keeps two runs apart whatever else is known; a discarded match is only not counted:
others may still join the two (§4.1).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

from pydantic import Field, model_validator

from ..topology.map_schema import Model, validated
from .result import PairVerdict

DISCARDS_SCHEMA: Literal["topobatch.discards/1"] = "topobatch.discards/1"

REASON = "the match was discarded by a person"

Names = tuple[str, str]


class DiscardEntry(Model):
    """One match in the document."""

    a: str
    b: str

    @model_validator(mode="after")
    def _ordered(self) -> DiscardEntry:
        if not self.a < self.b:
            raise ValueError(f"a pair is ordered by name: {self.a!r}, {self.b!r}")
        return self


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
    return frozenset((e.a, e.b) for e in validated(DiscardsDocument, doc, name).discarded)


def discarded(verdict: PairVerdict) -> bool:
    """Whether a person discarded the match of a pair."""
    return REASON in verdict.reason
