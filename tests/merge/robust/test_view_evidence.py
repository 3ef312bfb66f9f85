"""What views say of a placement."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from topobatch.merge.robust.settings import MATCH
from topobatch.merge.robust.support import Support
from topobatch.merge.robust.view_evidence import (
    BEND_SLACK_M,
    DETAILED_Z,
    JUDGE_PAIRS,
    UNSEEN_BITS,
    Overlap,
    ViewEvidence,
    overlaps,
    refine,
    repeats,
    revisits,
    view_evidence,
    worth_judging,
)
from topobatch.merge.robust.view_search import Picture, pictured, placements
from topobatch.topology.se2 import compose, inverse, wrap

from .rooms import line, views_of, walls_of

T_B_WORLD = np.array([5.0, -3.0, 2.0])


def evidence_of(
    a: Picture, b: Picture, overlap: Overlap, others: Sequence[Overlap] = ()
) -> ViewEvidence:
    return view_evidence(overlap, others, (repeats(a.views), repeats(b.views)), revisits(a.views))


def test_the_place_itself_is_told_from_other_placements() -> None:
    walls = walls_of(1)
    a = pictured(views_of(walls, line((5, 20), (35, 20))))
    b = pictured(views_of(walls, line((8, 21), (33, 21)), T_B_WORLD))
    (T, overlap), *others = refine(a, b, placements(a, b))
    assert worth_judging(overlap)
    off = compose(T, T_B_WORLD)
    assert np.hypot(*off[:2]) < 0.4
    assert abs(wrap(off[2])) < 0.03
    overlap = overlaps(a, b, [compose(T, b.pose)], 24)[0]
    elsewhere = [other for _, other in others]
    evidence = evidence_of(a, b, overlap, elsewhere)
    assert evidence.agreeing >= 3
    assert evidence.total > 10
    assert evidence.copies > 2
    assert evidence.repeated == evidence.against == 0


def test_a_placement_that_is_off_is_corrected() -> None:
    walls = walls_of(3)
    a = pictured(views_of(walls, line((5, 20), (35, 20))))
    b = pictured(views_of(walls, line((5, 20), (35, 20)), T_B_WORLD))
    off = compose(np.array([0.4, -0.3, 0.03]), inverse(T_B_WORLD))
    better = overlaps(a, b, [compose(off, b.pose)], 24)[0].corrected(off)
    left = compose(better, T_B_WORLD)
    assert np.hypot(*left[:2]) < 0.25
    assert abs(wrap(left[2])) < 0.01


def test_where_the_maps_repeat_themselves_the_place_may_be_a_copy() -> None:
    room = walls_of(1)
    aisles = np.concatenate([room, room + np.array([40.0, 0, 40.0, 0])])
    a = pictured(views_of(aisles, line((5, 20), (75, 20))))
    b = pictured(views_of(room, line((8, 21), (33, 21)), T_B_WORLD))
    (T, _), *_ = refine(a, b, placements(a, b))
    overlap = overlaps(a, b, [compose(T, b.pose)], 24)[0]
    evidence = evidence_of(a, b, overlap)
    assert repeats(a.views).size > 5
    assert evidence.total > 8
    assert evidence.repeated > 0.5


def test_parts_that_move_apart_speak_against_a_placement() -> None:
    walls = walls_of(1)
    a = pictured(views_of(walls, line((5, 20), (35, 20))))
    b = pictured(views_of(walls, line((8, 21), (33, 21)), T_B_WORLD))
    overlap = overlaps(a, b, [compose(inverse(T_B_WORLD), b.pose)], 24)[0]
    assert overlap.consistency.min() > 0.5
    torn = replace(
        overlap, registered=overlap.registered + np.outer(1.4 * (overlap.cell % 2), [1.0, 0.0, 0.0])
    )
    assert torn.consistent_parts < 0 < overlap.consistent_parts
    elsewhere = [some for _, some in refine(a, b, placements(a, b))[1:]]
    whole, less = (evidence_of(a, b, some, elsewhere) for some in (overlap, torn))
    assert whole.total > less.total + 2 * (len(whole.bits) - 1)
    assert whole.copies == less.copies


def test_a_bent_map_is_laid_over_the_other_piece_by_piece() -> None:
    walls = walls_of(1, (80.0, 30.0))
    a = pictured(views_of(walls, line((5, 15), (75, 15), 25)))
    straight = views_of(walls, line((8, 16), (73, 16), 23))
    off = np.zeros((23, 3))
    off[:, 1] = 3.0 * np.linspace(0, 1, 23) ** 2
    b = pictured(replace(straight, pose=straight.pose + off))
    poses = b.pose
    rigid = found = overlaps(a, b, [poses], JUDGE_PAIRS)[0]
    for slack_m in BEND_SLACK_M:
        poses = found.bent(poses)
        (found,) = overlaps(a, b, [poses], JUDGE_PAIRS, slack_m)
    assert np.abs(poses - straight.pose)[:, :2].max() < 0.5
    assert len(rigid) < len(found) == len(b.pose)
    assert found.consistent_parts > rigid.consistent_parts + 2


def test_walls_that_agree_bound_what_an_unseen_junction_tells() -> None:
    walls = walls_of(1)
    a = pictured(views_of(walls, line((5, 20), (35, 20))))
    b = pictured(views_of(walls, line((8, 21), (33, 21)), T_B_WORLD))
    overlap = overlaps(a, b, [compose(inverse(T_B_WORLD), b.pose)], 24)[0]
    elsewhere = [some for _, some in refine(a, b, placements(a, b))[1:]]
    evidence = evidence_of(a, b, overlap, elsewhere)
    beside, far = np.full((2, len(evidence)), 50.0)
    beside[0] = 1.0
    assert np.allclose(evidence.penalty_bound(np.array([beside, far])), [UNSEEN_BITS, np.inf])
    alike = replace(evidence, null=np.array([3.0, 0.5]))
    assert alike.penalty_bound(beside[None])[0] == MATCH.most_bits


def test_bare_walls_that_agree_tell_nothing() -> None:
    wall = np.array([[0.0, 18.0, 60.0, 18.0], [0.0, 22.0, 60.0, 22.0]])
    a = pictured(views_of(wall, line((10, 20), (50, 20))))
    b = pictured(views_of(wall, line((20, 20), (40, 20)), T_B_WORLD))
    overlap = overlaps(a, b, [compose(inverse(T_B_WORLD), b.pose)], 24)[0]
    assert overlap.part_z.min() > 4
    assert overlap.informative_part_z.max() == DETAILED_Z[0]


def test_walls_tell_whether_one_placement_fits_all_parts() -> None:
    walls = walls_of(1)
    a, b = (views_of(walls, line((5, 20), (35, 20)), T) for T in (np.zeros(3), T_B_WORLD))
    one, two = pictured(a), pictured(b)
    overlap = overlaps(one, two, [compose(inverse(T_B_WORLD), b.pose)], 24)[0]
    evidence = evidence_of(one, two, overlap)
    assert evidence.residual_m(a, b) < 0.1
    smaller = replace(b, pose=b.pose * [0.95, 0.95, 1.0])  # 1.5 m of 30 m
    assert evidence.residual_m(a, smaller) > 0.3
    few = replace(evidence, z=np.where(evidence.cell > 1, 0.0, evidence.z))
    assert few.residual_m(a, b) == np.inf


def test_walls_that_agree_bound_what_lengths_and_branches_tell_against_a_match() -> None:
    links, branches = np.array([3.0, -4.0, -4.0]), np.array([2.0, -3.0, -3.0])
    ends = np.array([[0, 1], [0, 1], [1, 2]])
    along = np.array([0, 1, 2])
    corridors = np.array([[0, 0], [2, 2], [4, 4]])
    found = Support(corridors, ends, along, links, branches, -9.0)
    bounded = found.bounded(np.array([UNSEEN_BITS, UNSEEN_BITS, np.inf]))
    assert np.allclose(bounded.links, [3.0, -UNSEEN_BITS, -4.0])
    assert np.allclose(bounded.branches, [2.0, -UNSEEN_BITS, -3.0])
    assert np.isclose(bounded.bits, -9.0 + (4.0 - UNSEEN_BITS) + (3.0 - UNSEEN_BITS))
