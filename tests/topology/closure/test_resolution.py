"""Junctions nearer to each other than the detector can tell apart."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.topology.closure import resolution
from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.estimate import optimise
from topobatch.topology.closure.missed_detections import correct_detections
from topobatch.topology.closure.places import NOWHERE

from .walks import NOISE, partition, record


def a_crossing_seen_as_two_forks():
    """A crossing at 0, 0, and the two forks beside each other that some looks show in its place."""
    xy = {"west": (-6, 0), "east": (6, 0), "north": (0, 6), "south": (0, -6)}
    xy |= {"crossing": (0, 0), "left": (-0.5, 0), "right": (0.5, 0)}
    beside = {
        **{end: ["crossing"] for end in ("west", "east", "north", "south")},
        "crossing": ["west", "east", "north", "south"],
        "left": ["west", "right", "north"],
        "right": ["east", "left", "south"],
    }
    return {name: np.array(at, float) for name, at in xy.items()}, beside


def corrected_by_sight(route, resolution_m):
    """Every description of a place taken for a place of its own, then corrected."""
    odometry, passes, truth = record(a_crossing_seen_as_two_forks(), route)
    reckoning, place = dead_reckoning(odometry, passes, NOISE), partition(truth)
    corrected = correct_detections(
        reckoning, odometry, place, optimise(reckoning, place), resolution_m=resolution_m
    )
    return corrected, {name: int(corrected.place[k]) for k, name in reversed([*enumerate(truth)])}


THERE = ["west", "left", "right", "east"]


def test_two_forks_in_place_of_a_crossing_are_the_crossing_that_was_seen_better():
    route = [*THERE, "crossing", "west", "crossing", "north"]
    corrected, number = corrected_by_sight(route, 1.3)
    assert number["left"] == number["crossing"]
    assert number["right"] == NOWHERE  # the same visit
    assert corrected.visits.vertex.tolist() == [0, 2, 1, 2, 0, 2, 3]
    assert corrected.xy[2] - corrected.xy[0] == pytest.approx([6.0, 0.0], abs=0.1)
    assert corrected.fair.tolist() == [True, False, False, *[True] * 5]
    assert [q.reason for q in corrected.identifications] == [resolution.REASON] * 2
    # It lies amid all looks: the three here, of which two are a little aside.
    assert np.hypot(*(corrected.xy[2] - corrected.xy[0] - [6.0, 0.0])) < 0.01
    assert all(q.accepted and q.bits > 0 for q in corrected.identifications)


def test_what_a_detector_tells_apart_stays_apart():
    route = [*THERE, "crossing", "west"]
    assert len(corrected_by_sight(route, 0.0)[0].xy) == 5
    assert len(corrected_by_sight(route, 0.3)[0].xy) == 5
    told, number = corrected_by_sight([*THERE, *THERE[-2::-1]], 1.3)
    assert number["left"] != number["right"]
    assert told.identifications == []
