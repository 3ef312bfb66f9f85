"""Corridors of two maps that look alike."""

import numpy as np

from topobatch.merge.robust.links import candidate_links, windows
from topobatch.merge.robust.prepare import prepare
from topobatch.merge.robust.settings import MATCH


def test_windows_are_all_pairs_of_ranges():
    left, right = windows(np.array([0, 2, 5]), np.array([2, 2, 7]))
    assert left.tolist() == [0, 0, 2, 2]
    assert right.tolist() == [0, 1, 5, 6]


def test_candidate_links_are_those_of_brute_force(halves):
    a, b = (prepare(m) for m in halves)
    links = candidate_links(a, b)
    found = set(zip(links.a_row.tolist(), links.b_row.tolist(), strict=True))
    assert len(found) == len(links)
    expected = set()
    for i in range(len(a.tail) // 2):
        for j in range(len(b.tail)):
            sigma = np.sqrt(a.variance[i] + b.variance[j])
            if (
                a.pattern[i] == b.pattern[j]
                and abs(a.length[i] - b.length[j]) < MATCH.length_sigmas * sigma
                and abs(a.sagitta[i] - b.sagitta[j]) < MATCH.gate_m
            ):
                expected.add((i, j))
    # Branches near the border of two sectors are looked up in both: more may be found, none fewer.
    assert expected <= found
    softened = found - expected
    assert all(a.pattern[i] != b.pattern[j] for i, j in softened)
