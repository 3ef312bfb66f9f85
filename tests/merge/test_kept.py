"""A merge that finds results of another one: the same bytes, whatever became of these."""

from __future__ import annotations

import sqlite3
import tempfile
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from topobatch.merge.document import write_merged
from topobatch.merge.kept import Kept, Kind
from topobatch.merge.merging import merge_maps
from topobatch.merge.robust import DEFAULT_ROBUST, Means, RobustSettings, tasks
from topobatch.merge.robust.tasks import era_of
from topobatch.merge.workers import Workers


@pytest.fixture(scope="module")
def fleet(maze, other_maze, see):
    """Five maps, of which some share places."""
    quarters = [(maze, 0.0, 0.5), (maze, 0.2, 0.7), (maze, 0.5, 1.0), (other_maze, 0.0, 0.6)]
    maps = []
    for k, (world, low, high) in enumerate(quarters):
        across = np.argsort(np.argsort(world.xy[:, 0])) / len(world.xy)
        rows = np.flatnonzero((across >= low) & (across <= high)).tolist()
        maps.append(see(world, rows, k + 1, f"r{k}"))
    return [*maps, see(other_maze, list(range(40)), 7, "r4")]


def text(maps, means=None):
    """The document as it is written."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "merged.json"
        write_merged(path, merge_maps(maps, means=means))
        return path.read_text()


class Counted(Kept):
    """Remembers what was made anew."""

    def __init__(self, path):
        super().__init__(path, era_of(DEFAULT_ROBUST))
        self.fresh = []

    def add(self, kind, key, data):
        self.fresh.append(kind)
        super().add(kind, key, data)


def merged_with(folder, maps, settle=True):
    kept = Counted(folder / "kept.sqlite")
    out = text(maps, Means(kept=kept))
    kept.flush()
    if settle:
        kept.settle()
    return out, kept.fresh


def test_only_pairs_with_the_new_map_are_matched(fleet, tmp_path):
    _, before = merged_with(tmp_path, fleet[:4])
    assert before.count(Kind.PAIR) == 6
    assert before.count(Kind.ITSELF) == 4
    out, fresh = merged_with(tmp_path, fleet)
    assert out == text(fleet)
    assert fresh.count(Kind.PAIR) == 4
    assert fresh.count(Kind.ITSELF) == 1
    again, nothing = merged_with(tmp_path, fleet)
    assert again == out
    assert nothing == []


def test_a_folder_of_several_buildings_merges_anew_as_it_grew(mixed, tmp_path):
    for count in (2, 3, 4, 7, len(mixed)):
        out, _ = merged_with(tmp_path, mixed[:count])
    assert out == text(mixed)


def test_a_run_by_another_name_is_not_matched_again(fleet, tmp_path):
    merged_with(tmp_path, fleet)
    maps = [*fleet[:4], replace(fleet[4], run="r9")]
    out, fresh = merged_with(tmp_path, maps)
    assert not {Kind.PAIR, Kind.ITSELF} & set(fresh)
    assert out == text(maps)


@pytest.mark.parametrize("harm", ["flip", "cut", "empty", "junk", "gone", "row", "type", "null"])
def test_damage_costs_time_only(fleet, tmp_path, harm):
    right, _ = merged_with(tmp_path, fleet)
    path = tmp_path / "kept.sqlite"
    data = bytearray(path.read_bytes())
    for at in range(len(data) // 3, len(data), 1000):
        data[at] ^= 4
    whole = path.read_bytes()
    content = {"cut": whole[: len(whole) // 2], "empty": b"", "junk": b"SQLite" * 999}
    path.write_bytes(content.get(harm, bytes(data) if harm == "flip" else whole))
    if harm == "gone":
        path.unlink()
    elif harm in ("row", "type", "null"):
        with sqlite3.connect(path) as database:
            data = {"row": "zeroblob(99)", "type": "3.5", "null": "NULL"}[harm]
            database.execute(f"UPDATE result SET data = {data} WHERE rowid % 2")
    out, fresh = merged_with(tmp_path, fleet)
    assert out == right
    assert fresh
    assert merged_with(tmp_path, fleet)[1] == []


def test_what_belongs_to_no_map_is_dropped(fleet, tmp_path):
    merged_with(tmp_path, fleet)
    size = (tmp_path / "kept.sqlite").stat().st_size
    out, _ = merged_with(tmp_path, fleet[:2])
    assert (tmp_path / "kept.sqlite").stat().st_size < size / 2
    assert merged_with(tmp_path, fleet[:2]) == (out, [])


def test_settings_and_program_make_another_era(monkeypatch):
    plain = era_of(DEFAULT_ROBUST)
    assert era_of(RobustSettings(hypotheses=4)) != plain
    assert era_of(RobustSettings(false_merge_rate=0.01)) == plain
    monkeypatch.setattr(tasks, "program_digest", lambda *_: b"other")
    assert era_of(DEFAULT_ROBUST) != plain


def test_results_of_another_era_are_not_used(tmp_path):
    one, key = Kept(tmp_path / "k", b"one"), (b"a" * 16, b"b" * 16)
    one.add(Kind.PAIR, key, b"result")
    one.flush()
    assert list(Kept(tmp_path / "k", b"one").find(Kind.PAIR, [key, (key[0], key[0])])) == [
        b"result",
        None,
    ]
    assert list(Kept(tmp_path / "k", b"two").find(Kind.PAIR, [key])) == [None]
    Kept(tmp_path / "k", b"two").settle()
    assert list(Kept(tmp_path / "k", b"one").find(Kind.PAIR, [key])) == [None]


def test_several_write_to_one_file(tmp_path):
    several = [Kept(tmp_path / "k") for _ in range(3)]
    for k, kept in enumerate(several):
        kept.add(Kind.PAIR, (bytes([k]), b""), b"%d" % k)
        kept.flush()
    keys = [(bytes([k]), b"") for k in range(3)]
    for kept in several:
        assert list(kept.find(Kind.PAIR, keys)) == [b"0", b"1", b"2"]


@pytest.mark.parametrize("what", ["folder", "table"])
def test_a_file_that_cannot_be_written_is_told(fleet, tmp_path, what):
    path, heard = tmp_path / "kept.sqlite", []
    if what == "folder":
        path.mkdir()
    else:
        with sqlite3.connect(path) as database:
            database.execute("CREATE TABLE result (other TEXT)")
    kept = Kept(path, era_of(DEFAULT_ROBUST), heard.append)
    assert text(fleet[:2], Means(kept=kept)) == text(fleet[:2])
    kept.flush()
    kept.settle()
    (told,) = heard
    assert "results are not kept" in told


@pytest.mark.parametrize("sent", [True, False])
def test_workers_give_the_same_bytes(fleet, tmp_path, sent):
    by_run = {m.run: m for m in fleet}

    class Maps:
        def read_map(self, run):
            return by_run[run]

    with ThreadPoolExecutor(2) as pool:
        kept = Counted(tmp_path / "kept.sqlite")
        means = Means(Workers(lambda: nullcontext(pool)), maps=None if sent else Maps(), kept=kept)
        assert text(fleet, means) == text(fleet)
    assert kept.fresh.count(Kind.PAIR) == 10
