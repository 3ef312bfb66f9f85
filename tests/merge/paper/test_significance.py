"""How often chance grows a match: the sums by hand, and that bits are bits."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.merge.paper.method import PaperSettings, judge, prepare_map
from topobatch.merge.paper.significance import (
    SelfSimilarity,
    independent_lengths,
    match_bits,
    self_similarity,
)
from topobatch.topology.matching.association import grow
from topobatch.topology.matching.correspondence import GrowthSettings
from topobatch.topology.matching.structure import prepare

NONE = SelfSimilarity(links=0, tested=0, agreed=0, largest=0, ends=0.25)


def ladder(draw, rungs, name="a", width=5.0):
    """A ladder of equal rungs: it repeats itself at every step."""
    corners = {f"{s}{k}": (width * k, 4.0 * s) for k in range(rungs) for s in (0, 1)}
    sides = [(f"{s}{k}", f"{s}{k + 1}") for s in (0, 1) for k in range(rungs - 1)]
    return draw(name, corners, [*sides, *((f"0{k}", f"1{k}") for k in range(rungs))])


def test_bits_of_matches_by_hand(maze_pair):
    a, b, _ = maze_pair(2)
    sa, sb = prepare(a), prepare(b)
    growth = grow(sa, sb)
    bits = match_bits(growth, sa, sb, (NONE, NONE))
    along = independent_lengths(growth, sa)
    for c in range(len(growth.rejected)):
        mine, links = growth.component == c, growth.link_component == c
        others = np.flatnonzero(np.arange(len(growth.rejected)) != c)
        reached = np.count_nonzero(~mine)
        p = (growth.agreed[others].sum() - reached + 1) / (
            growth.tested[others].sum() - reached + 2
        )
        v = np.count_nonzero(mine)
        chosen_from = np.log2(np.count_nonzero(~links) + 1)
        free = min(v - 2, along[:, c].min())
        slid = -free * np.log2(p) + 2 * (v - 2 - free)
        expected = min(slid, -(v - 2) * np.log2(p)) - chosen_from
        assert bits[c] == pytest.approx(min(expected, -v * np.log2(p)))
        assert along[:, c].sum() <= max(v - 1, 1)


def test_a_match_no_larger_than_what_a_map_shares_with_itself_is_no_evidence(draw, maze_pair):
    a = prepare(ladder(draw, 8))
    alike = self_similarity(a, GrowthSettings())
    assert alike.largest == 16  # turned by half a turn
    assert alike.agreed > 0.5 * alike.tested
    b = prepare(ladder(draw, 8, "b"))
    growth = grow(a, b)
    assert match_bits(growth, a, b, (alike, alike)).max() < 2
    maze, _, _ = maze_pair(0)
    assert self_similarity(prepare(maze), GrowthSettings()).largest <= 4


@pytest.mark.parametrize("degree", ["exact", "inexact"])
def test_ladders_are_never_merged(draw, degree):
    settings = PaperSettings(GrowthSettings(degree=degree))
    maps = [ladder(draw, n, name) for n, name in ((7, "a"), (9, "b"), (9, "c"))]
    prepared = [prepare_map(m, settings) for m in maps]
    for i, j in ((0, 1), (1, 2)):
        assert not judge(prepared[i], prepared[j], settings).accepted
