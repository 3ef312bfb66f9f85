"""Matches that grow from seeds."""

import numpy as np

from topobatch.merge.robust.growth import grow
from topobatch.merge.robust.links import Seed, candidate_links, seeds
from topobatch.merge.robust.prepare import prepare

from .plans import SETTINGS, lanes_of


def test_seeds_grow_as_each_would_alone(halves):
    a, b = (prepare(m) for m in halves)
    found = seeds(a, b, candidate_links(a, b), 3)
    wrong = Seed(np.array([0, 1]), np.array([7, 3]), 2.0, 5j, 1.0)
    several = [*found, wrong, *found]
    lanes = lanes_of([(a, b)] * len(several))
    grown = grow(lanes, several, SETTINGS)
    for k, seed in enumerate(several):
        alone = grow(lanes_of([(a, b)]), [seed], SETTINGS)
        mine, rows = grown.lane == k, lanes.lane == k
        assert (grown.a[mine] - lanes.a.vertex[k]).tolist() == alone.a.tolist()
        assert (grown.b[mine] - lanes.b.vertex[k]).tolist() == alone.b.tolist()
        assert grown.place[rows].tolist() == alone.place.tolist()
        assert grown.branch[mine].tolist() == alone.branch.tolist()
    assert np.count_nonzero(grown.lane == 0) > 10
    assert not (grown.lane == len(found)).any()
