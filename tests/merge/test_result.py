"""Where the points of runs lie in the map that these were fused to."""

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.fusion.fuse import fuse
from topobatch.merge.result import Alignment, PairVerdict, Verdict, placed_at
from topobatch.topology.se2 import apply, inverse

from ..maps import straight_map

CORNERS = [(0, 0), (10, 0), (10, 6), (0, 6), (16, 6)]
WAYS = [(0, 1), (1, 2), (2, 3), (3, 0), (2, 4)]
T_B_WORLD = np.array([5.0, -3.0, 0.7])


def test_points_move_as_the_junctions_near_them_do() -> None:
    a, m = straight_map("a", CORNERS, WAYS), straight_map("b", CORNERS, WAYS, T=T_B_WORLD)
    best = Alignment(inverse(T_B_WORLD), 40.0, np.arange(5).repeat(2).reshape(-1, 2), 0.1)
    pair = PairVerdict("a", "b", Verdict.MERGED, True, 40.0, "", best=best)
    (component,), result = fuse([a, m], [pair])
    rigid = placed_at(result, component, m, m.xy)
    assert rigid == pytest.approx(np.tile(component.poses["b"], (len(m), 1)), abs=1e-6)
    moved = np.array(result.xy)
    moved[4] += (0.5, 0.0)  # the end of the stub
    fused = replace(result, xy=moved)
    bent = apply(placed_at(fused, component, m, m.xy), m.xy)
    off = np.hypot(*(bent - result.xy[:5]).T)
    assert off.argmax() == 4
    assert off[4] > 0.3
    assert off[0] < 0.1
