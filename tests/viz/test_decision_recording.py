from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from topobatch.merge.decision import (
    Decision,
    Placement,
    Requirement,
    Term,
)
from topobatch.merge.decision_text import lines
from topobatch.merge.result import Alignment, PairVerdict, Verdict
from topobatch.topology.matching.views import AGREES, CONTRADICTS, SILENT, Compared
from topobatch.viz.decision_recording import write_decision_recording

from .readback import Readback

NEED = Requirement(12.55, 6, 0.001, 5, 4.0, 2.5)
EVERY = np.repeat(np.arange(5), 2).reshape(-1, 2)


def placement(bits: float, matched: np.ndarray = EVERY) -> Placement:
    terms = (
        Term("corridor", bits - 1.0, "corridor", (0, 1), (0, 1), (10.0, 10.1)),
        Term("unseen", -2.0, "junction unseen in a corridor", (2, 3), (4,)),
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


def written(path: Path, make_map, told: Decision) -> Readback:
    write_decision_recording(path, make_map("a/1"), make_map("b", (1.0, 2.0, 0.4)), told)
    return Readback(path)


def test_a_merged_pair_is_drawn_over_and_tied(tmp_path: Path, make_map) -> None:
    told = decision(Verdict.MERGED, [placement(30.0)])
    got = written(tmp_path / "a.rrd", make_map, told)
    assert got.identity == ("topobatch", "a/1 - b")
    assert got.blueprints == 1
    for picture in ("placement", "tied"):
        assert len(got.value(f"/placements/{picture}/ties", "LineStrips2D:strips")) == 5
        assert f"/placements/{picture}/a/a\\/1/corridors" in got.entities
    assert got.value("/placements/titles", "Points2D:labels") == [
        "placement: 30.0 bits",
        "the 5 matched junctions tied",
    ]
    assert got.value("/placements/placement/contradictions", "told") == [
        "-2.0 bits: junction unseen in a corridor",
        "-1.0 bits: corridors that lead elsewhere",
    ]
    page = got.value("/decision", "TextDocument:text")[0]
    assert [*lines(told)] == page.splitlines()[1:-1]  # between fences
    assert "a/1 and b: merged: 30.0 bits of evidence, 12.6 needed" in page
    assert "unseen in a corridor" in got.value("/evidence", "TextDocument:text")[0]


def test_an_ambiguous_pair_is_drawn_both_ways(tmp_path: Path, make_map) -> None:
    told = decision(Verdict.AMBIGUOUS, [placement(9.9), placement(8.0)], why="it repeats itself")
    got = written(tmp_path / "a.rrd", make_map, told)
    titles = got.value("/placements/titles", "Points2D:labels")
    assert titles == ["placement: 9.9 bits", "next best: 8.0 bits"]
    page = got.value("/decision", "TextDocument:text")[0]
    assert "it repeats itself" in page


def seen(kind: int) -> Compared:
    """Four walls of a and two of b, these of one kind."""
    xy = np.array([(x, 1.0) for x in (0, 1, 2, 3, 0, 1)], float)
    of_second = np.arange(6) > 3
    return Compared(xy, of_second, np.where(of_second, kind, SILENT))


def with_views(placed: Placement) -> Placement:
    terms = (
        Term("views", 3.0, "1 pair of views", (1,), (1,), seen=seen(AGREES)),
        Term("views", -2.5, "1 pair of views", (2,), (2,), seen=seen(CONTRADICTS)),
        Term("views", -0.5, "2 pairs of views"),
    )
    return replace(placed, terms=(*placed.terms, *terms))


def test_views_that_speak_most_for_and_against_are_laid_over_each_other(
    tmp_path: Path, make_map
) -> None:
    told = decision(Verdict.MERGED, [with_views(placement(30.0))])
    got = written(tmp_path / "a.rrd", make_map, told)
    assert got.value("/placements/titles", "Points2D:labels")[-2:] == [
        "views for it: +3.0 bits",
        "views against it: -2.5 bits",
    ]
    at = np.array(got.value("/views/for/a/silent", "Points2D:positions"))
    assert len(at) == 4
    for name in ("/views/for/b/agrees", "/views/against/b/contradicts"):
        own = np.array(got.value(name, "Points2D:positions"))
        assert np.ptp(own[:, 0]) == pytest.approx(np.ptp(at[:, 0]) / 3, abs=1e-5)
    without = written(tmp_path / "b.rrd", make_map, decision(Verdict.MERGED, [placement(30.0)]))
    assert not [entity for entity in without.entities if entity.startswith("/views/")]
