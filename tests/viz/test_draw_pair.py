from dataclasses import replace

import numpy as np

from topobatch.merge.decision import Decision, Placement, Requirement, Term
from topobatch.merge.result import Alignment, PairVerdict, Verdict
from topobatch.topology.matching.views import AGREES, CONTRADICTS, SILENT, Compared
from topobatch.viz.draw_pair import draw_decision
from topobatch.viz.palette import LIGHT

from .test_draw import seen

NEED = Requirement(12.55, 6, 0.001, 5, 4.0, 2.5)
EVERY = np.repeat(np.arange(5), 2).reshape(-1, 2)


def placement(bits: float, matched: np.ndarray = EVERY) -> Placement:
    terms = (
        Term("corridor", bits - 1.0, "corridor", (0, 1), (0, 1), (10.0, 10.1)),
        Term("corridor", -0.1, "common length", (1, 2), (1, 2), (6.0, 6.2)),
        Term("unseen", -1.9, "junction unseen in a corridor", (2, 3), (4,)),
        Term("elsewhere", -1.0, "corridors that lead elsewhere", (0, 1), (2, 3)),
        *(Term("branches", 1.0, "3 and 3 branches", (v,), (v,)) for v in range(len(matched))),
        Term("hypotheses", 4.0 - len(matched), "chosen from 3"),
    )
    return Placement(Alignment(np.array([1.0, 2.0, 0.3]), bits, matched, 0.1, 1), terms)


def decision(verdict: Verdict, placements: list[Placement], **fields: object) -> Decision:
    accepted = verdict is Verdict.MERGED
    best = placements[0].alignment if placements else None
    bits = best.evidence_bits if best else 0.0
    said = PairVerdict("a/1", "b", verdict, accepted, bits, "so it is", best)
    if len(placements) > 1:
        said = replace(said, margin_bits=bits - placements[1].alignment.evidence_bits)
    return Decision(said, True, NEED, tuple(placements), **fields)


def test_a_merged_pair_is_tied_junction_by_junction(make_map) -> None:
    told = decision(Verdict.MERGED, [placement(30.0)])
    a, b = make_map("a/1"), make_map("b", (1.0, 2.0, 0.4))
    texts, titles = seen(draw_decision(a, b, told, LIGHT))
    assert "a/1 and b: merged: 30.0 bits of evidence, 12.6 needed" in texts
    assert "placement: 30.0 bits" not in texts  # the only picture
    assert {f"junction {k} = junction {k}" for k in range(5)} <= set(titles)
    assert "+29.0 bits: corridor" in titles
    assert "-1.9 bits: junction unseen in a corridor" in titles
    assert "link that says little" in texts
    assert {"matched junctions, tied", "link that speaks for it", "what speaks against it"} <= set(
        texts
    )


def test_an_ambiguous_pair_shows_both_placements(make_map) -> None:
    told = decision(Verdict.AMBIGUOUS, [placement(9.0), placement(8.0)])
    a, b = make_map("a"), make_map("b", (1.0, 2.0, 0.4))
    texts, _ = seen(draw_decision(a, b, told, LIGHT))
    assert {"placement: 9.0 bits", "next best: 8.0 bits"} <= set(texts)


def test_junctions_of_either_run_are_numbered_and_what_to_record_is_shown(
    make_map, monkeypatch
) -> None:
    """In the colours of their runs; of large maps those that the advice names, and matched ones."""
    told = decision(Verdict.AMBIGUOUS, [placement(9.0, EVERY[:2]), placement(8.0, EVERY[:2])])
    said = "record with a/1's robot the corridor that b drove from its junction 2 to 4 (6.0 m): so"
    told = replace(told, pair=replace(told.pair, advice=said))
    a, b = make_map("a/1"), make_map("b", (1.0, 2.0, 0.4))
    canvas = draw_decision(a, b, told, LIGHT)
    texts, _ = seen(canvas)
    assert [texts.count(str(k)) for k in range(5)] == [4] * 5  # two runs on two pictures
    written = [text.partition(">")[0] for text in canvas.as_bytes("svg").decode().split("<text ")]
    for rank in (0, 1):
        assert sum(f"fill: {LIGHT.run(rank)}" in text for text in written) == 10
    assert "corridor to record" in texts
    monkeypatch.setattr("topobatch.viz.draw_pair.MOST_NUMBERED", 4)
    texts, _ = seen(draw_decision(a, b, told, LIGHT))
    assert [texts.count(str(k)) for k in range(5)] == [4, 4, 2, 0, 2]


def compared(kind: int) -> Compared:
    """Four walls of a and two of b, these of one kind."""
    xy = np.array([(x, 1.0) for x in (0, 1, 2, 3, 0, 1)], float)
    of_second = np.arange(6) > 3
    return Compared(xy, of_second, np.where(of_second, kind, SILENT))


def with_views(placed: Placement) -> Placement:
    terms = (
        Term("views", 3.0, "1 pair of views", (1,), (1,), seen=compared(AGREES)),
        Term("views", -2.5, "1 pair of views", (2,), (2,), seen=compared(CONTRADICTS)),
        Term("views", -0.5, "2 pairs of views"),
    )
    return replace(placed, terms=(*placed.terms, *terms))


def test_views_that_speak_most_for_and_against_are_laid_over_each_other(make_map) -> None:
    a, b = make_map("a"), make_map("b", (1.0, 2.0, 0.4))
    shown = decision(Verdict.MERGED, [with_views(placement(30.0))])
    canvas = draw_decision(a, b, shown, LIGHT)
    texts, _ = seen(canvas)
    assert {"views for it: +3.0 bits", "views against it: -2.5 bits"} <= set(texts)
    assert "walls that contradict each other" in texts
    svg = canvas.as_bytes("svg").decode()
    assert LIGHT.pale(LIGHT.run(0)) in svg  # walls of a that say nothing
    texts, _ = seen(draw_decision(a, b, decision(Verdict.MERGED, [placement(30.0)]), LIGHT))
    assert not [text for text in texts if text.startswith("views")]


def test_a_pair_that_nothing_places_is_drawn_apart(make_map) -> None:
    texts, _ = seen(
        draw_decision(make_map("a"), make_map("b"), decision(Verdict.UNRELATED, []), LIGHT)
    )
    assert "matched junctions, tied" not in texts
    assert {"a", "b"} <= set(texts)
