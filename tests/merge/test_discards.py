"""Matches that a person took back, as a document."""

from __future__ import annotations

import pytest

from topobatch.merge.discards import discards_from_document, discards_to_document
from topobatch.topology.errors import DocumentError


def test_pairs_survive_their_document_in_one_order() -> None:
    pairs = {("b", "c"), ("a", "c")}
    doc = discards_to_document(pairs)
    assert doc["discarded"] == [{"a": "a", "b": "c"}, {"a": "b", "b": "c"}]
    assert discards_from_document(doc) == pairs


@pytest.mark.parametrize("pair", [{"a": "b", "b": "a"}, {"a": "a", "b": "a"}, {"a": "a"}])
def test_what_is_no_pair_is_refused(pair: dict[str, str]) -> None:
    doc = {**discards_to_document([]), "discarded": [pair]}
    with pytest.raises(DocumentError, match=r"d\.json: discarded\.0"):
        discards_from_document(doc, "d.json")
