"""The parts of trusted merging on maps drawn by hand, and against brute force."""

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.result import Verdict
from topobatch.merge.robust.alignment import match, match_all, same_placement, self_matches
from topobatch.merge.robust.atlas import Atlas, Lanes
from topobatch.merge.robust.branches import branch_bits
from topobatch.merge.robust.components import Components, as_alignment, join_all
from topobatch.merge.robust.conflicts import conflicts
from topobatch.merge.robust.growth import grow
from topobatch.merge.robust.links import (
    Seed,
    candidate_links,
    seeds,
    windows,
)
from topobatch.merge.robust.prepare import prepare
from topobatch.merge.robust.records import to_bytes
from topobatch.merge.robust.repetition import (
    SHARES,
    copy_model,
    default_copies,
    sameness,
)
from topobatch.merge.robust.settings import MATCH, RobustSettings
from topobatch.merge.robust.sites import Sites
from topobatch.merge.robust.support import _forest, _without_repeats
from topobatch.merge.robust.verdict import (
    PairCount,
    _missing,
    counted_bits,
    in_steps,
    needed_bits,
    opinion,
    threshold_for,
    uniformity,
)
from topobatch.merge.wording import told_bits
from topobatch.topology.ragged import Ragged
from topobatch.topology.se2 import compose, inverse, wrap

SETTINGS = RobustSettings()
COPIES = default_copies(SETTINGS)

#   5 --- 6 --- 7
#   |     |
#   0 --- 1 ------- 2
#         |         |
#         3 ------- 4
POINTS = [(0, 0), (5, 0), (12, 0), (5, -6), (12, -6), (0, 4), (5, 4), (9, 4)]
EDGES = [(0, 1), (1, 2), (1, 3), (3, 4), (2, 4), (0, 5), (5, 6), (6, 7), (1, 6)]


def lanes_of(pairs):
    """A lane for each pair of maps."""
    a, b = (Atlas.of(maps) for maps in zip(*pairs, strict=True))
    return Lanes.of(a, b, np.arange(len(pairs)), np.arange(len(pairs)))


def laid(a, b, dx=0.0, dy=0.0):
    """b over a without a turn, grown from its first vertex that lies on one of a's."""
    gap = np.abs(a.z[:, None] - (b.z + dx + 1j * dy)[None])
    i, j = np.unravel_index(gap.argmin(), gap.shape)
    seed = Seed(np.array([i]), np.array([j]), 0.0, complex(dx, dy), 1.0)
    return grow(lanes_of([(a, b)]), [seed], SETTINGS)


def against(grown):
    """The contradictions of a match in the only lane."""
    (found,) = conflicts(grown, np.ones(1, bool))
    return found


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
                and abs(a.sag[i] - b.sag[j]) < MATCH.gate_m
            ):
                expected.add((i, j))
    # Branches near the border of two sectors are looked up in both: more may be found, none fewer.
    assert expected <= found
    softened = found - expected
    assert all(a.pattern[i] != b.pattern[j] for i, j in softened)


