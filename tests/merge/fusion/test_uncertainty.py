"""How surely chains of runs are placed: covariances against samples and against what is known."""

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.fusion.fuse import fuse
from topobatch.merge.fusion.joint_graph import SOLVER, optimise_poses, pass_counts
from topobatch.merge.fusion.uncertainty import fused_sigmas
from topobatch.merge.fusion.vertex_partition import Pool
from topobatch.merge.result import Alignment, PairVerdict, Verdict
from topobatch.topology.posegraph.solve import solve
from topobatch.topology.se2 import apply, between, fit_rigid, inverse, wrap
from topobatch.topology.topomap import RunNoise


def verdict(a, b, matched):
    pairs = np.array(matched)
    transform = fit_rigid(a.xy[pairs[:, 0]], b.xy[pairs[:, 1]])
    best = Alignment(transform, 30.0, pairs, 0.0)
    return PairVerdict(a.run, b.run, Verdict.MERGED, True, 30.0, "by hand", best=best)


def along(draw, name, first, last):
    """Part of a corridor with doors."""
    names = range(first, last + 1)
    corners = {k: (6.0 * k, 1.5 * (k % 2)) for k in names}
    return draw(name, corners, [(k, k + 1) for k in names[:-1]], [(k, np.pi / 2) for k in names])


@pytest.fixture
def chain(draw):
    a, b, c = (along(draw, n, s, s + 8) for n, s in (("a", 0), ("b", 6), ("c", 12)))
    links = [verdict(x, y, [(6, 0), (7, 1), (8, 2)]) for x, y in ((a, b), (b, c))]
    return [a, b, c], links


def test_spread_is_the_covariance_of_rigid_fits_of_the_truth(draw):
    # Everything drawn anew as it is said to be: what odometry measured, and how far from the truth
    # each map saw each junction. Some are seen by all three maps, some by one.
    firsts = {"a": 0, "b": 5, "c": 7}
    maps = [along(draw, name, first, first + 8) for name, first in firsts.items()]
    pool = Pool.of(maps)
    label = np.concatenate([np.arange(first, first + 9) for first in firsts.values()])
    start = {name: np.array([6.0 * k, 1.5 * (k % 2), 0.0]) for name, k in firsts.items()}
    joint = optimise_poses(pool, label, start)
    *_, found = fused_sigmas(pool, label, joint.graph, joint.solution, ())
    true = np.zeros((len(pool), 3))
    true[:, :2] = np.column_stack([6.0 * label, 1.5 * (label % 2)])
    plain = replace(joint.graph, kernel=np.full(len(joint.graph.source), np.inf), pose=true)
    within = pool.run[plain.source] == pool.run[plain.target]
    root = np.linalg.cholesky(np.linalg.inv(plain.information[within]))
    centre = np.array([m.measured.centre_m for m in maps])[pool.run] / np.sqrt(pass_counts(pool))
    rng = np.random.default_rng(0)
    off = []
    for _ in range(150):
        seen = true.copy()
        seen[:, :2] += centre[:, None] * rng.normal(size=(len(pool), 2))
        measured = between(seen[plain.source], seen[plain.target])
        measured[within] += (root @ rng.normal(size=(len(root), 3, 1)))[:, :, 0]
        measured[~within] = 0.0
        measured[~within, 2] = 0.01 * rng.normal(size=int((~within).sum()))
        pose = solve(replace(plain, measurement=measured), SOLVER).pose
        fits = [fit_rigid(pose[pool.run == k, :2], seen[pool.run == k, :2]) for k in (0, 2)]
        truths = [fit_rigid(true[pool.run == k, :2], seen[pool.run == k, :2]) for k in (0, 2)]
        there = apply(between(*truths), apply(inverse(truths[1]), found.middle[2]))
        T = between(*fits)
        step = apply(T, apply(inverse(truths[1]), found.middle[2])) - there
        off.append((*step, wrap(T[2] - between(*truths)[2])))
    (told,), off = found.relative([("a", "c")]), np.array(off)
    sampled = off.T @ off / len(off)
    # Along the chain maps err by their scale, too, which is not drawn here.
    np.testing.assert_allclose(sampled[1:, 1:], told[1:, 1:], rtol=0.3)
    # The same middle, seen from a; seen from c, it is off by the turn about the step between them.
    step = found.middle[2] - found.middle[0]
    back = -off[:, :2] + off[:, 2:] * np.array([-step[1], step[0]])
    both = np.sqrt(((off[:, :2] ** 2).sum(axis=1) + (back**2).sum(axis=1)) / 2)
    ((metres, radians),) = found.sigmas([("a", "c")])
    assert metres == pytest.approx(np.quantile(both, 0.6827), rel=0.15)
    assert radians == pytest.approx(np.sqrt(sampled[2, 2]), rel=0.15)
    assert found.sigmas([("c", "a")])[0] == pytest.approx((metres, radians))


def test_fused_vertices_say_how_sure_they_are(chain):
    maps, links = chain
    _, fused = fuse(maps, links, sigmas=True)
    assert fused.position_sigma.shape == (len(fused),)
    # What the middle run ties lies surer than the far ends.
    order = np.argsort(fused.xy[:, 0])
    sigma = fused.position_sigma[order]
    assert sigma[len(sigma) // 2] < min(sigma[0], sigma[-1])
    assert fuse(maps, links)[1].position_sigma is None


def test_lengths_are_as_sure_as_all_runs_are_of_their_ends(draw):
    # Odometry that errs in nothing: where a junction lies is known by its sightings alone.
    exact = RunNoise(1e-6, 1e-6, 1e-6, scale=0.0, centre_m=0.1)
    stated = np.full(16, 2 * exact.centre_m)
    maps = [replace(along(draw, name, 0, 16), noise=exact, length_sigma=stated) for name in "abcd"]
    links = [verdict(maps[0], m, [(k, k) for k in range(17)]) for m in maps[1:]]
    for count in (2, 4):
        _, fused = fuse(maps[:count], links[: count - 1], sigmas=True)
        sigma = np.sqrt(np.mean(fused.length_sigma**2))
        assert sigma == pytest.approx(np.sqrt(2 / count) * exact.centre_m, rel=0.1)
    # No map is less sure of its lengths for being merged.
    sure = [replace(m, length_sigma=stated / 10) for m in maps[:2]]
    _, fused = fuse(sure, links[:1], sigmas=True)
    np.testing.assert_allclose(fused.length_sigma, stated[0] / 10 / np.sqrt(2), rtol=1e-6)
