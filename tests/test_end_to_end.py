"""The whole chain on the sample logs, through the library, judged by the truth beside them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from topobatch.ingest.mapping import build_map
from topobatch.ingest.reading import read_run
from topobatch.merge.decision_text import lines
from topobatch.merge.document import merged_to_document
from topobatch.merge.merging import merge_maps
from topobatch.merge.result import MergeResult, Verdict
from topobatch.merge.robust.explained import Merge, explain
from topobatch.merge.wording import describe_placement
from topobatch.simulation.samples import sample_scenario
from topobatch.simulation.truth import (
    MIXED,
    Truth,
    placement_error,
    true_vertex_of_nodes,
    true_vertex_of_passes,
)
from topobatch.simulation.writing import write_run
from topobatch.topology.document import map_from_document, map_to_document, read_map
from topobatch.topology.se2 import between
from topobatch.topology.topomap import TopoMap

SAMPLES = Path(__file__).parent.parent / "sample_logs"
MAZE = ("maze-1", "maze-2", "maze-3")
OVERLAPPING = (("maze-1", "maze-2"), ("maze-2", "maze-3"))


@pytest.fixture(scope="module")
def truth() -> Truth:
    return sample_scenario().truth


@pytest.fixture(scope="module")
def maps(samples: Path) -> dict[str, TopoMap]:
    """As the command wrote them, but for that of office-1, whose truth is told otherwise."""
    folder = samples / "topobatch-workspace" / "maps"
    return {run: read_map(folder / f"{run}.json") for run in (*MAZE, "streets-1")}


@pytest.fixture(scope="module")
def merged(maps: dict[str, TopoMap]) -> MergeResult:
    return merge_maps(list(maps.values()))


@pytest.mark.parametrize("run", [*MAZE, "streets-1"])
def test_every_node_is_one_place_and_nearly_every_place_one_node(
    run: str, maps: dict[str, TopoMap], truth: Truth
) -> None:
    vertex = true_vertex_of_nodes(truth, maps[run])
    assert MIXED not in vertex
    real = vertex[vertex >= 0].tolist()
    assert set(real) == truth.runs[run].detected
    assert len(real) - len(set(real)) <= 1
    assert len(vertex) - len(real) <= truth.runs[run].fault.count("phantom")


@pytest.mark.parametrize("run", [*MAZE, "streets-1"])
def test_maps_have_the_shape_of_their_world(
    run: str, maps: dict[str, TopoMap], truth: Truth
) -> None:
    topomap, world = maps[run], truth.worlds[truth.runs[run].world]
    vertex = true_vertex_of_nodes(truth, topomap)
    real = np.flatnonzero(vertex >= 0)
    # Distances need no common frame.
    apart = np.array(list(combinations(real.tolist(), 2)))
    drawn = np.hypot(*(topomap.xy[apart[:, 0]] - topomap.xy[apart[:, 1]]).T)
    true = np.hypot(*(world.xy[vertex[apart[:, 0]]] - world.xy[vertex[apart[:, 1]]]).T)
    assert np.sqrt(np.mean((drawn - true) ** 2)) < 0.6


@pytest.mark.parametrize("run", [*MAZE, "streets-1"])
def test_corridors_join_what_the_world_joins(
    run: str, maps: dict[str, TopoMap], truth: Truth
) -> None:
    topomap, of_run = maps[run], truth.runs[run]
    world = truth.worlds[of_run.world]
    vertex = true_vertex_of_nodes(truth, topomap)
    known = {frozenset(e) for e in zip(world.source.tolist(), world.target.tolist(), strict=True)}
    ends = zip(vertex[topomap.source].tolist(), vertex[topomap.target].tolist(), strict=True)
    drawn = {frozenset(e) for e in ends if min(e) >= 0}
    driven = {
        frozenset((int(world.source[e]), int(world.target[e]))) for e in of_run.drive_edge.tolist()
    }
    # A junction that was missed once may leave a corridor past it, and two undrawn.
    assert len(drawn - known) <= of_run.fault.count("missed")
    assert len(driven - drawn) <= 2 * of_run.fault.count("missed")


def test_merging_joins_the_maze_and_leaves_the_streets(merged: MergeResult) -> None:
    groups = sorted(sorted(component.poses) for component in merged.components)
    assert groups == [list(MAZE), ["streets-1"]]
    verdicts = {(v.a, v.b): v.verdict for v in merged.verdicts}
    assert all(verdicts[pair] == Verdict.MERGED for pair in OVERLAPPING)
    assert all(verdicts[run, "streets-1"] == Verdict.UNRELATED for run in MAZE)


def test_runs_joined_by_another_alone_are_told_so(merged: MergeResult) -> None:
    through = {(v.a, v.b): v.through for v in merged.verdicts if v.through}
    assert through == {("maze-1", "maze-3"): ("maze-2",)}
    (told,) = (v for v in merged.verdicts if v.placed is not None)
    assert (told.a, told.b) == ("maze-1", "maze-3")
    metres, radians = told.placed
    assert 0 < metres < 1
    assert 0 < radians < 0.1
    assert told.reason.startswith(
        f"joined through maze-2, placed to {describe_placement(*told.placed)} ("
    )


@pytest.mark.parametrize(("a", "b"), OVERLAPPING)
def test_runs_are_laid_over_one_another_rightly(
    a: str, b: str, merged: MergeResult, maps: dict[str, TopoMap], truth: Truth
) -> None:
    component = next(c for c in merged.components if a in c.poses)
    for found in (
        between(component.poses[a], component.poses[b]),
        next(v.best.transform for v in merged.verdicts if (v.a, v.b) == (a, b) and v.best),
    ):
        metres, radians = placement_error(truth, maps[a], maps[b], found)
        assert metres < 1.0
        assert radians < np.radians(5)


def test_fused_vertices_are_single_places(merged: MergeResult, truth: Truth) -> None:
    seen: dict[tuple[str, int], set[int]] = {}
    for number, observations in enumerate(merged.fused.observations):
        places = {
            (truth.runs[run].world, int(true_vertex_of_passes(truth, run, [time_ns])[0]))
            for run, time_ns in observations
        }
        real = {place for place in places if place[1] >= 0}
        assert len(real) <= 1
        for place in real:
            seen.setdefault(place, set()).add(number)
    shared = {("maze-world", v) for a, b in OVERLAPPING for v in truth.common(a, b)}
    split = [place for place in shared if len(seen[place]) > 1]
    assert len(split) <= 0.1 * len(shared)


def test_the_order_of_maps_changes_nothing(merged: MergeResult, maps: dict[str, TopoMap]) -> None:
    again = merge_maps(list(maps.values())[::-1])
    assert [(v.a, v.b, v.verdict, v.evidence_bits) for v in again.verdicts] == [
        (v.a, v.b, v.verdict, v.evidence_bits) for v in merged.verdicts
    ]
    np.testing.assert_array_equal(again.fused.xy, merged.fused.xy)
    assert again.fused.members == merged.fused.members


def test_one_run_gives_one_map_from_any_container(tmp_path: Path, maps: dict[str, TopoMap]) -> None:
    simulated = next(s for s in sample_scenario().simulated if s.run.name == "maze-3")
    want = json.dumps(map_to_document(maps["maze-3"]))  # read from a database
    for container in ("mcap", "bag", "ros2-mcap"):
        run = read_run(write_run(tmp_path / container, simulated, container))
        assert json.dumps(map_to_document(build_map(run))) == want


def test_maps_survive_their_documents(maps: dict[str, TopoMap]) -> None:
    for topomap in maps.values():
        doc = map_to_document(topomap)
        assert map_to_document(map_from_document(doc)) == doc


def test_the_page_on_verdicts_shows_what_explain_says_today(
    merged: MergeResult, maps: dict[str, TopoMap]
) -> None:
    page = (SAMPLES.parent / "docs" / "verdicts.md").read_text()
    shown = [line[4:] for line in page.splitlines() if line.startswith("    ")]
    example = shown[next(k for k, line in enumerate(shown) if "maze-1 and maze-2" in line) :]
    said = {(pair.a, pair.b): pair for pair in merged.verdicts}
    told = lines(explain(Merge(maps.__getitem__, len(maps), said), "maze-1", "maze-2"))
    assert len(example) > 15
    assert [
        line for line in example if line and line.strip() not in {"…", *map(str.strip, told)}
    ] == []


def numbers(value: object, key: str = "") -> Iterator[tuple[str, float]]:
    """Every float of a document, with the last name on the way to it."""
    if isinstance(value, dict):
        for name, part in value.items():
            if name != "settings":
                yield from numbers(part, str(name))
    elif isinstance(value, list):
        for part in value:
            yield from numbers(part, key)
    elif isinstance(value, float):
        yield key, value


DECIMALS = {
    **dict.fromkeys(("x", "y", "length", "path", "rmse_m"), 3),
    **dict.fromkeys(("evidence_bits", "margin_bits", "bits"), 2),
    "branches": 4,
    "theta": 6,
}


def test_every_number_is_rounded_to_what_it_means(
    merged: MergeResult, maps: dict[str, TopoMap]
) -> None:
    told = [*map(map_to_document, maps.values()), merged_to_document(merged)]
    found = [pair for document in told for pair in numbers(document)]
    assert {key for key, _ in found} >= {"x", "theta", "length_sigma", "branches", "bits", "path"}
    for key, value in found:
        if key in DECIMALS:
            assert value == np.round(value, DECIMALS[key]), key
        else:  # sigmas, rates, calibration
            assert value == float(f"{value:.3e}"), key
