"""Growing from seeds finds what growing everywhere finds."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.topology.matching.association import (
    grow,
)
from topobatch.topology.matching.correspondence import (
    GrowthSettings,
    candidate_nodes,
    is_rectilinear,
    node_codes,
)
from topobatch.topology.matching.local_growth import grow_from
from topobatch.topology.matching.structure import prepare

from .test_association import grown, random_pair


@pytest.mark.parametrize("degree", ["exact", "inexact"])
@pytest.mark.parametrize("rectilinear", [True, False])
def test_growing_from_seeds_gives_the_matches_that_hold_one(rectilinear, degree):
    settings = GrowthSettings(world="auto" if rectilinear else "general", degree=degree)
    some = left_out = 0
    for seed in range(120):
        a, b = (prepare(m) for m in random_pair(seed, rectilinear))
        if is_rectilinear(a, b, settings) != rectilinear:
            continue
        rng = np.random.default_rng(seed)
        near = tuple(np.flatnonzero(rng.random(len(s)) < 0.4) for s in (a, b))
        seeds = candidate_nodes(a, b, settings, near)
        every = candidate_nodes(a, b, settings)
        chosen = np.isin(every.vertex_a, near[0]) & np.isin(every.vertex_b, near[1])
        assert node_codes(a, b, seeds, rectilinear).tolist() == (
            node_codes(a, b, every, rectilinear)[chosen].tolist()
        )
        whole, local = grow(a, b, settings), grow_from(a, b, seeds, settings)
        held = np.isin(
            node_codes(a, b, whole.nodes, rectilinear), node_codes(a, b, seeds, rectilinear)
        )
        kept = np.isin(np.arange(len(whole.rejected)), whole.component[held])
        assert grown(local, np.ones(len(local.rejected), bool)) == grown(whole, kept)
        some += np.count_nonzero(kept)
        left_out += np.count_nonzero(~kept)
    assert some > 10
    assert left_out > 10
