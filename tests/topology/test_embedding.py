"""Embedding: exact on exact measurements, most likely on noisy ones, frames free."""

from __future__ import annotations

import numpy as np
import pytest

from topobatch.topology.embedding import embed_general, embed_rectilinear, embed_springs
from topobatch.topology.ragged import Ragged
from topobatch.topology.se2 import apply, fit_rigid, wrap
from topobatch.topology.topomap import TopoMap

E, N, W, S = 0.0, np.pi / 2, -np.pi, -np.pi / 2
SQUARE = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [0.0, 4.0]])
RING = [(0, 1), (1, 2), (2, 3), (3, 0)]


def ring(lengths, turn=0.0, sigma=0.1, bend=False):
    """A rectangle of four corners; with `bend`, its last corridor turns a corner on the way."""
    xy = SQUARE
    rows = [np.array(r) for r in ([E, N], [W, N], [W, S], [E, S])]
    edges = list(RING)
    paths = [xy[[u, v]] for u, v in edges]
    branches = [(E, W), (N, S), (W, E), (S, N)]
    if bend:  # corner 0 is passed on the way from 3 to 1
        xy, rows, edges = xy[1:], rows[1:], [(0, 1), (1, 2), (2, 0)]
        paths = [*paths[1:3], np.array([[0.0, 4.0], [0.0, 0.0], [6.0, 0.0]])]
        branches = [(N, S), (W, E), (S, W)]
    turned = [np.sort(wrap(r + turn)) for r in rows]
    T = np.array([0.0, 0.0, turn])

    def branch(v, h):
        return int(np.abs(wrap(turned[v] - h - turn)).argmin())

    m = len(edges)
    return TopoMap(
        run="ring",
        frame="odom",
        xy=apply(T, xy),
        branches=Ragged.from_rows(turned),
        kind=("bend",) * len(xy),
        source=np.array([u for u, _ in edges]),
        target=np.array([v for _, v in edges]),
        source_branch=np.array(
            [branch(u, h[0]) for (u, _), h in zip(edges, branches, strict=True)]
        ),
        target_branch=np.array(
            [branch(v, h[1]) for (_, v), h in zip(edges, branches, strict=True)]
        ),
        length=np.array(lengths),
        length_sigma=np.full(m, sigma),
        traversals=np.ones(m, np.int64),
        paths=tuple(apply(T, p) for p in paths),
        observation_vertex=np.arange(len(xy)),
        observation_time_ns=np.arange(len(xy)),
    )


def shape_error(xy, truth):
    return np.abs(apply(fit_rigid(truth, xy), xy) - truth).max()


@pytest.mark.parametrize("turn", [0.0, 0.3, -2.0])
@pytest.mark.parametrize("embed", [embed_rectilinear, embed_general])
def test_exact_lengths_give_the_exact_shape(embed, turn):
    xy = embed(ring([6.0, 4.0, 6.0, 4.0], turn))
    assert shape_error(xy, SQUARE) < 1e-6


@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_springs_share_an_error_between_opposite_corridors(turn):
    xy = embed_rectilinear(ring([6.2, 4.0, 6.0, 4.0], turn))
    sides = np.hypot(*(np.roll(xy, -1, axis=0) - xy).T)
    assert sides == pytest.approx([6.1, 4.0, 6.1, 4.0], abs=0.01)


def test_a_corridor_that_bends_measures_the_displacement_of_its_path():
    xy = embed_rectilinear(ring([4.0, 6.0, 10.0], bend=True))
    assert shape_error(xy, SQUARE[1:]) < 1e-6


def test_springs_weigh_by_inverse_variance_and_anchor_every_part():
    ends = (np.array([0, 0, 2]), np.array([1, 1, 3]))
    x = embed_springs(4, ends, np.array([1.0, 4.0, 7.0]), np.array([1.0, 0.5, 1.0]))
    assert x == pytest.approx([0.0, (1.0 + 4 * 4.0) / 5, 0.0, 7.0])


def test_a_map_off_every_grid_has_no_rectilinear_embedding():
    star = TopoMap(
        run="star",
        frame="odom",
        xy=np.zeros((1, 2)),
        branches=Ragged.from_rows([[-2.0, 0.1, 1.2]]),
        kind=("junction",),
        source=np.zeros(0, np.int64),
        target=np.zeros(0, np.int64),
        source_branch=np.zeros(0, np.int64),
        target_branch=np.zeros(0, np.int64),
        length=np.zeros(0),
        length_sigma=np.zeros(0),
        traversals=np.zeros(0, np.int64),
        paths=(),
        observation_vertex=np.zeros(1, np.int64),
        observation_time_ns=np.zeros(1, np.int64),
    )
    with pytest.raises(ValueError, match="'star' is not rectilinear"):
        embed_rectilinear(star)
    assert embed_general(star).shape == (1, 2)
