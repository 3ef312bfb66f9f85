"""Explanations come to the decision of the merge, from its documents."""

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.decision_text import agreement, headline, lines, needs
from topobatch.merge.document import merged_to_document, poses_from_document, verdict_from_entry
from topobatch.merge.locks import Lock
from topobatch.merge.merged_schema import MergedDocument
from topobatch.merge.merging import MergeSettings, merge_maps
from topobatch.merge.result import Verdict, shown_bits
from topobatch.merge.robust.alignment import match
from topobatch.merge.robust.explained import Merge, _copy_told, explain
from topobatch.merge.robust.prepare import prepare
from topobatch.merge.robust.settings import RobustSettings, settings_from_document
from topobatch.simulation import make_world
from topobatch.topology.digits import BITS, rounded
from topobatch.topology.se2 import between


def documented(maps, settings=None, locks=()):
    """The batch as its document holds it."""
    chosen = MergeSettings(robust=settings or RobustSettings())
    result = merge_maps(maps, chosen, locks=locks)
    document = MergedDocument.model_validate(merged_to_document(result))
    said = {(entry.a, entry.b): verdict_from_entry(entry) for entry in document.merges}
    known = settings_from_document(document.graph.settings)
    assert known == chosen.robust
    return merge_of(maps, said, known, locks)


def merge_of(maps, said=(), settings=None, locks=(), poses=()):
    by_run = {m.run: m for m in maps}
    settings = settings or RobustSettings()
    return Merge(by_run.__getitem__, len(maps), dict(said), settings, locks, dict(poses))


def explained(batch, a, b):
    """The decision on a pair, checked: its terms add up to the document's evidence."""
    decision = explain(batch, a, b)
    assert decision.notes == ()
    assert decision.of_merge
    for placement in decision.placements:
        # A length that follows from others tells nothing; it fits all the same.
        assert all(t.bits < 0 for t in placement.terms if t.told == "misfit")
        assert all(t.bits >= 0 for t in placement.terms if t.told == "corridor")
        assert all(t.bits < 0 for t in placement.terms if t.kind == "few")
        total = sum(term.bits for term in placement.terms)
        if decision.said.accepted_by != "components":
            assert total == pytest.approx(
                rounded(placement.alignment.evidence_bits, BITS), abs=1e-6
            )
    if decision.start is None and decision.placements:
        total = sum(term.bits for term in decision.placements[0].terms)
        assert total == pytest.approx(decision.said.evidence_bits, abs=0.01)
    assert decision.said.threshold_bits == pytest.approx(
        decision.requirement.threshold_bits, abs=0.01
    )
    return decision


def test_pairs_that_are_rounded_up_are_told_as_they_are_too(halves):
    batch = documented(halves)
    assert needs(explain(batch, "left", "right")).startswith("log2(1 pair / rate 0.001), ")
    many = replace(batch, runs=50)
    told = needs(explain(many, "left", "right"))
    assert told.startswith("log2(1,280 for 1,225 pairs / rate 0.001), ")


def test_every_pair_of_a_batch_is_explained_as_it_was_decided(halves, other_maze, see):
    stranger = see(other_maze, list(range(60)), 5, "stranger")
    batch = documented([*halves, stranger])
    merged = explained(batch, "left", "right")
    assert merged.said.accepted_by == "pair"
    assert np.array_equal(
        merged.placements[0].alignment.matched, batch.said["left", "right"].best.matched
    )
    assert merged.requirement.pairs == 3
    assert merged.requirement.threshold_bits == pytest.approx(np.log2(3 / 0.001))
    for run in ("left", "right"):
        apart = explained(batch, run, "stranger")
        assert apart.said.verdict is Verdict.UNRELATED
        assert lines(apart)


def test_pairs_of_a_folder_of_several_buildings_are_explained_as_they_were_decided(mixed):
    batch = documented(mixed)
    assert explained(batch, "left", "right").said.accepted
    decision = explained(batch, "o-0", "o-1")
    told = decision.said.extra["same_place_bits"]
    assert told == decision.requirement.same_place_bits


def test_the_settings_of_the_merge_are_those_of_the_explanation(halves):
    bits = documented(halves).said["left", "right"].evidence_bits
    batch = documented(halves, RobustSettings(false_merge_rate=2.0 ** -(bits + 5)))
    doubtful = explained(batch, "left", "right")
    assert doubtful.said.verdict is Verdict.AMBIGUOUS
    assert doubtful.why == "chance offers as much too often"
    assert doubtful.requirement.threshold_bits == pytest.approx(bits + 5, abs=0.01)


def test_a_map_that_changed_since_is_told(halves, see, maze):
    batch = documented(halves)
    less = see(maze, list(range(60)), 1, "left")
    decision = explain(replace_map(batch, less), "left", "right")
    assert "the merge says " in decision.notes[0]
    assert "changed since; merge again" in decision.notes[0]


def test_a_map_that_changed_by_less_than_is_shown_is_told(halves):
    """Beyond the digits of a document, though both numbers would read alike."""
    batch = documented(halves)
    told = batch.said["left", "right"]
    beside = (told.evidence_bits + 0.03, told.evidence_bits - 0.03)
    bits = next(x for x in beside if shown_bits(x) == shown_bits(told.evidence_bits))
    said = {**batch.said, ("left", "right"): replace(told, evidence_bits=bits)}
    (note,) = explain(replace(batch, said=said), "left", "right").notes
    assert note.startswith("the maps no longer say just what the merge says: ")


def replace_map(batch, changed):
    return replace(batch, read=lambda run: changed if run == changed.run else batch.read(run))


