"""Explanations come to the decision of the merge, from its documents."""

import numpy as np
import pytest

from topobatch.merge.decision_text import lines
from topobatch.merge.document import (
    merged_to_document,
    result_from_document,
    settings_from_document,
)
from topobatch.merge.merged_schema import MergedDocument
from topobatch.merge.merging import MergeSettings, merge_maps
from topobatch.merge.result import Verdict
from topobatch.merge.robust.explained import Merge, explain
from topobatch.merge.robust.settings import RobustSettings


def documented(maps, settings=None, locks=()):
    """The batch as its document holds it."""
    chosen = MergeSettings(robust=settings or RobustSettings())
    result = merge_maps(maps, chosen, locks=locks)
    document = MergedDocument.model_validate(merged_to_document(result))
    known = settings_from_document(RobustSettings, document.graph.settings)
    assert known == chosen.robust
    by_run = {m.run: m for m in maps}
    return Merge.of(result_from_document(document), by_run.__getitem__, known, locks)


def explained(batch, a, b):
    """The decision on a pair, checked: its terms add up to the document's evidence."""
    decision = explain(batch, a, b)
    assert decision.notes == ()
    assert decision.of_merge
    for placement in decision.placements:
        # A length that follows from others tells nothing; it fits all the same.
        assert all(t.bits < 0 for t in placement.terms if t.text in ("misfit", "common length"))
        assert all(t.bits >= 0 for t in placement.terms if t.text == "corridor")
        assert all(t.bits < 0 for t in placement.terms if t.kind == "few")
        total = sum(term.bits for term in placement.terms)
        if decision.pair.accepted_by != "components":
            assert total == pytest.approx(placement.alignment.evidence_bits, abs=0.01)
    if decision.placements:
        total = sum(term.bits for term in decision.placements[0].terms)
        assert total == pytest.approx(decision.pair.evidence_bits, abs=0.01)
    assert decision.pair.threshold_bits == pytest.approx(
        decision.requirement.threshold_bits, abs=0.01
    )
    return decision


def test_every_pair_of_a_batch_is_explained_as_it_was_decided(halves, other_maze, see):
    stranger = see(other_maze, list(range(60)), 5, "stranger")
    batch = documented([*halves, stranger])
    merged = explained(batch, "left", "right")
    assert merged.pair.accepted_by == "pair"
    assert np.array_equal(
        merged.placements[0].alignment.matched, batch.verdicts["left", "right"].best.matched
    )
    assert merged.requirement.pairs == 3
    assert merged.requirement.threshold_bits == pytest.approx(np.log2(3 / 0.001), abs=0.01)
    for run in ("left", "right"):
        apart = explained(batch, run, "stranger")
        assert apart.pair.verdict is Verdict.UNRELATED
        assert lines(apart)


def test_maps_without_anything_alike_are_explained(halves, drawn):
    pair = drawn("zwei", [(0, 0), (5, 0)], [(0, 1)])
    lone = drawn("lone", [(0, 0)], [], stubs=[(0, 0.0)])
    batch = documented([halves[0], pair, lone])
    for a, b in (("left", "zwei"), ("left", "lone"), ("lone", "zwei")):
        decision = explained(batch, a, b)
        assert decision.pair.evidence_bits == 0.0
        assert lines(decision)[0] == f"{a} and {b}: unrelated: 0.0 bits of evidence, 11.6 needed"
