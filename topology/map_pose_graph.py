"""A map as a pose graph: its corridors as the odometry measured them (§3.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import FloatArray, IntArray
from .posegraph.graph import PoseGraph
from .se2 import turned_axes
from .topomap import TopoMap

LEAST_TURN_RAD = 1e-4
"""No corridor keeps its heading better than this, 1 sigma: it keeps information finite, and is far
below what an odometry without noise is told to be (3e-4 in a corridor)."""

LEAST_STEP_M = 0.001
"""Nor its length, to which documents are rounded."""


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """Relative poses between vertices, or rows: source, target: (k,); measurement: (k, 3)
    T_source_target; information: (k, 3, 3)."""

    source: IntArray
    target: IntArray
    measurement: FloatArray
    information: FloatArray


def odometry_measurements(topomap: TopoMap) -> Measurements:
    """Relative poses along the corridors of a map, loops left out, in the map's directions (so that
    the turn is 0), with the errors of the odometry between them.

    For a pose graph whose vertices are centres as this map saw them: an error of a vertex's centre
    is common to all of its corridors, and enters where that vertex is tied to other maps. What the
    single passes by a junction differ by remains in each corridor as far as the odometry lets it
    (`_followed`). Errors of turns: a robot enters a corridor straight or at a right angle, a
    quarter of π in the mean, half of it at each end.
    """
    noise, length = topomap.measured, topomap.length
    times = np.maximum(topomap.traversals, 1)
    visits = np.maximum(topomap.passes, 1)
    differ = (1 - 1 / visits[topomap.source]) + (1 - 1 / visits[topomap.target])
    walk = noise.heading_rad_per_sqrt_m**2 * length
    swing = noise.heading_rad_per_sqrt_rad**2 * np.pi / 8
    # A heading that walks at random turns the chord by half as much as the far end; what it errs
    # in the junction at the near end, it turns all of the corridor by.
    along = noise.along_m_per_sqrt_m**2 * length
    across = (walk / 3 + swing) * length**2
    cov = np.zeros((len(length), 3, 3))
    # What is along one corridor may be across the next.
    followed = _followed((along + across) / 2 + LEAST_STEP_M**2, noise.centre_m**2)
    passes = noise.centre_m**2 * differ * followed
    for axis, leg in ((0, along), (1, across)):
        cov[:, axis, axis] = (leg + passes) / times + LEAST_STEP_M**2
    cov[:, 1, 2] = cov[:, 2, 1] = (walk / 2 + swing) * length / times
    cov[:, 2, 2] = (walk + 2 * swing) / times + LEAST_TURN_RAD**2
    keep = np.flatnonzero(topomap.source != topomap.target)  # a loop tells nothing of its junction
    source, target = topomap.source[keep], topomap.target[keep]
    step = topomap.xy[target] - topomap.xy[source]
    axes = turned_axes(np.arctan2(step[:, 1], step[:, 0]))
    information = axes @ np.linalg.inv(cov[keep]) @ axes.transpose(0, 2, 1)
    return Measurements(
        source,
        target,
        np.column_stack([step, np.zeros(len(keep))]),
        0.5 * (information + information.transpose(0, 2, 1)),
    )


def _followed(leg: FloatArray, seen: float) -> FloatArray:
    """(k,) share of the variance `seen` of a centre by which a pass is placed, between legs of an
    odometry of variances `leg` [m²] each.

    A random walk of q per leg that is observed at every pass to r: predicted from the passes before
    it is known to P = (q + √(q² + 4 q r)) / 2 (where the Riccati equation of its Kalman filter
    stands still), from those after it likewise, and smoothed to r · P / (P + 2 r).
    """
    ahead = (leg + np.sqrt(leg * (leg + 4 * seen))) / 2
    return np.asarray(ahead / (ahead + 2 * seen))


def map_pose_graph(topomap: TopoMap) -> PoseGraph:
    """The vertices of a map as poses, its corridors as what the odometry measured between them.

    Headings are turns against the map's frame: all 0 where the map lies as it was drawn.
    """
    pose = np.column_stack([topomap.xy, np.zeros(len(topomap))])
    parts = odometry_measurements(topomap)
    return PoseGraph(pose, parts.source, parts.target, parts.measurement, parts.information)