def test_only_the_maps_of_a_pair_are_read(halves, other_maze, see):
    stranger = see(other_maze, list(range(60)), 5, "stranger")
    batch, asked = documented([*halves, stranger]), []

    def read(run):
        asked.append(run)
        return batch.read(run)

    explain(replace(batch, read=read), "left", "right")
    assert set(asked) == {"left", "right"}


def test_what_a_person_locked_is_explained(side_by_side):
    a, b, at = side_by_side
    decision = explained(documented([a, b], locks=[Lock("a", "b", "same", at)]), "a", "b")
    assert "locked as the same" in headline(decision)
    assert list(at) in decision.placements[0].alignment.matched.tolist()


def test_what_speaks_for_a_copy_is_told_as_such():
    assert _copy_told(5.94, 8.6) == "is it a copy? 5.9 bits say no, 8.6 needed"
    assert _copy_told(-4.02, 2.5) == "is it a copy? 4.0 bits say yes, 2.5 for no needed"


def test_a_pair_is_locked_as_it_is_shown(see):
    """Not as chance ranks the placements, where the question whether they are copies ranks others
    first."""
    office = make_world("office", 120, 8)
    parts = [list(range(60)), list(range(15, 80)), list(range(40, 110))]
    maps = [see(office, part, 800 + k, "abc"[k]) for k, part in enumerate(parts)]
    plain = documented(maps)
    shown = plain.said["b", "c"].best
    assert plain.said["b", "c"].verdict is Verdict.AMBIGUOUS
    likely = match(prepare(maps[1]), prepare(maps[2]), plain.settings)[0]
    assert not np.allclose(likely.transform, shown.transform, atol=1.0)
    said = documented(maps, locks=[Lock("b", "c", "same")]).said["b", "c"]
    assert said.accepted_by == "lock"
    np.testing.assert_array_equal(said.best.matched, shown.matched)
    assert said.evidence_bits == plain.said["b", "c"].evidence_bits


def test_what_components_say_together_is_explained(maze, see):
    """As in `test_components_say_together_what_no_pair_can`."""
    order = np.argsort(maze.xy[:, 0], kind="stable")
    a = see(maze, order[:52].tolist(), 1, "a", missed=0.0)
    b = see(maze, order[42:].tolist(), 2, "b", missed=0.0)
    c = see(maze, order[30:66].tolist(), 3, "c", missed=0.0)
    alone = [documented([one, c]).said[one.run, "c"].evidence_bits for one in (a, b)]
    strict = RobustSettings(false_merge_rate=3 * 2.0 ** -(max(alone) + 3))
    batch = documented([a, b, c], strict, locks=[Lock("a", "b", "same")])
    for run in ("a", "b"):
        decision = explained(batch, run, "c")
        assert decision.said.together == (("a", "b"), ("c",))
        other = "b" if run == "a" else "a"
        assert headline(decision).startswith(f"{run} and c: merged, together with {other}: ")
        assert agreement(decision.placements[0]) in decision.said.reason.replace(
            "0 contradict", "nothing contradicts"
        )
        (shown,) = decision.placements
        known = {tuple(pair) for pair in shown.alignment.matched.tolist()}
        named = {(u, v) for t in shown.terms if t.kind == "branches" for u in t.a for v in t.b}
        assert named == known
    less = see(maze, order[30:50].tolist(), 3, "c", missed=0.0)
    changed = explain(replace_map(batch, less), "a", "c")
    assert "changed since; merge again" in changed.notes[0]
    for placement in changed.placements:
        assert np.all(placement.alignment.matched < (len(a), len(less)))


def test_runs_that_others_join_lie_where_these_place_them(maze, see):
    order = np.argsort(maze.xy[:, 0], kind="stable")
    parts = {"a": order[:45], "b": order[25:85], "c": order[65:]}
    maps = [see(maze, part.tolist(), k, run) for k, (run, part) in enumerate(parts.items())]
    document = MergedDocument.model_validate(merged_to_document(merge_maps(maps)))
    said = {(entry.a, entry.b): verdict_from_entry(entry) for entry in document.merges}
    poses = poses_from_document(document)
    batch = merge_of(maps, said, poses=poses)
    decision = explain(batch, "a", "c")
    assert decision.said.through == ("b",)
    assert decision.said.verdict is Verdict.UNRELATED
    assert np.allclose(decision.by_others, between(poses["a"], poses["c"]))
    assert explain(batch, "a", "b").by_others is None


def test_without_a_merge_the_maps_speak_for_themselves(halves):
    decision = explain(merge_of(halves), "left", "right")
    assert not decision.of_merge
    assert decision.said.accepted
    assert decision.requirement.pairs == 1
    assert decision.notes == ()


def test_maps_without_anything_alike_are_explained(halves, drawn):
    pair = drawn("zwei", [(0, 0), (5, 0)], [(0, 1)])
    lone = drawn("lone", [(0, 0)], [], stubs=[(0, 0.0)])
    batch = documented([halves[0], pair, lone])
    for a, b in (("left", "zwei"), ("left", "lone"), ("lone", "zwei")):
        decision = explained(batch, a, b)
        assert decision.said.evidence_bits == 0.0
        assert lines(decision)[0] == f"{a} and {b}: unrelated: 0.0 bits of evidence, 11.6 needed"


def test_settings_of_a_document_are_checked():
    known = settings_from_document({"false_merge_rate": 0.01, "of_a_later_version": 3})
    assert known == replace(RobustSettings(), false_merge_rate=0.01)
    with pytest.raises(ValueError, match="false_merge_rate"):
        settings_from_document({"false_merge_rate": 2.0})
    with pytest.raises(ValueError, match="hypotheses must be a whole number"):
        settings_from_document({"hypotheses": 2.5})
    with pytest.raises(ValueError, match="size_sigmas must be a number: 'four'"):
        settings_from_document({"size_sigmas": "four"})
