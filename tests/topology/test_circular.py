"""Headings that cluster."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.topology.circular import cluster_angles


def test_angles_cluster_across_the_seam():
    angle = np.array([3.1, -3.1, 0.0, 0.1, 3.0, 1.5])
    owner = np.array([0, 0, 0, 0, 4, 4])
    c = cluster_angles(angle, owner, 0.3)
    assert len(c) == 4
    assert c.of[0] == c.of[1] != c.of[2]
    assert c.of[2] == c.of[3]
    assert c.owner.tolist() == [0, 0, 4, 4]
    assert abs(c.mean[c.of[0]]) == pytest.approx(np.pi)
    assert np.all(np.diff(c.mean[:2]) > 0)
    assert len(cluster_angles(np.zeros(0), np.zeros(0, int), 0.3)) == 0
