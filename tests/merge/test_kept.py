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
from topobatch.merge.robust import DEFAULT_ROBUST, Means
from topobatch.merge.robust.pairing import era_of
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


def test_a_run_by_another_name_is_not_matched_again(fleet, tmp_path):
    merged_with(tmp_path, fleet)
    maps = [*fleet[:4], replace(fleet[4], run="r9")]
    out, fresh = merged_with(tmp_path, maps)
    assert not {Kind.PAIR, Kind.ITSELF} & set(fresh)
    assert out == text(maps)


@pytest.mark.parametrize("harm", ["flip", "junk", "gone", "row"])
def test_damage_costs_time_only(fleet, tmp_path, harm):
    right, _ = merged_with(tmp_path, fleet)
    path = tmp_path / "kept.sqlite"
    data = bytearray(path.read_bytes())
    for at in range(len(data) // 3, len(data), 1000):
        data[at] ^= 4
    whole = path.read_bytes()
    path.write_bytes({"junk": b"SQLite" * 999, "flip": bytes(data)}.get(harm, whole))
    if harm == "gone":
        path.unlink()
    elif harm == "row":
        with sqlite3.connect(path) as database:
            database.execute("UPDATE result SET data = zeroblob(99) WHERE rowid % 2")
    out, fresh = merged_with(tmp_path, fleet)
    assert out == right
    assert fresh
    merged_with(tmp_path, fleet)  # what is found damaged last is kept by the next merge
    assert merged_with(tmp_path, fleet)[1] == []


def test_workers_give_the_same_bytes(fleet, tmp_path):
    by_run = {m.run: m for m in fleet}
    with ThreadPoolExecutor(2) as pool:
        kept = Counted(tmp_path / "kept.sqlite")
        means = Means(Workers(lambda: nullcontext(pool)), by_run.__getitem__, kept)
        assert text(fleet, means) == text(fleet)
    assert kept.fresh.count(Kind.PAIR) == 10
