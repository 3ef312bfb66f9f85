"""The example of §2.3 cell by cell: two maps drawn from the paper's text and its two tables.

What the words settle: a1, a2, a4, a5 and b4, b5, b7, b8 have four branches and form squares; a6 is
east and a7 south of a5, b3 north and b6 east of b5, b2 north of b4; a5-a7 and b5-b6 differ in
length; a3 and b6 have no corridor in common and lie alike beside their squares. Of all choices of
the branches that a3, a6, a7, b2, b3 and b6 have and nobody drove, two give the table of vertices of
degree three; both are tested, and both give fifteen hypotheses.

Not to be read: the lengths and coordinates of Figure 1 (those here are made up); where b1, of
degree two, lies; of the table of degree four the cells a2-b4, a5-b5 and a5-b8, and some signs and
numbers of others ("?", "H?" below). The words say of a7-b6 at 90 degrees that it "should also
match" but for the lengths; the table has H3 for a7-b6. As vertices of degree three pair under one
rotation only, H3 is at another one, and at 90 degrees a7-b6 is only the next pair to look at.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.paper.explain import explain, lines, to_document
from topobatch.merge.paper.method import decide, match, prepare_map
from topobatch.merge.result import Verdict
from topobatch.topology.matching.association import grow
from topobatch.topology.matching.correspondence import candidate_nodes
from topobatch.topology.se2 import wrap

HEADING = {"E": 0.0, "N": np.pi / 2, "W": np.pi, "S": -np.pi / 2}

A_CORNERS = {
    "a1": (0, 5), "a2": (5, 5), "a3": (12, 5),
    "a4": (0, 0), "a5": (5, 0), "a6": (12, 0),
    "a7": (5, -4),
}  # fmt: skip
A_CORRIDORS = [
    ("a1", "a2"), ("a1", "a4"), ("a2", "a5"), ("a4", "a5"),
    ("a5", "a6"), ("a5", "a7"), ("a3", "a6"),
]  # fmt: skip
B_CORNERS = {
    "b1": (-6, 9), "b2": (0, 9), "b3": (5, 12),
    "b4": (0, 5), "b5": (5, 5), "b6": (12, 5),
    "b7": (0, 0), "b8": (5, 0),
}  # fmt: skip
B_CORRIDORS = [
    ("b4", "b5"), ("b4", "b7"), ("b5", "b8"), ("b7", "b8"),
    ("b2", "b4"), ("b3", "b5"), ("b5", "b6"), ("b1", "b2"),
]  # fmt: skip

SQUARES = "a1N a1W a2N a2E a4W a4S b4W b7W b7S b8E b8S b1S"
UNEXPLORED = {
    "east": f"{SQUARES} a3N a3W a6E a7E a7S b2N b3N b3W b6N b6S",
    "north": f"{SQUARES} a3E a3W a6S a7E a7W b2E b3E b3W b6E b6S",
}
"""The two drawings, by the branch that a3, b2, b3 and b6 lack: vertices with the headings of their
branches that nobody drove."""

DEGREE_THREE = {  # the sign for "none" is written -
    "a3": {"b2": "-", "b3": "-", "b6": "H1"},
    "a6": {"b2": "-", "b3": "-", "b6": "-"},
    "a7": {"b2": "H2", "b3": "-", "b6": "H3"},
}  # fmt: skip
TURNS = (90, 180, 0, 270)
DEGREE_FOUR = {  # map A turned by 90, 180, 0 and 270 degrees
    "a1": {"b4": "- - H? H11", "b5": "? - - H12", "b7": "- H? H? H13", "b8": "- H? H? H14"},
    "a2": {"b4": "? ? ? ?", "b5": "- ? H4 -", "b7": "- H2 H7 H11", "b8": "H8 ? ? H12"},
    "a4": {"b4": "- H9 - H12", "b5": "- H2 - -", "b7": "- H10 H4 H14", "b8": "- - - H15"},
    "a5": {"b4": "- H2 - -", "b5": "? ? ? ?", "b7": "- - - H12", "b8": "- ? ? -"},
}  # fmt: skip

H2 = {("a1", "b8"), ("a2", "b7"), ("a4", "b5"), ("a5", "b4"), ("a7", "b2")}
H4 = {("a1", "b4"), ("a2", "b5"), ("a4", "b7"), ("a5", "b8")}
QUARTER_TURN = {("a1", "b7"), ("a2", "b4"), ("a5", "b5"), ("a4", "b8"), ("a6", "b3")}


@pytest.fixture(name="example", params=list(UNEXPLORED))
def _example(draw, request):
    stubs = [(word[:2], HEADING[word[2]]) for word in UNEXPLORED[request.param].split()]
    of = {m: [stub for stub in stubs if stub[0][0] == m] for m in "ab"}
    return (draw("a", A_CORNERS, A_CORRIDORS, of["a"]), draw("b", B_CORNERS, B_CORRIDORS, of["b"]))


def matched(example):
    return match(*(prepare_map(m) for m in example))


def named(pairs):
    return {(f"a{u + 1}", f"b{v + 1}") for u, v in np.asarray(pairs).tolist()}


def rotated_a_deg(turn_rad):
    """The text turns map A; transforms here turn b."""
    return round(float(np.rad2deg(-wrap(turn_rad)))) % 360


def hypotheses_of(example):
    """(rotation of A, pairs) of every hypothesis."""
    h = matched(example).hypotheses
    pairs = np.column_stack([h.vertex_a, h.vertex_b])
    return [(rotated_a_deg(h.transform[k, 2]), named(pairs[h.of == k])) for k in range(len(h))]


def printed(example):
    """Both tables of Fig. 1 with the hypotheses numbered as printed.

    First those of the vertices of degree three, row by row; then those of degree four by rotation,
    0 to 270 degrees, and within each row by row.
    """
    at = {(u, v, turn): k for k, (turn, p) in enumerate(hypotheses_of(example)) for u, v in p}
    three = {
        (u, v): next((k for (x, y, _), k in at.items() if (x, y) == (u, v)), None)
        for u in DEGREE_THREE
        for v in ("b2", "b3", "b6")
    }
    four = {
        (u, v, turn): at.get((u, v, turn))
        for turn in (0, 90, 180, 270)
        for u in DEGREE_FOUR
        for v in ("b4", "b5", "b7", "b8")
    }
    number = {}
    for k in [*three.values(), *four.values()]:
        if k is not None:
            number.setdefault(k, f"H{len(number) + 1}")
    number[None] = "-"
    return {c: number[k] for c, k in three.items()}, {c: number[k] for c, k in four.items()}


def test_degrees_and_correspondences(example):
    a, b = example
    assert a.degree.tolist() == [4, 4, 3, 4, 4, 3, 3]
    assert b.degree.tolist() == [2, 3, 3, 4, 4, 3, 4, 4]
    nodes = candidate_nodes(prepare_map(a).structure, prepare_map(b).structure)
    # "Degree two and three vertices can match only for a single edge pairing; degree four vertices
    # can match for four."
    assert len(nodes) == 3 * 3 + 4 * 4 * 4


def test_the_table_of_degree_four_wherever_it_can_be_read(example):
    _, four = printed(example)
    read = 0
    for u, row in DEGREE_FOUR.items():
        for v, cell in row.items():
            for turn, sign in zip(TURNS, cell.split(), strict=True):
                if sign == "H?":
                    assert four[u, v, turn] != "-", (u, v, turn)
                elif sign != "?":
                    assert four[u, v, turn] == sign, (u, v, turn)
                read += sign != "?"
    assert read == 50


def test_cells_that_the_words_say_or_that_follow_where_the_table_cannot_be_read(example):
    _, four = printed(example)
    assert four["a1", "b8", 180] == "H2"
    assert {four[u, v, 90] for u, v in QUARTER_TURN - {("a6", "b3")}} == {"-"}
    assert four["a1", "b4", 0] == four["a5", "b8", 0] == "H4"
    assert four["a1", "b7", 180] == "H9"  # printed like H0
    assert four["a1", "b7", 0] == four["a2", "b8", 0] == "H5"
    assert four["a1", "b8", 0] == "H6"
    assert set(four.values()) == {"-", "H2"} | {f"H{k}" for k in range(4, 16)}


def test_the_quarter_turn_is_grown_as_far_as_it_goes_and_rejected_whole_for_one_length(example):
    a, b = example
    growth = grow(prepare_map(a).structure, prepare_map(b).structure)
    pairs = np.column_stack([growth.nodes.vertex_a, growth.nodes.vertex_b])
    grown = [
        (named(pairs[growth.component == c]), bool(growth.rejected[c]))
        for c in range(len(growth.rejected))
    ]
    assert (QUARTER_TURN, True) in grown
    alive = hypotheses_of(example)
    assert not any(turn == 90 and pairs & QUARTER_TURN for turn, pairs in alive)
    assert (90, {("a7", "b6")}) not in alive
    south, east = (np.flatnonzero((m.source == 4) & (m.target == t)) for m, t in ((a, 6), (b, 5)))
    assert abs(a.length[south] - b.length[east]) > 10 * a.length_sigma[south]


def test_the_best_cluster_is_the_half_turn_and_the_next_two_hypotheses_unrotated(example):
    found = matched(example)
    h, c = found.hypotheses, found.clusters
    assert c.vertices[:2].tolist() == [5, 5]
    assert c.hypotheses[:2].tolist() == [1, 2]
    assert [rotated_a_deg(t) for t in c.transform[:2, 2]] == [180, 0]
    pairs = np.column_stack([h.vertex_a, h.vertex_b])
    assert named(pairs[c.of[h.of] == 1]) == H4 | {("a3", "b6")}


def test_nothing_is_merged(example):
    (verdict,) = decide(example)
    assert verdict.verdict is Verdict.UNRELATED
    assert "chance offers as much" in verdict.reason


def test_explanation_as_text_and_json(example):
    found = explain(*example)
    text = "\n".join(lines(found))
    assert "73 with their rotations; 15 hypotheses" in text
    assert "cluster      pairs  hypotheses" in text  # junctions may stand in several
    table = next(line for line in lines(found) if line.strip().startswith("a2 "))
    assert "H" in table
    hypotheses, first = found.found.hypotheses, np.unique(found.found.clusters.of, True)[1]
    bits = np.zeros(len(hypotheses))
    bits[first] = 3.846  # 3.85 in documents
    half = replace(found.found, hypotheses=replace(hypotheses, bits=bits))
    assert lines(replace(found, found=half))[-1].endswith(" 3.9")
    document = to_document(found)
    best = document["hypotheses"][0]
    assert named(best["matched"]) in (H2, H4)
    marked = [c for c in document["candidates"] if (c["a"], c["b"]) == (5, 2)]
    assert len(marked) == 1
    assert marked[0]["hypothesis"] is None  # a6-b3 belongs to the rejected quarter turn
    held = sum(c["hypothesis"] is not None for c in document["candidates"])
    assert held == sum(len(h["matched"]) for h in document["hypotheses"])
