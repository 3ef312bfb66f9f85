"""Small maps drawn by hand, and one map laid over another."""

import numpy as np

from topobatch.merge.robust.atlas import Atlas, Lanes
from topobatch.merge.robust.conflicts import conflicts
from topobatch.merge.robust.growth import grow
from topobatch.merge.robust.links import Seed
from topobatch.merge.robust.repetition import default_copies
from topobatch.merge.robust.settings import RobustSettings

SETTINGS = RobustSettings()
COPIES = default_copies(SETTINGS)

#   5 --- 6 --- 7
#   |     |
#   0 --- 1 ------- 2
#         |         |
#         3 ------- 4
POINTS = [(0, 0), (5, 0), (12, 0), (5, -6), (12, -6), (0, 4), (5, 4), (9, 4)]
EDGES = [(0, 1), (1, 2), (1, 3), (3, 4), (2, 4), (0, 5), (5, 6), (6, 7), (1, 6)]


def lanes_of(pairs):
    """A lane for each pair of maps."""
    a, b = (Atlas.of(maps) for maps in zip(*pairs, strict=True))
    return Lanes.of(a, b, np.arange(len(pairs)), np.arange(len(pairs)))


def laid(a, b, dx=0.0, dy=0.0):
    """b over a without a turn, grown from its first vertex that lies on one of a's."""
    gap = np.abs(a.z[:, None] - (b.z + dx + 1j * dy)[None])
    i, j = np.unravel_index(gap.argmin(), gap.shape)
    seed = Seed(np.array([i]), np.array([j]), 0.0, complex(dx, dy), 1.0)
    return grow(lanes_of([(a, b)]), [seed], SETTINGS)


def against(grown):
    """The contradictions of a match in the only lane."""
    (found,) = conflicts(grown, np.ones(1, bool))
    return found
