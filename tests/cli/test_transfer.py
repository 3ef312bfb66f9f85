"""`topobatch transfer`: tables in, tables out, and what is said of what stays behind."""

from __future__ import annotations

import csv
import io
from dataclasses import replace

import numpy as np
import pytest

from topobatch.cli.workspace import Workspace
from topobatch.merge.document import write_merged
from topobatch.merge.merging import merge_maps
from topobatch.topology.document import write_map
from topobatch.topology.se2 import apply
from topobatch.topology.topomap import TopoMap

from ..maps import straight_map

T = np.array([12.0, -7.0, 0.6])
LENGTHS = (7.0, 11.0, 5.0, 8.5, 13.0, 6.2, 9.7, 4.4)


def comb(run: str, pose: np.ndarray, *, stretch: float = 1.0) -> TopoMap:
    """A street with side streets of all lengths, one to a side, as a map in a frame of its own."""
    x = np.concatenate([[0.0], np.cumsum(LENGTHS)]) * stretch
    stem = np.column_stack([x, np.zeros(len(x))])
    tips = stem[1:-1] + np.column_stack([np.zeros(7), [3.1, -5.2, 7.3, -4.4, 2.6, 8.8, -6.1]])
    ends = [(i, i + 1) for i in range(8)] + [(i + 1, 9 + i) for i in range(7)]
    return straight_map(run, [*stem, *tips], ends, T=pose)


@pytest.fixture
def place(tmp_path) -> Workspace:
    """Two maps of one street, a third of somewhere else, merged."""
    found = Workspace(tmp_path / "ws")
    elsewhere = comb("else", np.zeros(3), stretch=1.9)
    maps = [comb("one", np.zeros(3)), comb("two", T), elsewhere]
    for m in maps:
        write_map(found.map_json(m.run), m)
    result = merge_maps(maps)
    assert len(result.components) == 2
    write_merged(found.merged_json, result)
    return found


@pytest.fixture
def table(tmp_path):
    def write(text: str):
        path = tmp_path / "places.csv"
        path.write_text(text)
        return path

    return write


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_places_are_carried_with_what_they_are(topobatch, place, table) -> None:
    path = table('name,x,y,theta,colour\n"dock, east",20,1,0.5,red\nlift,3,-1,,blue\n')
    shown = topobatch("transfer", path, "--from", "one", "--to", "two", "-w", place.root)
    assert (shown.code, shown.err) == (0, "")
    dock, lift = rows_of(shown.out)
    assert (dock["name"], dock["colour"], dock["note"]) == ("dock, east", "red", "")
    there = apply(T, np.array([(20.0, 1.0)]))[0]
    assert np.allclose([float(dock["x"]), float(dock["y"])], there, atol=0.05)
    assert float(dock["theta"]) == pytest.approx(1.1, abs=0.03)
    assert (lift["theta"], lift["sigma_rad"]) == ("", "")
    back = topobatch("transfer", table(shown.out), "--from", "two", "--to", "merged", "-w",
                     place.root, "-o", place.root / "there.csv")  # fmt: skip
    assert back.code == 0
    again = rows_of((place.root / "there.csv").read_text())
    assert np.allclose([float(again[0]["x"]), float(again[0]["y"])], [20, 1], atol=0.05)
    result = place.read_result()
    named = tuple(replace(c, site=f"site-{min(c.poses)}") for c in result.components)
    write_merged(place.merged_json, replace(result, components=named))
    call = ("transfer", table(shown.out), "--from", "two", "-w", place.root, "--to")
    assert rows_of(topobatch(*call, "site-one").out) == again
    assert "two is of the site site-one, not of site-else" in topobatch(*call, "site-else").error(1)


def test_what_cannot_be_carried_is_said_line_by_line(topobatch, place, table) -> None:
    path = table("name,x,y\nnear,20,1\nfar,900,900\n")
    shown = topobatch("transfer", path, "--from", "one", "--to", "two", "-w", place.root)
    assert shown.code == 1
    near, far = rows_of(shown.out)
    assert near["x"]
    assert (far["x"], far["y"]) == ("", "")
    (line,) = shown.err.strip().splitlines()
    assert f"{path}:3: far: not carried: the nearest matched junction is" in line
    apart = topobatch("transfer", path, "--from", "one", "--to", "else", "-w", place.root)
    assert "nothing was carried: one and else are not merged: unrelated" in apart.error(1)
    assert apart.out.count("are not merged: unrelated") == 2
    assert [row["x"] for row in rows_of(apart.out)] == ["", ""]


def test_runs_of_one_site_without_a_common_junction(topobatch, place, table, monkeypatch) -> None:
    monkeypatch.setattr("topobatch.cli.transfer.junctions_of_runs", lambda *_: [])
    path = table("name,x,y\ndock,20,1\n")
    call = ("transfer", path, "--from", "one", "--to", "two", "-w", place.root)
    told = topobatch(*call).error(1)
    assert "no junction of one is matched to one of two; --to 'component 1' carries" in told


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("name,x\na,1\n", ":1: has no column 'y'"),
        ("name;x;y\na;1;2\n", "the first line is 'name;x;y', and must be name,x,y"),
        ("name,x,y\na,1,oops\n", ":2: y is 'oops', not a number"),
        ("name,x,y\na,1,nan\n", "which is nowhere"),
        ("name,x,y\na,1,-1e11\n", "which is nowhere"),
        ("name,x,y\na,1\n", ":2: has more or fewer values"),
        ("name,x,y\n", "holds no place"),
        ("name,x,y\n" + "a,1,2\n" * 100_001, "holds more than 100,000 places"),
        ('name,x,y\n"a,1,2\n', "is not CSV"),
    ],
)
def test_tables_that_are_none(topobatch, place, table, text, told) -> None:
    call = ("transfer", table(text), "--from", "one", "--to", "two", "-w", place.root)
    assert told in topobatch(*call).error(1)


def test_calls_that_cannot_be(topobatch, place, table) -> None:
    path, w = table("name,x,y\na,1,2\n"), ("-w", place.root)
    loop = path.with_name("loop.csv")
    loop.symlink_to(loop)
    assert "itself" in topobatch("transfer", loop, "--from", "one", "--to", "two", *w).error(1)
    assert "already" in topobatch("transfer", path, "--from", "one", "--to", "one", *w).error(2)
    assert "no map of x" in topobatch("transfer", path, "--from", "x", "--to", "one", *w).error(2)
    one = place.read_map("one")
    write_map(place.map_json("one"), replace(one, observation_time_ns=one.observation_time_ns + 1))
    changed = topobatch("transfer", path, "--from", "one", "--to", "two", *w).error(1)
    assert "merge again" in changed
    write_map(place.map_json("new"), replace(one, run="new"))
    assert "no run 'new'; merge" in topobatch(
        "transfer", path, "--from", "new", "--to", "one", *w
    ).error(2)
    place.merged_json.unlink()
    assert "merge --all" in topobatch("transfer", path, "--from", "one", "--to", "two", *w).error(1)
