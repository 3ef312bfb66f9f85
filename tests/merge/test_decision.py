"""Decisions as values, as JSON and on a screen."""

import json
from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.decision import Decision, Placement, Requirement, Term, to_document
from topobatch.merge.decision_text import WIDTH, advice, because, headline, lies, lines, needs
from topobatch.merge.result import Alignment, PairVerdict, Verdict
from topobatch.merge.robust.verdict import MAYBE_COPY

NEED = Requirement(12.55, 6, 0.001, 5, 4.0, 2.5)


def placement(bits, count=12, links=9):
    """Of so much evidence: links of 3 bits, branches, hypotheses, and what junctions carry."""
    matched = np.column_stack([np.arange(count), np.arange(count) + 20])
    terms = [
        *(
            Term("corridor", 3.04, "corridor", (k, k + 1), (k, k + 2), (5, 5.1))
            for k in range(links)
        ),
        *(Term("branches", 8.0 / count, "3 and 3 branches", (k,), (k + 20,)) for k in range(count)),
        Term("unseen", -6.0, "junction unseen in a corridor", (1, 2), (7,)),
        Term("hypotheses", -7.0, "chosen from 127 pairs of corridors that look alike"),
    ]
    rest = bits - sum(t.bits for t in terms)
    terms.append(Term("few", rest, "junctions carry no more than 2.5 bits each"))
    return Placement(
        Alignment(np.array([1.0, -2.0, np.pi]), bits, matched, 0.1, links), tuple(terms)
    )


def decision(verdict, bits, placements, **fields):
    accepted = verdict is Verdict.MERGED
    best = placements[0].alignment if placements else None
    margin = None
    if len(placements) > 1:
        margin = bits - placements[1].alignment.evidence_bits
    said = PairVerdict(
        "left",
        "right",
        verdict,
        accepted,
        bits,
        "so it is",
        best,
        margin_bits=margin,
        accepted_by="pair" if accepted else None,
        threshold_bits=12.55,
    )
    return Decision(said, True, NEED, tuple(placements), **fields)


MERGED = decision(Verdict.MERGED, 30.0, [placement(30.0)])
AMBIGUOUS = decision(Verdict.AMBIGUOUS, 9.93, [placement(9.93), placement(4.0)], why=MAYBE_COPY)
AMBIGUOUS = replace(AMBIGUOUS, pair=replace(AMBIGUOUS.pair, advice="record " + "further " * 30))
UNRELATED = decision(Verdict.UNRELATED, 1.5, [placement(1.5, 2, 1)])
NOTHING = decision(Verdict.UNRELATED, 0.0, [])
ALL = [MERGED, AMBIGUOUS, UNRELATED, NOTHING]


@pytest.mark.parametrize("told", ALL)
def test_a_decision_fits_a_terminal_with_the_verdict_first(told):
    shown = lines(told)
    assert max(map(len, shown)) <= WIDTH
    assert max(map(len, lines(told, width=40))) <= 40
    assert shown[0].startswith(f"left and right: {told.pair.verdict}: ")
    assert "12.6 needed" in shown[0]
    assert any("log2(6 pairs / rate 0.001)" in line for line in shown)


def test_a_rounded_number_of_pairs_is_said_to_be_one():
    many = replace(MERGED.requirement, pairs=448)
    assert "log2(448 pairs, rounded up, / rate 0.001)" in needs(replace(MERGED, requirement=many))


def test_the_document_adds_up_too():
    for told in ALL:
        document = json.loads(json.dumps(to_document(told)))
        assert document["schema"] == "topobatch.decision/1"
        assert document["verdict"] == told.pair.verdict
        assert document["threshold_bits"] == 12.55
        for shown in document["placements"]:
            total = sum(term["bits"] for term in shown["terms"])
            assert total == pytest.approx(shown["evidence_bits"], abs=0.1)  # each is rounded
    assert to_document(AMBIGUOUS)["margin_bits"] == 5.93


def test_an_ambiguous_pair_says_what_it_lacks():
    assert "repeat themselves" in because(AMBIGUOUS)
    assert because(replace(AMBIGUOUS, why="")).endswith(" agree, 1 contradicts; so it is.")
    assert advice(AMBIGUOUS).startswith("To settle it: record further")
    assert advice(MERGED) == advice(UNRELATED) == ""
    joined = replace(AMBIGUOUS.pair, through=("other",), lacks=AMBIGUOUS.why)
    through = replace(AMBIGUOUS, pair=joined)
    assert advice(through) == ""  # it is settled, and its own placement may be wrong
    assert any("the next best lays it at" in line for line in lines(AMBIGUOUS))


def test_an_unrelated_pair_says_why():
    assert "too little evidence" in because(UNRELATED)
    assert lies(UNRELATED).startswith("right would lie at ")
    assert "no alignment of the two maps holds" in because(NOTHING)


def test_what_others_and_people_say_stands_in_the_headline():
    pair, chain = replace(UNRELATED.pair, through=("mid",)), (("left", "mid", 22.0),)
    chain = (*chain, ("mid", "right", 17.25))
    through = replace(UNRELATED, pair=pair, chain=chain, by_others=np.zeros(3))
    told = "one place through mid: left + mid 22.0 bits, mid + right 17.2 bits"
    assert headline(through) == f"left and right: {told}"
    first, *more = lines(through)
    assert first.startswith("left and right: one place through mid")
    text = " ".join(" ".join(more).split())
    assert "right lies at (0.00, 0.00) m" in text
    assert "By the two maps alone unrelated, 1.5 bits, 12.6 needed" in text
    assert text.index("right lies at") < text.index("By the two maps alone") < text.index("needed:")
    assert "does not count" in text
    assert to_document(through)["chain"][1]["evidence_bits"] == 17.25
    by = {
        "lock": "locked as the same",
        "runs": "as other runs say",
        "components": "merged, together with",
    }
    for accepted_by, words in by.items():
        told = replace(MERGED, pair=replace(MERGED.pair, accepted_by=accepted_by))
        assert words in headline(told)
    sides = (("left", "mid"), ("right",))
    by_maps = replace(MERGED.pair, accepted_by="components", together=sides, reason="x: 9 agree")
    (placement, *_) = MERGED.placements
    joined = replace(MERGED, pair=by_maps, placements=(replace(placement, terms=()),))
    text = "\n".join(lines(joined, width=200))
    assert "9 agree. The evidence is that of the maps that were joined: of left, mid; and" in text
    assert "for (+) and against" not in text
    never = replace(UNRELATED, pair=replace(UNRELATED.pair, locked="never"))
    assert because(never) == "Locked apart by a person."
    assert lies(never).startswith("right would lie at ")
    assert headline(never).startswith("left and right: locked apart: 1.5 bits of evidence")
