"""Trajectories, read by evo."""

from __future__ import annotations

import numpy as np

from topobatch.topology.se2 import apply
from topobatch.viz.exports.tum import corrected_tum, recorded_tum

from .readers import read_tum


def test_the_odometry_is_as_it_was_recorded(driven, tmp_path) -> None:
    odometry = driven[0].odometry
    read = read_tum(recorded_tum(odometry), tmp_path)
    np.testing.assert_allclose(read.timestamps, odometry.time_ns * 1e-9, rtol=0, atol=1e-6)
    np.testing.assert_allclose(read.positions_xyz[:, :2], odometry.pose[:, :2], atol=1e-6)
    yaw = read.get_orientations_euler("sxyz")[:, 2]
    np.testing.assert_allclose(np.exp(1j * yaw), np.exp(1j * odometry.pose[:, 2]), atol=1e-6)


def test_corrected_trajectories_pass_where_the_junctions_are(driven, tmp_path) -> None:
    run, topomap = driven
    corrected = read_tum(corrected_tum(topomap, run.odometry) or "", tmp_path)
    at = np.searchsorted(corrected.timestamps, topomap.observation_time_ns * 1e-9)
    there = topomap.xy[topomap.observation_vertex]
    assert np.hypot(*(corrected.positions_xyz[at, :2] - there).T).max() < 0.2


def test_a_run_can_be_laid_into_another_frame(driven, tmp_path) -> None:
    run, topomap = driven
    T = np.array([1.0, 2.0, 0.5])
    own = read_tum(corrected_tum(topomap, run.odometry) or "", tmp_path)
    moved = read_tum(corrected_tum(topomap, run.odometry, T) or "", tmp_path)
    there = apply(T, own.positions_xyz[:, :2])
    np.testing.assert_allclose(moved.positions_xyz[:, :2], there, atol=1e-5)
