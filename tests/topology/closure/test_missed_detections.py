"""Junctions driven by unseen, and places that are none."""

from __future__ import annotations

import numpy as np

from topobatch.topology.closure.dead_reckoning import dead_reckoning
from topobatch.topology.closure.incremental import full_closure
from topobatch.topology.closure.missed_detections import correct_detections, phantoms
from topobatch.topology.closure.places import tabulate

from .walks import NOISE, grid_world, partition, record


def test_a_missed_junction_becomes_an_unseen_visit():
    world = grid_world(2, 4)
    there = [(0, 0), (0, 1), (0, 2), (0, 3)]
    route = [*there, *there[-2::-1], *there[1:]]
    odometry, passes, truth = record(world, route, unseen=(5,))
    reckoning = dead_reckoning(odometry, passes, NOISE)
    closed = full_closure(reckoning)
    assert closed.place.tolist() == partition(truth).tolist()
    corrected = correct_detections(reckoning, odometry, closed.place, closed.estimate)
    assert int((~corrected.visits.seen).sum()) == 1
    again = corrected.visits.vertex.tolist()
    assert again == partition(route).tolist()


def test_a_place_driven_by_unseen_again_and_again_is_a_phantom():
    world = grid_world(1, 4)
    xy, beside = world
    xy["ghost"] = np.array([7.5, 5.0])
    beside["ghost"] = [(0, 0), (0, 1)]
    beside[0, 0], beside[0, 1] = [(0, 1), "ghost"], [(0, 0), (0, 2), "ghost"]
    first = [(0, 0), "ghost", (0, 1), (0, 2)]
    back = [(0, 1), (0, 0), (0, 1), (0, 2), (0, 1), (0, 0)]
    odometry, passes, truth = record(world, first + back)
    reckoning = dead_reckoning(odometry, passes, NOISE)
    closed = full_closure(reckoning)
    corrected = correct_detections(reckoning, odometry, closed.place, closed.estimate)
    assert corrected.place[truth.index("ghost")] == -1
    assert len(corrected.xy) == 3
    # Once is not enough for a place with a side branch.
    places = tabulate(reckoning, closed.place, closed.estimate.pose[:, 2])
    assert not phantoms(reckoning, places, np.zeros(len(places), int)).any()


def test_a_doubtful_place_stays_where_a_run_shows_no_other():
    route = [(0, 0), *[(0, 1), (0, 2), (0, 1), (0, 0)] * 5, (0, 1), (0, 2)]
    between = [k for k in range(len(route)) if k not in (1, len(route) - 2)]
    odometry, passes, _ = record(grid_world(1, 3), route, unseen=between)
    reckoning = dead_reckoning(odometry, passes, NOISE)
    closed = full_closure(reckoning)
    corrected = correct_detections(reckoning, odometry, closed.place, closed.estimate)
    assert corrected.place.tolist() == [0, 0]
    assert int((~corrected.visits.seen).sum()) == 9
