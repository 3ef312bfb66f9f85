"""Which branches of a map's junctions a robot drove."""

from __future__ import annotations

import numpy as np

from .arrays import BoolArray
from .passes import DRIVEN_RAD, NO_BRANCH
from .polyline import leaving_over
from .se2 import wrap
from .topomap import Graph

LEAVING_M = 1.5
"""The direction of a corridor at its end is taken over this distance."""


def driven_branches(graph: Graph) -> BoolArray:
    """(total branches,) whether a corridor of the map leaves by the branch.

    An end of a corridor without a branch has the one nearest in direction, within DRIVEN_RAD.
    O(branches + edges).
    """
    driven = np.zeros(len(graph.branches.values), bool)
    offsets = graph.branches.offsets
    for vertex, branch, step in (
        (graph.source, graph.source_branch, 1),
        (graph.target, graph.target_branch, -1),
    ):
        known = branch != NO_BRANCH
        driven[offsets[vertex[known]] + branch[known]] = True
        for edge in np.flatnonzero(~known).tolist():
            leaving = leaving_over(graph.paths[edge][::step], LEAVING_M)
            turn_rad = np.abs(wrap(graph.branches[int(vertex[edge])] - leaving))
            if len(turn_rad) and turn_rad.min() < DRIVEN_RAD:
                driven[offsets[vertex[edge]] + int(turn_rad.argmin())] = True
    return driven
