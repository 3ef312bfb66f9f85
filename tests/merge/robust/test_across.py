"""Copies of components, told by all pairs across them."""

from dataclasses import replace

import pytest

from topobatch.merge.result import PairVerdict, Verdict
from topobatch.merge.robust.alignment import match
from topobatch.merge.robust.components import LARGER_TOGETHER, Across, Components, as_alignment
from topobatch.merge.robust.prepare import prepare
from topobatch.merge.robust.verdict import OTHER_SIZE

from .plans import EDGES, POINTS, SETTINGS


@pytest.fixture
def sizes(drawn):
    """Two maps of one plan, and two of it 2 % larger; each pair by its best alignment."""
    larger = [(1.02 * x, 1.02 * y) for x, y in POINTS]
    plans = {"a": POINTS, "b": POINTS, "c": larger, "d": larger}
    maps = [drawn(name, plan, EDGES) for name, plan in plans.items()]
    scale = 0.006
    prepared = [prepare(replace(m, noise=replace(m.noise, scale=scale))) for m in maps]
    found = {
        (i, j): match(prepared[i], prepared[j], SETTINGS)[0] for j in range(4) for i in range(j)
    }
    joins = {pair: as_alignment(c) for pair, c in found.items()}
    return Across(prepared, {}, joins, _nothing, (), SETTINGS.size_sigmas), found


def _nothing(pairs):
    return [0.0] * len(pairs)


def test_more_runs_tell_more_than_two(sizes):
    """Their scales err apart: of two runs on either side by less than of one."""
    own, _ = sizes
    components = Components(4, ())
    across = {pair: own.joins[pair] for pair in ((0, 2), (0, 3), (1, 2), (1, 3))}
    alone = own._size_sigmas(components, (0, 2), {(0, 2): across[0, 2]})
    for i, j in ((0, 1), (2, 3)):
        components.join(i, j, own.joins[i, j].transform)
    together = own._size_sigmas(components, (0, 2), across)
    assert alone < own.most_sigmas < together < 2 * alone
    assert own._size_sigmas(components, (1, 3), across) == pytest.approx(together)
    larger = PairVerdict(
        "a", "d", Verdict.AMBIGUOUS, False, 20.0, "", best=across[0, 3], lacks=OTHER_SIZE
    )
    known = replace(own, verdicts={(0, 3): larger})
    assert known.refusal(components, (0, 2)) is LARGER_TOGETHER
    assert own.refusal(components, (0, 2)) is None  # no pair says so by itself
    assert replace(known, locked=[(0, 2)]).refusal(components, (0, 2)) is None
