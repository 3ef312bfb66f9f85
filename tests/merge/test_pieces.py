"""Pieces of a run whose odometry broke: joined where what they saw leaves no doubt."""

from dataclasses import replace

import numpy as np
import pytest

from topobatch.merge.merging import merge_maps
from topobatch.merge.pieces import joined_pieces
from topobatch.topology.document import map_from_document, map_to_document
from topobatch.topology.errors import DataError
from topobatch.topology.ragged import Ragged
from topobatch.topology.se2 import apply, fit_rigid
from topobatch.topology.topomap import Closure

HOUR_NS = 3600 * 10**9


def in_pieces(*maps):
    """One map of a run that drove the given ones one after the other, drawn side by side."""
    first = np.cumsum([0, *(len(m) for m in maps)])
    shift = [np.array([500.0 * k, 0.0]) for k in range(len(maps))]
    one = maps[0]

    def column(name, add=None):
        parts = [getattr(m, name) for m in maps]
        return np.concatenate([p if add is None else p + add[k] for k, p in enumerate(parts)])

    return replace(
        one,
        run="run",
        xy=column("xy", shift),
        branches=Ragged.from_rows(m.branches[v] for m in maps for v in range(len(m))),
        kind=tuple(kind for m in maps for kind in m.kind),
        source=column("source", first),
        target=column("target", first),
        source_branch=column("source_branch"),
        target_branch=column("target_branch"),
        length=column("length"),
        length_sigma=column("length_sigma"),
        traversals=column("traversals"),
        paths=tuple(p + shift[k] for k, m in enumerate(maps) for p in m.paths),
        observation_vertex=column("observation_vertex", first),
        observation_time_ns=column("observation_time_ns", HOUR_NS * np.arange(len(maps))),
        confidence=column("confidence"),
        info={"pieces": len(maps), "warnings": ["a gap"]},
    )


def vertices_of(topomap, time_ns):
    """The vertex of each pass, by time."""
    seen = dict(
        zip(topomap.observation_time_ns.tolist(), topomap.observation_vertex.tolist(), strict=True)
    )
    return [seen[t] for t in time_ns.tolist()]


def test_pieces_that_share_places_become_one(halves, maze):
    left, right = halves
    broken = in_pieces(left, right)
    (whole,) = joined_pieces(broken)
    assert np.all(whole.position_sigma > 0)
    truth = [*left.info["truth"], *right.info["truth"]]
    assert len(whole) == pytest.approx(len(set(truth)), abs=2)
    assert sorted(whole.observation_time_ns) == sorted(broken.observation_time_ns)
    place = np.array(vertices_of(whole, broken.observation_time_ns))
    true = np.array(truth)[broken.observation_vertex]
    for vertex in set(place.tolist()):
        assert len(set(true[place == vertex].tolist())) == 1
    at = maze.xy[[true[place == v][0] for v in range(len(whole))]]
    assert np.abs(apply(fit_rigid(at, whole.xy), whole.xy) - at).max() < 1.0
    assert "pieces" not in whole.info
    assert whole.info["warnings"] == [
        "a gap",
        "the odometry broke: 2 pieces, 1 joined to another by what they saw",
    ]
    document = map_to_document(whole)
    assert map_to_document(map_from_document(document)) == document


def test_pieces_that_share_nothing_become_runs_of_their_own(halves, maze, other_maze, see):
    left, right = halves
    elsewhere = see(other_maze, list(range(len(other_maze.xy))), 5, "elsewhere")
    closure = Closure(int(HOUR_NS + elsewhere.observation_time_ns[0]), 3 * HOUR_NS, True, 9.0, "x")
    broken = replace(in_pieces(left, elsewhere, right), closures=(closure,))
    whole, other = joined_pieces(broken)
    assert (whole.run, other.run) == ("run", "run#2")
    assert len(other) == len(elsewhere)
    assert other.xy == pytest.approx(elsewhere.xy + np.array([500.0, 0.0]))
    assert other.closures == (closure,)
    assert closure not in whole.closures
    said = "the odometry broke: 3 pieces, 1 joined to another by what they saw; "
    assert other.info["warnings"][-1] == said + "on their own: run#2"


def test_maps_in_pieces_are_not_merged_as_if_they_had_one_frame(halves):
    with pytest.raises(DataError, match=r"run 'run' is in 2 pieces"):
        merge_maps([in_pieces(*halves), halves[1]])
