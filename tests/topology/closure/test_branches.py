"""What branches say of two places of one run being one."""

from types import SimpleNamespace

import numpy as np
import pytest

from topobatch.topology.closure.branches import align, branches_of
from topobatch.topology.closure.evidence import EvidenceSettings
from topobatch.topology.se2 import wrap

COMMON = SimpleNamespace(branch_sigma=0.05, fault_rate=0.02)


def branches(headings, share=1.0, confidence=1.0):
    """Of places with these headings; share: of their passes that saw each branch."""
    width = max(len(row) for row in headings)
    padded = np.full((len(headings), width), np.nan)
    for row, values in zip(padded, headings, strict=True):
        row[: len(values)] = values
    places = SimpleNamespace(
        heading=padded,
        share=np.where(np.isfinite(padded), share, 0.0),
        confidence=np.full(len(headings), confidence),
    )
    return branches_of(places, COMMON, EvidenceSettings())


def odds(of, a, b, sigma=0.05):
    return float(align(of, np.array([a]), np.array([b]), turn_sigma=np.array([sigma])).odds[0])


def others(seed, count):
    rng = np.random.default_rng(seed)
    return [np.sort(rng.uniform(-np.pi, np.pi, 3)) for _ in range(count)]


def test_the_turn_is_found_that_lays_branches_over_each_other():
    rng = np.random.default_rng(0)
    here = [wrap(turn + np.array([0.0, 1.7, 3.9])) for turn in rng.uniform(-3, 3, 40)]
    there = [wrap(row - turn) for row, turn in zip(here, rng.normal(0, 0.3, 40), strict=True)]
    k = np.arange(40)
    found = align(branches(here + there), k, k + 40, turn_sigma=np.full(40, 0.3))
    for row, (a, b) in enumerate(zip(here, there, strict=True)):
        said = wrap(a - b[found.partner[row]])
        weight = 3 / (2 * COMMON.branch_sigma**2)
        assert found.partner[row].tolist() == [0, 1, 2]
        assert found.turn[row] == pytest.approx(said.mean() * weight / (weight + 0.3**-2))
    assert (found.odds > 0).all()


def test_the_turn_expected_is_where_the_search_begins():
    cross = np.array([-np.pi / 2, 0.0, np.pi / 2])
    of = branches([cross, wrap(cross - 1.0), *others(2, 20)])
    one, two = np.array([0]), np.array([1])
    sigma = np.array([0.05])
    assert align(of, one, two, turn_sigma=sigma).partner.tolist() == [[-1, -1, -1]]
    told = align(of, one, two, turn_sigma=sigma, turn_mean=np.array([1.0]))
    assert told.partner.tolist() == [[0, 1, 2]]
    assert told.turn == pytest.approx(1.0)


def test_branches_that_many_places_have_tell_little():
    cross, odd = np.array([-np.pi / 2, 0.0, np.pi / 2]), np.array([-2.0, -0.5, 2.6])
    of = branches([odd, odd, *[cross] * 20])
    assert odds(of, 0, 1) > odds(of, 2, 3) + 2
    assert odds(of, 2, 3) > 0 > odds(of, 0, 2)


def test_what_another_look_lacks_counts_as_often_as_it_was_seen():
    cross, less = np.array([-np.pi / 2, 0.0, np.pi / 2]), np.array([-np.pi / 2, 0.0])
    pairs = (([cross, cross], 1.0, 1.0), ([cross, less], 1.0, 1.0))
    doubtful = (([cross, less], 0.5, 1.0), ([cross, less], 1.0, 0.5))
    told = []
    for two, share, confidence in (*pairs, *doubtful):
        of = branches([*two, *others(3, 20)], share, confidence)
        told.append(odds(of, 0, 1) + of.common[:2].max())
    same, sure, seldom, vague = told
    a_branch = np.log(2 * np.pi) - np.log(np.sqrt(2 * np.pi * 2) * COMMON.branch_sigma)
    assert same - sure == pytest.approx(a_branch - np.log(COMMON.fault_rate), abs=0.1)
    assert seldom - sure == pytest.approx(np.log(0.5 / COMMON.fault_rate))
    assert vague - sure == pytest.approx(-0.5 * np.log(COMMON.fault_rate))


def test_places_without_branches_are_compared_with_nothing():
    of = branches([np.zeros(0), np.array([0.0, 1.0]), *others(4, 5)])
    found = align(of, np.array([0]), np.array([1]), turn_sigma=np.array([0.1]))
    assert found.partner.tolist() == [[-1, -1, -1]]
    assert found.odds[0] == -np.inf
