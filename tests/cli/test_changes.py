"""`topobatch changes`: what it says of two runs, one of which found a corridor closed."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from topobatch.cli.workspace import Workspace
from topobatch.ingest.mapping import build_map
from topobatch.merge.document import write_merged
from topobatch.merge.merging import merge_maps
from topobatch.simulation import DRIFTS, FAULTS, RunSettings, make_world, simulate_run
from topobatch.simulation.scenario import EPOCH_NS
from topobatch.topology.document import write_map


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Workspace:
    found = Workspace(tmp_path_factory.mktemp("changes") / "ws")
    world = make_world("organic", 30, 2)
    settings = RunSettings(drift=DRIFTS["low"], faults=replace(FAULTS["mild"], closed_share=0.0))
    shut = replace(settings, faults=replace(settings.faults, closed_share=0.1))
    day = EPOCH_NS + 86_400 * 10**9
    for run in (
        simulate_run(world, None, settings, name="monday", seed=2),
        simulate_run(world, None, shut, name="tuesday", seed=102, start_ns=day),
    ):
        write_map(found.map_json(run.run.name), build_map(run.run))
    maps = [found.read_map(run) for run in found.runs()]
    write_merged(found.merged_json, merge_maps(maps))
    return found


def test_changes_are_told_with_dates(topobatch, place) -> None:
    shown = topobatch("changes", "-w", place.root)
    assert (shown.code, shown.err) == (0, "")
    assert "gone: corridor of" in shown.out
    assert "passed by monday" in shown.out
    assert "not there for tuesday" in shown.out
    assert "2023-11-15" in shown.out
    told = json.loads(topobatch("changes", "-w", place.root, "--json").out)
    assert shown.out.splitlines()[-1].startswith(f"{len(told)} change")
    assert {c["kind"] for c in told} == {"gone"}
    every = json.loads(topobatch("changes", "-w", place.root, "--json", "--all").out)
    assert len(every) >= len(told)


def test_calls_that_cannot_be(topobatch, place, tmp_path) -> None:
    assert "topobatch ingest" in topobatch("changes", "-w", tmp_path).error(1)
    assert "no component 9" in topobatch("changes", "--component", 9, "-w", place.root).error(2)
    alone = Workspace(tmp_path / "alone")
    one = place.read_map("monday")
    write_map(alone.map_json("monday"), one)
    write_merged(alone.merged_json, merge_maps([one]))
    assert "nothing to compare" in topobatch("changes", "-w", alone.root).out
    write_map(
        alone.map_json("monday"), replace(one, observation_time_ns=one.observation_time_ns + 1)
    )
    write_map(alone.map_json("tuesday"), place.read_map("tuesday"))
    write_merged(alone.merged_json, merge_maps([place.read_map(r) for r in place.runs()]))
    assert "merge again" in topobatch("changes", "-w", alone.root).error(1)
