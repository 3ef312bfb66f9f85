"""Registered views as measurements between the junctions of two maps.

Where too few junctions match to hold a map in place, fused maps are laid out by the walls that
lasers and grids show of both.
"""

from __future__ import annotations

import numpy as np

from ...topology.arrays import FloatArray, IntArray
from ...topology.posegraph.graph import NO_MEASUREMENTS, Measurements
from ...topology.se2 import between, compose, inverse, turned_axes, xy_as_complex
from .prepare import Prepared
from .view_evidence import ViewEvidence

FREE = 1e-6
"""Information [1/m², 1/rad²] in directions that registration leaves free, as along a corridor."""


def view_ties(a: Prepared, b: Prepared, views: ViewEvidence) -> Measurements:
    """Relative poses of junctions of two maps, by the views that agree at a placement.

    Each view measures the junction nearest to it, with the drift between the two. Views of one part
    of the overlap share walls and count once together.
    """
    agreeing = np.flatnonzero(views.z > views.null[0] + 2 * views.null[1])
    if not len(agreeing):
        return NO_MEASUREMENTS
    of_a, near_a = _anchors(a, views.first[agreeing])
    of_b, near_b = _anchors(b, views.second[agreeing])
    view_b = compose(near_a, views.transform[agreeing])
    measured = compose(view_b, inverse(near_b))
    # A rotation error of the view of b moves the junction of b, too.
    lever = measured[:, :2] - view_b[:, :2]
    turn_effect = np.tile(np.eye(3), (len(agreeing), 1, 1))
    turn_effect[:, 0, 2], turn_effect[:, 1, 2] = -lever[:, 1], lever[:, 0]
    part = views.cell[agreeing]
    shared = np.bincount(part)[part, None, None]
    errors = shared * np.linalg.inv(views.information[agreeing] + FREE * np.eye(3))
    jacobian = turn_effect @ turned_axes(near_a[:, 2])
    covariance = jacobian @ errors @ np.swapaxes(jacobian, 1, 2)
    for m, anchor_pose in ((a, near_a), (b, near_b)):
        covariance += m.noise.straight_covariance(np.hypot(anchor_pose[:, 0], anchor_pose[:, 1]))
    return Measurements(of_a, of_b, measured, np.asarray(np.linalg.inv(covariance), np.float64))


def _anchors(m: Prepared, rows: IntArray) -> tuple[IntArray, FloatArray]:
    """(k,) the junction nearest to each view, and (k, 3) the view's pose in its frame."""
    pose = m.views.pose[rows]
    vertex = np.abs(xy_as_complex(pose)[:, None] - m.z).argmin(axis=1)
    z = m.z[vertex]
    return vertex, between(np.column_stack([z.real, z.imag, np.zeros(len(z))]), pose)
