"""What pairs of a batch must reach."""

from dataclasses import dataclass

import numpy as np

from topobatch.merge.robust.assessment import thresholds
from topobatch.merge.robust.settings import MATCH
from topobatch.merge.robust.verdict import PairCount

from .plans import COPIES, SETTINGS


@dataclass(frozen=True)
class Repetition:
    """A match of a map with another part of itself, of so many junctions."""

    junctions: int
    bits: float = MATCH.lead_bits + 1

    def __len__(self):
        return self.junctions


def test_copies_are_taken_to_be_as_large_as_most_maps_of_the_batch_show():
    chance = Repetition(30, bits=MATCH.lead_bits - 1)
    own = [(), (Repetition(6), Repetition(4)), (Repetition(8),), (chance,)]
    heard = []

    def copies(samples):
        heard.extend((k, len(c)) for k, c in samples)
        return COPIES

    asked = thresholds([None] * 4, SETTINGS, own, copies)
    count = PairCount(6, 2)
    most = np.quantile([0, 6, 8, 0], SETTINGS.copied_share)
    assert [asked([k], count).copied for k in range(4)] == [most, most, 8.0, most]
    # Of two components the larger copies count; what chance offers is none.
    assert asked([0, 2], count).copied == 8.0
    assert heard == [(1, 6), (1, 4), (2, 8)]
