"""What the branches of matched junctions tell."""

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.robust.branches import branch_bits
from topobatch.merge.robust.prepare import prepare

from .plans import EDGES, POINTS


def test_equal_branches_speak_for_a_junction_and_different_ones_against(drawn):
    a = prepare(drawn("a", POINTS, EDGES))
    b = prepare(drawn("b", POINTS, EDGES, stubs=[(2, 0.0)]))
    k = np.arange(len(a))
    straight = branch_bits(a, b, k, k, np.ones(len(a), complex))
    turned = branch_bits(a, b, k, k, np.full(len(a), np.exp(0.8j)))
    assert (np.delete(straight, 2) > 0).all()
    assert straight[2] < 0
    assert (turned < straight).all()


def test_a_junction_in_doubt_tells_less_either_way(drawn):
    plain = drawn("a", POINTS, EDGES), drawn("b", POINTS, EDGES, stubs=[(2, 0.0)])
    k, turn = np.arange(len(POINTS)), np.ones(len(POINTS), complex)
    sure = branch_bits(*map(prepare, plain), k, k, turn)
    doubted = [prepare(replace(m, confidence=[0.8])) for m in plain]
    # Of 0.64 of looks at both as they are, and of others nothing.
    assert branch_bits(*doubted, k, k, turn) == pytest.approx(np.log2(0.64 * 2**sure + 0.36))
    one = prepare(replace(plain[0], confidence=np.where(k == 2, 0.5, 1.0)))
    changed = branch_bits(one, prepare(plain[1]), k, k, turn)
    assert np.flatnonzero(changed != sure).tolist() == [2]
    assert sure[2] < -1 < changed[2] < 0
