"""Identifications that are sure only together."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from topobatch.topology.closure.candidates import Candidates, Surroundings
from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.estimate import optimise
from topobatch.topology.closure.evidence import background
from topobatch.topology.closure.joint_compatibility import jointly_certain
from topobatch.topology.odometry import Odometry

from ..tracks import passes_at
from .walks import NOISE, T0, no_ground


def _ends_of_a_long_way(offsets, street=(0, 7, 13, 22)):
    """A street driven twice, 150 m of ways without branches in common between the two drives.

    offsets: where the second drive comes by junctions of the first, and how far it seems off [m].
    """
    first = np.array([[x, 0.0] for x in street])
    away = np.array([[60.0, 40.0 + 10 * k] for k in range(4)])
    again = first[: len(offsets)] + np.asarray(offsets)
    centre = np.vstack([first, away, again])
    pose = np.vstack([np.linspace(p, q, 60) for p, q in itertools.pairwise(centre)])
    pose = np.column_stack([pose, np.zeros(len(pose))])
    time_ns = T0 + np.arange(len(pose)) * 100_000_000
    odometry = Odometry(time_ns, pose, np.zeros(0, int))
    when = time_ns[np.minimum(np.arange(len(centre)) * 60, len(pose) - 1)]
    passes = passes_at(when, centre)
    reckoning = dead_reckoning(odometry, passes, replace(NOISE, heading_rad_per_sqrt_m=0.012))
    return reckoning, optimise(reckoning, np.arange(len(centre)))


def _asked(a, b, position, alike):
    """Candidates with nothing but position and likeness."""
    zero = np.zeros(len(a))
    likeness = np.asarray(alike, float)
    return Candidates(
        np.array(a), np.array(b), position, Surroundings(likeness, zero, zero, zero), zero,
        no_ground(len(a)), np.ones(len(a), bool),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("offsets", "together"),
    [
        ([[2.0, 1.5]] * 4, True),  # all are off by the same: one drift explains it
        ([[2.0, 1.5], [-2.0, 3.5], [4.0, -2.5], [-3.0, -3.0]], False),
        ([[2.0, 1.5]], False),  # one alone is not sure
    ],
)
def test_identifications_that_agree_on_one_position_are_sure_together(offsets, together):
    reckoning, estimate = _ends_of_a_long_way(offsets)
    k = len(offsets)
    common = background(reckoning, reckoning.noise)
    a, b = np.arange(k), 8 + np.arange(k)
    position = np.full(k, -2.0)
    found = _asked(a, b, position, np.full(k, 4.0))
    rows, odds, reason = jointly_certain(estimate, found, common, least_odds=9.0)
    assert (rows.tolist() == list(range(k))) is together
    assert (np.all(odds > 4.5), reason) == (True, "")
