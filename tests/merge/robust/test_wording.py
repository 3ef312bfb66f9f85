"""What is said against an alignment, and where it lies."""

from types import SimpleNamespace

import numpy as np

from topobatch.merge.robust.conflicts import Conflicts
from topobatch.merge.robust.view_evidence import NO_VIEW_EVIDENCE
from topobatch.merge.robust.wording import contradictions, summary


def test_every_contradiction_names_its_junctions() -> None:
    rows = np.array([(0, 1)])
    conflicts = Conflicts(
        extra_b=np.array([7]),
        extra_b_in=np.array([0]),
        extra_b_bits=np.array([3.0]),
        extra_a=np.array([9]),
        extra_a_in=np.array([1]),
        extra_a_bits=np.array([2.0]),
        elsewhere=rows,
        elsewhere_bits=1.0,
    )
    a = SimpleNamespace(run="one", tail=np.array([1, 3]), head=np.array([2, 4]))
    b = SimpleNamespace(run="two", tail=np.array([5, 6]), head=np.array([6, 8]))
    told, of_a, of_b = zip(*contradictions(SimpleNamespace(conflicts=conflicts), a, b), strict=True)
    assert of_a == ((1, 2), (9,), (1, 2))
    assert of_b == ((7,), (6, 8), (6, 8))
    assert told[0] == "junction 7 of two falls inside corridor 1 to 2 of one, unseen there"
    assert told[1] == "junction 9 of one falls inside corridor 6 to 8 of two, unseen there"
    assert "lead to different ones" in told[2]


class Alignment(SimpleNamespace):
    views = NO_VIEW_EVIDENCE

    def __len__(self) -> int:
        return 5


def test_contradictions_that_were_not_looked_for_are_not_said_to_be_none() -> None:
    found = Alignment(corridors=range(2), conflicts=(), searched=True)
    assert "2 corridors agree, 0 contradict: " in summary(found, -3.0, 10.0, None)
    found.searched = False
    told = summary(found, -3.0, 10.0, None)
    assert "2 corridors agree, contradictions were not looked for: " in told


def test_the_next_best_is_as_far_behind_as_explain_shows() -> None:
    best = Alignment(corridors=range(38), conflicts=(), searched=True)
    told = summary(best, 6.75, 14.8, 0.51)  # 6.8 and 6.2
    assert told.endswith("6.8 bits, 14.8 needed; next best alignment 0.6 bits behind")
    assert summary(best, 6.75, 14.8, -0.51).endswith("; another alignment has 0.5 bits more")
    assert summary(best, 6.75, 14.8, None).endswith("; no other alignment comes near")
