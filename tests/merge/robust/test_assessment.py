"""What pairs of a batch must reach."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from topobatch.merge.result import Verdict
from topobatch.merge.robust import assessment
from topobatch.merge.robust.alignment import match, self_matches
from topobatch.merge.robust.assessment import _told_once, thresholds
from topobatch.merge.robust.prepare import prepare
from topobatch.merge.robust.settings import MATCH
from topobatch.merge.robust.verdict import MAYBE_COPY, PairCount, assess, counted_bits, needed_bits
from topobatch.merge.robust.view_evidence import NO_VIEW_EVIDENCE, ViewEvidence

from .plans import COPIES, SETTINGS

#  A wing by a hall at the origin; the wing opposite is the same, turned by half a turn.
WING = np.array(
    [
        *[(4, 0), (9, 0), (9, 5.5), (4, 7.5), (16, 0), (16, 5.5), (22.5, 5.5), (22.5, 14)],
        *[(9, 14), (16, 18.5), (30, 14), (30, 21.5), (9, 18.5)],
    ]
)
WAYS = [(0, 1), (1, 2), (0, 3), (1, 4), (4, 5), (2, 5), (5, 6), (6, 7), (2, 8), (7, 10), (10, 11)]
WAYS += [(8, 12), (12, 9)]
CORNER = 5
"""So many junctions of the wing opposite were seen beside this one."""
LEAD_ON = [(u, v) for u, v in WAYS if u < CORNER <= v]


def wing_and_corner(drawn, *, leads_on=()):
    """A run through a wing and the hall, and a corner of the wing opposite. leads_on: where that
    was seen to lead: junctions, each at the end of the corridor from one of the corner."""
    n, corner = len(WING), [(u, v) for u, v in WAYS if max(u, v) < CORNER]
    seen = {u: n + CORNER + k for k, (u, _) in enumerate(leads_on)}
    points = [*WING.tolist(), *(-WING[:CORNER]).tolist(), *(at for _, at in leads_on)]
    ways = [*WAYS, (0, n), *((n + u, n + v) for u, v in corner)]
    ways += [(n + u, new) for u, new in seen.items()]
    out = {(n + u): WING[u] - WING[v] for u, v in LEAD_ON if u not in seen}
    return drawn(
        "a", points, ways, stubs=[(u, float(np.arctan2(y, x))) for u, (x, y) in out.items()]
    )


@dataclass(frozen=True)
class Repetition:
    """A match of a map with another part of itself, of so many junctions."""

    junctions: int
    bits: float = MATCH.lead_bits + 1
    contradicting_bits: float = 0.0
    tested_bits: float = 5.0
    views: ViewEvidence = NO_VIEW_EVIDENCE
    back: bool = False
    """Half of its junctions lie where the other half does."""

    @property
    def a(self):
        return np.arange(self.junctions)

    @property
    def b(self):
        return self.a[::-1] if self.back else self.a + self.junctions

    def __len__(self):
        return self.junctions


@dataclass(frozen=True)
class Equal:
    """A map of so many junctions; density [1/m]: of corridors equally long."""

    number: int
    junctions: int = 36
    density: float = 1.0

    @property
    def alike(self):
        return self.density * self.alike_pairs

    @property
    def alike_pairs(self):
        return 10.0

    def __len__(self):
        return self.junctions


@pytest.fixture
def reached(monkeypatch):
    """The thresholds of maps by what each matches of itself; copies: gives the copy model of
    (map, match) samples; links: pairs that hold together a little."""

    def reached(own, links=None, copies=lambda _: COPIES, maps=None):
        monkeypatch.setattr(assessment, "copy_model", lambda samples, _: copies(samples))
        known = links if links is None or isinstance(links, dict) else dict.fromkeys(links, 5.0)
        maps = maps or [Equal(k) for k in range(len(own))]
        return thresholds(maps, SETTINGS, known, own)

    return reached


def test_copies_are_taken_to_be_as_large_as_most_maps_of_the_batch_show(reached):
    chance = Repetition(30, bits=MATCH.lead_bits - 1)
    own = [(), (Repetition(6), Repetition(4)), (Repetition(8),), (chance,)]
    heard = []

    def copies(samples):
        heard.extend((m.number, len(c)) for m, c in samples)
        return COPIES

    asked = reached(own, copies=copies)
    count = PairCount(6, 2)
    most = np.quantile([0, 6, 8, 0], SETTINGS.copied_share)
    assert [asked([k], count).copied for k in range(4)] == [most, most, 8.0, most]
    # Of two components the larger copies count; what chance offers is none.
    assert asked([0, 2], count).copied == 8.0
    assert heard == [(1, 6), (1, 4), (2, 8)]


def test_maps_that_nothing_links_say_nothing_of_each_other(reached):
    own = [(Repetition(n),) if n else () for n in (0, 0, 0, 0, 6, 7, 8, 9, 10, 12)]
    heard = []

    def copies(samples):
        heard.append([m.number for m, _ in samples])
        return replace(COPIES, change_rate=0.01 * len(samples))

    links = [(0, 1), (2, 1), (2, 3), (5, 6), (7, 8), (6, 8)]
    asked = reached(own, links, copies)
    count = PairCount(45, 2)
    most = np.quantile([7, 8, 9, 10], SETTINGS.copied_share)
    # Of the two that nothing links there are too few: they are held to all maps.
    whole = np.quantile([0, 0, 0, 0, 6, 7, 8, 9, 10, 12], SETTINGS.copied_share)
    expected = [0.0, 0.0, 0.0, 0.0, whole, most, most, most, 10.0, 12.0]
    assert [asked([k], count).copied for k in range(10)] == expected
    assert [asked([k], count).copies.change_rate for k in (0, 4, 5)] == [0.0, 0.06, 0.04]
    # Buildings of one kind are learned from once; of two, both count.
    assert heard == [[], [4, 5, 6, 7, 8, 9], [5, 6, 7, 8]]
    both = asked([2, 5], count)
    assert (both.copied, both.copies.change_rate) == (most, 0.04)
    assert asked([5, 2], count) is both
    turned = reached(own, [(j, i) for i, j in links[::-1]], copies)
    assert all(turned([k], count) == asked([k], count) for k in range(10))


def test_a_copy_that_nothing_ends_may_go_on(reached):
    enough, lead = needed_bits(1, SETTINGS), MATCH.lead_bits
    copies = [
        Repetition(6, enough + 0.1),
        Repetition(6, enough - 0.1),
        Repetition(6, enough, contradicting_bits=lead + 0.1),
        Repetition(6, 2 * enough - 0.1, back=True),
        # A few junctions tell little, whatever they seem to tell.
        Repetition(3, 99.0),
    ]
    asked = reached([(c,) for c in copies])
    # The other maps of the batch are held to what was seen.
    assert [asked([k], PairCount(10, 2)).copied for k in range(5)] == [np.inf, 6.0, 6.0, 6.0, 6.0]


def test_buildings_of_few_lengths_that_show_no_copies_are_asked_less(reached):
    """Two sites of four runs; `SURE` pairs are of one site."""
    sure = needed_bits(28, SETTINGS)
    links = {(i, i + 1): sure for i in (0, 1, 2, 4, 5, 6)}
    repeats, none = (Repetition(9),), ()

    def bits(own, maps=None, links=links):
        asked = reached(own, links, maps=maps)
        return [asked([k], PairCount(28, 2)).unrepeated_bits for k in range(len(own))]

    plain = bits([none] * 8)
    assert plain[0] == plain[7] > 2
    # A map that repeats itself speaks against its own building, and a little against the other.
    mixed = bits([none] * 4 + [repeats] + [none] * 3)
    assert 0 < mixed[0] < plain[0]
    assert mixed[4] < mixed[0]
    # A standard part is no copy of a wing, small maps can show none, mazes tell nothing of offices.
    assert bits([none] * 4 + [(Repetition(8),)] + [none] * 3) == plain
    assert bits([none] * 8, [Equal(k, 11) for k in range(8)]) == [0.0] * 8
    mazes = bits([none] * 8, [Equal(k, density=1.0 if k < 4 else 0.1) for k in range(8)])
    assert 0 < mazes[0] < plain[0]
    # Two runs alone are asked as before, or nearly.
    assert max(bits([none] * 2, links={})) < 0.5


def assessed(a, b, count):
    """Two maps, as one of so many pairs."""
    ready = [prepare(a), prepare(b)]
    found = match(*ready, SETTINGS, rivals=True)
    return assess(*ready, found, thresholds(ready, SETTINGS)((0, 1), count))


def test_what_may_lie_in_the_next_wing_is_not_merged(drawn):
    """The copy has ten junctions, five there and five back, and the match thirteen."""
    many = PairCount(1000, 1000)
    other_run = drawn("b", WING.tolist(), WAYS, stubs=[(0, np.pi)])
    turned = wing_and_corner(drawn)
    ((copy,),) = self_matches([prepare(turned)], SETTINGS)
    assert len(copy) == 2 * CORNER
    assert _told_once(copy) == counted_bits(copy) / 2
    view = assessed(turned, other_run, many)
    assert (view.verdict, view.why, len(view.best)) == (Verdict.AMBIGUOUS, MAYBE_COPY, len(WING))
    # Beyond its corner the wing opposite is seen to be another one.
    ended = wing_and_corner(drawn, leads_on=[(4, (-16, -2.5)), (2, (-13, -5.5))])
    assert next(self_matches([prepare(ended)], SETTINGS))[0].bits > MATCH.lead_bits
    view = assessed(ended, other_run, many)
    assert (view.verdict, len(view.best)) == (Verdict.MERGED, len(WING))
