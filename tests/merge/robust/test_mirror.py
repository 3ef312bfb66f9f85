"""Mirror images of maps, and verdicts that they cast doubt on."""

import numpy as np

from topobatch.merge.result import Verdict
from topobatch.merge.robust.alignment import image_bits, match
from topobatch.merge.robust.mirror import mirrored
from topobatch.merge.robust.prepare import prepare
from topobatch.merge.robust.settings import MATCH
from topobatch.merge.robust.verdict import assess, held_against_image, threshold_for

from .plans import COPIES, EDGES, POINTS, SETTINGS


def test_a_mirror_image_is_the_other_way_round_and_twice_mirrored_the_same(drawn):
    m = drawn("a", POINTS, EDGES, stubs=[(2, 0.4)])
    image = mirrored(m)
    np.testing.assert_array_equal(image.xy, m.xy * [1, -1])
    for edge in range(len(m.source)):
        there, here = (x.branches[int(x.source[edge])][x.source_branch[edge]] for x in (image, m))
        assert np.cos(there + here) > 1 - 1e-12
    again = mirrored(image)
    np.testing.assert_allclose(again.branches.values, m.branches.values, atol=1e-12)
    np.testing.assert_array_equal(again.target_branch, m.target_branch)


def test_only_what_leads_its_mirror_image_stays_merged(drawn):
    a, b = prepare(drawn("a", POINTS, EDGES)), prepare(drawn("b", POINTS, EDGES))
    found = match(a, b, SETTINGS)
    (bits,) = image_bits([(a, b)], SETTINGS)
    assert np.isfinite(bits)
    merged = assess(a, b, found, threshold_for(1, 1, COPIES, SETTINGS))
    for more, verdict in ((-0.1, Verdict.MERGED), (0.1, Verdict.AMBIGUOUS)):
        shown = held_against_image(merged, found[0].bits - MATCH.lead_bits + more)
        assert shown.verdict is verdict
