"""What changed between runs: a corridor that is closed in the later one."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from topobatch.ingest.mapping import build_map
from topobatch.merge.change import ChangeKind, change_to_document
from topobatch.merge.changes import changes
from topobatch.merge.document import merged_to_document, result_from_document
from topobatch.merge.locks import Lock
from topobatch.merge.merged_schema import MergedDocument
from topobatch.merge.merging import merge_maps
from topobatch.simulation.scenario import EPOCH_NS, simulate_run
from topobatch.simulation.settings import DRIFTS, FAULTS, RunSettings
from topobatch.simulation.worlds import make_world
from topobatch.topology.document import map_from_document, map_to_document

DAY_NS = 86_400 * 10**9

CORNERS = {(i, j): (x, y) for i, x in enumerate((0, 7, 16, 29)) for j, y in enumerate((0, 5, 13))}
STREETS = [
    *(((i, j), (i + 1, j)) for i in range(3) for j in range(3)),
    *(((i, j), (i, j + 1)) for i in range(4) for j in range(2)),
]
"""A grid of streets between corners."""


@cache
def observed(
    seed: int,
    *,
    closed: float,
    later: bool = True,
    kind: str = "organic",
    junctions: int = 30,
    faults: str = "mild",
):
    """Maps of two runs in one world, the second a day later with some corridors closed (or the
    first, if not later); their merge; the ends of the corridors that were open and then closed."""
    world = make_world(kind, junctions, seed)
    open_ = RunSettings(drift=DRIFTS["low"], faults=replace(FAULTS[faults], closed_share=0.0))
    shut = replace(open_, faults=replace(open_.faults, closed_share=closed))
    first, second = (open_, shut) if later else (shut, open_)
    runs = [
        simulate_run(world, None, first, name="monday", seed=seed),
        simulate_run(
            world, None, second, name="tuesday", seed=seed + 100, start_ns=EPOCH_NS + DAY_NS
        ),
    ]
    maps = {s.run.name: map_from_document(map_to_document(build_map(s.run))) for s in runs}
    result = merge_maps(list(maps.values()))
    assert len(result.components) == 1
    was, then = runs if later else runs[::-1]
    closed_edges = set(then.truth.closed_edges) & set(was.truth.drive_edge.tolist())
    lengths = sorted(
        float(world.length[e])
        for e in closed_edges
        if {int(world.source[e]), int(world.target[e])} <= then.truth.detected
    )
    return result, maps, lengths


def two_days(*drawn):
    """The document of the merge of drawn maps, a day from each to the next, that are locked as the
    same; and the maps by their runs."""
    maps = {
        m.run: replace(m, observation_time_ns=m.observation_time_ns + EPOCH_NS + k * DAY_NS)
        for k, m in enumerate(drawn)
    }
    locks = [Lock("monday", "tuesday", "same")]
    return merged_to_document(merge_maps(list(maps.values()), locks=locks)), maps


def read(document):
    return result_from_document(MergedDocument.model_validate(document))


@pytest.mark.parametrize(("later", "kind"), [(True, ChangeKind.GONE), (False, ChangeKind.NEW)])
def test_closed_corridors_are_told_with_their_witnesses(later, kind) -> None:
    result, maps, lengths = observed(2, closed=0.1, later=later)
    found = changes(result, 0, maps)
    sure = [c for c in found if c.sure]
    assert len(lengths) >= 3
    assert np.allclose(sorted(c.length for c in sure), lengths, rtol=0.1)
    for change in sure:
        assert (change.thing, change.kind) == ("corridor", kind)
        assert [w.run for w in change.there] == ["monday" if later else "tuesday"]
        assert [w.run for w in change.missing] == ["tuesday" if later else "monday"]
        assert all(w.passes > 0 and w.first_ns <= w.last_ns for w in change.there + change.missing)
        assert change_to_document(change)["sure"]
    assert [c.bits for c in found] == sorted((c.bits for c in found), reverse=True)


def test_nothing_changed_where_nothing_did() -> None:
    result, maps, lengths = observed(1, closed=0.0)
    assert lengths == []
    assert not any(c.sure for c in changes(result, 0, maps))


def test_a_corridor_gone_with_the_junction_at_its_end_is_one_change(draw) -> None:
    """Where it left a straight corridor, the later runs drive by without detecting a junction."""
    gone, end = ((1, 0), (1, 1)), (1, 0)
    later = [pair for pair in STREETS if end not in pair] + [((0, 0), (2, 0))]
    left = {name: xy for name, xy in CORNERS.items() if name != end}
    merged, maps = two_days(draw("monday", CORNERS, STREETS), draw("tuesday", left, later))
    (change,) = changes(read(merged), 0, maps)
    ends = {tuple(merged["nodes"][j]["members"]["monday"]) for j in change.junctions}
    assert ends == {(list(CORNERS).index(name),) for name in gone}
    assert (change.thing, change.kind, change.sure) == ("corridor", ChangeKind.GONE, True)
    assert [w.run for w in change.between] == ["monday", "tuesday"]
    what, when, who, evidence = change.words("north")
    assert what.startswith("gone: corridor of 5.0 m between junctions")
    assert when.startswith("last found 2023-11-14 22:13 (monday), first missing 2023-11-15")
    assert who == "driven by monday; missing for tuesday in 2 passes"
    assert evidence.endswith("needed")


@pytest.mark.parametrize("apart", [4.0, 1.2])
def test_a_junction_beside_another_is_not_gone(draw, apart) -> None:
    """Tuesday drives through one of monday's junctions, and knows another one beside it: the fused
    map shows a place twice."""
    middle = (1, 1)
    later = [pair for pair in STREETS if middle not in pair]
    later += [((0, 1), (2, 1)), ((1, 0), (1, 2))]
    left = {name: xy for name, xy in CORNERS.items() if name != middle}
    merged, maps = two_days(draw("monday", CORNERS, STREETS), draw("tuesday", left, later))
    (gone,) = changes(read(merged), 0, maps)
    assert (gone.thing, gone.kind) == ("junction", ChangeKind.GONE)
    one = merged["nodes"][gone.junctions[0]]
    twin = one | {"id": len(merged["nodes"]), "x": one["x"] + apart, "observations": []}
    merged["nodes"].append(twin | {"members": {"tuesday": [0]}})
    found = changes(read(merged), 0, maps)
    assert [c.junctions for c in found] == ([gone.junctions] if apart > 2 else [])
