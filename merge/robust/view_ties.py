"""Registered views as measurements between the junctions of two maps.

Where few junctions match, or none that hold a map, fused maps are laid out by what lasers and grids
showed of the same walls.
"""

from __future__ import annotations

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.map_pose_graph import NO_MEASUREMENTS, Measurements
from ...topology.se2 import between, compose, inverse, turned_axes
from .prepare import Prepared
from .view_evidence import ViewEvidence

FREE = 1e-6
"""Information [1/m², 1/rad²] in directions that registration leaves free, as along a corridor."""


def view_ties(a: Prepared, b: Prepared, views: ViewEvidence) -> Measurements:
    """Relative poses of junctions of two maps, by the views that agree at a placement.

    Each view stands for the junction nearest to it, whose pose relative to the view is known to the
    drift between the two. Views of one part of the overlap share walls and count once together.
    """
    good = np.flatnonzero(views.z > views.null[0] + 2 * views.null[1])
    if not len(good):
        return NO_MEASUREMENTS
    of_a, near_a = _anchored(a, views.first[good])
    of_b, near_b = _anchored(b, views.second[good])
    there = compose(near_a, views.transform[good])
    measured = compose(there, inverse(near_b))
    # What turns the view of b moves the junction of b, too.
    arm = measured[:, :2] - there[:, :2]
    move = np.tile(np.eye(3), (len(good), 1, 1))
    move[:, 0, 2], move[:, 1, 2] = -arm[:, 1], arm[:, 0]
    cell = views.cell[good]
    shared = np.bincount(cell)[cell, None, None]
    errors = shared * np.linalg.inv(views.information[good] + FREE * np.eye(3))
    jacobian = move @ turned_axes(near_a[:, 2])
    covariance = jacobian @ errors @ np.swapaxes(jacobian, 1, 2)
    for m, near in ((a, near_a), (b, near_b)):
        covariance += _drift(m, np.hypot(near[:, 0], near[:, 1]))
    return Measurements(of_a, of_b, measured, np.asarray(np.linalg.inv(covariance), np.float64))


def _anchored(m: Prepared, rows: IntArray) -> tuple[IntArray, FloatArray]:
    """(k,) the junction nearest to each view, and (k, 3) the view's pose in its frame."""
    pose = m.views.pose[rows]
    place = pose[:, 0] + 1j * pose[:, 1]
    vertex = np.abs(place[:, None] - m.z).argmin(axis=1)
    z = m.z[vertex]
    return vertex, between(np.column_stack([z.real, z.imag, np.zeros(len(z))]), pose)


def _drift(m: Prepared, way: FloatArray) -> FloatArray:
    """(k, 3, 3) covariance of the odometry over a straight way (k,) [m] (Measurements)."""
    noise, out = m.noise, np.zeros((len(way), 3, 3))
    swing = noise.heading_rad_per_sqrt_m**2 * way
    out[:, 0, 0] = out[:, 1, 1] = noise.along_m_per_sqrt_m**2 * way + swing * way**2 / 3
    out[:, 2, 2] = swing
    return out