@pytest.mark.parametrize("n", [1, 40, 900])
def test_sites_find_the_nearest_both_ways(n):
    rng = np.random.default_rng(n)
    z, where = (
        (rng.uniform(0, 40, (k, 2)) + 3e5) @ np.array([1, 1j])
        for k in (n, MATCH.most_pairs // n + 1)
    )
    sites = Sites.of(z)
    for asked in (where, where[: MATCH.most_pairs // n]):
        gap, index = sites.nearest(asked, 3.0)
        all_gaps = np.abs(asked[:, None] - z)
        near = all_gaps.min(axis=1) < 3.0
        assert (index[near] == all_gaps.argmin(axis=1)[near]).all()
        assert gap[near] == pytest.approx(all_gaps.min(axis=1)[near], abs=1e-9)
        assert (gap[~near] >= 3.0).all()


def test_no_sites_are_near_nothing():
    gap, _ = Sites.of(np.zeros(0, complex)).nearest(np.array([1j, 2.0]), 5.0)
    assert np.isinf(gap).all()


def test_seeds_grow_as_each_would_alone(halves):
    a, b = (prepare(m) for m in halves)
    found = seeds(a, b, candidate_links(a, b), 3)
    wrong = Seed(np.array([0, 1]), np.array([7, 3]), 2.0, 5j, 1.0)
    several = [*found, wrong, *found]
    lanes = lanes_of([(a, b)] * len(several))
    grown = grow(lanes, several, SETTINGS)
    for k, seed in enumerate(several):
        alone = grow(lanes_of([(a, b)]), [seed], SETTINGS)
        mine, rows = grown.lane == k, lanes.lane == k
        assert (grown.a[mine] - lanes.a.vertex[k]).tolist() == alone.a.tolist()
        assert (grown.b[mine] - lanes.b.vertex[k]).tolist() == alone.b.tolist()
        assert grown.place[rows].tolist() == alone.place.tolist()
        assert grown.branch[mine].tolist() == alone.branch.tolist()
    assert np.count_nonzero(grown.lane == 0) > 10
    assert not (grown.lane == len(found)).any()


def test_pairs_are_matched_together_as_each_would_be_alone(halves, drawn):
    """To the last bit: what a task holds, and so how work is divided, changes nothing."""
    more = [*POINTS, (8.5, -6)]
    split = [e for e in EDGES if e != (3, 4)] + [(3, 8), (8, 4)]
    small = [drawn("a", POINTS, EDGES), drawn("b", more, split, stubs=[(8, -1.57)])]
    maps = [prepare(m) for m in (*small, *halves)]
    pairs = [(a, b) for a in maps for b in maps]
    together = list(match_all(pairs, SETTINGS))
    assert [to_bytes(found) for found in together] == [
        to_bytes(match(a, b, SETTINGS)) for a, b in pairs
    ]
    assert sum(len(found) > 0 for found in together) >= 8
    assert list(match_all([], SETTINGS)) == []


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


def test_that_a_junction_in_doubt_goes_unseen_says_little(drawn):
    more = [*POINTS, (8.5, -6)]
    split = [e for e in EDGES if e != (3, 4)] + [(3, 8), (8, 4)]
    a = prepare(drawn("a", POINTS, EDGES))
    b = drawn("b", more, split, stubs=[(8, -1.57)])
    shown = np.where(np.arange(len(more)) == 8, 0.25, 1.0)
    (sure,), (doubted,) = (
        against(laid(a, prepare(m))).extra_b_bits for m in (b, replace(b, confidence=shown))
    )
    assert doubted == pytest.approx(-np.log2(0.25 * 2**-sure + 0.75))
    assert doubted < 0.5 < sure


@pytest.mark.parametrize("stubs", [[], [(8, -1.57)]], ids=["bend", "fork"])
def test_bends_contradict_only_maps_whose_detector_shows_them(drawn, stubs):
    more = [*POINTS, (8.5, -6)]
    split = [e for e in EDGES if e != (3, 4)] + [(3, 8), (8, 4)]
    a, b = drawn("a", POINTS, EDGES), drawn("b", more, split, stubs=stubs)
    scans = prepare(replace(a, shows_bends=False))
    b = prepare(b)
    for one, two in ((prepare(a), b), (b, prepare(a))):
        assert len(against(laid(one, two))) == 1
    for one, two in ((scans, b), (b, scans)):
        assert len(against(laid(one, two))) == len(stubs)


ENDS = [(-6, 0), (-6, -5), (6, 0), (6, 5)]
AROUND = [(0, 1), (0, 2), (1, 2), (3, 4)]


def crossing_and_forks(drawn, apart_m=1.2):
    """The same ways twice: an acute crossing in the middle, or two forks in its place."""
    whole = drawn("a", [(0, 0), *ENDS], [*AROUND, (0, 3), (0, 4)])
    x, y = apart_m / 2 * np.cos(np.pi / 9), apart_m / 2 * np.sin(np.pi / 9)
    return whole, drawn("b", [(-x, -y), *ENDS, (x, y)], [*AROUND, (0, 5), (5, 3), (5, 4)])


def test_two_forks_close_by_are_halves_of_a_crossing(drawn):
    whole, forks = crossing_and_forks(drawn)
    scans = prepare(replace(forks, shows_bends=False))
    assert scans.half.tolist() == [5, 1, 2, 3, 4, 0]
    ways = np.sort(np.angle(scans.crossing_unit[[0, 5]]), axis=1)
    assert np.abs(wrap(ways - np.radians([-140, 0, 40, 180]))).max() < 0.1
    assert not scans.crossing_unit[1:5].any()
    # Detectors tell crossings from forks, and forks farther apart are two.
    far = replace(crossing_and_forks(drawn, 2.0)[1], shows_bends=False)
    for other in (forks, far, replace(whole, shows_bends=False)):
        m = prepare(other)
        assert m.half.tolist() == list(range(len(m)))


def test_a_crossing_fits_two_forks_of_a_skeleton(drawn):
    whole, forks = crossing_and_forks(drawn)
    a, plain, scans = map(prepare, (whole, forks, replace(forks, shows_bends=False)))
    one, zero = np.ones(1, complex), np.zeros(1, np.int64)
    fork, crossing, back = (
        branch_bits(x, y, zero, zero, one) for x, y in ((a, plain), (a, scans), (scans, a))
    )
    assert crossing == pytest.approx(back)
    assert fork + 2 < crossing
    for x, y in ((a, scans), (scans, a)):
        assert len(against(laid(x, y))) == 0
    assert len(against(laid(a, plain))) > 0
    together = Atlas.of([a, scans, prepare(replace(forks, run="c", shows_bends=False))])
    assert together.whole.half[-6:].tolist() == (scans.half + len(a) + 6).tolist()


def test_what_both_saw_agrees_and_nothing_contradicts(drawn):
    a, b = prepare(drawn("a", POINTS, EDGES)), prepare(drawn("b", POINTS, EDGES))
    grown = laid(a, b)
    assert grown.a.tolist() == grown.b.tolist() == list(range(len(POINTS)))
    assert len(against(grown)) == 0


def test_a_junction_in_the_others_corridor_contradicts(drawn):
    more = [*POINTS, (8.5, -6)]
    split = [e for e in EDGES if e != (3, 4)] + [(3, 8), (8, 4)]
    a, b = prepare(drawn("a", POINTS, EDGES)), prepare(drawn("b", more, split, stubs=[(8, -1.57)]))
    for one, two, extra in ((a, b, "extra_b"), (b, a, "extra_a")):
        found = against(laid(one, two))
        assert len(found) == 1
        assert getattr(found, extra).tolist() == [8]
        row = getattr(found, extra + "_in")[0]
        assert {int(a.tail[row]), int(a.head[row])} == {3, 4}
        assert found.bits > 3


def test_corridors_that_lead_elsewhere_contradict_once(drawn):
    a = prepare(drawn("a", POINTS, EDGES))
    # 7 stands farther on, where a run that drove to 7 in a would not have met it.
    moved = [*POINTS[:7], (9, 9)]
    b = prepare(drawn("b", moved, EDGES))
    matched = laid(a, b)
    kept = matched.a != 7
    parts = {name: getattr(matched, name)[kept] for name in ("lane", "a", "row", "branch")}
    found = against(replace(matched, **parts))
    assert len(found.elsewhere) <= 1
    straight = [*POINTS[:7], (11.5, 4)]
    c = prepare(drawn("c", straight, EDGES))
    grown = laid(a, c)
    assert 7 not in grown.a
    told = against(grown)
    ends = [{int(a.tail[r]), int(a.head[r])} for r in told.elsewhere[:, 0]]
    passed = [{int(c.tail[r]), int(c.head[r])} for r in told.extra_a_in]
    assert ends + passed == [{6, 7}]
    assert told.bits > 1
    assert len(against(laid(a, a)).elsewhere) == 0


def test_what_is_no_larger_than_copies_may_be_one(drawn):
    a = prepare(drawn("a", POINTS, EDGES))
    (told, *_) = match(a, prepare(drawn("b", POINTS, EDGES)), SETTINGS)
    count = PairCount(1, 1)
    weights = [
        threshold_for(count, COPIES, SETTINGS, copied=n).may_be_copy(told) for n in (0, 4, 6, 8, 9)
    ]
    assert weights == pytest.approx([0.0, 0.0, 2 / 3, 1.0, 1.0])


def test_a_forest_has_no_cycle_and_the_best_links():
    rng = np.random.default_rng(0)
    k = 30
    i, j = np.triu_indices(k, 1)
    bits = rng.normal(2, 2, len(i))
    chosen = _forest(i, j, bits, rng.uniform(0, 1, k))
    assert len(chosen) <= k - 1
    assert (bits[chosen] > 0).all()
    head = list(range(k))

    def root(v):
        while head[v] != v:
            v = head[v]
        return v

    for u, v in zip(i[chosen].tolist(), j[chosen].tolist(), strict=True):
        assert root(u) != root(v)
        head[root(u)] = root(v)


@pytest.mark.parametrize("turn", [0.0, 0.3, 2.0])
def test_on_a_grid_only_the_gaps_between_lines_tell(turn):
    """Of the links of a 3 × 3 block two gaps each way are news; so the corners add no more."""
    x, y = np.meshgrid([0.0, 4.0, 10.0], [0.0, 3.0, 8.5], indexing="ij")
    grid = (x + 1j * y) * np.exp(1j * turn)
    straight = [(grid[:-1], grid[1:]), (grid[:, :-1], grid[:, 1:])]
    across = [(grid[:-1, :-1], grid[1:, 1:]), (grid[:1], grid[2:])]
    start, end = (
        np.concatenate([pair[k].reshape(-1) for pair in straight + across]) for k in (0, 1)
    )
    noise = np.random.default_rng(0).normal(0, 0.05, (2, len(start), 2)) @ [1, 1j]
    bits = np.where(np.arange(len(start)) < 12, 4.0, 3.0)
    found = sum(_without_repeats(start + noise[0], end + noise[1], bits.tolist()))
    assert found == pytest.approx(4 * 4.0)


def test_links_between_places_without_order_nearly_all_tell():
    """Now and then such a place lies on one line with others, both ways, by chance."""
    places = np.random.default_rng(1).uniform(0, 60, (12, 2)) @ [1, 1j]
    bits = [3.0] * 11
    assert 30.0 <= sum(_without_repeats(places[:-1], places[1:], bits)) <= 33.0


def test_the_same_place_and_a_copy_of_it_are_told_apart(maze, see):
    """A copy is the same plan with every length off by 2 % and some junctions changed."""
    part = list(range(60))
    quiet = {"centre_m": 0.02, "branch_rad": 0.02, "bend_m": 0.0, "missed": 0.0}
    a, again = (prepare(see(maze, part, s, f"s{s}", **quiet, branch_fault=0.0)) for s in (1, 2))
    copy = see(maze, part, 3, "copy", **quiet, branch_fault=0.0)
    rng = np.random.default_rng(4)
    stretched = copy.xy.copy()
    for axis in (0, 1):
        lines, line = np.unique(
            np.round(maze.xy[copy.info["truth"]][:, axis], 1), return_inverse=True
        )
        gaps = np.diff(lines, prepend=lines[0]) * (1 + rng.normal(0, 0.03, len(lines)))
        stretched[:, axis] = np.cumsum(gaps)[line]
    other = prepare(_redrawn(copy, stretched))
    same = [sameness(a, m, match(a, m, SETTINGS)[0], COPIES) for m in (again, other)]
    assert same[0].bits > 10
    assert same[1].bits < 2


def _redrawn(topomap, xy):
    length = np.hypot(*(xy[topomap.target] - xy[topomap.source]).T)
    paths = tuple(xy[[u, v]] for u, v in zip(topomap.source, topomap.target, strict=True))
    rows = [np.sort(r) for r in (topomap.branches[v] for v in range(len(topomap)))]
    assert all(len(r) for r in rows)
    turn = _turn(topomap)
    moved = [wrap(r - turn) for r in rows]
    order = [np.argsort(r) for r in moved]
    rank = [np.argsort(o) for o in order]

    def branch(vertex, index):
        pairs = zip(vertex, index, strict=True)
        return np.array([-1 if k < 0 else rank[v][k] for v, k in pairs], np.int64)

    return replace(
        topomap,
        xy=xy,
        length=length,
        paths=paths,
        branches=Ragged.from_rows(r[o] for r, o in zip(moved, order, strict=True)),
        source_branch=branch(topomap.source, topomap.source_branch),
        target_branch=branch(topomap.target, topomap.target_branch),
    )


def _turn(topomap):
    """How far the map's grid is turned."""
    angle = topomap.branches.values
    return float(np.angle(np.exp(4j * angle).mean()) / 4)


def test_a_building_that_repeats_itself_is_found_out(drawn):
    twice = [*POINTS, *[(x + 40.0, y + 0.03 * x) for x, y in POINTS]]
    n = len(POINTS)
    edges = [*EDGES, *[(u + n, v + n) for u, v in EDGES], (2, n)]
    wings, plain = prepare(drawn("wings", twice, edges)), prepare(drawn("plain", POINTS, EDGES))
    repeated, few = self_matches([wings, plain], SETTINGS)
    assert repeated[0].bits > 15
    assert len(repeated[0]) >= n - 2
    assert all(len(c) < 5 for c in few)
    learned = copy_model([(wings, repeated[0])], SETTINGS)
    assert np.dot(learned.exact_odds, SHARES) > np.dot(COPIES.exact_odds, SHARES)
    assert sum(learned.exact_odds) == pytest.approx(1.0)
    assert SETTINGS.copy_change_rate < learned.change_rate < 0.15  # the bent copy's branches differ


def test_few_junctions_carry_little_whatever_they_seem_to_tell(drawn):
    a, b = prepare(drawn("a", POINTS, EDGES)), prepare(drawn("b", POINTS, EDGES))
    told = replace(match(a, b, SETTINGS)[0], bits=99.0)
    assert counted_bits(told) == MATCH.junction_bits * len(told)
    assert counted_bits(replace(told, bits=7.0)) == 7.0
    doubted = replace(
        told,
        conflicts=replace(told.conflicts, elsewhere=np.zeros((2, 2), np.int64), elsewhere_bits=3.0),
    )
    assert counted_bits(doubted) == counted_bits(told) - doubted.conflicts.bits
    counts = (PairCount(n, n) for n in (1, 10**6))
    alone, among_many = (threshold_for(c, COPIES, SETTINGS, copied=len(told)) for c in counts)
    assert opinion(a, b, [told], alone).verdict is Verdict.MERGED
    view = opinion(a, b, [told], among_many)
    assert view.verdict is Verdict.AMBIGUOUS
    (answers,) = view.answers
    assert answers.carried == MATCH.junction_bits * len(told)
    assert view.bits == answers.from_copies < answers.carried
    assert "another copy" in view.why
    unasked = replace(answers, same_place=None)
    assert unasked.bits == answers.carried
    assert _missing(told, unasked, None, among_many) == "chance offers as much too often"


def test_bits_that_fall_short_are_seen_to_do_so():
    assert told_bits(30.0, 12.55) == "30.0 bits, 12.6 needed"
    assert told_bits(20.0, 20.04) == "20.00 bits, 20.04 needed"


def test_what_a_match_is_made_of_adds_up(halves):
    a, b = (prepare(m) for m in halves)
    for found in match(a, b, SETTINGS):
        agree = found.support
        assert len(agree.links) == len(agree.ends) == len(agree.along)
        assert len(agree.branches) == len(found)
        total = agree.links.sum() + agree.branches.sum() - found.conflicts.bits - found.tested_bits
        assert total == pytest.approx(found.bits, abs=1e-9)
        corridors = agree.corridors[agree.along[agree.along >= 0]]
        ends = {frozenset(found.a[pair].tolist()) for pair in agree.ends[agree.along >= 0]}
        rows = zip(a.tail[corridors[:, 0]], a.head[corridors[:, 0]], strict=True)
        assert {frozenset(map(int, row)) for row in rows} == ends


def test_a_building_of_few_sizes_is_uniform(drawn):
    grid = [(5.0 * x, 5.0 * y) for x in range(6) for y in range(6)]
    edges = [(i, i + 6) for i in range(30)] + [(i, i + 1) for i in range(36) if i % 6 != 5]
    steps = np.cumsum([0.0, 3.0, 4.3, 7.1, 11.7, 5.9])
    uneven = [(x, 1.3 * y) for x in steps for y in steps]
    regular, varied = prepare(drawn("grid", grid, edges)), prepare(drawn("plain", uneven, edges))
    assert uniformity(regular, regular) == 1.0
    assert uniformity(varied, varied) == 0.0
    few = prepare(drawn("few", POINTS, EDGES))
    assert uniformity(few, varied) == 0.0


def test_two_placements_that_fit_alike_are_ambiguous(drawn):
    """One wing, and a building that has it twice: there is no telling which."""
    n = len(POINTS)
    twice = [*POINTS, *[(x + 40.0, y) for x, y in POINTS]]
    edges = [*EDGES, *[(u + n, v + n) for u, v in EDGES], (2, n)]
    a, b = prepare(drawn("both", twice, edges)), prepare(drawn("one", POINTS, EDGES))
    found = match(a, b, SETTINGS)
    assert len(found) >= 2
    assert not same_placement(found[0], found[1], b)
    view = opinion(a, b, found, threshold_for(PairCount(1, 1), COPIES, SETTINGS))
    assert view.verdict == "ambiguous"
    assert view.runner_up is not None
    assert view.margin < MATCH.lead_bits


def test_cycles_that_contradict_give_way_at_their_weakest_link(halves):
    a, b = (prepare(m) for m in halves)
    found = as_alignment(match(a, b, SETTINGS)[0])
    straight = {(0, 1): found, (1, 2): found, (0, 2): found}
    groups = Components(3, [])
    refused = join_all(groups, [(0, 1), (1, 2), (0, 2)], straight, [a.z, b.z, b.z], ["x", "y", "z"])
    assert set(refused) == {(0, 2)}
    assert "place the two differently" in refused[0, 2].reason
    assert groups.together(0, 2)


def test_poses_of_components_follow_when_they_join():
    groups = Components(4, [(0, 3)])
    T01, T23, T12 = np.array([1.0, 2.0, 0.3]), np.array([-4.0, 1.0, 1.2]), np.array([5.0, 0, -2.0])
    groups.join(0, 1, T01)
    assert groups.forbidden(1, 3) == (0, 3)
    assert groups.forbidden(1, 2) is None
    groups.join(2, 3, T23)
    groups.join(1, 2, T12)
    assert np.allclose(groups.relative(0, 3), compose(compose(T01, T12), T23))
    assert np.allclose(groups.relative(3, 0), inverse(groups.relative(0, 3)))


def test_settings_are_checked():
    with pytest.raises(ValueError, match="false_merge_rate"):
        RobustSettings(false_merge_rate=0.0)
    with pytest.raises(ValueError, match="min_matches"):
        RobustSettings(min_matches=1)


def test_pairs_are_counted_in_steps_and_never_too_few():
    assert [in_steps(n) for n in range(16)] == list(range(16))
    counts = [*range(1, 3000), 19_900, 1_007_490, 49_995_000]
    for n in counts:
        assert n <= in_steps(n) <= 9 * n / 8
        assert in_steps(in_steps(n)) == in_steps(n)
    # One more run of 1,420 is no step for most.
    steps = {in_steps(n * (n - 1) // 2) for n in range(1400, 1440)}
    assert len(steps) == 2
    assert needed_bits(16, SETTINGS) < needed_bits(17, SETTINGS) == needed_bits(18, SETTINGS)
