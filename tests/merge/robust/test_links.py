"""Corridors of two maps that look alike."""

import numpy as np

from topobatch.merge.robust.links import candidate_links, seeds, windows
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


def test_rivals_are_the_same_whether_the_first_seeds_are_known_or_not(drawn):
    """Equal blocks: a map of them lies over another in many ways."""
    grid = [(5.0 * x, 7.0 * y) for x in range(5) for y in range(4)]
    edges = [(k, k + 4) for k in range(16)] + [(k, k + 1) for k in range(20) if k % 4 != 3]
    a, b = prepare(drawn("a", grid, edges)), prepare(drawn("b", grid, edges[1:]))
    links = candidate_links(a, b)
    first = seeds(a, b, links, 2)
    anew = seeds(a, b, links, 2, rival_bits=1.0)
    known = seeds(a, b, links, 2, rival_bits=1.0, first=first)
    assert len(first) == sum(not seed.rival for seed in anew) == 2 < len(anew)
    told = [[(s.bits, s.shift, s.rival) for s in found] for found in (anew, known)]
    assert told[0] == told[1]
    assert all(any(one is s for s in known) for one in first)
