"""A map as a pose graph: its corridors as the odometry measured them (§3.1)."""

from __future__ import annotations

import numpy as np

from .arrays import FloatArray
from .corridor_lengths import LEAST_M, length_variances
from .digits import BRANCH
from .posegraph.graph import Measurements, PoseGraph
from .se2 import turned_axes
from .topomap import TopoMap

LEAST_TURN_RAD = 10.0**-BRANCH
"""Lower bound of a corridor's heading error, 1 sigma: keeps the information finite; an odometry
without noise is assumed to have more (3e-4 in a corridor)."""


def odometry_measurements(topomap: TopoMap) -> Measurements:
    """Relative poses along the corridors of a map, without loops, with the errors of the odometry.

    Axes are those of the map, so that the measured turn is 0. The vertices of the pose graph are
    junction centres as this map saw them: the error of a centre is common to all of its corridors,
    and enters where the vertex is tied to other maps; only the scatter of the single passes about
    it remains in each corridor (`_followed`). For errors of turns, the robot is taken to enter
    corridors straight or at a right angle equally often: π/4 in the mean, half of it at each end.
    The covariance of a corridor whose length is less certain than that explains is enlarged to it
    (`length_variances`), as a whole.
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
    followed = _followed((along + across) / 2 + LEAST_M**2, noise.centre_m**2)
    passes = noise.centre_m**2 * differ * followed
    for axis, leg in ((0, along), (1, across)):
        cov[:, axis, axis] = (leg + passes) / times + LEAST_M**2
    cov[:, 1, 2] = cov[:, 2, 1] = (walk / 2 + swing) * length / times
    cov[:, 2, 2] = (walk + 2 * swing) / times + LEAST_TURN_RAD**2
    _, discounted = length_variances(topomap)
    cov *= (1 + discounted / cov[:, 0, 0])[:, None, None]
    keep = np.flatnonzero(topomap.source != topomap.target)  # a loop constrains no other junction
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
    """(k,) share of the variance `seen` [m²] of a junction centre by which the position of a pass
    errs, between legs of odometry with variances `leg` (k,) [m²].

    A random walk with variance q per leg, observed at every pass with variance r: the steady state
    of its Kalman filter predicts a pass from those before it with P = (q + √(q² + 4 q r)) / 2
    (Riccati equation), from those after it likewise, and the smoother gives r · P / (P + 2 r).
    """
    ahead = (leg + np.sqrt(leg * (leg + 4 * seen))) / 2
    return np.asarray(ahead / (ahead + 2 * seen))


def map_pose_graph(topomap: TopoMap) -> PoseGraph:
    """A map as a pose graph: vertices are poses, corridors are the odometry's measurements.

    Headings are rotations relative to the map's frame, 0 for the map as it was drawn.
    """
    pose = np.column_stack([topomap.xy, np.zeros(len(topomap))])
    parts = odometry_measurements(topomap)
    return PoseGraph(pose, parts.source, parts.target, parts.measurement, parts.information)
