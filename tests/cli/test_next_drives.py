"""`topobatch next`: the plan on the screen, in JSON, CSV and GeoJSON, and in the report."""

from __future__ import annotations

import csv
import json
import shutil
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from topobatch.cli.next_drives import nothing_worth
from topobatch.cli.workspace import Workspace
from topobatch.merge.result import Standing
from topobatch.viz import draw


@pytest.fixture
def place(two_buildings, tmp_path, topobatch):
    """Merged at a rate of false merges so low that a site or more is open."""
    root = tmp_path / "ws"
    shutil.copytree(two_buildings, root)
    call = ("merge", "--all", "--false-merge-rate", 1e-9, "-q", "-w", root)
    assert topobatch(*call).code == 0
    return root


def test_a_plan(place, topobatch, tmp_path) -> None:
    files = [tmp_path / "plan.csv", tmp_path / "plan.geojson"]
    outputs = [word for path in files for word in ("-o", path)]
    shown = topobatch("next", *outputs, "-w", place)
    assert shown.code == 0, shown
    told = json.loads(topobatch("next", "--json", "-w", place).out)
    assert told
    assert all(drive["where"] in shown.out for drive in told)
    assert all(drive["settles"] in shown.out for drive in told)
    ranks = [drive["bits_per_metre"] for drive in told]
    assert ranks == sorted(ranks, reverse=True)
    document = json.loads((place / "merged.json").read_text())
    sites = {c["site"]: c["id"] for c in document["graph"]["components"]}
    for drive in told:
        assert sites[drive["site"]] == drive["component"]
        for stop in drive["stops"]:
            if stop["junction"] is not None:
                assert document["nodes"][stop["junction"]]["component"] == sites[stop["site"]]
    rows = list(csv.DictReader(files[0].read_text().splitlines()))
    assert len(rows) == sum(len(drive["stops"]) for drive in told)
    assert [float(rows[0][key]) for key in "xy"] == [told[0]["stops"][0][key] for key in "xy"]
    features = json.loads(files[1].read_text())["features"]
    lines = [f for f in features if f["geometry"]["type"] == "LineString"]
    assert [f["geometry"]["coordinates"] for f in lines] == [drive["path"] for drive in told]
    assert len(features) == len(lines) + len(rows)


def test_a_picture_of_the_plan(place, topobatch, tmp_path) -> None:
    files = [tmp_path / "plan.svg", tmp_path / "plan.png"]
    shown = topobatch("next", "-n", 1, "-o", files[0], "-o", files[1], "-w", place)
    assert shown.code == 0, shown
    (told,) = json.loads(topobatch("next", "-n", 1, "--json", "-w", place).out)
    texts = "".join(ET.parse(files[0]).getroot().itertext())
    assert f"Drive 1: {told['where']}" in texts
    assert "drive to record, from its number on" in texts
    for stop in told["stops"]:
        assert f"{stop['junction']}" in texts
    assert files[1].read_bytes().startswith(b"\x89PNG")


def test_of_many_junctions_a_plan_numbers_those_that_it_speaks_of(
    place, topobatch, tmp_path, monkeypatch
) -> None:
    monkeypatch.setattr(draw, "MOST_NUMBERED", 1)
    plan = tmp_path / "plan.svg"
    assert topobatch("next", "-n", 1, "-o", plan, "-w", place).code == 0
    (told,) = json.loads(topobatch("next", "-n", 1, "--json", "-w", place).out)
    words = ["".join(text.itertext()) for text in ET.parse(plan).findall(".//{*}text")]
    result = Workspace(place).read_result()
    known = set(words) & {f"{k}" for k in np.flatnonzero(~result.fused.is_turned)}
    assert {f"{stop['junction']}" for stop in told["stops"]} <= known
    assert 2 <= len(known) < result.fused.junctions


def test_where_no_drive_is_worth_it(merged_once, topobatch, tmp_path) -> None:
    plan, csv_, ways = (tmp_path / f"plan.{ending}" for ending in ("svg", "csv", "geojson"))
    shown = topobatch("next", "-o", plan, "-o", csv_, "-o", ways, "-w", merged_once)
    assert json.loads(topobatch("next", "--json", "-w", merged_once).out) == []
    features = json.loads(ways.read_text())["features"]
    assert {f["properties"]["kind"] for f in features} == {"undriven"}
    assert all(f"{f['properties']['junction']}" in shown.out for f in features)
    assert f"{csv_}" in shown.out
    assert ": no drive is proposed" in plan.read_text()
    assert topobatch("next", "-o", plan, "--theme", "dark", "-w", merged_once).code == 0
    assert "#0f1115" in plan.read_text()
    assert shown.out.startswith("there is one site: nothing is left to join")
    assert "branches that nobody drove" in shown.out
    assert "branch never driven" in plan.read_text()


def test_a_plan_for_one_site(place, topobatch) -> None:
    told = json.loads(topobatch("next", "--json", "-w", place).out)
    site = told[-1]["site"]
    own = json.loads(topobatch("next", site, "-n", 1, "--json", "-w", place).out)
    assert len(own) == 1
    assert site in (own[0]["site"], own[0]["onto"])
    # A run stands for its site. Pairs of other sites are not its own.
    result = Workspace(place).read_result()
    here = next(c for c in result.components if c.name == site)
    for run in here.poses:
        assert json.loads(topobatch("next", run, "-n", 1, "--json", "-w", place).out) == own
    far = tuple(v for v in result.verdicts if not {v.a, v.b} & {*here.poses})
    assert any(v.standing is Standing.AMBIGUOUS for v in far)
    elsewhere = replace(result, verdicts=far)
    (why, *_) = nothing_worth(elsewhere, [], Workspace(place), here)
    assert f"no open pair concerns {site}" in why
    assert "open, but no drive" in nothing_worth(elsewhere, [], Workspace(place))[0]


def test_the_report_shows_it(place, topobatch) -> None:
    told = json.loads(topobatch("next", "-n", 1, "--json", "-w", place).out)
    assert topobatch("report", "-w", place).code == 0
    page = (place / "report.html").read_text()
    assert "<h2>What to record next</h2>" in page
    assert told[0]["where"] in page
    assert "drive to record, from its number on" in page


def test_the_calls_that_cannot_be(place, topobatch) -> None:
    for call, said in (
        (("next", "nowhere"), "there is no site 'nowhere'"),
        (("next", "-o", "plan.txt"), "ends in .svg, .png, .csv or .geojson"),
        (("next", "--merge", "two"), "is not there"),
    ):
        assert said in topobatch(*call, "-w", place).error(2)
    (place / "merged.json").unlink()
    assert "make it with" in topobatch("next", "-w", place).error(1)
    assert not Path("plan.txt").exists()
