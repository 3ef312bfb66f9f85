"""Meetings: their notation, and hypotheses seeded by them."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.merge.paper.meeting import Meeting, parse_meeting
from topobatch.merge.paper.method import PaperSettings, match, prepare_map
from topobatch.topology.errors import UsageError
from topobatch.topology.matching.correspondence import GrowthSettings

GROWTH = GrowthSettings()


def test_notation():
    met = parse_meeting("run1@12.5,dir/run-2@1700000000000000000")
    assert met == Meeting("run1", 12_500_000_000, "dir/run-2", 1_700_000_000_000_000_000)
    for bad in ("run1,run2", "run1@x,run2@3", "run1@3", "@3,run2@3", "a@1,a@2"):
        with pytest.raises(UsageError):
            parse_meeting(bad)


def test_only_hypotheses_that_pair_vertices_near_both_robots_are_formed(maze_pair):
    a, b, truth = maze_pair(1)
    u, v = truth[len(truth) // 2].tolist()
    met = Meeting("a", u * 10**9, "b", v * 10**9, range_m=4.0)
    free = PaperSettings(GROWTH)
    seeded = PaperSettings(GROWTH, meetings=(met,))
    every = match(prepare_map(a, free), prepare_map(b, free), free).hypotheses
    pa, pb = prepare_map(a, seeded), prepare_map(b, seeded)
    found = match(pa, pb, seeded).hypotheses
    near = [set(p.near[met].tolist()) for p in (pa, pb)]
    expected = {
        tuple(zip(every.vertex_a[rows].tolist(), every.vertex_b[rows].tolist(), strict=True))
        for k in range(len(every))
        for rows in [np.flatnonzero(every.of == k)]
        if any(
            int(x) in near[0] and int(y) in near[1]
            for x, y in zip(every.vertex_a[rows], every.vertex_b[rows], strict=True)
        )
    }
    got = {
        tuple(zip(found.vertex_a[rows].tolist(), found.vertex_b[rows].tolist(), strict=True))
        for k in range(len(found))
        for rows in [np.flatnonzero(found.of == k)]
    }
    assert got == expected
    assert 0 < len(found) < len(every)
    assert any((u, v) in h for h in got)
