"""Sites by name: given, kept, and what goes by them."""

from __future__ import annotations

import json

import pytest


@pytest.fixture
def place(buildings):
    return buildings


def sites(root):
    """Runs by site, as the merge has it."""
    graph = json.loads((root / "merged.json").read_text())["graph"]
    return {c["site"]: sorted(c["runs"]) for c in graph["components"]}


def largest(root):
    name, runs = max(sites(root).items(), key=lambda item: len(item[1]))
    assert len(runs) > 2
    return name, runs


def test_every_component_has_a_name(place, topobatch) -> None:
    name, runs = largest(place)
    shown = topobatch("list", "-w", place)
    assert any(line.startswith(f"{name}: {len(runs)} runs, ") for line in shown.out.splitlines())
    rows = json.loads(topobatch("list", "--json", "-w", place).out)
    assert {row["run"]: row["site"] for row in rows} == {
        run: site for site, own in sites(place).items() for run in own
    }


def test_a_given_name_is_kept_whatever_happens(place, topobatch) -> None:
    _, runs = largest(place)
    shown = topobatch("site", runs[1], "north", "-w", place)
    assert shown.code == 0
    assert "\nsite north: " in shown.out
    assert sites(place)["north"] == runs
    assert topobatch("rename", runs[0], "zz", "-w", place).code == 0
    assert sites(place)["north"] == sorted([*runs[1:], "zz"])
    assert topobatch("discard", runs[1], "-w", place).code == 0
    assert sites(place)["north"] == sorted([*runs[2:], "zz"])
    (place / "merged.json").unlink()
    assert topobatch("merge", "--all", "-w", place).code == 0
    assert sites(place)["north"] == sorted([*runs[2:], "zz"])
    history = topobatch("history", "-w", place).out
    assert f"north: {', '.join(runs)}" in history
    # By its name it can be called otherwise.
    assert topobatch("site", "north", "annex", "-w", place).code == 0
    assert sites(place)["annex"] == sorted([*runs[2:], "zz"])
    kept = json.loads((place / "sites.json").read_text())["sites"]
    assert [entry["site"] for entry in kept] == ["annex"]


def test_several_sites_are_named_at_once(place, topobatch) -> None:
    before = json.loads((place / "merged.json").read_text())
    recording = (place / "merged.rrd").read_bytes()
    pairs = [word for k, own in enumerate(sites(place).values()) for word in (own[0], f"s-{k}")]
    shown = topobatch("site", *pairs, "-w", place)
    assert shown.code == 0, shown
    after = json.loads((place / "merged.json").read_text())
    named = [c.pop("site") for c in after["graph"]["components"]]
    assert sorted(named) == sorted(pairs[1::2])
    for component in before["graph"]["components"]:
        del component["site"]
    assert after == before
    assert (place / "merged.rrd").read_bytes() != recording
    # None of the names is kept where one of them cannot be.
    given = (place / "sites.json").read_text()
    assert "a run is called so" in topobatch("site", "s-0", "x", "s-1", pairs[0], "-w", place).err
    assert (place / "sites.json").read_text() == given
    assert "is alone" in topobatch("site", "s-0", "-w", place).error(2)


def test_pictures_changes_and_exports_go_by_site(place, topobatch, tmp_path) -> None:
    _, runs = largest(place)
    assert topobatch("site", runs[0], "north", "-w", place).code == 0
    shown = topobatch("draw", "north", tmp_path / "north.svg", "-w", place)
    assert shown.code == 0
    assert f"north: {len(runs)} runs" in (tmp_path / "north.svg").read_text()
    assert topobatch("changes", "north", "-w", place).code == 0
    told = json.loads(topobatch("changes", "--all", "--json", "-w", place).out)
    assert {change["site"] for change in told} <= {*sites(place)}
    page = tmp_path / "report.html"
    assert topobatch("report", page, "-w", place).code == 0
    assert "<td>north</td>" in page.read_text()
    assert topobatch("export", "-f", "nav2", "-w", place).code == 0
    assert sorted(p.name for p in (place / "exports").iterdir()) == sorted(
        f"{site}.geojson" for site in sites(place)
    )
    north = (place / "exports" / "north.geojson").read_text()
    for call in (["--site", "north"], ["north"], ["merged", "--site", "north"]):
        assert topobatch("export", *call, "-f", "nav2", "-o", "-", "-w", place).out == north


def test_the_calls_that_cannot_be(place, topobatch) -> None:
    sorted_sites = sorted(sites(place).items(), key=lambda item: -len(item[1]))
    (one, a), (_, b) = sorted_sites[:2]
    for call, told in (
        (("site", "nobody", "north"), "no run or site named nobody"),
        (("site", a[0], b[0]), "a run is called so"),
        (("site", a[0], "merged"), "a merge is called so"),
        (("rename", b[0], one), "a site is called so"),
        (("site", a[0], "x/y"), "must work as a file name"),
        (("site", a[0], "x:y"), "without a colon"),
        (("changes", "nowhere"), "there is no site 'nowhere'; there are: "),
        (("export", "-f", "nav2", "--site", "nowhere"), "there is no site 'nowhere'"),
        (("export", "-f", "nav2", "--site", one, "--component", 0), "not both"),
        (("export", a[0], "-f", "nav2", "--site", one), "--site goes with the merged map"),
        (("export", "-f", "csv", "-f", "nav2"), "one --format; 2 are given: csv, nav2"),
        (("merge", a[0], "--output", "sites"), "something else is called so"),
    ):
        assert told in topobatch(*call, "-w", place).error(2), call
    assert topobatch("site", a[0], "north", "-w", place).code == 0
    refused = topobatch("site", b[0], "north", "-w", place).error(2)
    assert f"topobatch lock {b[0]} {a[0]} --same" in refused
    assert "did you mean north?" in topobatch("changes", "nort", "-w", place).error(2)


def test_names_of_a_later_version_are_refused_with_the_way_out(place, topobatch) -> None:
    (place / "sites.json").write_text('{"schema": "topobatch.sites/9", "sites": []}')
    (name, *_) = sites(place)
    error = topobatch("site", name, "north", "-w", place).error(1)
    assert "made by a newer topobatch" in error
    assert "name the sites again" in error
