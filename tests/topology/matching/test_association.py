"""The growth of matches: its special cases by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topobatch.topology.errors import UsageError
from topobatch.topology.matching.association import Growth, grow
from topobatch.topology.matching.correspondence import GrowthSettings
from topobatch.topology.matching.structure import prepare
from topobatch.topology.ragged import Ragged
from topobatch.topology.topomap import TopoMap

QUARTER = np.pi / 2

Pair = tuple[int, int]


def topomap(branches, edges, sigma=0.1, run="run"):
    """A map from rows of headings and edges (u, branch of u, v, branch of v, length)."""
    n = len(branches)
    xy = np.column_stack([np.arange(n) * 5.0, np.zeros(n)])
    u, i, v, j, length = (np.array(c) for c in zip(*edges, strict=True)) if edges else ([],) * 5
    return TopoMap(
        run=run,
        frame="odom",
        xy=xy,
        branches=Ragged.from_rows(branches),
        kind=("junction",) * n,
        source=np.array(u, np.int64),
        target=np.array(v, np.int64),
        source_branch=np.array(i, np.int64),
        target_branch=np.array(j, np.int64),
        length=np.array(length, np.float64),
        length_sigma=np.broadcast_to(np.array(sigma, np.float64), (len(u),)).copy(),
        traversals=np.ones(len(u), np.int64),
        paths=tuple(np.array([xy[s], xy[t] + [0.0, 1.0]]) for s, t in zip(u, v, strict=True)),
        observation_vertex=np.arange(n),
        observation_time_ns=np.arange(n),
    )


def survivors(growth: Growth) -> list[set[Pair]]:
    pairs = zip(growth.nodes.vertex_a.tolist(), growth.nodes.vertex_b.tolist(), strict=True)
    out = {}
    for pair, c in zip(pairs, growth.component.tolist(), strict=True):
        if not growth.rejected[c]:
            out.setdefault(c, set()).add(pair)
    return sorted(out.values(), key=lambda m: (-len(m), sorted(m)))


E, N, W, S = 0.0, QUARTER, -np.pi, -QUARTER


def test_the_bound_on_lengths_holds_for_the_whole_match():
    corridor = GrowthSettings(confidence=0.95, confidence_of="corridor")
    assert corridor.bound_sigmas(1) == pytest.approx(1.96, abs=0.001)
    assert corridor.bound_sigmas(50) == corridor.bound_sigmas(1)
    whole = GrowthSettings(confidence=0.95)
    assert whole.bound_sigmas(1) == corridor.bound_sigmas(1)
    z = np.random.default_rng(0).normal(size=(20_000, 30))
    assert np.mean(np.abs(z).max(axis=1) <= whole.bound_sigmas(30)) == pytest.approx(0.95, abs=0.01)
    shared = 0.8 * z + 0.6 * z[:, :1]  # an error common to all lengths: survival is no less likely
    assert np.mean(np.abs(shared).max(axis=1) <= whole.bound_sigmas(30)) >= 0.945
    for nonsense in (0.0, 1.0, 2.0):
        with pytest.raises(UsageError, match="confidence"):
            GrowthSettings(confidence=nonsense)


@pytest.mark.parametrize(("corridors", "survives"), [(1, False), (8, True)])
def test_a_longer_match_may_hold_a_larger_difference(corridors, survives):
    """3.5 sigma is too much for one corridor, and within the bound of eight."""
    east, west = 0.0, -np.pi
    n = corridors + 1
    branches = [[east], *([[west, east]] * (n - 2)), [west]] if n > 2 else [[east], [west]]
    edges = [(k, 0 if k == 0 else 1, k + 1, 0, 5.0 + k) for k in range(corridors)]
    a = topomap(branches, edges)
    length = a.length.copy()
    length[0] += 3.5 * np.hypot(0.1, 0.1)
    b = replace(a, length=length)
    growth = grow(prepare(a), prepare(b), GrowthSettings())
    whole = {(k, k) for k in range(n)}
    assert (whole in survivors(growth)) == survives
