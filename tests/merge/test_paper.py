"""The paper's own example, drawn from its text, and the method as a whole."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.explain import explain, lines, to_document
from topobatch.merge.hypotheses import hypothesise
from topobatch.merge.paper import PaperSettings, decide, judge, match, prepare_map
from topobatch.merge.result import Verdict
from topobatch.topology.association import grow
from topobatch.topology.correspondence import GrowthSettings, candidate_nodes
from topobatch.topology.se2 import wrap

E, N, W, S = 0.0, np.pi / 2, np.pi, -np.pi / 2

# §2.3. What the text and its tables settle: a1, a2, a4, a5 and b4, b5, b7, b8 have four branches
# and form squares; a3, a6, a7 and b2, b3, b6 have three; a5-a7 and b5-b6 differ in length; a3 and
# b6 share no explored corridor; no rotation lays a's square on b's with a3 on b6.
A_CORNERS = {
    "a1": (0, 5), "a2": (5, 5), "a3": (12, 5),
    "a4": (0, 0), "a5": (5, 0), "a6": (12, 0),
    "a7": (5, -4),
}  # fmt: skip
A_CORRIDORS = [
    ("a1", "a2"), ("a1", "a4"), ("a2", "a5"), ("a4", "a5"),
    ("a5", "a6"), ("a5", "a7"), ("a3", "a6"),
]  # fmt: skip
A_STUBS = [
    ("a1", N), ("a1", W), ("a2", N), ("a2", E), ("a4", W), ("a4", S),
    ("a3", N), ("a3", W), ("a6", S), ("a7", E), ("a7", W),
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
B_STUBS = [
    ("b1", S), ("b2", E), ("b3", W), ("b3", E), ("b4", W), ("b6", N), ("b6", S),
    ("b7", W), ("b7", S), ("b8", E), ("b8", S),
]  # fmt: skip


@pytest.fixture(name="example")
def _example(draw):
    return draw("a", A_CORNERS, A_CORRIDORS, A_STUBS), draw("b", B_CORNERS, B_CORRIDORS, B_STUBS)


def named(pairs):
    return {(f"a{u + 1}", f"b{v + 1}") for u, v in np.asarray(pairs).tolist()}


def rotated_a_deg(turn_rad):
    """The text turns map A; transforms here turn b."""
    return round(float(np.rad2deg(-wrap(turn_rad)))) % 360


def hypotheses_of(a, b):
    pa, pb = prepare_map(a), prepare_map(b)
    h = hypothesise(pa.structure, pb.structure, (a.xy, b.xy))
    pairs = np.column_stack([h.vertex_a, h.vertex_b])
    return [
        (rotated_a_deg(h.rotation[h.of == k][0]), named(pairs[h.of == k])) for k in range(len(h))
    ]


H2 = {("a1", "b8"), ("a2", "b7"), ("a4", "b5"), ("a5", "b4"), ("a7", "b2")}
QUARTER_TURN = {("a1", "b7"), ("a2", "b4"), ("a5", "b5"), ("a4", "b8"), ("a6", "b3")}


def test_example_degrees_and_correspondences(example):
    a, b = example
    assert a.degree.tolist() == [4, 4, 3, 4, 4, 3, 3]
    assert b.degree.tolist() == [2, 3, 3, 4, 4, 3, 4, 4]
    pa, pb = prepare_map(a), prepare_map(b)
    nodes = candidate_nodes(pa.structure, pb.structure)
    # Degree three pairs match for a single edge pairing, degree four for four (§2.3).
    assert len(nodes) == 3 * 3 + 4 * 4 * 4


def test_example_half_turn_gives_h2(example):
    assert (180, H2) in hypotheses_of(*example)


def test_example_h1_is_a_single_pair_without_rotation(example):
    assert (0, {("a3", "b6")}) in hypotheses_of(*example)


def test_example_quarter_turn_is_rejected_whole_for_one_length(example):
    a, b = example
    growth = grow(prepare_map(a).structure, prepare_map(b).structure)
    pairs = np.column_stack([growth.nodes.vertex_a, growth.nodes.vertex_b])
    grown = [
        (named(pairs[growth.component == c]), bool(growth.rejected[c]))
        for c in range(len(growth.rejected))
    ]
    assert (QUARTER_TURN, True) in grown
    alive = hypotheses_of(a, b)
    assert not any(turn == 90 and pairs & QUARTER_TURN for turn, pairs in alive)


def test_example_quarter_turn_would_match_were_it_not_for_that_length(example):
    a, b = example
    edge = int(np.flatnonzero((b.source == 4) & (b.target == 5))[0])
    length = b.length.copy()
    length[edge] = a.length[np.flatnonzero((a.source == 4) & (a.target == 6))[0]]
    found = hypotheses_of(a, replace(b, length=length))
    assert (90, QUARTER_TURN | {("a7", "b6")}) in found


def test_example_best_cluster_is_the_half_turn_and_the_next_two_hypotheses_unrotated(example):
    a, b = example
    found = match(prepare_map(a), prepare_map(b))
    h, c = found.hypotheses, found.clusters
    assert c.vertices[:2].tolist() == [5, 5]
    assert c.hypotheses[:2].tolist() == [1, 2]
    assert [rotated_a_deg(t) for t in c.transform[:2, 2]] == [180, 0]
    pairs = np.column_stack([h.vertex_a, h.vertex_b])
    unrotated = {("a1", "b4"), ("a2", "b5"), ("a4", "b7"), ("a5", "b8"), ("a3", "b6")}
    assert named(pairs[c.of[h.of] == 1]) == unrotated


def test_example_is_ambiguous_as_a_merge(example):
    (verdict,) = decide(example)
    assert verdict.verdict is Verdict.AMBIGUOUS
    assert not verdict.accepted
    assert len(verdict.best.matched) == len(verdict.runner_up.matched) == 5


def test_explanation_of_the_example_as_text_and_json(example):
    found = explain(*example)
    text = "\n".join(lines(found))
    assert "73 with their rotations" in text
    table = next(line for line in lines(found) if line.strip().startswith("a2 "))
    assert "H" in table
    document = to_document(found)
    best = document["hypotheses"][0]
    assert named(best["matched"]) in (H2, {("a1", "b4"), ("a2", "b5"), ("a4", "b7"), ("a5", "b8")})
    marked = [c for c in document["candidates"] if (c["a"], c["b"]) == (5, 2)]
    assert len(marked) == 1
    assert marked[0]["hypothesis"] is None  # a6-b3 belongs to the rejected quarter turn
    held = sum(c["hypothesis"] is not None for c in document["candidates"])
    assert held == sum(len(h["matched"]) for h in document["hypotheses"])


# --- the method as a whole ------------------------------------------------------------------------


@pytest.mark.parametrize("world", ["auto", "general"])
@pytest.mark.parametrize("degree", ["exact", "inexact"])
def test_mazes_are_merged_where_they_overlap(maze_pair, world, degree):
    settings = PaperSettings(GrowthSettings(world, degree))
    for seed in range(3):
        a, b, truth = maze_pair(seed)
        verdict = judge(prepare_map(a), prepare_map(b), settings)
        assert verdict.verdict is Verdict.MERGED
        right = {tuple(p) for p in truth.tolist()}
        got = {tuple(p) for p in verdict.best.matched.tolist()}
        assert len(got & right) >= 0.5 * len(truth)  # the overlap may be in several parts
        assert len(got - right) <= (1 if degree == "inexact" else 0)
        assert abs(wrap(verdict.best.transform[2] + 0.7)) < 0.02
        assert verdict.best.rmse_m < 0.2
        assert verdict.evidence_bits > 20


def test_moving_and_renumbering_a_map_moves_the_answer_alike(maze_pair):
    a, b, _ = maze_pair(3)
    settings = PaperSettings(GrowthSettings())
    before = judge(prepare_map(a), prepare_map(b), settings)
    swapped = judge(prepare_map(replace(b, run="a")), prepare_map(replace(a, run="b")), settings)
    assert {tuple(p) for p in before.best.matched[:, ::-1].tolist()} == {
        tuple(p) for p in swapped.best.matched.tolist()
    }
    assert wrap(before.best.transform[2] + swapped.best.transform[2]) == pytest.approx(0, abs=1e-6)


def test_an_executor_gives_the_same_verdicts(maze_pair):
    a, b, _ = maze_pair(1)
    maps = [a, b, replace(a, run="c"), replace(b, run="d")]
    seen = []
    alone = decide(maps, on_pair=lambda done, total: seen.append((done, total)))
    assert seen == [(k, 6) for k in range(1, 7)]
    with ThreadPoolExecutor(2) as pool:
        shared = decide(maps[::-1], executor=pool)
    assert [(v.a, v.b, v.reason, v.evidence_bits) for v in alone] == [
        (v.a, v.b, v.reason, v.evidence_bits) for v in shared
    ]


def test_maps_with_nothing_in_common_are_unrelated(draw):
    a = draw("a", {"p": (0, 0), "q": (5, 0)}, [("p", "q")])
    b = draw("b", {"p": (0, 0), "q": (9, 0)}, [("p", "q")])
    (verdict,) = decide([b, a])
    assert verdict.verdict is Verdict.UNRELATED
    assert verdict.best is None
    assert "no pair of junctions is compatible" in verdict.reason
