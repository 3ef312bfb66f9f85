"""A merge of nothing new: said again, and made where anything is not as it was."""

import json
import shutil
from itertools import combinations

import pytest

from topobatch.cli import unchanged
from topobatch.merge.locks import discards_to_document

from .conftest import nameless

NOTHING_NEW = "nothing is new"


@pytest.fixture(scope="module")
def merged(tmp_path_factory, fleet_maps):
    """A workspace with three maps; whoever asks for it first merges them."""
    root = tmp_path_factory.mktemp("merged")
    fleet_maps(root / "maps", 3)
    return root


@pytest.fixture
def place(merged, topobatch, tmp_path):
    topobatch("merge", "--all", "-w", merged)
    shutil.copytree(merged, tmp_path / "ws")
    return tmp_path / "ws"


def files(place):
    return {path.name: path.read_bytes() for path in (place / "merged.json", place / "merged.rrd")}


def test_nothing_new_is_not_merged_but_said_again_and_noted(topobatch, place):
    (place / "cache" / "merged" / "merged.json").unlink()
    first = topobatch("merge", "--all", "-v", "-w", place)
    before, noted = files(place), (place / "history.jsonl").read_text().splitlines()
    again = topobatch("merge", "--all", "-v", "-w", place)
    assert NOTHING_NEW in again.err
    assert (again.code, again.out) == (0, first.out)
    assert files(place) == before
    after = (place / "history.jsonl").read_text().splitlines()
    assert len(after) == len(noted) + 1
    assert json.loads(after[-1])["text"] == json.loads(noted[-1])["text"]
    assert topobatch("merge", "--all", "-q", "-w", place).out == ""


def test_a_merge_says_that_junctions_have_other_numbers(topobatch, place):
    assert "other numbers" not in topobatch("merge", "--all", "-w", place).out
    for a, b in combinations(sorted(p.stem for p in (place / "maps").glob("*.json")), 2):
        topobatch("lock", a, b, "--never", "-w", place)
    merged = topobatch("merge", "--all", "-w", place).out
    assert "\njunctions of sites have other numbers now; draw and export them again" in merged


@pytest.mark.parametrize(
    "change",
    ["map", "new map", "gone map", "lock", "discard", "option", "document", "recording", "program"],
)
def test_whatever_is_new_is_merged(topobatch, place, tmp_path, monkeypatch, change):
    options = []
    path = sorted((place / "maps").glob("*.json"))[0]
    runs = sorted(p.stem for p in (place / "maps").glob("*.json"))
    if change == "map":
        path.write_bytes(path.read_bytes() + b"\n")
    elif change == "new map":
        document = path.read_text().replace(f'"{path.stem}"', '"another"')
        path.with_name("another.json").write_text(document)
    elif change == "gone map":
        path.unlink()
        options = ["--replace"]
    elif change == "lock":
        topobatch("lock", *runs[:2], "--never", "-w", place)
    elif change == "discard":
        discards = discards_to_document([tuple(runs[:2])])
        (place / "discards.json").write_text(json.dumps(discards))
    elif change == "option":
        options = ["--false-merge-rate", "0.01"]
    elif change == "document":
        (place / "merged.json").write_bytes(files(place)["merged.json"] + b" ")
    elif change == "recording":
        (place / "merged.rrd").unlink()
    else:
        monkeypatch.setattr(unchanged, "FOLDERS", ("topology",))
    called = topobatch("merge", "--all", *options, "-v", "-w", place)
    assert called.code == 0, called
    assert NOTHING_NEW not in called.err
    assert NOTHING_NEW in topobatch("merge", "--all", *options, "-v", "-w", place).err
    here = nameless(place)
    shutil.rmtree(place / "cache")
    (place / "merged.json").unlink()
    topobatch("merge", "--all", *options, "-w", place)
    assert nameless(place) == here
