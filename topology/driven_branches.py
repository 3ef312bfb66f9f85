"""Which branches of a map's junctions a robot drove."""

from __future__ import annotations

import numpy as np

from .arrays import BoolArray
from .passes import NO_BRANCH
from .polyline import leaving_over
from .se2 import wrap
from .topomap import Graph

SAME_BRANCH_RAD = 0.7
"""A corridor's end that names no branch is assigned the nearest one within this angle."""

LEAVING_M = 1.5
"""The direction of a corridor at its end is taken over this distance."""


def driven_branches(graph: Graph) -> BoolArray:
    """(total branches,) whether a corridor of the map leaves by the branch.

    A corridor's end that names no branch takes the one nearest in direction, within
    SAME_BRANCH_RAD. O(branches + edges).
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
            gap = np.abs(wrap(graph.branches[int(vertex[edge])] - leaving))
            if len(gap) and gap.min() < SAME_BRANCH_RAD:
                driven[offsets[vertex[edge]] + int(gap.argmin())] = True
    return driven
