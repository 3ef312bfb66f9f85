"""Sightings fused to passes."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.ingest.passes import fuse_passes, scanned_passes
from topobatch.topology.odometry import Odometry
from topobatch.topology.passes import NO_BRANCH
from topobatch.topology.ragged import Ragged
from topobatch.topology.run import Detections, ScanPasses
from topobatch.topology.se2 import apply, inverse, wrap

T0 = 1_700_000_000 * 10**9
STEP_NS = 50_000_000


def straight(length_m: float = 20.0, speed: float = 1.0) -> Odometry:
    """Along x at constant speed, 20 rows a second."""
    x = np.arange(0.0, length_m, speed * STEP_NS * 1e-9)
    pose = np.column_stack([x, np.zeros((len(x), 2))])
    return Odometry(T0 + np.arange(len(x)) * STEP_NS, pose, np.zeros(0, np.int64))


def sight(odometry, centre, branches, rows):
    """What an exact detector says of one junction at some rows of the odometry."""
    pose = odometry.pose[rows]
    xy = apply(inverse(pose), np.asarray(centre, float))
    return [
        (int(t), p, [wrap(b - theta) for b in branches])
        for t, p, theta in zip(odometry.time_ns[rows], xy, pose[:, 2], strict=True)
    ]


def detections(messages):
    messages = sorted(messages, key=lambda m: m[0])
    return Detections(
        np.array([m[0] for m in messages], np.int64),
        np.array([m[1] for m in messages]).reshape(-1, 2),
        Ragged.from_rows([m[2] for m in messages]),
    )


def near(odometry, x, reach=1.0):
    return np.flatnonzero(np.abs(odometry.pose[:, 0] - x) <= reach)[::3]


def test_two_junctions_on_a_straight_track():
    odometry = straight()
    seen = detections(
        sight(odometry, (5, 0), [0, np.pi, 1.5], near(odometry, 5))
        + sight(odometry, (12, 0.1), [0, np.pi], near(odometry, 12))
    )
    passes = fuse_passes(odometry, seen)
    assert len(passes) == 2
    np.testing.assert_allclose(passes.centre, [[5, 0], [12, 0.1]], atol=1e-9)
    np.testing.assert_allclose(passes.branches[0], [-np.pi, 0, 1.5], atol=1e-9)
    # Came from behind, left ahead.
    assert passes.branches[0][passes.entry[0]] == pytest.approx(-np.pi)
    assert passes.branches[0][passes.exit[0]] == pytest.approx(0)
    assert np.all(passes.confidence == 1)
    assert np.all(np.abs(passes.time_ns - T0 - [5 * 10**9, 12 * 10**9]) < 0.2e9)
    assert np.all((passes.start_ns <= passes.time_ns) & (passes.time_ns <= passes.end_ns))


def test_close_junctions_are_told_apart_by_the_jump():
    odometry = straight()
    a = sight(odometry, (5, 0), [0, np.pi], np.flatnonzero(np.abs(odometry.pose[:, 0] - 5) < 0.6))
    b = sight(
        odometry, (6.3, 0), [0, np.pi], np.flatnonzero(np.abs(odometry.pose[:, 0] - 6.3) < 0.6)
    )
    assert len(fuse_passes(odometry, detections(a + b))) == 2


def test_a_break_cuts_passes_and_hides_sightings_within_it():
    whole = straight()
    keep = np.r_[0:100, 104 : len(whole)]
    broken = Odometry(whole.time_ns[keep], whole.pose[keep], np.array([100]))
    seen = detections(sight(whole, (5, 0), [0, np.pi], np.r_[84:118:2]))
    passes = fuse_passes(broken, seen)
    assert len(passes) == 2
    assert passes.exit[0] == NO_BRANCH
    assert passes.entry[1] == NO_BRANCH
    assert passes.messages.sum() == len(seen) - 2


def scan_passes(odometry, rows, centres, headings, confidence):
    """What scans show at rows of the odometry: centres and headings in its frame."""
    pose = odometry.pose[rows]
    time_ns = odometry.time_ns[rows]
    branches = Ragged.from_rows([wrap(h - t) for h, t in zip(headings, pose[:, 2], strict=True)])
    return ScanPasses(
        time_ns=time_ns,
        start_ns=time_ns - STEP_NS,
        end_ns=time_ns + STEP_NS,
        centre=apply(inverse(pose), np.asarray(centres, float)),
        branches=branches,
        confidence=np.asarray(confidence, float),
        windows=np.full(len(rows), 3),
        clearance_m=np.ones(len(rows)),
        shared_m=np.zeros(len(rows)),
    )


def test_what_scans_show_becomes_passes_like_others():
    odometry = straight()
    headings = [np.array([0.1, np.pi - 0.05, -1.5]), np.array([-3.1, 3.0, 0.0, 1.6])]
    seen = scan_passes(odometry, [100, 300], [(5.0, 0.3), (15.0, -0.2)], headings, [1.0, 4 / 7])
    passes = scanned_passes(odometry, seen)
    assert np.allclose(passes.centre, [(5.0, 0.3), (15.0, -0.2)])
    for row, given in enumerate(headings):
        assert np.allclose(passes.branches[row], np.sort(given))
        came, went = passes.branches[row][[passes.entry[row], passes.exit[row]]]
        assert abs(wrap(came - np.pi)) < 0.2
        assert abs(went) < 0.2
    assert passes.confidence.tolist() == [1.0, 4 / 7]
