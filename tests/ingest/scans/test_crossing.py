"""Centres of crossings: where axes of corridors meet, or the fork where branches are none."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from topobatch.ingest.scans.crossing import crossing, placed
from topobatch.ingest.scans.skeleton import Node, SkeletonGraph, SkeletonSettings, thin, traced
from topobatch.ingest.scans.skeleton_lines import Lines, lines_of
from topobatch.topology.se2 import wrap

CELL = 0.1
SIDE = 120
MIDDLE = np.array([6.0, 6.0])


def corridors(*headings_deg: float, wave_m: float = 0.0) -> np.ndarray:
    """Free cells of corridors, 1.4 m wide, that leave the middle of a square, winding every 3 m."""
    y, x = np.mgrid[:SIDE, :SIDE] * CELL - MIDDLE[0]
    free = np.zeros((SIDE, SIDE), bool)
    for heading in np.radians(headings_deg):
        c, s = np.cos(heading), np.sin(heading)
        along, across = c * x + s * y, c * y - s * x
        free |= (np.abs(across - wave_m * np.sin(2.1 * along)) < 0.701) & (along >= 0)
    return free


def skeleton_of(clearance: np.ndarray) -> Lines:
    """The lines of a skeleton, given the distance from walls; the ways lead to the outline."""
    border = np.pad(np.zeros(np.array(clearance.shape) - 2, bool), 1, constant_values=True)
    return lines_of(thin(clearance > SkeletonSettings().clearance_m), clearance, CELL, border)


def fork_of(free: np.ndarray) -> tuple[SkeletonGraph, Node]:
    """The skeleton of a grid with one junction, and its node."""
    clearance = ndimage.distance_transform_edt(np.pad(free, 1, mode="edge"))[1:-1, 1:-1] * CELL
    settings = SkeletonSettings()
    graph = traced(skeleton_of(clearance), settings)
    (node,) = graph.nodes
    return graph, node


def seen(free: np.ndarray) -> tuple[Node, Node]:
    """The one junction of a grid, as the skeleton forks and as its corridors cross."""
    graph, node = fork_of(free)
    (place,) = placed(graph, [node])
    return node, crossing(graph, place, SkeletonSettings())


@pytest.mark.parametrize("sharp", [40, 75])
def test_acute_crossings_are_where_their_axes_meet(sharp: float) -> None:
    node, found = seen(corridors(0, 180, sharp))
    off = np.hypot(*(found.xy - MIDDLE))
    assert off < max(0.15, 0.5 * np.hypot(*(node.xy - MIDDLE)))
    assert off < 0.25
    apart = np.abs(wrap(found.headings[:, None] - np.radians([0, 180, sharp])))
    assert apart.min(axis=0).max() < 0.15
